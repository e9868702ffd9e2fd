"""How the axes of a sensor lie, and whether a sign or a side is exchanged, whatever its clock says.

Which way the axes of an inertial sensor lie follows from gravity, from the change of speed and from how the car turns.
Lags are sought before signs, so that a late sensor is not taken for a reversed one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import FORCES, INERTIAL_FIELDS, RATES
from vsense_ros.checks.consistency import SIDES
from vsense_ros.checks.finding import Finding, Kind, Matrix, Scale, Turn
from vsense_ros.checks.lags import LagSettings, lag_curve
from vsense_ros.checks.motion import ACCELEROMETER, GNSS, GYRO, ROAD_WHEEL, STEERING_WHEEL, WHEELS, Motion
from vsense_ros.checks.motion import SETTINGS as MOTION
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import Role
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import Subject
from vsense_ros.checks.units import GRAVITY

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OrientationSettings:
    """By which axes and signs are known well enough to be mended."""

    correlation: float = setting(0.7, "-", "from where on two signals show the same motion")
    clear: float = setting(0.9, "-", "of the best, which the second best stays below")
    better: float = setting(0.6, "-", "of the error with the axes as they are, below which others are right")
    moving: float = setting(0.3, "m/s²", "root mean square acceleration that shows where an axis is", JUDGEMENT)
    offset: float = setting(1.5, "m/s²", "of mean error that attitude and offsets of a sensor make", JUDGEMENT)
    least: float = setting(2.0, "s", "of driving", JUDGEMENT)
    coarse: float = setting(0.01, "-", "of a correlation, within which the smaller lag is taken", JUDGEMENT)


SETTINGS = OrientationSettings()
LAGS = LagSettings(longest=3.0, least_overlap=2.0)


def orientation(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Axes, signs and sides that are exchanged, each with the transformation that mends it; nothing where GNSS, which
    shows them, is wrong itself."""
    motion = subject.motion
    if motion is not None and not subject.frame_findings and not subject.course_findings:
        yield from _inertial(motion, subject.topics[Role.IMU])
        yield from _lateral_alone(motion, subject.topics[Role.IMU])
        yield from _steering(motion, subject.topics[Role.STEERING])
        yield from _sides(motion, subject.topics[Role.WHEELS])


def signed_correlation(one: Array, other: Array, step: float) -> float:
    """Correlation of two signals (n,), `step` [s] apart, at the lag at which it is largest, whatever its sign; 0 where
    another lag is as good with the other sign, as for a sine half a period later.

    Signals that go along without a lag keep that sign: a sine resembles itself one period later, too.
    """
    longest = min(round(LAGS.longest / step), len(one) - 1)
    if longest < 1:
        return 0.0
    values = np.nan_to_num(lag_curve(one, other, longest, LAGS.least_overlap / step).correlation)
    if values[longest] >= SETTINGS.correlation:
        return float(values[longest])
    high, low = float(values.max()), -float(values.min())
    if min(high, low) > SETTINGS.clear * max(high, low):
        return 0.0
    return high if high > low else -low


def _inertial(motion: Motion, topic: str) -> Iterator[Finding]:
    """How the axes of accelerometers and gyros lie: in one way if that may be, as they share a housing."""
    by_forces, up = _force_axes(motion), _turning_axis(motion)
    usual = np.eye(3)
    forces = usual if by_forces is None else by_forces
    rates = usual if up is None else _bringing_up(up)
    if up is not None and by_forces is not None and np.array_equal(forces[2], up) and np.linalg.det(forces) > 0:
        rates = forces
    rate_field, force_field = INERTIAL_FIELDS
    if np.array_equal(rates, forces):
        parts: list[tuple[Reason, Array, tuple[str, ...]]] = [(Reason.SENSOR_TURNED, forces, (rate_field, force_field))]
    else:
        parts = [(_force_reason(forces), forces, (force_field,)), (Reason.RATE_AXES, rates, (rate_field,))]
    for reason, matrix, fields in parts:
        if not np.array_equal(matrix, usual):
            rows: Matrix = tuple(tuple(float(v) for v in row) for row in matrix)
            yield Finding(topic, Kind.AXES, reason, " ".join(fields), mend=Turn(fields, rows))


def _force_reason(forces: Array) -> Reason:
    return Reason.FORCE_AXES_TURNED if np.linalg.det(forces) > 0 else Reason.FORCE_AXES_EXCHANGED


def _bringing_up(up: Array) -> Array:
    """A rotation (3, 3) that brings an axis (3,) upwards, and the others along."""
    axis = int(np.argmax(np.abs(up)))
    if axis == 2:
        return np.diag([1.0, up[2], up[2]])  # about x
    first = np.zeros(3)
    first[(axis + 1) % 3] = 1.0
    return np.array([first, np.cross(up, first), up])


def _force_axes(motion: Motion) -> Array | None:
    """The matrix (3, 3), of all 48 of axes exchanged and reversed, that brings what accelerometers measure to how the
    car moves by the other sensors; None where they do not determine it."""
    signals = motion.signals
    source = next((name for name in (GNSS, WHEELS, GYRO) if name in motion.turns), None)
    along = motion.along
    names = [name for name in FORCES if name in signals and np.isfinite(signals.signals[name]).any()]
    if along is None or source is None or names[:2] != list(FORCES[:2]):
        return None
    expected = np.array([along, motion.to_the_left(source)])
    expected[:, ~(motion.speed > MOTION.slowest)] = np.nan
    measured = np.array([motion.smooth(signals.signals[name]) for name in names])
    lag = _lag(measured, expected, signals.step)
    length, later, earlier = len(signals.t) - abs(lag), max(lag, 0), max(-lag, 0)
    measured, expected = measured[:, later : later + length], expected[:, earlier : earlier + length]
    good = np.isfinite(measured).all(axis=0) & np.isfinite(expected).all(axis=0)
    if good.sum() < signals.rows(SETTINGS.least):
        return None
    measured, expected = measured[:, good], expected[:, good]
    if np.sqrt(np.mean(expected**2, axis=1)).min() < SETTINGS.moving:
        return None
    if len(names) == 3:
        expected = np.vstack([expected, np.full(expected.shape[1], GRAVITY)])
    errors = []
    for matrix in _signed_permutations(len(names)):
        error = matrix @ measured - expected
        # The attitude and offsets of the sensor stay in the means.
        error = error - np.clip(np.median(error, axis=1, keepdims=True), -SETTINGS.offset, SETTINGS.offset)
        errors.append((float(np.mean(np.abs(error))), matrix))
    as_it_is = errors[0][0]
    (best, matrix), (second, _) = sorted(errors, key=lambda one: one[0])[:2]
    if best > SETTINGS.clear * second:
        return None
    result = np.eye(3)
    if best <= SETTINGS.better * as_it_is:
        result[: len(names), : len(names)] = matrix
    return result


def _signed_permutations(count: int) -> list[Array]:
    """All matrices with one ±1 in each row and column, the identity first."""
    rows = np.eye(count)
    return [
        np.array(signs)[:, None] * rows[list(order)]
        for order in permutations(range(count))
        for signs in product((1.0, -1.0), repeat=count)
    ]


def _turning_axis(motion: Motion) -> Array | None:
    """The axis of the gyros (3,), with its sign, that the car turns about; None where the others do not show it.

    All axes are compared at one lag, and at none where another is hardly better: in a sine steer roll and pitch rates
    go along with the turning of the car a quarter of a period earlier or later. A late sensor is compared at its lag.
    """
    source = motion.first_turning(GNSS, WHEELS, ROAD_WHEEL, STEERING_WHEEL)
    names = [name for name in RATES if name in motion.signals]
    if source is None or not names:
        return None
    step = motion.signals.step
    rates, turning = [motion.smooth(motion.signals.signals[name]) for name in names], motion.turns[source]
    longest = min(round(LAGS.longest / step), len(turning) - 1)
    if longest < 1:
        return None
    least = LAGS.least_overlap / step
    curves = np.abs(np.nan_to_num([lag_curve(rate, turning, longest, least).correlation for rate in rates]))
    together = curves[:, longest].max() >= SETTINGS.clear * curves.max()
    lag = longest if together else int(np.argmax(curves.max(axis=0)))
    best = int(np.argmax(curves[:, lag]))
    correlation = signed_correlation(rates[best], turning, step)
    if abs(correlation) <= SETTINGS.correlation:
        return None
    return np.asarray(np.sign(correlation) * np.eye(3)[RATES.index(names[best])])


def _lateral_alone(motion: Motion, topic: str) -> Iterator[Finding]:
    """The sign of a lateral accelerometer without a longitudinal one, against how the car turns by other sensors than
    the inertial one, else by its gyro."""
    if "ax" in motion.signals or ACCELEROMETER not in motion.turns:
        return
    source = motion.first_turning(GNSS, WHEELS, ROAD_WHEEL, STEERING_WHEEL, GYRO)
    if source is not None and _is_reversed(motion, ACCELEROMETER, source):
        rows: Matrix = ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
        mend = Turn(("linear_acceleration",), rows)
        yield Finding(topic, Kind.SIGN, Reason.LATERAL_REVERSED, "linear_acceleration.y", mend=mend)


def _steering(motion: Motion, topic: str) -> Iterator[Finding]:
    """Steering angles against how the car turns."""
    source = motion.first_turning(GNSS, GYRO, WHEELS)
    for name in (STEERING_WHEEL, ROAD_WHEEL):
        if source is not None and name in motion.turns and _is_reversed(motion, name, source):
            mend = Scale("position", -1.0, name)
            yield Finding(topic, Kind.SIGN, Reason.TURNS_AGAINST, name, source, mend=mend)


def _sides(motion: Motion, topic: str) -> Iterator[Finding]:
    """Wheels of the left that are called those of the right."""
    source = motion.first_turning(GNSS, ROAD_WHEEL, STEERING_WHEEL)
    if source is not None and WHEELS in motion.turns and _is_reversed(motion, WHEELS, source):
        yield Finding(topic, Kind.AXES, Reason.WHEEL_SIDES, against=source, mend=SIDES)


def _is_reversed(motion: Motion, name: str, source: str) -> bool:
    correlation = signed_correlation(motion.turns[name], motion.turns[source], motion.signals.step)
    return correlation < -SETTINGS.correlation


def _lag(measured: Array, expected: Array, step: float) -> int:
    """Steps by which measured accelerations (k, n) are later than those expected (2, n), whichever axes belong
    together: where the sum of the best correlations is largest."""
    longest = min(round(LAGS.longest / step), measured.shape[1] - 1)
    whole = np.zeros(2 * longest + 1)
    for one in expected:
        curves = [lag_curve(axis, one, longest, LAGS.least_overlap / step).correlation for axis in measured]
        whole += np.nan_to_num(np.abs(curves)).max(axis=0)
    shifts = np.arange(-longest, longest + 1)
    as_good = whole >= whole.max() - SETTINGS.coarse
    return int(min(shifts[as_good], key=abs))
