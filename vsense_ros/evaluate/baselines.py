"""Simpler ways to the same signals: what an observer has to beat to be worth its cost."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import pymap3d
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.evaluate.metrics import SignalScore, score
from vsense_ros.evaluate.signals import (
    SIGNALS,
    SLOWEST_SIDE_SLIP,
    Array,
    Series,
    find_channel,
    make_series,
    read_signals,
)
from vsense_ros.messages.recording import Channel, Recording

Scores = dict[str, SignalScore]


def score_all(estimates: Iterable[Series], recording: Recording) -> Scores:
    """Scores of some series against the reference of a recording, by signal."""
    truths = read_signals(recording, "reference")
    scores = {
        series.signal.name: score(series, truths[series.signal.name])
        for series in estimates
        if series.signal.name in truths
    }
    return {name: result for name, result in scores.items() if result is not None}


def wheel_speed(recording: Recording, rolling_radius: float) -> list[Series]:
    """The car's own speed: mean of its wheel speeds times a rolling radius [m]."""
    channel = find_channel(recording, "vehicle/wheel_speeds")
    if channel is None:
        return []
    return [make_series(SIGNALS["speed"], channel, rolling_radius * _mean(channel.columns["velocity"]))]


def gyro(recording: Recording) -> list[Series]:
    """The yaw rate as the gyro measures it."""
    channel = find_channel(recording, "imu/data")
    if channel is None:
        return []
    return [make_series(SIGNALS["yaw_rate"], channel, channel.columns["angular_velocity"][:, 2:])]


ZERO, CONSTANT = "zero", "mean"
_ABOUT_ZERO = ("side_slip", "lateral_velocity", "roll", "pitch", "vertical_acceleration")


def trivial(recording: Recording) -> dict[str, tuple[str, SignalScore]]:
    """What costs nothing, for each signal of the reference: its name in words, and its score.

    The last reading of the sensor that measures the signal, as it is: GNSS for speed, course and position, the gyro
    and the accelerometers; zero for angles and velocities that are small on most drives; else the mean of the truth,
    which nobody knows beforehand. How late a reading is, they do not have.
    """
    truths = read_signals(recording, "reference")
    readings = {reading.signal.name: (label, reading) for label, reading in _raw_readings(recording, truths)}
    costless = {}
    for name, truth in truths.items():
        label, estimate = readings.get(name, (ZERO, _level(truth, 0.0)))
        if name not in readings and name not in _ABOUT_ZERO:
            label, estimate = CONSTANT, _level(truth, truth.value.mean(axis=0))
        result = score(estimate, truth, with_lag=False)
        if result is not None:
            costless[name] = label, result
    return costless


def _level(truth: Series, value: Array | float) -> Series:
    return Series(truth.signal, truth.stamp, np.broadcast_to(value, truth.value.shape).astype(float))


def _raw_readings(recording: Recording, truths: Mapping[str, Series]) -> Iterator[tuple[str, Series]]:
    """The last readings of sensors at the stamps of the truth, each with its name."""
    channels = {topic: find_channel(recording, topic) for topic in ("imu/data", "gps/velocity", "gps/fix")}
    imu, velocity, fix = channels.values()
    values: list[tuple[str, str, Channel, Array]] = []
    if imu is not None and "angular_velocity" in imu.columns:
        values.append(("yaw_rate", "gyro", imu, imu.measured["angular_velocity"][:, 2:]))
    if imu is not None and "linear_acceleration" in imu.columns:
        for axis, name in enumerate(("longitudinal", "lateral")):
            forces = imu.measured["linear_acceleration"][:, axis : axis + 1]
            values.append((f"{name}_acceleration", "sensor", imu, forces))
    if velocity is not None:
        east, north = velocity.columns["linear"][:, 0], velocity.columns["linear"][:, 1]
        for name in ("speed", "longitudinal_velocity"):
            values.append((name, "GNSS", velocity, np.hypot(east, north)[:, None]))
        course = np.where(np.hypot(east, north) > SLOWEST_SIDE_SLIP, np.arctan2(north, east), np.nan)
        values.append(("yaw", "course", velocity, course[:, None]))
    if fix is not None and recording.map_origin is not None:
        columns = [fix.columns[name][:, 0] for name in ("latitude", "longitude", "altitude")]
        east, north, _ = pymap3d.geodetic2enu(columns[0], columns[1], np.nan_to_num(columns[2]), *recording.map_origin)
        values.append(("position", "fix", fix, np.column_stack([east, north])))
    for name, label, channel, value in values:
        series = make_series(SIGNALS[name], channel, value)
        if name in truths and len(series):
            stamp = truths[name].stamp[truths[name].stamp >= series.stamp[0]]
            last = np.searchsorted(series.stamp, stamp, side="right") - 1
            yield label, Series(series.signal, stamp, series.value[last])


def fit_regression(laps: Iterable[Recording]) -> Array:
    """Coefficients (4,) of v_y = c0 + c1 v + c2 ψ̇ + c3 ψ̇ v², by least squares over the reference of all laps.

    This is the steady-state single-track model: c2 is the distance from the rear axle, c3 the compliance of the rear
    tyres (mass by axle load over cornering stiffness), c1 the mounting angle of the reference.
    Raises `InputError` if a lap has no lateral velocity or no gyro.
    """
    rows = [_regressors(lap) for lap in laps]
    matrix = np.vstack([regressors for _, regressors, _ in rows])
    lateral = np.concatenate([odometry.columns["linear"][:, 1] for odometry, _, _ in rows])
    finite = np.isfinite(lateral) & np.isfinite(matrix).all(axis=1)
    coefficients, *_ = np.linalg.lstsq(matrix[finite], lateral[finite], rcond=None)
    return np.asarray(coefficients, dtype=np.float64)


def regression(recording: Recording, coefficients: Array) -> list[Series]:
    """Lateral velocity and side slip by the coefficients of `fit_regression`, at the stamps of the reference."""
    odometry, regressors, speed = _regressors(recording)
    return _lateral(odometry, regressors @ coefficients, speed)


def kinematic(recording: Recording, cog_to_rear_axle: float) -> list[Series]:
    """Lateral velocity and side slip of a car whose rear wheels roll where they point: v_y = l_r ψ̇.

    `cog_to_rear_axle` is l_r [m].
    """
    odometry, regressors, speed = _regressors(recording)
    return _lateral(odometry, cog_to_rear_axle * regressors[:, 2], speed)


def _regressors(recording: Recording) -> tuple[Channel, Array, Array]:
    """Reference, (n, 4) of 1, v, ψ̇, ψ̇ v², and the longitudinal velocity (n,), at the stamps of the reference.

    The speed is that of the reference, which a GNSS receiver measures well; the yaw rate is the car's own.
    """
    odometry, imu = find_channel(recording, "reference/odometry"), find_channel(recording, "imu/data")
    if odometry is None or imu is None:
        raise InputError(
            f"{recording.name}: a regression needs reference/odometry and imu/data, found "
            f"{', '.join(sorted(recording.channels)) or 'nothing'}"
        )
    linear = odometry.columns["linear"]
    speed = np.hypot(linear[:, 0], linear[:, 1])
    yaw_rate = np.interp(odometry.stamp, imu.stamp, imu.columns["angular_velocity"][:, 2])
    return odometry, np.column_stack([np.ones_like(speed), speed, yaw_rate, yaw_rate * speed**2]), linear[:, 0]


def _lateral(odometry: Channel, lateral: Array, longitudinal: Array) -> list[Series]:
    slip = np.where(longitudinal > SLOWEST_SIDE_SLIP, np.arctan2(lateral, longitudinal), np.nan)
    return [
        make_series(SIGNALS["lateral_velocity"], odometry, lateral[:, None]),
        make_series(SIGNALS["side_slip"], odometry, slip[:, None]),
    ]


def _mean(value: NDArray[np.float64]) -> Array:
    return np.asarray(value.mean(axis=1, keepdims=True), dtype=np.float64)


def by_label(*labelled: tuple[str, Scores]) -> Mapping[str, Scores]:
    """The baselines that have a score, by label."""
    return {label: scores for label, scores in labelled if scores}
