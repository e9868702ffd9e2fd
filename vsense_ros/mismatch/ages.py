"""How much older than its stamps each sensor is, where that is more than any fit would find.

Sensors of one car measure one motion: a gyro, the course of GNSS, a steered wheel and an accelerometer how it turns;
wheels, GNSS, an accelerometer and wheel torques how it gains speed. Where one of them is late by tenths of a second, a
simulation from its inputs is beside the car from the first bend on, sizes and signs seem wrong, and no small step of a
fit leads to the truth. So lags are sought first, up to three seconds, by correlation, which asks neither for sizes nor
for signs. Whoever is late against the others, who agree among themselves, is taken to be as old as they say; gyros and
accelerometers of an inertial sensor apart, as they may come by different ways.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import means_around
from vsense_ros.checks.blame import who_is_wrong
from vsense_ros.checks.clocks import SETTINGS as CLOCKS
from vsense_ros.checks.lags import LONG_LAGS, Match, match
from vsense_ros.mismatch.windows import WINDOWS, Dataset, Readings, Window
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import bounds
from vsense_ros.model.sensors import MeasuredQuantity, SensorBase, best_measuring
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LagSearchSettings:
    """How the lags between sensors are sought, before any fit: decisions of this project."""

    step: float = 0.05  # [s] between the values that are compared
    span: float = 0.3  # [s] of the means
    least_lag: float = 0.3  # [s] of a lag; a smaller one is left to the fit, and cars take as long to respond
    # [s] of a gyro behind the course, beyond the time that a car takes from its rear axle to the antenna, by which the
    # course of the antenna may lead
    least_rigid_lag: float = 0.1
    least_explained: float = 2.0  # [-] unexplained variance without that lag, over that with it
    least_distinct: float = 1.5  # [-] that at any other lag, over that with it
    antenna: float = 1.0  # [m] standard deviation of how far an antenna sits ahead of where the vehicle file says
    agreement: float = 0.25  # [s] within which recordings, and groups of a sensor, are equally late
    least_correlation: float = 0.7  # [-] of two measurements of one motion, at the best lag
    correlation_gain: float = 0.15  # [-] by which that correlation exceeds the one without a lag
    clearance: float = 0.05  # [-] by which it exceeds that at any other lag: a slalom looks the same one period later
    deviation: float = 0.06  # [s] standard deviation of a lag from correlation
    least_compared: float = 8.0  # [s] that are compared
    least_turning: float = 0.02  # [rad/s] standard deviation of a turning rate that shows a lag
    least_acceleration: float = 0.2  # [m/s²] standard deviation of an acceleration that shows a lag


LAG_SEARCH = LagSearchSettings()


GROUPS, WHOLE = ("gyro", "accelerometer"), "imu"  # of an inertial sensor, which may be late apart or together
Source = str  # of a motion: gyro, accelerometer, or the kind of a sensor
DELAY = next(effect for effect in EVERY.values() if effect.delays)
FIELDS = DELAY.delays


class Age(NamedTuple):
    """How much older a sensor is than its stamps say beyond what the vehicle file knows, and the standard deviation of
    that [s]."""

    value: float
    deviation: float


def ages(dataset: Dataset, vehicle: Vehicle) -> dict[str, Age]:
    """By size of the effect that sensors are late, how late they are: those in which all recordings agree."""
    latencies, leads = [], []
    for windows in dataset.by_recording():
        lead = _lead(windows, dataset.sensors, vehicle)
        latencies.append(_late(_lags(windows, dataset.sensors, vehicle, lead)))
        leads.append(lead.deviation)
    result = {}
    for source, field in FIELDS.items():
        lags = [one[source] for one in latencies if source in one]
        if lags and abs(np.median(lags)) >= LAG_SEARCH.least_rigid_lag and np.ptp(lags) < LAG_SEARCH.agreement:
            beside = float(np.median(leads)) if source == GROUPS[0] else 0.0
            result[field] = Age(round(float(np.median(lags)), 2), float(np.hypot(LAG_SEARCH.deviation, beside)))
    groups = [FIELDS[group] for group in GROUPS]
    if result.keys() >= set(groups) and np.ptp([result[group].value for group in groups]) < LAG_SEARCH.agreement:
        both = [result.pop(group) for group in groups]
        result[FIELDS[WHOLE]] = Age(round(float(np.mean([one.value for one in both])), 2), both[-1].deviation)
    info = DELAY.model_fields
    return {field: age for field, age in result.items() if bounds(info[field])[0] < age.value < bounds(info[field])[1]}


_Pairs = Mapping[tuple[Source, Source], float]  # by how much the first is the later one [s]


class _Lead(NamedTuple):
    """By how much the course of GNSS may lead the turning of the car [s], and how well that is known. Without slip it
    leads by the time that the car takes from its rear axle to the antenna, with slip by less."""

    course: Source | None
    most: float
    deviation: float


def _lead(windows: Sequence[Window], sensors: Mapping[str, SensorBase], vehicle: Vehicle) -> _Lead:
    name = best_measuring(sensors.items(), "course")
    if name is None:
        return _Lead(None, 0.0, 0.0)
    speed = max(float(np.nanmedian(np.concatenate([w.speed.value[:, 0] for w in windows]))), WINDOWS.slowest)
    antenna = float(np.asarray(getattr(sensors[name], "position", np.zeros(3)))[0])
    ahead = vehicle.physics.chassis.cog_to_rear_axle + antenna
    uniform = ahead / 12**0.5
    return _Lead(sensors[name].kind, ahead / speed, float(np.hypot(uniform, LAG_SEARCH.antenna)) / speed)


def _lags(
    windows: Sequence[Window], sensors: Mapping[str, SensorBase], vehicle: Vehicle, lead: _Lead
) -> _Pairs:  # fmt: skip
    """The lags between all sources that measure one motion well enough.

    A steered wheel leads the motion that answers it, and an accelerometer ahead of the centre of gravity leads as well.
    Gyro and course are of one rigid body, so that a gyro that is later than the course may lead is late, by half of
    what this may lead less.
    """
    lags: dict[tuple[Source, Source], float] = {}
    for signals, least in zip(
        _motions(windows, sensors, vehicle), (LAG_SEARCH.least_turning, LAG_SEARCH.least_acceleration), strict=True
    ):
        moving = {source: v for source, v in signals.items() if np.nanstd(v, ddof=0) > least}
        for one, other in combinations(moving, 2):
            matched = match(moving[one], moving[other], LAG_SEARCH.step, LONG_LAGS)
            if matched is None or abs(matched.best) < LAG_SEARCH.least_correlation:
                continue
            rigid = (one, other) == (GROUPS[0], lead.course)
            lag = matched.lag - lead.most / 2 if rigid else matched.lag
            if rigid and _late_rigidly(matched, lead):
                lags.setdefault((one, other), lag)
            elif abs(matched.lag) < LAG_SEARCH.least_lag:
                lags.setdefault((one, other), 0.0)
            elif _clearly_late(matched) or (_smoothed(matched) and GROUPS[1] in (one, other)):
                lags.setdefault((one, other), lag)
    return lags


def _late_rigidly(matched: Match, lead: _Lead) -> bool:
    """True if a gyro is behind the course by more than this may lead."""
    return (
        matched.lag > LAG_SEARCH.least_rigid_lag + lead.most
        and matched.explained > LAG_SEARCH.least_explained
        and matched.distinct > LAG_SEARCH.least_distinct
    )


def _clearly_late(matched: Match) -> bool:
    """True if two signals are alike at one lag only."""
    return (
        matched.clear > LAG_SEARCH.clearance
        and abs(matched.correlation) < abs(matched.best) - LAG_SEARCH.correlation_gain
    )


def _smoothed(matched: Match) -> bool:
    """True if two signals are alike at one lag and those beside it, as after a filter, and hardly without a lag."""
    return (
        abs(matched.lag) > CLOCKS.gaining_lag
        and abs(matched.best) > CLOCKS.gaining_correlation
        and matched.explained > CLOCKS.gaining_explained
    )


def _late(lags: _Pairs) -> dict[Source, float]:
    """How late each source is against those that agree among themselves, which are not late; nothing where it is open
    who is."""
    agree = {pair: lag == 0.0 for pair, lag in lags.items()}
    blame = who_is_wrong(agree, {})
    if blame.undecided or not any(agree.values()):
        return {}
    sources = dict.fromkeys(source for pair in lags for source in pair)
    late = {source: 0.0 for source in sources if source not in blame.wrong}
    for source in blame.wrong:
        against = [
            lag if source == one else -lag
            for (one, other), lag in lags.items()
            if source in (one, other) and (other if source == one else one) not in blame.wrong
        ]
        if against:
            late[source] = float(np.median(against))
    return late


def _motions(
    windows: Sequence[Window], sensors: Mapping[str, SensorBase], vehicle: Vehicle
) -> tuple[dict[Source, Array], dict[Source, Array]]:
    """Turning [rad/s] and gain of speed [m/s²] of one recording, by what measures them, at common times with gaps
    between the windows."""
    begin, end = min(w.begin for w in windows), max(w.end for w in windows)
    t = np.arange(begin, end, LAG_SEARCH.step)
    driven = np.zeros(len(t), dtype=bool)
    for window in windows:
        driven |= (t >= window.begin) & (t <= window.end)
    speed = _means(t, _joined([w.speed for w in windows]), 0)
    fast = np.where(driven & (speed > WINDOWS.slowest), speed, np.nan)
    chassis = vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    radius = float(np.mean(rolling_radii(vehicle)))

    def of(what: MeasuredQuantity) -> tuple[str, SensorBase, Readings] | None:
        name = best_measuring(((n, sensors[n]) for n in dict.fromkeys(n for w in windows for n in w.readings)), what)
        if name is None:
            return None
        return sensors[name].kind, sensors[name], _joined([w.readings[name] for w in windows if name in w.readings])

    turns: dict[Source, Array] = {}
    pushes: dict[Source, Array] = {}
    gyro, accelerometer = GROUPS
    if (inertial := of("rates and forces")) is not None:
        turns[gyro] = _means(t, inertial[2], 2)
        turns[accelerometer] = _means(t, inertial[2], 4) / fast
        pushes[accelerometer] = _means(t, inertial[2], 3)
    if (steering := of("steering")) is not None:
        turns[steering[0]] = _means(t, steering[2], 0) * fast / wheelbase
    if (course := of("course")) is not None:
        east, north = (_means(t, course[2], axis) for axis in (0, 1))
        ahead = np.exp(1j * np.unwrap(np.nan_to_num(np.arctan2(north, east))))
        turns[course[0]] = np.where(np.isfinite(east), np.gradient(np.unwrap(np.angle(ahead)), LAG_SEARCH.step), np.nan)
        pushes[course[0]] = np.gradient(np.hypot(east, north), LAG_SEARCH.step)
    if (rolling := of("rolling speed")) is not None:
        value = Readings(rolling[2].t, rolling[1].mean_speed(rolling[2].value, radius)[:, None])
        pushes[rolling[0]] = np.gradient(_means(t, value, 0), LAG_SEARCH.step)
    if (torques := of("torques")) is not None:
        value = Readings(torques[2].t, torques[2].value.sum(axis=1, keepdims=True))
        pushes[torques[0]] = _means(t, value, 0) / (radius * chassis.mass)
    hidden = ~(driven & np.isfinite(fast))
    for signals in (turns, pushes):
        for source in list(signals):
            signals[source] = np.where(hidden, np.nan, signals[source])
            if np.isfinite(signals[source]).sum() < LAG_SEARCH.least_compared / LAG_SEARCH.step:
                del signals[source]
    return turns, pushes


def _joined(parts: Sequence[Readings]) -> Readings:
    """Readings of windows that overlap, in order, each once."""
    t = np.concatenate([part.t for part in parts])
    value = np.concatenate([part.value for part in parts])
    t, first = np.unique(t, return_index=True)
    return Readings(t, value[first])


def _means(at: Array, readings: Readings, column: int) -> Array:
    """Means of a component over `LAG_SEARCH.span` seconds around times; NaN where there is nothing."""
    return means_around(at, readings.t, readings.value[:, column], LAG_SEARCH.span)
