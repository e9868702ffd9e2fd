"""Signs and axes: how the car turns and gains speed by one sensor against how it does by the others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import RATES, spread
from vsense_ros.checks.blame import who_is_wrong
from vsense_ros.checks.finding import Confidence, Finding, Kind, Rename, Scale
from vsense_ros.checks.lags import LagSettings, match
from vsense_ros.checks.motion import (
    ACCELEROMETER,
    GNSS,
    GYRO,
    ROAD_WHEEL,
    ROLE_OF,
    STEERING_WHEEL,
    WHEELS,
    Motion,
)
from vsense_ros.checks.motion import SETTINGS as MOTION
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import Role
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import Subject
from vsense_ros.checks.units import GRAVITY
from vsense_ros.messages.topics import WHEELS as CORNERS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ConsistencySettings:
    """Limits by which signals contradict each other."""

    correlation: float = setting(0.5, "-", "of two turning rates from where on they agree, or have opposite signs")
    other_axis: float = setting(0.9, "-", "correlation of another axis of the gyro with the turning, that turns")
    own_axis: float = setting(0.6, "-", "correlation of axis z, below which it does not turn")
    axis_least: float = setting(0.03, "rad/s", "standard deviation of the turning by which an axis is found")
    axis_ratio: tuple[float, float] = setting((0.5, 2.0), "-", "ratio of an axis and the turning")
    rate_correlation: float = setting(0.6, "-", "from where on the yaw rate's own unit is taken into account")
    least_driving: float = setting(2.0, "s", "in which accelerations are compared", JUDGEMENT)
    least_motion: float = setting(0.5, "m/s²", "root mean square that accelerations have", JUDGEMENT)
    one_axis: float = setting(0.3, "m/s²", "below which an axis is not driven along")
    in_g: tuple[float, float] = setting((0.06, 0.2), "-", "ratio of accelerations that are in g")
    offset: float = setting(1.0, "m/s²", "of mean error that attitude and offsets of a sensor make", JUDGEMENT)
    better: float = setting(0.5, "-", "of the error with the axes as they are, below which others are right")
    g_better: float = setting(0.6, "-", "of the accelerations that accelerations in g leave unexplained")
    alike: float = setting(1.2, "-", "of the least error, up to which other axes are as good")
    alike_apart: float = setting(0.02, "m/s²", "likewise, added", JUDGEMENT)
    wheel_span: float = setting(0.5, "s", "of the means in which wheels are compared", JUDGEMENT)
    wheel_spin: float = setting(10.0, "rad/s", "above which they are", JUDGEMENT)
    wheel_ratio: tuple[float, float] = setting((0.9, 1.1), "-", "spin of a wheel over that of the others")


SETTINGS = ConsistencySettings()
AXIS_LAGS = LagSettings(longest=0.3)  # of a gyro's axis, whose lag another check finds

# How sure a source's sign is: receivers hardly ever have a wrong one, mappings of accelerometers often do.
TRUST = {GNSS: 1.2, GYRO: 1.1, ROAD_WHEEL: 1.01, STEERING_WHEEL: 1.0, WHEELS: 0.99, ACCELEROMETER: 0.9}
SIDES = Rename(tuple((f"wheel_{corner}", f"wheel_{corner[0]}{'r' if corner[1] == 'l' else 'l'}") for corner in CORNERS))


def reversed_turning(motion: Motion) -> dict[str, str]:
    """The sources whose turning rate has the opposite sign of most of the others, each with one of these."""
    sources = [name for name, turn in motion.turns.items() if spread(turn) > MOTION.least_turning]
    agree = {}
    for one, other in combinations(sources, 2):
        matched = motion.compared(motion.turns, one, other)
        if matched is not None and abs(matched.correlation) > SETTINGS.correlation:
            agree[one, other] = matched.correlation > 0
    wrong = who_is_wrong(agree, TRUST, reversed_signs=True).wrong
    result = {}
    for name in wrong:
        partners = [pair[pair[0] == name] for pair in agree if name in pair]
        if right := [partner for partner in partners if partner not in wrong]:
            result[name] = right[0]
    return result


def turning(subject: Subject, earlier: Sequence[Finding]) -> Iterator[Finding]:
    """Turning rates with the opposite sign of most others. That of an accelerometer is judged by `axes_in_plane`."""
    motion, topics = subject.motion, subject.topics
    if motion is None:
        return
    blamed = {finding.topic for finding in earlier}
    for source, other in reversed_turning(motion).items():
        topic = topics[ROLE_OF[source]]
        if source == GNSS:
            if topic in blamed:
                continue
            if "east" in motion.signals:
                yield Finding(topic, Kind.FRAME, Reason.COURSE_AGAINST, against=other)
            else:
                yield Finding(topics[Role.POSITION], Kind.AXES, Reason.POSITION_COURSE_AGAINST, against=other)
        elif source == WHEELS:
            yield Finding(topic, Kind.AXES, Reason.WHEEL_SIDES, against=other, mend=SIDES)
        elif source == GYRO:
            yield Finding(topic, Kind.SIGN, Reason.TURNS_AGAINST, "angular_velocity.z", other)
        elif source != ACCELEROMETER:
            mend = Scale("position", -1.0, source)
            yield Finding(topic, Kind.SIGN, Reason.TURNS_AGAINST, source, other, mend=mend)


def gyro_axes(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """A turning of the car that shows on another axis of the gyro than z."""
    motion = subject.motion
    reference = None if motion is None else motion.first_turning(GNSS, WHEELS, least=SETTINGS.axis_least)
    if motion is None or reference is None or "wz" not in motion.signals:
        return
    span = motion.gnss_span if reference == GNSS else MOTION.span
    correlation, ratio = dict.fromkeys(RATES, 0.0), dict.fromkeys(RATES, 0.0)
    for name in RATES:
        if name in motion.signals:
            turn = motion.smooth(motion.signals.signals[name], span)
            if (matched := match(turn, motion.turns[reference], motion.signals.step, AXIS_LAGS)) is not None:
                correlation[name], ratio[name] = abs(matched.best), matched.ratio
    best = max(RATES, key=lambda name: correlation[name])
    low, high = SETTINGS.axis_ratio
    turns = correlation[best] > SETTINGS.other_axis and low < ratio[best] < high
    if best != "wz" and turns and correlation["wz"] < SETTINGS.own_axis:
        yield Finding(
            subject.topics[Role.IMU], Kind.AXES, Reason.TURN_AXIS, "angular_velocity", reference,
            evidence={"correlation": correlation[best]}, names={"axis": best[1]},
        )  # fmt: skip


# What accelerometers (2, n) measure of the motion, longitudinal and lateral, with axes exchanged and reversed.
_PLANE: tuple[tuple[Reason | None, Kind, tuple[tuple[int, int], tuple[int, int]]], ...] = (
    (None, Kind.AXES, ((1, 0), (0, 1))),
    (Reason.FORCES_REVERSED, Kind.AXES, ((-1, 0), (0, -1))),
    (Reason.LATERAL_REVERSED, Kind.SIGN, ((1, 0), (0, -1))),
    (Reason.LONGITUDINAL_REVERSED, Kind.SIGN, ((-1, 0), (0, 1))),
    (Reason.FORCES_EXCHANGED, Kind.AXES, ((0, 1), (1, 0))),
    (Reason.FORCES_QUARTER_TURN, Kind.AXES, ((0, 1), (-1, 0))),
    (Reason.FORCES_QUARTER_TURN, Kind.AXES, ((0, -1), (1, 0))),
    (Reason.FORCES_EXCHANGED_REVERSED, Kind.AXES, ((0, -1), (-1, 0))),
)
_SINGLE = {Reason.LATERAL_REVERSED: "linear_acceleration.y", Reason.LONGITUDINAL_REVERSED: "linear_acceleration.x"}


def axes_in_plane(subject: Subject, earlier: Sequence[Finding]) -> Iterator[Finding]:
    """Accelerometers against the change of speed and how the car turns: signs and axes in the plane."""
    motion = subject.motion
    if motion is None:
        return
    topic = subject.topics[Role.IMU]
    if "ax" not in motion.signals or "ay" not in motion.signals:
        if ACCELEROMETER in reversed_turning(motion):
            yield Finding(topic, Kind.SIGN, Reason.LATERAL_REVERSED, _SINGLE[Reason.LATERAL_REVERSED])
        return
    compared = _accelerations(motion, earlier, subject)
    if compared is None:
        return
    s = SETTINGS
    expected, measured = compared
    power = np.mean(expected**2, axis=1)
    if power.max() < s.least_motion**2:
        return
    scale = float(np.sqrt(np.mean(measured**2) / np.mean(expected**2)))
    in_g = s.in_g[0] < scale < s.in_g[1]
    if in_g:
        measured = measured * GRAVITY
    errors = [_mean_error(measured, np.array(matrix) @ expected) for *_, matrix in _PLANE]
    best = int(np.argmin(errors))
    evidence = {"error": errors[best], "error_as_it_is": errors[0], "ratio": scale}
    if best == 0 or errors[best] > s.better * errors[0]:
        if in_g and errors[0] < s.g_better * float(np.mean(np.abs(expected))):
            yield Finding(topic, Kind.UNIT, Reason.FORCES_TENTH, "linear_acceleration", evidence=evidence)
        return
    # Where the car was driven along one axis only, several explain it alike: then the one with the fewest changes.
    one_axis = bool(power.min() < s.one_axis**2)
    reason, kind, _ = _PLANE[_fewest_changes(errors, best) if one_axis else best]
    assert reason is not None
    undecided = reason in _SINGLE and one_axis
    yield Finding(
        topic, kind, reason, _SINGLE.get(reason, "linear_acceleration"),
        confidence=Confidence.UNDECIDED if undecided else Confidence.LIKELY, evidence=evidence,
    )  # fmt: skip


def _mean_error(measured: Array, expected: Array) -> float:
    """Mean absolute error [m/s²] of accelerations (2, n) but for an offset by the attitude and bias of the sensor."""
    error = measured - expected
    offset = np.clip(np.median(error, axis=1, keepdims=True), -SETTINGS.offset, SETTINGS.offset)
    return float(np.mean(np.abs(error - offset)))


def _fewest_changes(errors: Sequence[float], best: int) -> int:
    """The first exchange of axes in `_PLANE` that reverses a single one and explains nearly as much as the best."""
    limit = SETTINGS.alike * errors[best] + SETTINGS.alike_apart
    alike = (i for i in range(1, len(_PLANE)) if errors[i] < limit)
    return next((i for i in alike if _PLANE[i][0] in _SINGLE), best)


def _accelerations(motion: Motion, earlier: Sequence[Finding], subject: Subject) -> tuple[Array, Array] | None:
    """Longitudinal and lateral acceleration (2, n) as the other sensors have them, and as the accelerometers do; None
    where there is too little of them."""
    doubted = {f.topic for f in earlier if f.kind in (Kind.SIGN, Kind.AXES, Kind.FRAME)}
    sources = (name for name in (GYRO, GNSS, WHEELS) if name in motion.turns)
    source = next((name for name in sources if subject.topics[ROLE_OF[name]] not in doubted), None)
    if source is None or not motion.pushes.keys() & {GNSS, WHEELS}:
        return None
    span = motion.gnss_span if GNSS in motion.pushes else MOTION.span
    by_span = replace(motion, gnss_span=span)
    along, side = by_span.along, by_span.to_the_left(source) / _unit_of_gyro(motion, source)
    measured = np.array([motion.smooth(motion.signals.signals[name], span) for name in ("ax", "ay")])
    expected = np.array([along, side])
    good = np.isfinite(expected).all(axis=0) & np.isfinite(measured).all(axis=0) & (motion.speed > MOTION.slowest)
    if good.sum() < motion.signals.rows(SETTINGS.least_driving):
        return None
    return expected[:, good], measured[:, good]


def _unit_of_gyro(motion: Motion, source: str) -> float:
    """Ratio of a gyro to the turning by others where that is another unit, 1 otherwise."""
    other = next((name for name in (GNSS, WHEELS) if name in motion.turns), None)
    matched = None if source != GYRO or other is None else motion.compared(motion.turns, GYRO, other)
    if matched is None or abs(matched.best) <= SETTINGS.rate_correlation:
        return 1.0
    low, high = SETTINGS.axis_ratio
    return matched.ratio if not low < matched.ratio < high else 1.0


def wheel_ratios(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """A wheel that turns faster or slower than the others, or backwards."""
    signals, s = subject.aligned, SETTINGS
    if signals is None:
        return
    names = [name for name in signals.signals if name.startswith("wheel_")]
    if len(names) < 3:
        return
    spins = np.array([signals.smooth(signals.signals[name], s.wheel_span) for name in names])
    usual = np.median(spins, axis=0)
    moving = np.isfinite(spins).all(axis=0) & (np.abs(usual) > s.wheel_spin)
    if moving.sum() <= signals.rows(s.least_driving):
        return
    for name, ratio in zip(names, np.median(spins[:, moving] / usual[moving], axis=1), strict=True):
        if not s.wheel_ratio[0] < ratio < s.wheel_ratio[1]:
            yield Finding(
                subject.topics[Role.WHEELS], Kind.SIGN if ratio < 0 else Kind.UNIT, Reason.WHEEL_RATIO, name,
                evidence={"ratio": float(ratio)},
            )  # fmt: skip
