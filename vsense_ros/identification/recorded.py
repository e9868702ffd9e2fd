"""Drives for the handling models from recordings: signals of the car's own sensors, 100 times a second.

Sensors are read as the observer reads them (units, offsets, latency, mounting), accelerations are taken to the centre
of gravity, and wheels are compared with one another: their radii differ by more than their slip.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.noise import white_noise
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.identification.best import SETTINGS as BEST
from vsense_ros.identification.rinsing import Drive, independent, low_passed
from vsense_ros.identification.smoothing import smoothed
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase, best_measuring
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class RecordedSettings:
    """Bounds of the parts of recordings that are identified: decisions of this project."""

    step: float = 0.01  # [s]
    least_speed: float = 5.0  # [m/s] below which nothing is identified
    shortest: float = 10.0  # [s] of driving without a gap
    longest_gap: float = 0.3  # [s] between two samples of a sensor, beyond which there is a gap
    spin_angle: float = 20.0  # [°] of side slip, as yaw rate and speed and lateral acceleration have it, that is a spin
    straight_yaw_rate: float = 0.02  # [rad/s] up to which a car is taken to roll straight
    coasting_acceleration: float = 0.5  # [m/s²] up to which it is taken to roll freely


RECORDED = RecordedSettings()


@dataclass(frozen=True)
class Signals:
    """Signals of one recording on common instants `t` (N,) [s]: road-wheel angle (N,), wheel spins (N, 4), speed
    (N,), accelerations and rates at the centre of gravity in the axes of the car (N, 3); None where no sensor
    measures them."""

    name: str
    t: Array
    steering: Array
    speed: Array
    spins: Array | None
    forces: Array
    rates: Array
    known: Mask  # (N,) where all that is needed is there


def signals(recording: Recording, vehicle: Vehicle) -> Signals:
    """Raises `InputError` where a sensor is missing without which nothing can be identified."""
    name = recording.name or "recording"
    sensors, on_map = vehicle.sensing(), Map(recording.map_origin)
    measured = {
        key: measurements
        for key, sensor in sensors.items()
        if (measurements := _read(recording, sensor, on_map)) is not None
    }
    steering = _pick(measured, sensors, "steering", name, "a steering angle, which drives every model")
    imu = _pick(measured, sensors, "rates and forces", name, "accelerations and rates")
    wheels = best_measuring(((key, sensors[key]) for key in measured), "rolling speed")
    ground = best_measuring(((key, sensors[key]) for key in measured), "ground speed")
    if wheels is None and ground is None:
        raise InputError(f"{name}: expected wheel speeds or a GNSS velocity, found neither in the recording")
    begin = max(
        measurements[0][0] for key, measurements in measured.items() if key in (steering, imu, wheels or ground)
    )
    end = min(measurements[0][-1] for key, measurements in measured.items() if key in (steering, imu, wheels or ground))
    t = np.arange(begin, end, RECORDED.step)
    covered = np.ones(len(t), dtype=bool)

    def on_clock(key: str) -> Array:
        stamps, value = measured[key]
        nearest = np.searchsorted(stamps, t).clip(1, len(stamps) - 1)
        covered[:] &= stamps[nearest] - stamps[nearest - 1] < RECORDED.longest_gap
        return np.column_stack([_interpolated(t, stamps, column) for column in value.T])

    inertial = on_clock(imu)
    rates, forces = inertial[:, :3], inertial[:, 3:6]
    angle = on_clock(steering)[:, 0]
    radii = rolling_radii(vehicle)
    spins = None if wheels is None else on_clock(wheels)
    if spins is not None and np.isfinite(spins).all():
        speed = np.median(spins * radii, axis=1)
        spins = _alike(spins, radii, rates[:, 2], speed)
    else:
        key = ground or wheels
        assert key is not None
        spins = None
        speed = sensors[key].speeds(*_of_speed(measured, key, radii))
        speed = np.interp(t, measured[key][0][np.isfinite(speed)], speed[np.isfinite(speed)])
    lever = np.asarray(getattr(sensors[imu], "position", (0.0, 0.0, 0.0)))
    forces = _at_cog(forces, np.nan_to_num(rates), lever)
    return Signals(name, t, angle, speed, spins, forces, rates, covered & (speed > RECORDED.least_speed))


def _of_speed(measured: Mapping[str, tuple[Array, Array]], key: str, radii: Array) -> tuple[Array, Array]:
    return measured[key][1], radii


def _read(recording: Recording, sensor: SensorBase, on_map: Map) -> tuple[Array, Array] | None:
    """Times [s] and measurements (N, m) in the axes of the car; None where there are none."""
    if sensor.topic not in recording or len(recording[sensor.topic]) < 2:
        return None
    measurements = Reader(0, sensor, on_map).measurements(recording[sensor.topic])
    if len(measurements.stamp) < 2:
        return None
    stamps, measured = _joined(measurements.stamp, measurements.value)
    return np.asarray((stamps - recording.first_stamp) * 1e-9, dtype=np.float64), sensor.in_axes_of_car(measured)


def _joined(stamps: NDArray[np.int64], value: Array) -> tuple[NDArray[np.int64], Array]:
    """Stamps in order, each once, and measurements (N, m): of messages with one stamp the first number that is there,
    as rates and accelerations may come in two frames."""
    once, place = np.unique(stamps, return_inverse=True)
    merged = np.full((len(once), value.shape[1]), np.nan)
    for column in range(value.shape[1]):
        finite = np.flatnonzero(np.isfinite(value[:, column]))[::-1]
        merged[place[finite], column] = value[finite, column]
    return once, merged


def _pick(
    measured: Mapping[str, object], sensors: Mapping[str, SensorBase], quantity: str, name: str, needed: str
) -> str:
    chosen = best_measuring(((key, sensors[key]) for key in measured), quantity)  # type: ignore[arg-type]
    if chosen is None:
        raise InputError(f"{name}: expected {needed}; no sensor of the vehicle file gives it in this recording")
    return chosen


def _interpolated(t: Array, stamps: Array, value: Array) -> Array:
    finite = np.isfinite(value)
    return np.interp(t, stamps[finite], value[finite]) if finite.sum() > 1 else np.full(len(t), np.nan)


def _alike(spins: Array, radii: Array, yaw_rate: Array, speed: Array) -> Array:
    """Spins (N, 4) that all wheels would have with the mean radius, if they rolled alike straight ahead."""
    pace = np.gradient(speed, RECORDED.step)
    smooth = np.convolve(pace, np.ones(50) / 50, "same")
    free = (
        (np.abs(yaw_rate) < RECORDED.straight_yaw_rate)
        & (np.abs(smooth) < RECORDED.coasting_acceleration)
        & (speed > RECORDED.least_speed)
    )
    rolling = spins * radii
    if free.sum() > 1.0 / RECORDED.step:
        rolling = rolling / np.median(rolling[free] / rolling[free].mean(axis=1)[:, None], axis=0)
    return rolling / radii.mean()


def _at_cog(forces: Array, rates: Array, lever: Array) -> Array:
    """Specific forces (N, 3) at the centre of gravity, of a sensor that sits at `lever` [m] from it."""
    if not lever.any():
        return forces
    turning = np.gradient(low_passed(rates, RECORDED.step, 10.0), RECORDED.step, axis=0)
    return forces - np.cross(turning, lever) - np.cross(rates, np.cross(rates, np.broadcast_to(lever, rates.shape)))


def _refuse_absent(outputs: Array, model: str, name: str) -> None:
    """Raises `InputError` where a recording lacks a signal (N, m) that a model is compared with."""
    along, across = ("longitudinal acceleration",), ("lateral acceleration", "roll rate", "yaw rate")
    names = (*along, *across) if model == "best" else across[::2]
    absent = [one for one, column in zip(names, outputs.T, strict=True) if not np.isfinite(column).any()]
    if absent:
        hint = "; the model single_track needs no roll rate" if absent == ["roll rate"] else ""
        lacking = " and no ".join(absent)
        raise InputError(f"{name}: there is no {lacking}, with which the model {model} is compared{hint}")


def drives(signals_of_drives: Sequence[Signals], model: str) -> list[Drive]:
    """The longest stretch of each recording without a gap, for the model "best" or "single_track". Raises `InputError`
    where there is none, or a sensor is missing that the model needs."""
    stretches = []
    for recorded in signals_of_drives:
        if model == "best":
            spins = _need(recorded.spins, recorded.name, "the speeds of all four wheels")
            inputs = np.column_stack([recorded.steering, spins])
            outputs = np.column_stack([recorded.forces[:, :2], recorded.rates[:, [0, 2]]])
        else:
            inputs = np.column_stack([recorded.steering, recorded.speed])
            outputs = np.column_stack([recorded.forces[:, 1], recorded.rates[:, 2]])
        _refuse_absent(outputs, model, recorded.name)
        stretch = _longest(recorded.known & np.isfinite(inputs).all(axis=1) & np.isfinite(outputs).all(axis=1))
        if (stretch.stop - stretch.start) * RECORDED.step < RECORDED.shortest:
            raise InputError(
                f"{recorded.name}: nowhere {RECORDED.shortest:g} s of driving above {RECORDED.least_speed:g} m/s "
                "without a gap in a sensor; record a longer drive"
            )
        _refuse_spin(recorded, stretch)
        cut_off = cut_off_of(recorded, stretch)
        inputs, raw = inputs[stretch], outputs[stretch]
        # The steering angle is the first input of both models.
        inputs[:, 0] = smoothed(inputs[:, 0], white_noise(inputs[:, 0]), RECORDED.step)
        inputs, outputs = (low_passed(values, RECORDED.step, cut_off) for values in (inputs, raw))
        start = np.zeros(13 if model == "best" else 4)
        if model == "best":
            start[0], start[2] = (
                recorded.speed[stretch.start],
                _mean(recorded.rates[stretch.start : stretch.start + 20, 2]),
            )
        else:
            start[1] = outputs[0, 1]
        begin, sample_spacing = float(recorded.t[stretch.start]), independent(RECORDED.step, cut_off)
        noise = left_by(cut_off, raw - outputs)
        stretches.append(
            Drive(
                recorded.name, RECORDED.step, inputs, outputs, np.nan_to_num(start), begin, sample_spacing, tuple(noise)
            )
        )
    return stretches


def _mean(values: Array) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else 0.0


def _need(value: Array | None, name: str, needed: str) -> Array:
    if value is None:
        raise InputError(f"{name}: this model needs {needed}; use --model single_track, which needs a speed alone")
    return value


def left_by(cut_off: float, taken_away: Array) -> Array:
    """Standard deviations (m,) of the noise that a low-pass with a cut-off [Hz] leaves in columns of which it took
    (N, m) away: of white noise the share of the band that it lets through."""
    nyquist = 0.5 / RECORDED.step
    return np.asarray(taken_away.std(axis=0) * np.sqrt(cut_off / (nyquist - cut_off)))


def cut_off_of(recorded: Signals, stretch: slice) -> float:
    """Cut-off frequency of the low-pass [Hz]: lower for everyday driving, in which slip is small beside the noise of
    the wheels."""
    return BEST.everyday_cut_off if _strongest(recorded, stretch) < BEST.everyday_acceleration else BEST.cut_off


def _strongest(recorded: Signals, stretch: slice) -> float:
    """Acceleration in the plane that is exceeded for one per cent of the time [m/s²]."""
    plane = low_passed(np.nan_to_num(recorded.forces[stretch, :2]), RECORDED.step, 1.0)
    return float(np.percentile(np.hypot(*plane.T), 99))


def _longest(good: Mask) -> slice:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    if not len(edges):
        return slice(0, 0)
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    return slice(int(begins[longest]), int(ends[longest]))


def _refuse_spin(recorded: Signals, stretch: slice) -> None:
    """Raises `InputError` where the car spins: where its yaw rate is far beyond what its path turns."""
    part = slice(stretch.start, stretch.stop)
    path = low_passed(np.nan_to_num(recorded.forces[part, 1:2]), RECORDED.step, 1.0)[:, 0] / recorded.speed[part]
    yaw = low_passed(np.nan_to_num(recorded.rates[part, 2:3]), RECORDED.step, 1.0)[:, 0]
    excess_yaw_rate = np.abs(yaw) - np.abs(path) - 0.15
    slip = np.degrees(np.convolve(np.clip(excess_yaw_rate, 0, None), np.ones(100), "same") * RECORDED.step)
    if slip.max() > RECORDED.spin_angle:
        seconds = recorded.t[part][int(np.argmax(slip))]
        raise InputError(
            f"{recorded.name}: at {seconds:.1f} s the car turns {slip.max():.0f}° beyond its path within a second: a "
            "spin, in which no parameter of its tyres can be determined; leave that part out"
        )
