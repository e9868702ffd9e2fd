"""Signals of several sensors at common times, and the arithmetic by which they are compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pymap3d
from numpy.typing import NDArray

from vsense_ros.checks.roles import Role, Topics
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.messages.recording import Channel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class AlignmentSettings:
    """Grid of time on which signals are compared."""

    step: float = setting(0.02, "s", "between two of the common times: faster than any car turns", JUDGEMENT)
    longest: float = setting(1200.0, "s", "of a drive, in its middle, that is compared", JUDGEMENT)
    hole: float = setting(1.0, "s", "without a message, beyond which a signal is absent", JUDGEMENT)
    least_values: int = setting(10, "-", "values of a signal, of fewer of which nothing is said", JUDGEMENT)
    shortest: float = setting(2.0, "s", "of a drive, of less of which nothing is compared", JUDGEMENT)


SETTINGS = AlignmentSettings()
RATES, FORCES = ("wx", "wy", "wz"), ("ax", "ay", "az")  # names of the components of an inertial sensor
INERTIAL_FIELDS = {"angular_velocity": RATES, "linear_acceleration": FORCES}


def means_around(at: Array, t: Array, value: Array, span: float) -> Array:
    """Means of a signal over `span` seconds around the times `at` (n,), from samples `value` (m,) at times `t` (m,).

    The signal is linear between samples; absent samples (NaN) are passed over; NaN where there are fewer than two.
    """
    present = np.isfinite(value)
    if present.sum() < 2:
        return np.full(len(at), np.nan)
    t, value = t[present], value[present]
    integral = np.concatenate([[0.0], np.cumsum(np.diff(t) * (value[1:] + value[:-1]) / 2)])
    begin, end = np.clip(at - span / 2, t[0], t[-1]), np.clip(at + span / 2, t[0], t[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((np.interp(end, t, integral) - np.interp(begin, t, integral)) / (end - begin))


def stretches(where: Mask) -> list[tuple[int, int]]:
    """First index, and that behind the last one, of each stretch in which a mask (n,) is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    return [(int(first), int(end)) for first, end in zip(edges[::2], edges[1::2], strict=True)]


def runs_of_equal_values(value: Array, rounding: float = 0.0) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First index and length of each stretch of equal values (n,), or of equal rows (n, m), as far as
    neighbours that differ by no more than `rounding` are equal."""
    changes = ~(np.abs(np.diff(value, axis=0)) <= rounding)
    first = np.concatenate([[0], np.flatnonzero(changes if value.ndim == 1 else changes.any(axis=1)) + 1])
    return first, np.diff(np.append(first, len(value)))


def robust_deviation(values: Array) -> float:
    """Standard deviation of normally distributed values (n,) by their median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def spread(values: Array) -> float:
    """Standard deviation of those values (n,) that are present; 0 of too few."""
    present = values[np.isfinite(values)]
    return float(np.std(present)) if len(present) > SETTINGS.least_values else 0.0


@dataclass
class AlignedSignals:
    """What sensors measure of one motion, at common times; NaN where a signal is absent.

    `signals` has the rates `wx wy wz` [rad/s] and specific forces `ax ay az` [m/s²] of the inertial sensor, the GNSS
    velocity `east north up` [m/s], the position `x y` [m] east and north of the first fix and its `height` [m], and
    `x' y'` as it would be with latitude and longitude exchanged, wheel spins [rad/s] and steering angles [rad] by the
    names of their joints, and forward velocities that the car itself publishes [m/s], by the names of their roles.
    """

    start: int  # [ns]
    begin: int  # of the recording [ns]
    t: Array  # [s] since `start`
    topics: Topics
    period: dict[Role, float] = field(default_factory=dict)  # between two messages [s]
    signals: dict[str, Array] = field(default_factory=dict)
    step: float = SETTINGS.step

    def __contains__(self, name: str) -> bool:
        return name in self.signals

    def seconds(self, index: int) -> float:
        """The time of a row [s since the start of the recording]."""
        return float(self.t[index]) + (self.start - self.begin) * 1e-9

    def rows(self, seconds: float) -> float:
        """How many rows so many seconds are."""
        return seconds / self.step

    def at(self, channel: Channel, values: Array) -> Array:
        """Values (n,) of a channel at the common times, averaged over a step of them where they come faster."""
        good = np.isfinite(values)
        seconds, first = np.unique((channel.stamp[good] - self.start) * 1e-9, return_index=True)
        values = values[good][first]
        if len(seconds) < 3:
            return np.full(len(self.t), np.nan)
        steps = np.diff(seconds)
        usual = float(np.median(steps))
        if usual < self.step / 2:
            result = means_around(self.t, seconds, values, self.step)
        else:
            result = np.interp(self.t, seconds, values)
        result[(self.t < seconds[0]) | (self.t > seconds[-1])] = np.nan
        for hole in np.flatnonzero(steps > max(SETTINGS.hole, 3 * usual)):
            result[(self.t > seconds[hole]) & (self.t < seconds[hole + 1])] = np.nan
        return result

    def smooth(self, values: Array, span: float) -> Array:
        """Means over `span` seconds around each time; NaN near where something is missing."""
        width = max(round(span / self.step), 1) | 1
        good = np.isfinite(values)
        total = np.concatenate([[0.0], np.cumsum(np.where(good, values, 0.0))])
        count = np.concatenate([[0], np.cumsum(good)])
        first = np.clip(np.arange(len(values)) - width // 2, 0, len(values))
        last = np.clip(np.arange(len(values)) + width // 2 + 1, 0, len(values))
        with np.errstate(invalid="ignore"):
            means = (total[last] - total[first]) / (count[last] - count[first])
        means[count[last] - count[first] < width] = np.nan
        return means

    def slope(self, values: Array, span: float) -> Array:
        """Change of a signal over `span` seconds around each time, per second; NaN near where something is missing."""
        half = max(round(span / 2 / self.step), 1)
        change = np.full(len(values), np.nan)
        if len(values) > 2 * half:
            change[half:-half] = (values[2 * half :] - values[: -2 * half]) / (2 * half * self.step)
        return change

    def rate_of_change(self, values: Array, span: float) -> Array:
        """Slope of a noisy signal, averaged twice over `span` seconds."""
        return self.slope(self.smooth(values, span), span)

    def velocity_by_position(self, span: float) -> tuple[Array, Array]:
        """East and north velocity [m/s] by the change of the position, averaged twice over `span` seconds."""
        return self.rate_of_change(self.signals["x"], span), self.rate_of_change(self.signals["y"], span)

    def course_rate(self, east: Array, north: Array, span: float, slowest: float) -> Array:
        """How fast the course of a velocity turns to the left [rad/s]; NaN where it is slower than `slowest` [m/s]."""
        half = max(round(span / 2 / self.step), 1)
        rate = np.full(len(east), np.nan)
        if len(east) > 2 * half:
            before = east[: -2 * half] + 1j * north[: -2 * half]
            after = east[2 * half :] + 1j * north[2 * half :]
            rate[half:-half] = np.angle(after * np.conj(before)) / (2 * half * self.step)
        rate[~(np.hypot(east, north) > slowest)] = np.nan
        return rate


def align(channels: Mapping[Role, Channel], topics: Topics, begin: int) -> AlignedSignals | None:
    """The signals of the channels of a recording that begins at `begin` [ns] at common times; None where there is too
    little to compare."""
    if not channels:
        return None
    # A source whose clock is another one has no time in common with the rest, which the check of clocks reports.
    middle = float(np.median([float(np.median(c.stamp)) for c in channels.values()]))
    reach = SETTINGS.longest / 2 * 1e9
    first = max(min(float(np.quantile(c.stamp, 0.001)) for c in channels.values()), middle - reach)
    last = min(max(float(np.quantile(c.stamp, 0.999)) for c in channels.values()), middle + reach)
    if last - first < SETTINGS.shortest * 1e9:
        return None
    aligned = AlignedSignals(int(first), begin, np.arange(0.0, (last - first) * 1e-9, SETTINGS.step), topics)
    for role, channel in channels.items():
        steps = np.diff(channel.stamp)
        steps = steps[steps > 0]
        aligned.period[role] = float(np.median(steps)) * 1e-9 if len(steps) else np.inf
    if (imu := channels.get(Role.IMU)) is not None:
        _add_inertial(aligned, imu)
    if (velocity := channels.get(Role.VELOCITY)) is not None:
        for axis, name in enumerate(("east", "north", "up")):
            aligned.signals[name] = aligned.at(velocity, velocity.columns["linear"][:, axis])
    if (position := channels.get(Role.POSITION)) is not None:
        _add_position(aligned, position)
    for role in (Role.BODY_VELOCITY, Role.SPEED):
        if (own := channels.get(role)) is not None:
            aligned.signals[role] = aligned.at(own, own.columns["linear"][:, 0])
    for role, values in ((Role.WHEELS, "velocity"), (Role.STEERING, "position")):
        if (joints := channels.get(role)) is not None and joints.columns[values].shape[1]:
            for index, name in enumerate(joints.names):
                aligned.signals[name] = aligned.at(joints, joints.columns[values][:, index])
    return aligned


def _add_inertial(aligned: AlignedSignals, channel: Channel) -> None:
    columns = channel.measured
    for vector, names in INERTIAL_FIELDS.items():
        for axis, name in enumerate(names):
            values = columns[vector][:, axis]
            if np.isfinite(values).sum() >= SETTINGS.least_values:
                aligned.signals[name] = aligned.at(channel, values)


def _add_position(aligned: AlignedSignals, channel: Channel) -> None:
    latitude, longitude = channel.columns["latitude"][:, 0], channel.columns["longitude"][:, 0]
    good = np.isfinite(latitude) & np.isfinite(longitude) & (channel.columns["status"][:, 0] >= 0)
    fixes, latitude, longitude = channel.select(good), latitude[good], longitude[good]
    if good.sum() < SETTINGS.least_values or np.abs(latitude).max() > 90 or np.abs(longitude).max() > 180:
        return
    for suffix, north, east in (("", latitude, longitude), ("'", longitude, latitude)):
        if np.abs(north).max() < 86:
            x, y = _metres(north, east)
            aligned.signals[f"x{suffix}"], aligned.signals[f"y{suffix}"] = aligned.at(fixes, x), aligned.at(fixes, y)
    height = fixes.columns["altitude"][:, 0]
    if np.isfinite(height).sum() >= SETTINGS.least_values:
        aligned.signals["height"] = aligned.at(fixes, height)


def _metres(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """East and north [m] of the first of some places [deg], small against the earth: by its radii of curvature at their
    median latitude."""
    middle = float(np.median(latitude))
    meridian = float(pymap3d.rcurve.meridian(middle))
    parallel = float(pymap3d.rcurve.parallel(middle))
    return parallel * np.radians(longitude - longitude[0]), meridian * np.radians(latitude - latitude[0])
