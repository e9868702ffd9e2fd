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

from vsense_ros.mismatch.windows import SLOWEST, Dataset, Readings, Window
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import bounds
from vsense_ros.model.sensors import SensorBase, Tells, telling
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

STEP = 0.05  # [s] between the values that are compared
SPAN = 0.3  # [s] of the means
MOST = 3.0  # [s] of a lag that is looked for
LATE = 0.3  # [s] from where on a sensor is late: below it a fit finds how much, and cars take as long to respond
AGREED = 0.25  # [s] within which recordings, and groups of a sensor, are equally late
ALIKE = 0.7  # correlation of what tells one motion, at least, at the best lag …
BETTER = 0.15  # … and how much more that is than without a lag, …
CLEAR = 0.05  # … and than at any other lag: a slalom looks the same one period later
APART = 0.4  # [s] from a lag to another one
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


def best_lag(one: Array, other: Array, step: float) -> tuple[float, float, float] | None:
    """By how much the first of two signals (n,) at common times, `step` [s] apart, is the later one [s], their
    correlation then, and how much smaller it is at any other lag; None where they have too little in common."""
    shifts = range(-round(MOST / step), round(MOST / step) + 1)
    values = np.array([_correlation(one, other, shift, LEAST / step) for shift in shifts])
    if not np.isfinite(values).any():
        return None
    size = np.nan_to_num(np.abs(values))
    at = int(np.argmax(size))
    lags = np.array(shifts) * step
    elsewhere = size[np.abs(lags - lags[at]) > APART]
    return float(lags[at]), float(values[at]), float(size[at] - np.max(elsewhere, initial=0.0))


def _correlation(one: Array, other: Array, shift: int, least: float) -> float:
    """Of the first signal, `shift` steps later, with the other; NaN where they have too little in common."""
    if abs(shift) >= len(one):
        return np.nan
    a = one[max(shift, 0) : len(one) + min(shift, 0)]
    b = other[max(-shift, 0) : len(other) - max(shift, 0)]
    good = np.isfinite(a) & np.isfinite(b)
    if good.sum() < least:
        return np.nan
    a, b = a[good] - a[good].mean(), b[good] - b[good].mean()
    power = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / power if power > 0 else np.nan


_Pairs = Mapping[tuple[Source, Source], float]  # by how much the first is the later one [s]


def _lags(windows: Sequence[Window], sensors: Mapping[str, SensorBase], vehicle: Vehicle) -> _Pairs:
    """Between all that tell one motion well enough."""
    found: dict[tuple[Source, Source], float] = {}
    for signals, least in zip(_motions(windows, sensors, vehicle), (TURNING, PUSHING), strict=True):
        moving = {source: v for source, v in signals.items() if np.nanstd(v, ddof=0) > least}
        for one, other in combinations(moving, 2):
            told = best_lag(moving[one], moving[other], STEP)
            if told is None:
                continue
            lag, correlation, clear = told
            without = abs(np.nan_to_num(_correlation(moving[one], moving[other], 0, LEAST / STEP)))
            if abs(correlation) < ALIKE:
                continue
            if abs(lag) < LATE:
                found.setdefault((one, other), 0.0)
            elif clear > CLEAR and without < abs(correlation) - BETTER:
                found.setdefault((one, other), lag)
    return found


def _late(lags: _Pairs) -> dict[Source, float]:
    """How late each source is against those that agree among themselves, who are not; nothing where two groups of them
    agree as much."""
    sources = sorted({source for pair in lags for source in pair})
    lags = {**lags, **{(b, a): -lag for (a, b), lag in lags.items()}}
    agree = {pair for pair, lag in lags.items() if lag == 0.0}

    def together(of: Sequence[Source]) -> int:
        """How many of these agree with one another; none where two contradict each other."""
        pairs = list(combinations(of, 2))
        return 0 if any(pair in lags and pair not in agree for pair in pairs) else sum(pair in agree for pair in pairs)

    sets = [of for count in range(2, len(sources) + 1) for of in combinations(sources, count)]
    agreeing = {of: together(of) for of in sets}
    most = max(agreeing.values(), default=0)
    largest = [of for of, number in agreeing.items() if number == most]
    if not most:
        return {}
    smallest = min(map(len, largest))
    right = [of for of in largest if len(of) == smallest]
    if len(right) > 1:
        return {}
    late = {source: _against(source, right[0], lags) for source in sources if source not in right[0]}
    return dict.fromkeys(right[0], 0.0) | {source: float(np.median(told)) for source, told in late.items() if told}


def _against(source: Source, others: Sequence[Source], lags: _Pairs) -> list[float]:
    return [lags[source, other] for other in others if (source, other) in lags]


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
    speed = _smooth(t, _joined([w.speed for w in windows]), 0)
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
        turns[gyro] = _smooth(t, inertial[2], 2)
        turns[accelerometer] = _smooth(t, inertial[2], 4) / fast
        pushes[accelerometer] = _smooth(t, inertial[2], 3)
    if (steering := of("steering")) is not None:
        turns[steering[0]] = _smooth(t, steering[2], 0) * fast / wheelbase
    if (course := of("course")) is not None:
        east, north = (_smooth(t, course[2], axis) for axis in (0, 1))
        ahead = np.exp(1j * np.unwrap(np.nan_to_num(np.arctan2(north, east))))
        turns[course[0]] = np.where(np.isfinite(east), np.gradient(np.unwrap(np.angle(ahead)), STEP), np.nan)
        pushes[course[0]] = np.gradient(np.hypot(east, north), STEP)
    if (rolling := of("rolling speed")) is not None:
        value = Readings(rolling[2].t, rolling[1].mean_speed(rolling[2].value, radius)[:, None])
        pushes[rolling[0]] = np.gradient(_smooth(t, value, 0), STEP)
    if (torques := of("torques")) is not None:
        value = Readings(torques[2].t, torques[2].value.sum(axis=1, keepdims=True))
        pushes[torques[0]] = _smooth(t, value, 0) / (radius * chassis.mass)
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


def _smooth(at: Array, readings: Readings, column: int) -> Array:
    """Means over `SPAN` of a component around times; NaN where there is nothing."""
    value = readings.value[:, column]
    present = np.isfinite(value)
    if present.sum() < 2:
        return np.full(len(at), np.nan)
    t, value = readings.t[present], value[present]
    integral = np.concatenate([[0.0], np.cumsum(np.diff(t) * (value[1:] + value[:-1]) / 2)])
    first, last = np.clip(at - SPAN / 2, t[0], t[-1]), np.clip(at + SPAN / 2, t[0], t[-1])
    with np.errstate(invalid="ignore", divide="ignore"):
        return (np.interp(last, t, integral) - np.interp(first, t, integral)) / (last - first)
