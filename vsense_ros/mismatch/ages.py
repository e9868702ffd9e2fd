"""How much older than its stamps each sensor is, where that is more than any fit would find.

Sensors of one car tell one motion: a gyro, the course of GNSS, a steered wheel and an accelerometer how it turns;
wheels, GNSS, an accelerometer and wheel torques how it gains speed. Where one of them is late by tenths of a second, a
simulation from its inputs is beside the car from the first bend on, sizes and signs seem wrong, and no small step of a
fit leads to the truth. So lags are sought first, up to three seconds, by correlation, which asks neither for sizes nor
for signs. Whoever is late against the others, who agree among themselves, is taken to be as old as they say; gyros and
accelerometers of an inertial sensor apart, as they may come by different ways.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import means_around
from vsense_ros.checks.blame import who_is_wrong
from vsense_ros.checks.lags import LONG_LAGS, match
from vsense_ros.mismatch.windows import SLOWEST, Dataset, Readings, Window
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import bounds
from vsense_ros.model.sensors import SensorBase, Tells, telling
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

STEP = 0.05  # [s] between the values that are compared
SPAN = 0.3  # [s] of the means
LATE = 0.3  # [s] from where on a sensor is late: below it a fit finds how much, and cars take as long to respond
AGREED = 0.25  # [s] within which recordings, and groups of a sensor, are equally late
ALIKE = 0.7  # correlation of what tells one motion, at least, at the best lag …
BETTER = 0.15  # … and how much more that is than without a lag, …
CLEAR = 0.05  # … and than at any other lag: a slalom looks the same one period later
LEAST = 8.0  # [s] that are compared
TURNING, PUSHING = 0.02, 0.2  # [rad/s], [m/s²] that tell a lag, as standard deviations

GROUPS, WHOLE = ("gyro", "accelerometer"), "imu"  # of an inertial sensor, which may be late apart or together
Source = str  # of a motion: gyro, accelerometer, or the kind of a sensor
DELAY = next(effect for effect in EVERY.values() if effect.delays)
FIELDS = DELAY.delays


def ages(dataset: Dataset, vehicle: Vehicle) -> dict[str, float]:
    """By size of the effect that sensors are late, how much older one is than its stamps say beyond what the vehicle
    file knows [s]: those that all recordings agree in, of which no more is known than a tenth of a second."""
    found = [_late(_lags(windows, dataset.sensors, vehicle)) for windows in dataset.by_recording()]
    result = {}
    for source, field in FIELDS.items():
        told = [one[source] for one in found if source in one]
        if told and max(map(abs, told)) >= LATE and np.ptp(told) < AGREED:
            result[field] = round(float(np.median(told)), 2)
    groups = [FIELDS[group] for group in GROUPS]
    if result.keys() >= set(groups) and np.ptp([result[group] for group in groups]) < AGREED:
        result[FIELDS[WHOLE]] = round(float(np.mean([result.pop(group) for group in groups])), 2)
    info = DELAY.model_fields
    return {field: age for field, age in result.items() if bounds(info[field])[0] < age < bounds(info[field])[1]}


def with_ages(vehicle: Vehicle, older: Mapping[str, float]) -> Vehicle:
    """The vehicle whose sensors are older than their stamps say by so much more, by size of
    the effect [s]."""
    effects = vehicle.physics.effects
    known = getattr(effects, DELAY.id) or DELAY()
    late = known.model_copy(update={field: getattr(known, field) + age for field, age in older.items()})
    physics = vehicle.physics.model_copy(update={"effects": effects.model_copy(update={DELAY.id: late})})
    return vehicle.model_copy(update={"physics": physics})


_Pairs = Mapping[tuple[Source, Source], float]  # by how much the first is the later one [s]


def _lags(windows: Sequence[Window], sensors: Mapping[str, SensorBase], vehicle: Vehicle) -> _Pairs:
    """The lags between all sources that measure one motion well enough."""
    lags: dict[tuple[Source, Source], float] = {}
    for signals, least in zip(_motions(windows, sensors, vehicle), (TURNING, PUSHING), strict=True):
        moving = {source: v for source, v in signals.items() if np.nanstd(v, ddof=0) > least}
        for one, other in combinations(moving, 2):
            found = match(moving[one], moving[other], STEP, LONG_LAGS)
            if found is None or abs(found.best) < ALIKE:
                continue
            if abs(found.lag) < LATE:
                lags.setdefault((one, other), 0.0)
            elif found.clear > CLEAR and abs(found.correlation) < abs(found.best) - BETTER:
                lags.setdefault((one, other), found.lag)
    return lags


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
        against = [lag if source == one else -lag for (one, other), lag in lags.items() if source in (one, other)
                   and (other if source == one else one) not in blame.wrong]  # fmt: skip
        if against:
            late[source] = float(np.median(against))
    return late


def _motions(
    windows: Sequence[Window], sensors: Mapping[str, SensorBase], vehicle: Vehicle
) -> tuple[dict[Source, Array], dict[Source, Array]]:
    """Turning [rad/s] and gain of speed [m/s²] of one recording, by who tells them, at common times with gaps between
    the windows."""
    begin, end = min(w.begin for w in windows), max(w.end for w in windows)
    t = np.arange(begin, end, STEP)
    driven = np.zeros(len(t), dtype=bool)
    for window in windows:
        driven |= (t >= window.begin) & (t <= window.end)
    speed = _means(t, _joined([w.speed for w in windows]), 0)
    fast = np.where(driven & (speed > SLOWEST), speed, np.nan)
    chassis = vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    radius = float(np.mean(rolling_radii(vehicle)))

    def of(what: Tells) -> tuple[str, SensorBase, Readings] | None:
        name = telling(((n, sensors[n]) for n in dict.fromkeys(n for w in windows for n in w.readings)), what)
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
        turns[course[0]] = np.where(np.isfinite(east), np.gradient(np.unwrap(np.angle(ahead)), STEP), np.nan)
        pushes[course[0]] = np.gradient(np.hypot(east, north), STEP)
    if (rolling := of("rolling speed")) is not None:
        value = Readings(rolling[2].t, rolling[1].mean_speed(rolling[2].value, radius)[:, None])
        pushes[rolling[0]] = np.gradient(_means(t, value, 0), STEP)
    if (torques := of("torques")) is not None:
        value = Readings(torques[2].t, torques[2].value.sum(axis=1, keepdims=True))
        pushes[torques[0]] = _means(t, value, 0) / (radius * chassis.mass)
    hidden = ~(driven & np.isfinite(fast))
    for signals in (turns, pushes):
        for source in list(signals):
            signals[source] = np.where(hidden, np.nan, signals[source])
            if np.isfinite(signals[source]).sum() < LEAST / STEP:
                del signals[source]
    return turns, pushes


def _joined(parts: Sequence[Readings]) -> Readings:
    """Readings of windows that overlap, in order, each once."""
    t = np.concatenate([part.t for part in parts])
    value = np.concatenate([part.value for part in parts])
    t, first = np.unique(t, return_index=True)
    return Readings(t, value[first])


def _means(at: Array, readings: Readings, column: int) -> Array:
    """Means of a component over `SPAN` seconds around times; NaN where there is nothing."""
    return means_around(at, readings.t, readings.value[:, column], SPAN)
