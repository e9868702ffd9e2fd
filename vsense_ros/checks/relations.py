"""What the sensors of a recording say of each other's conventions: which go along, and which go against each other.

Nothing here decides who is wrong. A relation is kept only where it is sure: two turning rates that hardly correlate, or
that correlate as well with either sign half a period later, say nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import FORCES, RATES, spread
from vsense_ros.checks.finding import Finding
from vsense_ros.checks.frames import FORMS
from vsense_ros.checks.lags import LagSettings, lag_curve, match
from vsense_ros.checks.motion import ACCELEROMETER, GNSS, ROAD_WHEEL, STEERING_WHEEL, WHEELS, Motion, motion_of
from vsense_ros.checks.motion import SETTINGS as MOTION
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import Subject
from vsense_ros.checks.units import GRAVITY

Array = NDArray[np.float64]
Key = tuple[float, ...]

VELOCITY, POSITION = "velocity", "position"  # sources of a turning rate, beside those of `motion`
TURNING = (VELOCITY, POSITION, WHEELS, ROAD_WHEEL, STEERING_WHEEL)  # those beside the IMU, the most trusted first


@dataclass(frozen=True)
class RelationSettings:
    """By which two sensors are known to go along, or against each other."""

    correlation: float = setting(0.7, "-", "from where on two signals show the same motion")
    clear: float = setting(0.9, "-", "of the best, which the second best stays below")
    lasting: float = setting(1.0, "s", "of turning, of less of which nothing is said", JUDGEMENT)
    overlap: float = setting(0.7, "-", "of the shorter of two signals, which has to remain at a lag", JUDGEMENT)
    one_way: float = setting(0.7, "-", "correlation about zero that outweighs one about the means", JUDGEMENT)
    better: float = setting(0.6, "-", "of the error with the axes as they are, below which others are right")
    moving: float = setting(0.3, "m/s²", "root mean square acceleration that shows where an axis is", JUDGEMENT)
    offset: float = setting(1.5, "m/s²", "of mean error that attitude and offsets of a sensor make", JUDGEMENT)
    least: float = setting(2.0, "s", "of driving", JUDGEMENT)
    coarse: float = setting(0.01, "-", "of a correlation, within which the smaller lag is taken", JUDGEMENT)
    gravity: tuple[float, float] = setting((7.0, 13.0), "m/s²", "mean specific force that has gravity in it", JUDGEMENT)
    upright: float = setting(0.8, "-", "share of gravity on one axis, from where on it is the vertical one", JUDGEMENT)
    tilting: float = setting(0.4, "-", "correlation of roll and pitch rates with what makes a body roll and pitch")
    gain: float = setting(0.4, "-", "correlation of the speed with the integral of an acceleration, without trends")
    gain_ratio: tuple[float, float] = setting((0.4, 2.5), "-", "standard deviation of the second over the first")
    climbing: float = setting(0.5, "-", "correlation of the vertical velocity with the change of the height")


SETTINGS = RelationSettings()
LAGS = LagSettings(longest=3.0, least_overlap=2.0)
_TILT_LAGS = LagSettings(longest=0.15)


def signed_correlation(one: Array, other: Array, step: float) -> float:
    """Correlation of two signals (n,), `step` [s] apart, at the lag at which it is largest, whatever its sign; 0 where
    another lag is as good with the other sign, as for a sine half a period later.

    Signals that go along without a lag keep that sign: a sine resembles itself one period later, too. Two that turn the
    same way all the time, while one becomes faster and the other slower, say nothing either: at the brakes in a bend
    the yaw rate may fall where a steering angle by a usual understeer says that it rises.
    """
    values = _correlations(one, other, step)
    if not len(values):
        return 0.0
    now = float(values[len(values) // 2])
    high, low = float(values.max()), -float(values.min())
    if now < SETTINGS.correlation and min(high, low) > SETTINGS.clear * max(high, low):
        return 0.0
    correlation = now if now >= SETTINGS.correlation or high == low == 0.0 else high if high > low else -low
    return 0.0 if correlation * _similarity(one, other) < -SETTINGS.one_way * abs(correlation) else correlation


def _correlations(one: Array, other: Array, step: float) -> Array:
    """Correlation (2 k + 1,) of two signals (n,) at all lags that are sought, the one without a lag in the middle; 0
    where too little of them would overlap, and nothing of signals that are too short."""
    longest = min(round(LAGS.longest / step), len(one) - 1)
    if longest < 1:
        return np.zeros(0)
    present = min(int(np.isfinite(values).sum()) for values in (one, other))
    least = max(LAGS.least_overlap / step, SETTINGS.overlap * present)
    return np.nan_to_num(lag_curve(one, other, longest, least).correlation)


def _similarity(one: Array, other: Array) -> float:
    """Correlation of two signals (n,) whose means are not taken off: 1 of a car that turns one way by both."""
    good = np.isfinite(one) & np.isfinite(other)
    power = float(np.sqrt(np.sum(one[good] ** 2) * np.sum(other[good] ** 2)))
    return float(one[good] @ other[good]) / power if power > 0 else 0.0


def signed_permutations(count: int) -> list[Array]:
    """All matrices with one ±1 in each row and column, the identity first."""
    rows = np.eye(count)
    return [
        np.array(signs)[:, None] * rows[list(order)]
        for order in permutations(range(count))
        for signs in product((1.0, -1.0), repeat=count)
    ]


def key(matrix: Array) -> Key:
    """A matrix (n, n) of whole numbers as a key of a mapping."""
    return tuple(float(v) + 0.0 for v in matrix.ravel())


@dataclass
class Relations:
    """What sensors say of each other, as far as it is sure.

    `turns` has +1 for each pair of sources of a turning rate that go along, and -1 for each that go against each other;
    `yaw_axes` the axis of the gyro (3,) with its sign that turns as a source says, by source;
    `wheel_push` is the sign of the change of the wheels' speed against that over ground, `wheels_forward` that of the
    wheels' speed itself, 0 where it is not sure. `force_errors` has the mean error [m/s²] that each orientation of the
    accelerometer, a matrix as a `key`, leaves against the change of speed, the turning of `reference` and gravity;
    `lateral` has the sign of a lateral acceleration without a longitudinal one against each turning rate, and `up` is
    the axis (3,) on which gravity is. `form` (2, 2) takes the change of the position to the velocity.
    """

    motion: Motion
    turns: dict[tuple[str, str], int] = field(default_factory=dict)
    yaw_axes: dict[str, Array] = field(default_factory=dict)
    wheel_push: int = 0
    wheels_forward: int = 0
    reference: str = ""
    by_wheels: bool = False  # whether the change of speed in `force_errors` is that by the wheels, which have a sign
    force_errors: dict[Key, float] = field(default_factory=dict)
    lateral: dict[str, int] = field(default_factory=dict)
    up: Array | None = None
    form: Array | None = None
    lags: dict[str, int] = field(default_factory=dict)
    _tilts: dict[tuple[int, int], int] = field(default_factory=dict)
    _gains: dict[int, int] = field(default_factory=dict)

    def has_turn(self, source: str) -> bool:
        """True if a source of a turning rate goes along with, or against, any other."""
        return source in self.yaw_axes or any(source in pair for pair in self.turns)

    def explained(self, forces: Array, turn: float, push: float) -> bool:
        """True if accelerometers that lie so (3, 3) go along with the others, given the signs `turn` and `push` by
        which the turning and the change of speed that they are compared with are to be multiplied."""
        if not self.force_errors:
            return True
        best = min(self.force_errors.values())
        error = self.force_errors[key(np.diag([push, turn, 1.0]) @ forces)]
        tolerance = SETTINGS.better if np.array_equal(forces, np.eye(3)) else SETTINGS.clear
        return best > tolerance * error or error == best

    def tilts(self, rate: Array, force: Array) -> int:
        """+1 where the rate about an axis of the gyro (3,) goes along with the change of the specific force on an axis
        of the accelerometer (3,), as a body rolls in bends and pitches at the brakes; -1 where it goes against it, 0
        where neither is known."""
        one, other = int(np.argmax(np.abs(rate))), int(np.argmax(np.abs(force)))
        if (one, other) not in self._tilts:
            self._tilts[one, other] = self._tilt(RATES[one], FORCES[other])
        return int(self._tilts[one, other] * rate[one] * force[other])

    def _tilt(self, rate: str, force: str) -> int:
        signals = self.motion.signals
        if rate not in signals or force not in signals:
            return 0
        twice = signals.smooth(signals.smooth(signals.signals[rate], MOTION.span), MOTION.span)
        change = signals.rate_of_change(signals.signals[force], MOTION.span)
        matched = match(twice, change, signals.step, _TILT_LAGS)
        return 0 if matched is None or abs(matched.best) < SETTINGS.tilting else int(np.sign(matched.best))

    def gains_speed(self, force: Array) -> int:
        """+1 where the car becomes faster as an axis of the accelerometer (3,) says, -1 where it becomes slower, 0
        where that is not known: the integral of the specific force against the speed, both without their trends."""
        axis = int(np.argmax(np.abs(force)))
        if axis not in self._gains:
            self._gains[axis] = self._gain(FORCES[axis])
        return int(self._gains[axis] * force[axis])

    def _gain(self, name: str) -> int:
        signals = self.motion.signals
        if name not in signals:
            return 0
        speed, force = signals.smooth(self.motion.speed, MOTION.span), signals.signals[name]
        good = np.isfinite(speed) & np.isfinite(force) & (self.motion.speed > MOTION.slowest)
        if good.sum() < signals.rows(SETTINGS.least):
            return 0
        t = signals.t[good]
        gained, speed = (
            values - np.polyval(np.polyfit(t, values, 1), t)
            for values in (np.cumsum(force[good]) * signals.step, speed[good])
        )
        if min(gained.std(), speed.std()) == 0.0:
            return 0
        low, high = SETTINGS.gain_ratio
        correlation = float(np.corrcoef(gained, speed)[0, 1])
        is_sure = abs(correlation) > SETTINGS.gain and low < gained.std() / speed.std() < high
        return int(np.sign(correlation)) if is_sure else 0


# What a velocity may be that no exchange of axes takes to east and north.
_NO_COURSE = (
    Reason.VELOCITY_IN_CAR_AXES,
    Reason.COURSE_STAYS,
    Reason.VELOCITY_APART,
    Reason.VELOCITY_SIZE,
    Reason.VELOCITY_UNIT,
)


def relations(subject: Subject) -> Relations | None:
    """What the sensors of a recording say of each other; None where nothing measures its speed."""
    if subject.aligned is None:
        return None
    frame_findings = (*subject.frame_findings, *subject.course_findings)
    has_course = not any(finding.reason in _NO_COURSE for finding in frame_findings)
    motion = motion_of(subject.aligned, course_by_position=not has_course)
    if not motion.has_speed:
        return None
    result = Relations(motion)
    turns = _turning_rates(motion, by_velocity=has_course)
    result.form = _form(motion, subject.frame_findings) if VELOCITY in turns else None
    names = list(turns)
    for index, one in enumerate(names):
        for other in names[:index]:
            _note(result.turns, one, other, turns[one], turns[other], motion.signals.step)
    _of_wheels(result)
    _of_gyro(result, turns)
    _of_accelerometer(result, turns)
    if result.form is not None:
        # The position turns as the velocity does, or the other way round, by what takes one to the other.
        sign = round(float(np.linalg.det(result.form)))
        for (one, other), agrees in list(result.turns.items()):
            if VELOCITY in (one, other):
                result.turns[POSITION, other if one == VELOCITY else one] = sign * agrees
        if VELOCITY in result.yaw_axes:
            result.yaw_axes[POSITION] = sign * result.yaw_axes[VELOCITY]
    return result


def _note(pairs: dict[tuple[str, str], int], one: str, other: str, first: Array, second: Array, step: float) -> None:
    correlation = signed_correlation(first, second, step)
    if abs(correlation) > SETTINGS.correlation:
        pairs[one, other] = 1 if correlation > 0 else -1


def _turning_rates(motion: Motion, *, by_velocity: bool) -> dict[str, Array]:
    """Turning rates (n,) [rad/s] by all that measures them beside the IMU, where the car turns."""
    signals = motion.signals
    result = {}
    if GNSS in motion.turns:
        result[VELOCITY if "east" in signals and by_velocity else POSITION] = motion.turns[GNSS]
    for name in (WHEELS, ROAD_WHEEL, STEERING_WHEEL):
        if name in motion.turns:
            result[name] = motion.turns[name]
    return {
        name: turn
        for name, turn in result.items()
        if spread(turn) > MOTION.least_turning and _lasts(turn) > signals.rows(SETTINGS.lasting)
    }


def _lasts(values: Array) -> float:
    """Over how many rows a signal (n,) deviates from its mean: as many as would have the ratio of its second and fourth
    moments with the same deviation each."""
    deviation = values[np.isfinite(values)]
    square = (deviation - deviation.mean()) ** 2
    return float(square.sum() ** 2 / (square**2).sum())


def _form(motion: Motion, frame_findings: Sequence[Finding]) -> Array | None:
    """The matrix (2, 2) that takes the change of the position to the velocity; None without both."""
    if "x" not in motion.signals or "east" not in motion.signals:
        return None
    for finding in frame_findings:
        if "form" in finding.evidence:
            return np.array(FORMS[int(finding.evidence["form"])][2])
        if finding.against:
            return None
    return np.eye(2)


def _of_wheels(result: Relations) -> None:
    motion = result.motion
    names = [name for name in motion.signals.signals if name.startswith("wheel_")]
    if not names:
        return
    mean = np.mean([motion.signals.signals[name] for name in names], axis=0)
    moving = np.abs(mean) > MOTION.wheel_spin
    if moving.sum() > motion.signals.rows(1.0):
        result.wheels_forward = int(np.sign(np.median(mean[moving])))
    if GNSS in motion.pushes and WHEELS in motion.pushes:
        pairs: dict[tuple[str, str], int] = {}
        rolling = motion.smooth(motion.pushes[WHEELS])
        _note(pairs, GNSS, WHEELS, motion.pushes[GNSS], rolling, motion.signals.step)
        result.wheel_push = pairs.get((GNSS, WHEELS), 0)


def _of_gyro(result: Relations, turns: Mapping[str, Array]) -> None:
    """The axis that turns, by each source, where one is.

    All axes are compared at one lag, and at none where another is hardly better: in a sine steer roll and pitch rates
    go along with the turning of the car a quarter of a period earlier or later. A late sensor is compared at its lag,
    if no other axis is as good at a lag of its own. Only the wheels need no such lag: a car turns later than it is
    steered, and its course changes later than it turns, the more so the faster it is steered.
    """
    motion = result.motion
    step = motion.signals.step
    names = [name for name in RATES if name in motion.signals]
    if not names:
        return
    rates = [motion.smooth(motion.signals.signals[name]) for name in names]
    for source, turning in turns.items():
        curves = np.abs([_correlations(rate, turning, step) for rate in rates])
        if not curves.size:
            continue
        middle = curves.shape[1] // 2
        highest = curves.max(axis=1)
        at_once = curves[:, middle].max() >= SETTINGS.clear * highest.max()
        if at_once and source == WHEELS:
            result.lags[source] = 0
            best = int(np.argmax(curves[:, middle]))
        else:
            best = int(np.argmax(highest))
            if (highest >= SETTINGS.clear * highest[best]).sum() > 1:
                continue
            result.lags[source] = _smallest_lag(curves[best])
        correlation = signed_correlation(rates[best], turning, step)
        if abs(correlation) > SETTINGS.correlation:
            result.yaw_axes[source] = np.sign(correlation) * np.eye(3)[RATES.index(names[best])]


def _of_accelerometer(result: Relations, turns: Mapping[str, Array]) -> None:
    motion = result.motion
    signals = motion.signals.signals
    names = [name for name in FORCES if name in signals and np.isfinite(signals[name]).any()]
    if len(names) == 3:
        result.up = _up(np.array([np.nanmedian(signals[name]) for name in names]))
    if "ax" not in names and ACCELEROMETER in motion.turns:
        for source, turning in turns.items():
            pairs: dict[tuple[str, str], int] = {}
            _note(pairs, ACCELEROMETER, source, motion.turns[ACCELEROMETER], turning, motion.signals.step)
            result.lateral |= {other: agrees for (_, other), agrees in pairs.items()}
    along = motion.along
    result.reference = next((name for name in TURNING if name in turns), "")
    if along is None or not result.reference or names[:2] != list(FORCES[:2]):
        return
    result.by_wheels = GNSS not in motion.pushes
    turning = turns[result.reference]
    turning = turning if result.reference in (VELOCITY, POSITION) else motion.smooth(turning)
    expected = np.array([along, motion.smooth(motion.speed) * turning])
    expected[:, ~(motion.speed > MOTION.slowest)] = np.nan
    measured = np.array([motion.smooth(signals[name]) for name in names])
    if np.sqrt(np.nanmean(expected**2, axis=1)).max() >= SETTINGS.moving:
        lag = result.lags.get(result.reference)
        result.force_errors |= _force_errors(measured, expected, result.up is not None, lag, motion.signals.step)


def _up(mean: Array) -> Array | None:
    """The direction of gravity's reaction (3,) in the axes of a sensor whose median accelerations are these (3,)
    [m/s²]; None where they are not gravity along an axis."""
    size, axis = float(np.linalg.norm(mean)), int(np.argmax(np.abs(mean)))
    if SETTINGS.gravity[0] < size < SETTINGS.gravity[1] and abs(mean[axis]) > SETTINGS.upright * size:
        return np.asarray(np.sign(mean[axis]) * np.eye(3)[axis])
    return None


def _force_errors(measured: Array, expected: Array, upright: bool, lag: int | None, step: float) -> dict[Key, float]:
    """Mean absolute errors [m/s²] of accelerations (2 or 3, n) turned by each signed permutation of the axes, against
    those expected along and across (2, n), and against gravity if the sensor measures it (`upright`).

    The accelerations are `lag` steps of `step` [s] late, or each permutation has the lag that is best for it: in a sine
    reversed axes are as right half a period later, and no more so.
    """
    whole = np.zeros((3, measured.shape[1]))
    whole[: len(measured)] = measured
    gravity = np.full((1 if upright else 0, measured.shape[1]), GRAVITY)
    # Of a car that hardly gains speed only the lateral axis says how late it is.
    curves = np.array(
        [[spread(axis) * spread(one) * _correlations(axis, one, step) for axis in measured] for one in expected]
    )
    errors = {}
    for matrix in signed_permutations(3):
        if len(measured) < 3 and matrix[2, 2] != 1.0:
            continue
        late = _best_lag(curves, matrix) if lag is None else lag
        length, later, earlier = whole.shape[1] - abs(late), max(late, 0), max(-late, 0)
        target = np.vstack([expected[:, earlier : earlier + length], gravity[:, :length]])
        error = (matrix @ whole[:, later : later + length])[: len(target)] - target
        error = error[:, np.isfinite(error).all(axis=0)]
        if error.shape[1] < SETTINGS.least / step:
            return {}
        # The attitude and offsets of the sensor stay in the means.
        error = error - np.clip(np.median(error, axis=1, keepdims=True), -SETTINGS.offset, SETTINGS.offset)
        errors[key(matrix)] = float(np.mean(np.abs(error)))
    return errors


def _best_lag(curves: Array, matrix: Array) -> int:
    """Steps by which accelerations turned by a matrix (3, 3) are later than those expected, by the covariances
    (2, 2 or 3, lags) of each of these with each axis."""
    whole = np.einsum("ij,ijk->k", matrix[: curves.shape[0], : curves.shape[1]], curves)
    return _smallest_lag(whole)


def _smallest_lag(curve: Array) -> int:
    """The lag [steps] nearest to none at which a curve (2 k + 1,) is as good as at its best."""
    shifts = np.arange(len(curve)) - len(curve) // 2
    return int(min(shifts[curve >= (1 - SETTINGS.coarse) * curve.max(initial=0.0)], key=abs, default=0))
