"""An ordinary drive on one clock, as calibration looks at it: sensors only, in the axes in which they are mounted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate, signal

from vsense_ros.checks.motion import ROAD_WHEEL, STEERING_WHEEL
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.sensors import Imu, Steering, WheelSpeeds
from vsense_ros.model.sensors.base import SensorBase
from vsense_ros.model.sensors.gnss_velocity import GnssVelocity
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CalibrationSettings:
    """Bounds of the driving from which sensors are calibrated, and what is known before: decisions of this project."""

    step: float = 0.02  # [s] of the common clock
    longest_gap: float = 0.35  # [s] between two messages, to interpolate between them; of a slower sensor:
    longest_gap_periods: float = 1.5  # [-] periods of its messages, and
    slowest: float = 1.1  # [s] the longest period; a receiver that reports once a second is usual
    block: float = 12.0  # [s] of driving within which residuals may be correlated
    least_speed: float = 4.0  # [m/s] below which a course says little
    linear_acceleration: float = 4.0  # [m/s²] lateral acceleration up to which a car is linear, about
    cut_off: float = 1.0  # [Hz] below which signals are compared; less where GNSS is slower:
    cut_off_periods: float = 0.25  # [-] of the rate of GNSS; a cubic spline keeps 99 % of a sine of that frequency
    straight: float = 0.02  # [rad/s] yaw rate below which a drive is straight
    apart: float = 0.1  # [s] between messages by which noise is measured: slower than vibration, faster than motion
    slowest_noise: float = 0.15  # [s] between messages, beyond which motion hides their noise
    least_driving: float = 20.0  # [s] of a recording that is used
    least_messages: int = 20  # of a signal that is used
    steady: float = 0.5  # [m/s²] of acceleration along the car below which drive slip is small
    grade_length: float = 1000.0  # [m] along which a grade lasts: over longer drives its mean vanishes
    crossfall: float = 0.02  # [rad] by which roads fall to the side on average, both ways (AASHTO 2018: 1.5 to 2 %)
    # Standard deviations before a drive, where the vehicle file does not state them.
    latency_deviation: float = 0.05  # [s] that a receiver or a bus may be late
    compliance_deviation: float = 0.3  # [-] of the cornering compliance of an axle, as a share of its value
    tilt_deviation: float = 0.1  # [rad] that a sensor may lean
    arm_deviation: float = 0.5  # [m] that the place of the inertial sensor may be off
    # [-] of a turn that a gyro across reads: data sheets say ±2 % (InvenSense MPU-6050, Bosch BMI160)
    cross_axis_deviation: float = 0.012
    rolling_deviation: float = 0.1  # [-] of a lateral acceleration that a rolling or pitching body adds to it
    leaning_deviation: float = 0.02  # [rad s²/m] of a body that rolls or pitches
    gyro_bias_deviation: float = 0.02  # [rad/s] of the gyros across
    ratio_deviation: float = 0.1  # [-] of the steering ratio, as a share of its value
    lag_deviation: float = 0.15  # [s] that a car may answer its steering later
    # What is worth a change of the vehicle file.
    determined_share: float = 0.6  # [-] of the deviation before, up to which a quantity is determined
    smallest_latency: float = 0.002  # [s]
    least_noise_share: float = 0.5  # [-] of what the file says, below which a measured noise is not believed


CALIBRATION = CalibrationSettings()


@dataclass(frozen=True)
class CalibrationDrive:
    """n instants, `CALIBRATION.step` apart; what is not known is NaN. Latencies of the vehicle file are taken off."""

    name: str
    t: Array  # [s]
    rates: Array  # (n, 3) [rad/s] of the inertial sensor, in the axes that the vehicle file says are the car's
    forces: Array  # (n, 3) [m/s²] likewise
    velocity: Array  # (n, 2) [m/s] east and north by GNSS
    spin: Array  # (n, 4) [rad/s]
    steering: Array  # (n,) [rad] road-wheel angle by the vehicle file
    noise: dict[str, Array]  # standard deviations of single messages, by kind of sensor and component
    at_road_wheel: bool = False  # the steering angle was measured there, not at the steering wheel
    cut_off: float = CALIBRATION.cut_off  # [Hz] below which signals are compared

    def smooth(self, values: Array, cut_off: float | None = None) -> Array:
        """A signal (n, …) without what is faster than a frequency [Hz], by default `cut_off` of the drive; NaN where it
        is not known."""
        finite = np.isfinite(values)
        sections = signal.butter(2, cut_off or self.cut_off, fs=1 / CALIBRATION.step, output="sos")
        filtered = signal.sosfiltfilt(sections, np.where(finite, values, 0.0), axis=0)
        weight = signal.sosfiltfilt(sections, finite.astype(float), axis=0)
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(finite & (weight > 0.9), filtered / weight, np.nan)

    def slope(self, values: Array) -> Array:
        """Change of a smooth signal (n,) per second."""
        return np.asarray(np.gradient(values, CALIBRATION.step, axis=0))

    @cached_property
    def speed(self) -> Array:
        """Smooth speed over ground by GNSS [m/s], (n,)."""
        return self.smooth(np.hypot(*self.velocity.T))

    @cached_property
    def yaw_rate(self) -> Array:
        """Smooth yaw rate by the gyro [rad/s], (n,)."""
        return self.smooth(self.rates[:, 2])

    @cached_property
    def driving(self) -> NDArray[np.bool_]:
        """Where the car drives, as fast as its course can be believed and as gently as it is linear, (n,)."""
        with np.errstate(invalid="ignore"):
            return (self.speed > CALIBRATION.least_speed) & (
                np.abs(self.speed * self.yaw_rate) < CALIBRATION.linear_acceleration
            )

    def blocks(self, x: Array, y: Array, wanted_rows: NDArray[np.bool_]) -> Iterator[tuple[Array, Array]]:
        """Rows of X (n, k) and y (n,) that are known and meant, by stretches of `CALIBRATION.block`."""
        good = wanted_rows & np.isfinite(x).all(axis=1) & np.isfinite(y)
        length = round(CALIBRATION.block / CALIBRATION.step)
        for begin in range(0, len(y), length):
            rows = np.flatnonzero(good[begin : begin + length]) + begin
            if len(rows) > 0.2 * length:
                yield x[rows], y[rows]


def drive_of(recording: Recording, vehicle: Vehicle) -> CalibrationDrive:
    """The signals of a recording that the sensors of a vehicle file hear.

    Raises `InputError` for a recording without a GNSS velocity or a yaw rate, or one that is too short.
    """
    measured: dict[str, tuple[Array, Array]] = {}
    noise: dict[str, Array] = {}
    at_road_wheel = False
    start = recording.start
    for sensor in vehicle.sensors.values():
        channel = recording.channels.get(sensor.topic)
        if channel is None or len(channel) < CALIBRATION.least_messages:
            continue
        at_road_wheel |= isinstance(sensor, Steering) and ROAD_WHEEL in channel.names
        for name, values in _signals(sensor, channel, vehicle):
            time = np.asarray((channel.stamp - start) * 1e-9 - sensor.latency, dtype=np.float64)
            measured[name] = time, values
            noise[name] = scatter(channel.stamp, values)
    for quantity, description in (("velocity", "GNSS velocity (gps/velocity)"), ("rates", "yaw rate (imu/data)")):
        if quantity not in measured:
            raise InputError(f"{recording.name}: no {description}; calibration compares the other sensors with it")
    begin, end = (pick([time[index] for time, _ in measured.values()]) for pick, index in ((max, 0), (min, -1)))
    t = np.arange(begin, end, CALIBRATION.step)
    if len(t) * CALIBRATION.step < CALIBRATION.least_driving:
        raise InputError(
            f"{recording.name}: {max(end - begin, 0.0):.0f} s in which all sensors are heard; expected at least "
            f"{CALIBRATION.least_driving:.0f} s"
        )
    widths = {"rates": 3, "forces": 3, "velocity": 2, "spin": 4, "steering": 1}
    on_clock = {
        name: _resampled(*measured[name], t) if name in measured else np.full((len(t), width), np.nan)
        for name, width in widths.items()
    }
    on_clock["steering"] = on_clock["steering"][:, 0]
    time, velocity = measured["velocity"]
    period = _period(np.sort(time[np.isfinite(velocity).all(axis=1)]))
    cut_off = min(CALIBRATION.cut_off, CALIBRATION.cut_off_periods / max(period, CALIBRATION.step))
    return CalibrationDrive(recording.name, t, **on_clock, noise=noise, at_road_wheel=at_road_wheel, cut_off=cut_off)


def _signals(sensor: SensorBase, channel: Channel, vehicle: Vehicle) -> Iterator[tuple[str, Array]]:
    """What a channel gives for a sensor, by the names of a drive, each (m, k)."""
    columns = channel.measured
    if isinstance(sensor, Imu):
        turned = {**columns, **sensor.message_in_axes_of_car(columns)}
        yield "rates", turned["angular_velocity"]
        yield "forces", turned["linear_acceleration"]
    elif isinstance(sensor, GnssVelocity):
        yield "velocity", columns["linear"][:, :2]
    elif isinstance(sensor, WheelSpeeds) and all(f"wheel_{wheel}" in channel.names for wheel in WHEELS):
        yield "spin", columns["velocity"][:, [channel.names.index(f"wheel_{wheel}") for wheel in WHEELS]]
    elif isinstance(sensor, Steering):
        ratio = sensor.ratio or vehicle.physics.steering.ratio
        for name, factor in ((ROAD_WHEEL, 1.0), (STEERING_WHEEL, 1 / ratio)):
            if name in channel.names:
                yield "steering", sensor.gain * factor * columns["position"][:, [channel.names.index(name)]]
                return


def scatter(stamp: NDArray[np.int64], values: Array) -> Array:
    """Standard deviation of the noise of messages (m, k), component by component: that of second differences over
    `CALIBRATION.apart`, to which motion adds little, over √6; NaN for a component with too few messages, or too slow.

    Components may come in messages of their own, with those of the others absent, as on a CAN bus.
    """
    return np.array([_scatter_of(stamp[finite := np.isfinite(component)], component[finite]) for component in values.T])


def _scatter_of(stamp: NDArray[np.int64], values: Array) -> float:
    """Standard deviation of the noise of a signal (m,), as `scatter` has it."""
    if len(stamp) < 3:
        return np.nan
    period = float(np.median(np.diff(stamp))) * 1e-9
    if period > CALIBRATION.slowest_noise:
        return np.nan
    stride = max(round(CALIBRATION.apart / max(period, 1e-4)), 1)
    second = values[: -2 * stride] - 2 * values[stride:-stride] + values[2 * stride :]
    return float(np.sqrt(np.mean(second**2) / 6)) if len(second) > CALIBRATION.least_messages else np.nan


def _resampled(time: Array, values: Array, t: Array) -> Array:
    """Values (m, k) at the times t (n,), NaN in gaps and where they are absent."""
    order = np.argsort(time, kind="stable")
    time, values = time[order], values[order]
    resampled = np.full((len(t), values.shape[1]), np.nan)
    for k, column in enumerate(values.T):
        good = np.isfinite(column)
        if good.sum() >= CALIBRATION.least_messages:
            resampled[:, k] = _interpolated(time[good], column[good], t)
    return resampled


def _interpolated(time: Array, values: Array, t: Array) -> Array:
    """A signal (m,) at the times t (n,), NaN in gaps: straight between messages, or by cubic splines where they come
    so slowly that straight lines would cut bends off."""
    period = _period(time)
    longest = max(CALIBRATION.longest_gap, CALIBRATION.longest_gap_periods * min(period, CALIBRATION.slowest))
    after = np.clip(np.searchsorted(time, t), 1, len(time) - 1)
    covered = time[after] - time[after - 1] <= longest
    covered &= (t >= time[0]) & (t <= time[-1])
    if period <= CALIBRATION.longest_gap / 2:
        return np.where(covered, np.interp(t, time, values), np.nan)
    interpolated = np.full(len(t), np.nan)
    distinct = np.flatnonzero(np.diff(time, prepend=-np.inf) > 0)
    for piece in np.split(distinct, np.flatnonzero(np.diff(time[distinct]) > longest) + 1):
        inside = (t >= time[piece[0]]) & (t <= time[piece[-1]])
        if len(piece) >= 4 and inside.any():
            interpolated[inside] = interpolate.CubicSpline(time[piece], values[piece])(t[inside])
    return np.where(covered, interpolated, np.nan)


def _period(time: Array) -> float:
    """Median time between messages [s], of sorted times; infinite for fewer than two."""
    return float(np.median(np.diff(time))) if len(time) > 1 else np.inf
