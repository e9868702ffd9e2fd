"""The frame of the GNSS velocity, and the position, against each other and the yaw rate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import AlignedSignals, Mask, spread
from vsense_ros.checks.blame import who_is_wrong
from vsense_ros.checks.finding import Confidence, Finding, Kind, Matrix, Scale
from vsense_ros.checks.lags import match
from vsense_ros.checks.motion import GYRO, Motion, ground_span
from vsense_ros.checks.motion import SETTINGS as MOTION
from vsense_ros.checks.noise import white_noise
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import Role
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.messages.units import to_si

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FrameSettings:
    """Limits by which a velocity is not the change of a position."""

    spans: tuple[float, ...] = setting((1.0, 2.0, 3.0), "s", "of means, the next where fixes are noisier", JUDGEMENT)
    noise_share: float = setting(0.05, "-", "of the speed that the noise of the position may be", JUDGEMENT)
    least: float = setting(2.0, "s", "of driving", JUDGEMENT)
    apart_share: float = setting(0.1, "-", "of the speed by which the two differ, below which nothing is wrong")
    apart: float = setting(1.0, "m/s", "likewise")
    apart_noise: float = setting(5.0, "-", "times the noise of the position, likewise")
    form_share: float = setting(0.35, "-", "of the difference that a form leaves which explains it")
    form_speed_share: float = setting(0.2, "-", "of the speed that it leaves")
    form_apart: float = setting(2.0, "m/s", "that it may leave at low speed")
    exchanged_share: float = setting(0.3, "-", "of the difference that latitude and longitude exchanged leave")
    unknown_share: float = setting(0.4, "-", "of the speed by which the two differ though no form explains it")
    unknown_apart: float = setting(3.0, "m/s", "likewise at low speed")
    unknown_least: float = setting(4.0, "s", "of driving for that")
    size_low: float = setting(0.6, "-", "ratio of the speeds, below which a unit is wrong")
    size_high: float = setting(1.6, "-", "ratio of the speeds, above which a unit is wrong")
    agreement: float = setting(0.5, "-", "correlation of a course's turning with the yaw rate from where on they agree")
    gyro_span: float = setting(1.0, "s", "of the means of both", JUDGEMENT)
    gyro_least: float = setting(0.01, "rad/s", "standard deviation of both", JUDGEMENT)
    step: float = setting(4.0, "m", "by which a position steps that stays beside the way of the velocity")
    step_noise: float = setting(6.0, "-", "times its usual change, likewise")
    fixes: int = setting(10, "-", "before and behind a step of the position", JUDGEMENT)
    turned_low: float = setting(0.03, "rad", "standard deviation of a heading that changes")
    turned_high: float = setting(3.0, "rad", "beyond which the drift of a gyro adds up", JUDGEMENT)
    course_share: float = setting(0.2, "-", "of the heading's change that a course makes which stays")
    course_zero: float = setting(0.03, "rad", "that such a course is from zero")


SETTINGS = FrameSettings()
_UNITS = ("km/h", "mph", "kn")
# What takes a velocity to the east and north to what a sensor gives in other axes.
FORMS: tuple[tuple[Reason, Kind, Matrix], ...] = (
    (Reason.VELOCITY_EXCHANGED, Kind.FRAME, ((0.0, 1.0), (1.0, 0.0))),
    (Reason.VELOCITY_EAST_REVERSED, Kind.SIGN, ((-1.0, 0.0), (0.0, 1.0))),
    (Reason.VELOCITY_NORTH_REVERSED, Kind.SIGN, ((1.0, 0.0), (0.0, -1.0))),
    (Reason.VELOCITY_REVERSED, Kind.SIGN, ((-1.0, 0.0), (0.0, -1.0))),
    (Reason.VELOCITY_QUARTER_TURN, Kind.FRAME, ((0.0, -1.0), (1.0, 0.0))),
    (Reason.VELOCITY_QUARTER_TURN, Kind.FRAME, ((0.0, 1.0), (-1.0, 0.0))),
    (Reason.VELOCITY_EXCHANGED, Kind.FRAME, ((0.0, -1.0), (-1.0, 0.0))),
)


def velocity_against_position(signals: AlignedSignals) -> Finding | None:
    """The finding that the GNSS velocity is not the change of the position; None where it is, or one is missing."""
    if "x" not in signals or "east" not in signals:
        return None
    s, topics = SETTINGS, signals.topics
    velocity_topic, position_topic = topics[Role.VELOCITY], topics[Role.POSITION]
    compared = _in_means(signals)
    if compared is None:
        return None
    velocity, by_position, span, good, noise = compared
    speed = np.hypot(*by_position)
    usual = float(np.median(speed))
    away = _apart(velocity, by_position)
    if away < max(s.apart_share * usual, s.apart, s.apart_noise * noise):
        return None
    forms = _forms(by_position, velocity_topic)
    left = [_apart(velocity, form) for form, _ in forms]
    best = int(np.argmin(left))
    evidence = {"apart": away, "ratio": float(np.median(np.hypot(*velocity)) / usual)}
    if "x'" in signals:
        swapped = [signals.rate_of_change(signals.signals[name], span)[good] for name in ("x'", "y'")]
        if _apart(velocity, np.array(swapped)) < min(s.exchanged_share * away, left[best]):
            reason = Reason.POSITION_EXCHANGED
            return Finding(position_topic, Kind.AXES, reason, against=velocity_topic, evidence=evidence)
    close = left[best] < s.form_share * away and left[best] < max(s.form_speed_share * usual, s.form_apart)
    few = good.sum() < signals.rows(s.unknown_least)
    if not close and (away < max(s.unknown_share * usual, s.unknown_apart) or few):
        return None
    if close:
        evidence |= forms[best][1].evidence
    # Which of the two is wrong the gyro decides: the course of the right one turns with it.
    pairs = {("velocity", "position"): False}
    for name, values in (("velocity", velocity), ("position", by_position)):
        if (agree := _turns_with_gyro(signals, values, good)) is not None:
            pairs[name, GYRO] = agree
    trust = {GYRO: 2.0, "position": 1.0, "velocity": 0.5}
    if pairs.get(("position", GYRO)) is False and "position" in who_is_wrong(pairs, trust).wrong:
        reason = Reason.POSITION_AGAINST_YAW_RATE
        return Finding(position_topic, Kind.AXES, reason, against=velocity_topic, evidence=evidence)
    if close:
        finding = forms[best][1]
    elif not s.size_low < evidence["ratio"] < s.size_high:
        finding = Finding(velocity_topic, Kind.UNIT, Reason.VELOCITY_SIZE)
    else:
        finding = Finding(velocity_topic, Kind.FRAME, Reason.VELOCITY_APART, confidence=Confidence.UNDECIDED)
    return Finding(
        finding.topic, finding.kind, finding.reason, against=position_topic, confidence=finding.confidence,
        evidence=evidence, mend=finding.mend,
    )  # fmt: skip


def _in_means(signals: AlignedSignals) -> tuple[Array, Array, float, Mask, float] | None:
    """Velocity and that by the position (2, n) where the car moves, the span of their means [s], where that is among
    all times, and the noise of the second [m/s]; None where there is too little of it."""
    deviation = _position_noise(signals)
    result = None
    for span in (max(ground_span(signals), one) for one in SETTINGS.spans):
        by_position = np.array(signals.velocity_by_position(span))
        velocity = np.array(
            [signals.smooth(signals.smooth(signals.signals[name], span), span) for name in ("east", "north")]
        )
        speed = np.hypot(*by_position)
        good = np.isfinite(velocity).all(axis=0) & np.isfinite(by_position).all(axis=0) & (speed > MOTION.slowest)
        if good.sum() < signals.rows(SETTINGS.least):
            return None
        noise = deviation * float(np.sqrt(2 * signals.period[Role.POSITION] / span)) / span
        result = velocity[:, good], by_position[:, good], span, good, noise
        if noise < SETTINGS.noise_share * float(np.median(speed[good])):
            break
    return result


def _apart(one: Array, other: Array) -> float:
    """Median distance of two velocities (2, n) [m/s]."""
    return float(np.sqrt(np.median(np.sum((one - other) ** 2, axis=0))))


def _forms(velocity: Array, topic: str) -> list[tuple[Array, Finding]]:
    """What velocities (2, n) to the east and north would look like in another frame or unit."""
    speed = np.hypot(*velocity)
    forms = [(np.array([speed, 0 * speed]), Finding(topic, Kind.FRAME, Reason.VELOCITY_IN_CAR_AXES))]
    for index, (reason, kind, matrix) in enumerate(FORMS):
        finding = Finding(topic, kind, reason, evidence={"form": float(index)})
        forms.append((np.array(matrix) @ velocity, finding))
    for unit in _UNITS:
        mend = Scale("linear", to_si(unit), given=unit, expected="m/s")
        forms.append((velocity / to_si(unit), Finding(topic, Kind.UNIT, Reason.VELOCITY_UNIT, mend=mend)))
    return forms


def _position_noise(signals: AlignedSignals) -> float:
    """Standard deviation of a position [m], as far as it changes from one fix to the next."""
    step = max(round(signals.rows(signals.period[Role.POSITION])), 1)
    return max(white_noise(signals.signals[name][::step]) for name in "xy")


def _turns_with_gyro(signals: AlignedSignals, velocity: Array, good: Mask) -> bool | None:
    """True if the course of a velocity turns as the gyro does; None where that cannot be said."""
    if "wz" not in signals:
        return None
    full = np.full((2, len(signals.t)), np.nan)
    full[:, good] = velocity
    turn = signals.course_rate(full[0], full[1], SETTINGS.gyro_span, MOTION.slowest_course)
    yaw = signals.smooth(signals.signals["wz"], SETTINGS.gyro_span)
    matched = None if min(spread(turn), spread(yaw)) < SETTINGS.gyro_least else match(yaw, turn, signals.step)
    return None if matched is None or abs(matched.correlation) <= SETTINGS.agreement else matched.correlation > 0


def course_stays(motion: Motion) -> Finding | None:
    """The finding that a GNSS velocity whose course stays while the car turns is in the axes of the car."""
    signals, s = motion.signals, SETTINGS
    if "east" not in signals or GYRO not in motion.turns:
        return None
    east, north, gyro = signals.signals["east"], signals.signals["north"], motion.turns[GYRO]
    good = np.isfinite(gyro) & (np.hypot(east, north) > MOTION.slowest_course)
    if good.sum() < signals.rows(s.least):
        return None
    heading = np.cumsum(np.where(good, gyro, 0.0)) * signals.step
    course = np.unwrap(np.arctan2(north[good], east[good]))
    trend = np.polyval(np.polyfit(signals.t[good], heading[good], 1), signals.t[good])
    turned = spread(heading[good] - trend)
    middle = float(np.median(course))
    stays = spread(course) < s.course_share * turned and abs(middle) < s.course_zero
    if not (s.turned_low < turned < s.turned_high and stays):
        return None
    return Finding(
        signals.topics[Role.VELOCITY], Kind.FRAME, Reason.COURSE_STAYS, against=GYRO,
        evidence={"heading": turned, "course": middle},
    )  # fmt: skip


def position_steps(signals: AlignedSignals) -> Iterator[Finding]:
    """A position that steps to another place and stays there, against the way of the velocity."""
    if "x" not in signals or "east" not in signals:
        return
    count = SETTINGS.fixes
    every = max(round(signals.rows(signals.period[Role.POSITION])), 1)
    steps = []
    for place, velocity in (("x", "east"), ("y", "north")):
        speed = signals.signals[velocity]
        off = signals.signals[place] - np.cumsum(np.nan_to_num(speed)) * signals.step
        off[~np.isfinite(speed)] = np.nan
        rows = off[::every]
        if len(rows) < 4 * count:
            return
        means = np.convolve(rows, np.ones(count) / count, "valid")
        steps.append(means[count:] - means[:-count])
    size = np.hypot(*steps)
    known = size[np.isfinite(size)]
    if len(known) < 2 * count:
        return
    at = int(np.nanargmax(size))
    if size[at] > max(SETTINGS.step, SETTINGS.step_noise * float(np.median(known))):
        when = signals.seconds(min((at + count) * every, len(signals.t) - 1))
        yield Finding(
            signals.topics[Role.POSITION], Kind.JUMP, Reason.POSITION_STEPS,
            against=signals.topics[Role.VELOCITY], span=(when, when), evidence={"step": float(size[at])},
        )  # fmt: skip
