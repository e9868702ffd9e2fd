"""Signs, axes and units that are wrong in a recording, and the transformation that mends each.

The checks of `plausibility` say in words what cannot be true together. This says, of inertial sensors, steering and
wheels, what would have to be done to the values so that they can: which way the axes of an inertial sensor lie is read
from gravity, from the change of speed and from how the car turns, whatever the sensor's clock says (lags are sought
before signs). Nothing is changed unless it is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.plausibility import STANDARD_RADIUS, Relations, doubts, relations_of
from vsense_ros.messages.recording import Recording

Array = NDArray[np.float64]

IMU, STEERING, WHEELS = "imu/data", "vehicle/steering", "vehicle/wheel_speeds"
GRAVITY = 9.81  # [m/s²]
MOST_LAG = 3.0  # [s]
LAG_STEP = 0.1  # [s]
ALIKE = 0.7  # correlation from where on two signals tell of one motion
SURE = 0.6  # share of the error with the axes as they are, below which others are the right ones
CLEAR = 0.9  # of the error with the second best, below which the best ones are known
MOVING = 0.3  # [m/s²] that the car has to accelerate along an axis to tell it
_AXES = ("forward", "left", "up")


@dataclass(frozen=True)
class Mend:
    """What has to be done to a topic: values of vector fields are turned (3×3, new = matrix · old), named columns are
    multiplied, or take the place of others; and that in words."""

    topic: str
    words: str
    turns: Mapping[str, tuple[tuple[float, ...], ...]] | None = None
    factors: Mapping[str, float] | None = None  # by name of the column, or of the field for all of its columns
    names: Mapping[str, str] | None = None  # new name of each column by its old one

    def __str__(self) -> str:
        return f"{self.topic}: {self.words}"


def mends(recording: Recording, radius: float | None = None) -> list[Mend]:
    """What would mend a recording; the rolling `radius` [m] is that of the car, if it is known."""
    found = _units(recording, radius)
    relations = relations_of(mended(recording, found))
    if relations is None:
        return found
    found += _inertial(relations)
    found += _steering(relations)
    found += _sides(relations)
    return found


def mended(recording: Recording, todo: Sequence[Mend]) -> Recording:
    """The recording with all of that done."""
    channels = dict(recording.channels)
    for mend in todo:
        channel = channels[mend.topic]
        columns = dict(channel.columns)
        for field, turn in (mend.turns or {}).items():
            columns[field] = _turned(columns[field], np.array(turn))
        for name, factor in (mend.factors or {}).items():
            for field, values in columns.items():
                if name == field:
                    columns[field] = values * factor
                elif name in channel.names and values.shape[1] == len(channel.names):
                    index = channel.names.index(name)
                    columns[field] = np.column_stack(
                        [values[:, :index], values[:, index] * factor, values[:, index + 1 :]]
                    )
        names = tuple((mend.names or {}).get(name, name) for name in channel.names)
        channels[mend.topic] = replace(channel, columns=columns, names=names)
    notes = tuple(f"mended: {mend}" for mend in todo)
    return replace(recording, channels=channels, notes=(*recording.notes, *notes))


def _turned(values: Array, turn: Array) -> Array:
    """Axes exchanged and reversed; what is absent (NaN) stays so on the axis it comes to."""
    return np.column_stack([values[:, int(np.argmax(np.abs(row)))] * row[int(np.argmax(np.abs(row)))] for row in turn])


_FACTORS: tuple[tuple[str, str, str, Callable[[float], float], str], ...] = (
    (WHEELS, "look like m/s", "velocity", lambda radius: 1 / radius, "m/s into rad/s"),
    (WHEELS, "look like km/h", "velocity", lambda radius: 1 / 3.6 / radius, "km/h into rad/s"),
    (WHEELS, "look like rpm", "velocity", lambda _: 2 * np.pi / 60, "rpm into rad/s"),
    (WHEELS, "look like deg/s", "velocity", lambda _: np.pi / 180, "deg/s into rad/s"),
    (WHEELS, "turn backwards", "velocity", lambda _: -1.0, "the sign reversed"),
    (IMU, "specific force looks like g", "linear_acceleration", lambda _: GRAVITY, "g into m/s²"),
    (IMU, "the yaw rate looks like deg/s", "angular_velocity", lambda _: np.pi / 180, "deg/s into rad/s"),
)


def _units(recording: Recording, radius: float | None) -> list[Mend]:
    """By what the checks of units say."""
    said = doubts(recording, radius)
    found = []
    for topic, text, field, factor, words in _FACTORS:
        if any(text in one for one in said.get(topic, ())):
            found.append(Mend(topic, words, factors={field: factor(radius or STANDARD_RADIUS)}))
    for one in said.get(STEERING, ()):
        if "in degrees?" in one:
            name = one.split()[0]
            found.append(Mend(STEERING, f"{name}: degrees into rad", factors={name: np.pi / 180}))
    return found


def _inertial(relations: Relations) -> list[Mend]:
    """Which way the axes of accelerometers and gyros lie."""
    told, up = _force_axes(relations), _rate_axis(relations)
    usual = np.eye(3)
    forces = usual if told is None else told
    gyros = usual if up is None else _bringing(up)
    if up is not None and told is not None and np.array_equal(forces[2], up) and np.linalg.det(forces) > 0:
        gyros = forces  # one housing
    if np.array_equal(gyros, forces):
        both = dict.fromkeys(("angular_velocity", "linear_acceleration"), _rows(forces))
        turned = not np.array_equal(forces, usual)
        return [Mend(IMU, f"the sensor is turned: {_in_words(forces)}", turns=both)] if turned else []
    found = []
    if not np.array_equal(forces, usual):
        kind = "turned" if np.linalg.det(forces) > 0 else "exchanged or reversed"
        words = f"the axes of the accelerometers are {kind}: {_in_words(forces)}"
        found.append(Mend(IMU, words, turns={"linear_acceleration": _rows(forces)}))
    if not np.array_equal(gyros, usual):
        words = f"the axes of the gyros are turned or reversed: {_in_words(gyros)}"
        found.append(Mend(IMU, words, turns={"angular_velocity": _rows(gyros)}))
    return found


def _rows(turn: Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(v) for v in row) for row in turn)


def _in_words(turn: Array) -> str:
    parts = []
    for axis, row in zip(_AXES, turn, strict=True):
        of = int(np.argmax(np.abs(row)))
        parts.append(f"{axis} is {'−' if row[of] < 0 else '+'}{'xyz'[of]}")
    return ", ".join(parts)


def _bringing(up: Array) -> Array:
    """A turn that brings an axis (3) upwards, and the others along."""
    of = int(np.argmax(np.abs(up)))
    if of == 2:
        return np.diag([1.0, up[2], up[2]])  # about x
    first = np.zeros(3)
    first[(of + 1) % 3] = 1.0
    return np.array([first, np.cross(up, first), up])


def _force_axes(relations: Relations) -> Array | None:
    """Which turn, of all 48 of axes exchanged and reversed, brings what accelerometers feel to what the car does."""
    motion = relations.motion_told_by_others()
    signals = relations.m.signals
    if motion is None or not all(name in signals for name in ("ax", "ay")):
        return None
    expected = np.array(motion)
    span = relations.gnss_span
    names = [name for name in ("ax", "ay", "az") if name in signals and np.isfinite(signals[name]).any()]
    felt = np.array([relations.m.smooth(signals[name], span) for name in names])
    lag = _lag(felt, expected)
    felt, expected = _shifted(felt, expected, lag)
    good = np.isfinite(felt).all(axis=0) & np.isfinite(expected).all(axis=0)
    if good.sum() < 100:
        return None
    felt, expected = felt[:, good], expected[:, good]
    if np.sqrt(np.mean(expected**2, axis=1)).min() < MOVING:
        return None
    with_gravity = len(names) == 3
    if with_gravity:
        expected = np.vstack([expected, np.full(expected.shape[1], GRAVITY)])
    left: list[tuple[float, Array]] = []
    for turn in _all_turns(len(names)):
        error = turn @ felt - expected
        # The attitude and offsets of the sensor stay in the means.
        error = error - np.clip(np.median(error, axis=1, keepdims=True), -1.5, 1.5)
        left.append((float(np.mean(np.abs(error))), turn))
    left.sort(key=lambda one: one[0])
    usual = next(value for value, turn in left if np.array_equal(turn, np.eye(len(names))))
    best, turn = left[0]
    if best > CLEAR * left[1][0]:
        return None
    if best > SURE * usual:
        turn = np.eye(len(names))
    if len(names) == 2:
        turn = np.array([[*turn[0], 0.0], [*turn[1], 0.0], [0.0, 0.0, 1.0]])
    return turn


def _all_turns(count: int) -> list[Array]:
    found = []
    for order in permutations(range(count)):
        for signs in product((1.0, -1.0), repeat=count):
            turn = np.zeros((count, count))
            for row, (of, sign) in enumerate(zip(order, signs, strict=True)):
                turn[row, of] = sign
            found.append(turn)
    return found


def _rate_axis(relations: Relations) -> Array | None:
    """Which axis of the gyros, with its sign, is the one that the car turns about (3)."""
    turn = relations.turning_told_by_others()
    if turn is None:
        return None
    best, axis = ALIKE, None
    for of, name in enumerate(("wx", "wy", "wz")):
        if name in relations.m.signals:
            rate = relations.m.smooth(relations.m.signals[name], relations.gnss_span)
            correlation = _best(rate, turn)
            if abs(correlation) > best:
                best, axis = abs(correlation), np.sign(correlation) * np.eye(3)[of]
    return axis


def _steering(relations: Relations) -> list[Mend]:
    """Steering angles against how the car turns, of which gyro and the others have to agree."""
    turn = relations.turning_told_by_others(steering=False, gyro=True)
    found = []
    for name in ("steering_wheel", "road_wheel_front"):
        if turn is not None and name in relations.turns and _best(relations.turns[name], turn) < -ALIKE:
            found.append(Mend(STEERING, f"{name}: the sign reversed", factors={name: -1.0}))
    return found


def _sides(relations: Relations) -> list[Mend]:
    """Wheels of the left that are called those of the right."""
    turn = relations.turning_told_by_others(wheels=False)
    if turn is None or "wheels" not in relations.turns or _best(relations.turns["wheels"], turn) > -ALIKE:
        return []
    names = {f"wheel_{axle}{side}": f"wheel_{axle}{'r' if side == 'l' else 'l'}" for axle in "fr" for side in "lr"}
    return [Mend(WHEELS, "left and right exchanged", names=names)]


def _best(one: Array, other: Array) -> float:
    """Correlation at the lag at which it is largest, whatever its sign; 0 where another lag is as good with the other
    sign."""
    values = []
    for shift in _shifts():
        a, b = _shifted(one[None], other[None], shift)
        good = np.isfinite(a[0]) & np.isfinite(b[0])
        if good.sum() > 100 and a[0, good].std() > 0 and b[0, good].std() > 0:
            values.append(float(np.corrcoef(a[0, good], b[0, good])[0, 1]))
    if not values:
        return 0.0
    high, low = max(values), -min(values)
    if min(high, low) > CLEAR * max(high, low):
        return 0.0
    return high if high > low else -low


def _lag(felt: Array, expected: Array) -> int:
    """Steps by which what is felt (k, n) is later than what is expected (2, n), whichever axes belong together."""

    def alike(shift: int) -> float:
        a, b = _shifted(felt, expected, shift)
        good = np.isfinite(a).all(axis=0) & np.isfinite(b).all(axis=0)
        if good.sum() < 100:
            return 0.0
        a, b = a[:, good], b[:, good]
        every = np.asarray(np.corrcoef(np.vstack([a, b])))
        found = np.abs(np.nan_to_num(every[: len(a), len(a) :]))
        return float(found.max(axis=0).sum())

    return max(_shifts(), key=lambda shift: (round(alike(shift), 2), -abs(shift)))


def _shifts() -> list[int]:
    step, most = round(LAG_STEP / Relations.STEP), round(MOST_LAG / Relations.STEP)
    return list(range(-most, most + 1, step))


def _shifted(one: Array, other: Array, shift: int) -> tuple[Array, Array]:
    """The first (k, n) so many steps later, and the other (m, n)."""
    n = one.shape[1]
    return one[:, max(shift, 0) : n + min(shift, 0)], other[:, max(-shift, 0) : n - max(shift, 0)]
