"""Clocks: topics whose time stamps do not go with those of the others, with their arrival, or with each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import spread
from vsense_ros.checks.blame import who_is_wrong
from vsense_ros.checks.finding import Confidence, Finding, Kind
from vsense_ros.checks.lags import LONG_LAGS, Match, match
from vsense_ros.checks.motion import (
    ACCELEROMETER,
    GNSS,
    GYRO,
    OWN_SPEED,
    OWN_VELOCITY,
    ROLE_OF,
    STEERED,
    STEERING_WHEEL,
    WHEELS,
    Motion,
)
from vsense_ros.checks.motion import SETTINGS as MOTION
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import Role, Topics
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.recording import Channel

Array = NDArray[np.float64]
Span = tuple[int, int]  # first and last stamp [ns]


@dataclass(frozen=True)
class Allowed:
    """What two sources may be apart: from `low` to `high` [s] by which the first is the later one, given a correlation
    of at least `correlation` at the best lag."""

    low: float
    high: float
    correlation: float


@dataclass(frozen=True)
class ClockSettings:
    """Limits by which a clock is wrong."""

    sway: float = setting(3.0, "s", "over which a change has to happen that shows a lag", JUDGEMENT)
    turning: float = setting(0.03, "rad/s", "standard deviation of turning rates that show a lag")
    pushing: float = setting(0.5, "m/s²", "standard deviation of accelerations that show a lag")
    ahead: float = setting(1.5, "m", "of an antenna ahead of the rear axle, whose course turns earlier", JUDGEMENT)
    slow: float = setting(1.0, "s", "span of GNSS beyond which lags are known less well", JUDGEMENT)
    slow_lag: float = setting(0.6, "s", "that a slow GNSS may be apart")
    explained: float = setting(1.6, "-", "times less unexplained variance with a lag than without one")
    gained: float = setting(0.004, "-", "more correlation with a lag than without one")
    position_span: float = setting(0.6, "s", "of means in which position and velocity are compared", JUDGEMENT)
    position_speed: float = setting(1.0, "m/s", "standard deviation of a velocity that shows a lag", JUDGEMENT)
    position_correlation: float = setting(0.95, "-", "of both at the best lag")
    position_explained: float = setting(2.0, "-", "likewise for these")
    position_lag: float = setting(0.15, "s", "or half of the span, that they may be apart")
    speed_lag: float = setting(0.8, "s", "that the speed by GNSS and the car's own may be apart", JUDGEMENT)
    gaining_span: float = setting(1.5, "s", "of means in which gains of speed are compared", JUDGEMENT)
    gaining_sway: float = setting(10.0, "s", "over which these have to change: grades last longer", JUDGEMENT)
    gaining: float = setting(0.15, "m/s²", "standard deviation of them that shows a lag")
    gaining_correlation: float = setting(0.87, "-", "of them at the best lag")
    gaining_explained: float = setting(3.0, "-", "times less unexplained variance with the lag than without one")
    gaining_lag: float = setting(0.6, "s", "that accelerometer and speed may be apart", JUDGEMENT)
    cornering_span: float = setting(0.5, "s", "of means in which lateral accelerations are compared", JUDGEMENT)
    cornering: float = setting(0.3, "m/s²", "standard deviation of them that shows a lag", JUDGEMENT)
    cornering_lag: float = setting(0.3, "s", "that accelerometer and turning may be apart", "a body rolls within 0.2 s")
    slack: float = setting(1.0, "s", "by which a topic may begin or end beside the others", JUDGEMENT)
    slack_periods: float = setting(5.0, "-", "or so many of its periods", JUDGEMENT)
    moved_alike: float = setting(0.3, "s", "within which begin and end are moved by the same")
    least_rows: int = setting(20, "-", "of a topic whose clock is compared with the arrival", JUDGEMENT)
    step: float = setting(0.25, "s", "from one message to the next by which a clock steps")
    step_usual: float = setting(20.0, "-", "times the usual change of the delay, likewise")
    step_lasting: float = setting(0.2, "s", "of it that lasts")
    step_rows: int = setting(8, "-", "messages before and after by which that is judged", JUDGEMENT)
    parts: int = setting(10, "-", "of a drive in which the least delay is sought", JUDGEMENT)
    shortest: float = setting(5.0, "s", "of a drive in which a clock may be seen to run", JUDGEMENT)
    drift: float = setting(0.04, "s", "over a drive by which a clock runs")
    drift_deviations: float = setting(6.0, "-", "times the scatter about that, likewise")
    slope: float = setting(1e-3, "-", "by which clocks may run", "crystals keep to 1e-4")


SETTINGS = ClockSettings()
_GNSS, _STEERING = Role.VELOCITY.value, Role.STEERING.value


def lags(subject: Subject, earlier: Sequence[Finding]) -> Iterator[Finding]:
    """Sensors whose time stamps do not go with those of the others, by the motion that all measure."""
    motion, topics = subject.motion, subject.topics
    if motion is None:
        return
    apart = _lags_between(motion) | _speed_lag(motion)
    # Cars take a while to follow their steering: that a steering angle is in time clears nobody else.
    pairs = {pair: not lag for pair, lag in apart.items() if lag or _STEERING not in pair}
    blame = who_is_wrong(pairs, {_STEERING: 0.5})
    for late in (*blame.wrong, *blame.undecided):
        sure = late in blame.wrong
        behind = {}
        for (one, other), lag in apart.items():
            if lag and late in (one, other):
                behind[topics[Role(other if late == one else one)]] = lag if late == one else -lag
        yield Finding(
            topics[Role(late)], Kind.LAG, Reason.LATE if sure else Reason.LATE_OR_OTHER, against=", ".join(behind),
            confidence=Confidence.LIKELY if sure else Confidence.UNDECIDED, evidence=behind,
        )  # fmt: skip
    blamed = {finding.topic for finding in earlier} | {topics[Role(late)] for late in (*blame.wrong, *blame.undecided)}
    yield from _late_gains(motion, topics, blamed)
    yield from _late_across(motion, topics, blamed)
    if not blamed & {topics[Role.VELOCITY], topics[Role.POSITION]}:
        yield from _position_lag(motion, topics, any(agree and _GNSS in pair for pair, agree in pairs.items()))


def _lags_between(motion: Motion) -> dict[tuple[str, str], float]:
    """By how much the first of two roles is later than the other [s], 0 where that is no more than it may be; by the
    signals in which they are the most alike."""
    quick = [
        {name: values - motion.smooth(values, SETTINGS.sway) for name, values in of.items()}
        for of in (motion.turns, motion.pushes)
    ]
    result: dict[tuple[str, str], float] = {}
    likeness: dict[tuple[str, str], float] = {}
    for one, other, pushing, allowed in _comparisons(motion):
        signals = quick[pushing]
        if one not in signals or other not in signals:
            continue
        moves = spread(signals[other]) > SETTINGS.pushing if pushing else spread(signals[one]) > SETTINGS.turning
        matched = motion.compared(signals, one, other) if moves else None
        if matched is None or abs(matched.best) < allowed.correlation:
            continue
        pair = ROLE_OF[one].value, ROLE_OF[other].value
        if abs(matched.best) > likeness.get(pair, 0.0):
            result[pair], likeness[pair] = _beyond(matched, allowed), abs(matched.best)
    return result


def _comparisons(motion: Motion) -> Iterator[tuple[str, str, bool, Allowed]]:
    """Two sources of a motion, whether it is the push along the car instead of the turning, and how far they may be
    apart. Tolerances are those of healthy drives by all vehicles and manoeuvres of the project (`make recordings`)."""
    slow = SETTINGS.slow_lag if motion.gnss_span > SETTINGS.slow else 0.0
    # Where tyres hardly slip, the course of a point this far ahead of the rear axle turns before the car does.
    moving = motion.speed[motion.speed > MOTION.slowest]
    early = SETTINGS.ahead / float(moving.mean()) if len(moving) else 0.0
    steered = next((name for name in STEERED if name in motion.turns), STEERING_WHEEL)
    turning, pushing = False, True
    yield GYRO, WHEELS, turning, Allowed(-0.12, 0.12, 0.93)
    yield GYRO, steered, turning, Allowed(-0.06, 0.4, 0.85)  # the car follows its steering
    yield GYRO, GNSS, turning, Allowed(-(slow or 0.3), (slow or 0.12) + early, 0.93)
    yield ACCELEROMETER, GNSS, turning, Allowed(-(slow or 0.15), slow or 0.15, 0.93)
    # The nose dips after the brakes have taken hold, which an accelerometer feels as well.
    yield ACCELEROMETER, GNSS, pushing, Allowed(-(slow or 0.2) / 2, slow or 0.2, 0.9)
    yield ACCELEROMETER, WHEELS, pushing, Allowed(-(slow or 0.2) / 2, slow or 0.2, 0.9)
    yield WHEELS, GNSS, pushing, Allowed(-(slow or 0.15), slow or 0.15, 0.9)
    yield WHEELS, GNSS, turning, Allowed(-(slow or 0.3), (slow or 0.15) + early, 0.93)


def _beyond(matched: Match, allowed: Allowed) -> float:
    """The lag of a match where it is clear and more than allowed; else 0."""
    clear = matched.explained > SETTINGS.explained and abs(matched.best) - abs(matched.correlation) > SETTINGS.gained
    return matched.lag if clear and not allowed.low <= matched.lag <= allowed.high else 0.0


def _speed_lag(motion: Motion) -> dict[tuple[str, str], float]:
    """By how much the car's own speed is later than that by GNSS [s], where that is much: phones smooth theirs, and are
    seconds late. Speeds are alike at lags at which turns are not any more, and so are compared over more of them."""
    signals = motion.signals
    if "east" not in signals:
        return {}
    ground = motion.smooth(np.hypot(signals.signals["east"], signals.signals["north"]))
    for source in (WHEELS, OWN_VELOCITY, OWN_SPEED):
        own = _own_speed(motion, source)
        if own is None or spread(own) < SETTINGS.position_speed:
            continue
        matched = match(motion.smooth(np.abs(own)), ground, signals.step, LONG_LAGS)
        if (
            matched is None
            or matched.best < SETTINGS.position_correlation
            or matched.explained < SETTINGS.position_explained
        ):
            continue
        if abs(matched.lag) > max(SETTINGS.speed_lag, 0.5 * motion.gnss_span):
            return {(ROLE_OF[source].value, _GNSS): matched.lag}
    return {}


def _late_gains(motion: Motion, topics: Topics, blamed: Set[str]) -> Iterator[Finding]:
    """An accelerometer that feels much later than all others how the car gains speed, whatever is with the gyro beside
    it: filters that smooth it are as slow as that, and what is left of it is alike over seconds alone."""
    s = SETTINGS
    if ACCELEROMETER not in motion.pushes:
        return
    pushes = {source: _varying(motion, push, s.gaining_span) for source, push in motion.pushes.items()}
    behind = _behind(motion, topics, blamed, pushes, (GNSS, WHEELS), s.gaining, s.gaining_lag)
    yield from _late_accelerometer(topics, blamed, "linear_acceleration.x", behind)


def _late_across(motion: Motion, topics: Topics, blamed: Set[str]) -> Iterator[Finding]:
    """An accelerometer that feels much later than the gyro beside it and all others how the car turns at its speed."""
    s = SETTINGS
    if "ay" not in motion.signals or GYRO not in motion.turns:
        return
    felt = {
        source: _varying(motion, motion.speed * turn, s.cornering_span)
        for source, turn in motion.turns.items()
        if source in (GYRO, GNSS, WHEELS)
    }
    felt[ACCELEROMETER] = _varying(motion, motion.signals.signals["ay"], s.cornering_span)
    by_gyro = _behind(motion, topics, frozenset(), felt, (GYRO,), s.cornering, s.cornering_lag)
    if by_gyro:
        behind = _behind(motion, topics, blamed, felt, (GNSS, WHEELS), s.cornering, s.cornering_lag)
        yield from _late_accelerometer(topics, blamed, "linear_acceleration.y", behind)


def _varying(motion: Motion, values: Array, span: float) -> Array:
    """Means over a span [s], without what lasts: grades, banks and offsets."""
    means = motion.signals.smooth(values, span)
    return means - motion.signals.smooth(means, SETTINGS.gaining_sway)


def _behind(
    motion: Motion, topics: Topics, blamed: Set[str], felt: Mapping[str, Array], others: Sequence[str], least: float,
    lag: float,
) -> dict[str, float]:  # fmt: skip
    """By how much accelerations (n,) that an accelerometer has `felt` are later than those by `others` that change by
    `least` [m/s²] [s], by topic; nothing unless they are alike and later by a `lag` [s] than each of these."""
    s, behind = SETTINGS, {}
    for other in others:
        if other not in felt or topics[ROLE_OF[other]] in blamed or spread(felt[other]) < least:
            continue
        matched = match(felt[ACCELEROMETER], felt[other], motion.signals.step, LONG_LAGS)
        alike = matched is not None and matched.best > s.gaining_correlation and matched.explained > s.gaining_explained
        if matched is None or not alike or matched.lag < lag:
            return {}
        behind[topics[ROLE_OF[other]]] = matched.lag
    return behind


def _late_accelerometer(topics: Topics, blamed: Set[str], axis: str, behind: Mapping[str, float]) -> Iterator[Finding]:
    imu = topics[ROLE_OF[ACCELEROMETER]]
    if behind and imu not in blamed:
        yield Finding(
            imu, Kind.LAG, Reason.GAINS_LATE, axis, against=", ".join(behind), evidence=dict(behind),
            confidence=Confidence.LIKELY if len(behind) > 1 else Confidence.UNDECIDED,
        )  # fmt: skip


def _own_speed(motion: Motion, source: str) -> Array | None:
    """Speed along the car by what it publishes itself, of no unit in particular; None without that source."""
    signals = motion.signals.signals
    if source != WHEELS:
        return signals.get(ROLE_OF[source])
    wheels = [values for name, values in signals.items() if name.startswith("wheel_")]
    return np.asarray(np.mean(wheels, axis=0)) if wheels else None


def _position_lag(motion: Motion, topics: Topics, velocity_is_right: bool) -> Iterator[Finding]:
    """The position against the velocity of the same receiver."""
    signals, s = motion.signals, SETTINGS
    if "x" not in signals or "east" not in signals:
        return
    span = max(motion.gnss_span, s.position_span)
    by_position = [signals.slope(signals.signals[name], span) for name in "xy"]
    velocity = [signals.smooth(signals.signals[name], span) for name in ("east", "north")]
    if max(map(spread, velocity)) < s.position_speed:
        return
    # Both axes are one signal, with a gap between them that is longer than any lag.
    gap = np.full(len(signals.t), np.nan)
    one, other = (np.concatenate([axes[0], gap, axes[1]]) for axes in (by_position, velocity))
    matched = motion.compare(one, other)
    if matched is None or matched.best < s.position_correlation or matched.explained < s.position_explained:
        return
    if abs(matched.lag) <= max(s.position_lag, 0.5 * motion.gnss_span):
        return
    position, other_topic = topics[Role.POSITION], topics[Role.VELOCITY]
    if velocity_is_right:
        evidence = {other_topic: matched.lag}
        yield Finding(position, Kind.LAG, Reason.POSITION_LATE, against=other_topic, evidence=evidence)
        return
    for topic, than, lag in ((position, other_topic, matched.lag), (other_topic, position, -matched.lag)):
        yield Finding(
            topic, Kind.LAG, Reason.POSITION_OR_VELOCITY_LATE, against=than, confidence=Confidence.UNDECIDED,
            evidence={than: lag},
        )  # fmt: skip


def apart(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Topics that have no time in common with the others, that end early or begin late."""
    spans: dict[str, Span] = {}
    for topic in subject.topics.values():
        channel = subject.recording.channels.get(topic)
        if channel is not None and len(channel) >= 2:
            spans[topic] = int(channel.stamp.min()), int(channel.stamp.max())
    alone = [topic for topic in spans if len(spans) > 1 and _distance(topic, spans) > 0]
    if len(spans) == 2 and alone:
        first, second = sorted(spans)
        yield Finding(first, Kind.CLOCK, Reason.NO_COMMON_TIME_WITH, against=second, confidence=Confidence.UNDECIDED)
    elif len(alone) < len(spans):
        for topic in alone:
            evidence = {"distance": _distance(topic, spans) * 1e-9}
            yield Finding(topic, Kind.CLOCK, Reason.NO_COMMON_TIME, evidence=evidence)
    together = {topic: span for topic, span in spans.items() if topic not in alone}
    for topic, away in _moved(together).items():
        reason = Reason.CLOCK_LATER if away > 0 else Reason.CLOCK_EARLIER
        yield Finding(topic, Kind.CLOCK, reason, evidence={"apart": abs(away)})
        del together[topic]
    yield from _cut(together, subject)


def _cut(spans: Mapping[str, Span], subject: Subject) -> Iterator[Finding]:
    """Topics that end earlier, or begin later, than half of the others do."""
    for topic, (begin, end) in spans.items():
        period = (end - begin) / max(len(subject.recording.channels[topic]) - 1, 1)
        slack = max(SETTINGS.slack * 1e9, SETTINGS.slack_periods * period)
        others = [span for other, span in spans.items() if other != topic]
        for reason, beside in (
            (Reason.ENDS_EARLY, [last - end for _, last in others]),
            (Reason.BEGINS_LATE, [begin - first for first, _ in others]),
        ):
            more = [one for one in beside if one > slack]
            if more and 2 * len(more) >= len(others):
                yield Finding(topic, Kind.CUT, reason, evidence={"apart": float(np.median(more)) * 1e-9})


def _distance(topic: str, spans: Mapping[str, Span]) -> int:
    """Time [ns] between a topic and the nearest other one; 0 where it has some in common with any."""
    begin, end = spans[topic]
    return min(max(begin - last, first - end, 0) for other, (first, last) in spans.items() if other != topic)


def _moved(spans: Mapping[str, Span]) -> dict[str, float]:
    """The one topic that begins and ends by the same time [s] later or earlier than the others, which agree."""
    if len(spans) < 3:
        return {}
    middle = np.median(list(spans.values()), axis=0)
    result = {}
    for topic, span in spans.items():
        first, last = (np.array(span) - middle) * 1e-9
        if min(abs(first), abs(last)) > SETTINGS.slack and abs(first - last) < SETTINGS.moved_alike:
            result[topic] = float(first + last) / 2
    return result if len(result) == 1 else {}


def running(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Time stamps that step or run against the times of arrival."""
    for topic in subject.topics.values():
        channel = subject.recording.channels.get(topic)
        if channel is None or len(channel) < SETTINGS.least_rows or np.array_equal(channel.stamp, channel.received):
            continue
        step = _clock_step(channel, subject)
        finding = _clock_rate(channel) if step is None else step
        if finding is not None:
            yield finding


def _clock_step(channel: Channel, subject: Subject) -> Finding | None:
    delay = (channel.received - channel.stamp) * 1e-9
    steps = np.diff(delay)
    usual = float(np.median(np.abs(steps))) + 1e-6
    sudden = np.flatnonzero(np.abs(steps) > max(SETTINGS.step, SETTINGS.step_usual * usual))
    if not len(sudden):
        return None
    at, count = int(sudden[0]), SETTINGS.step_rows
    change = float(np.median(delay[max(at - count, 0) : at + 1])) - float(np.median(delay[at + 1 : at + 1 + count]))
    if abs(change) <= SETTINGS.step_lasting:
        return None
    when = subject.seconds(channel.received[at + 1])
    return Finding(channel.topic, Kind.CLOCK, Reason.CLOCK_STEPS, span=(when, when), evidence={"change": change})


def _clock_rate(channel: Channel) -> Finding | None:
    delay = (channel.received - channel.stamp) * 1e-9
    seconds = (channel.received - channel.received[0]) * 1e-9
    parts = SETTINGS.parts
    if seconds[-1] < SETTINGS.shortest or len(channel) < 4 * parts:
        return None
    edges = np.linspace(0, len(channel), parts + 1).astype(int)
    least = np.array([delay[a:b].min() for a, b in pairwise(edges)])
    middle = np.array([float(np.median(seconds[a:b])) for a, b in pairwise(edges)])
    slope = np.polyfit(middle, least, 1)[0]
    scatter = float(np.std(least - slope * middle))
    drift = abs(slope) * (middle[-1] - middle[0])
    if drift <= max(SETTINGS.drift, SETTINGS.drift_deviations * scatter) or abs(slope) <= SETTINGS.slope:
        return None
    reason = Reason.CLOCK_SLOWER if slope > 0 else Reason.CLOCK_FASTER
    return Finding(channel.topic, Kind.CLOCK, reason, evidence={"rate": abs(float(slope))})


def repeated(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Messages that come a second time."""
    for topic in subject.topics.values():
        channel = subject.recording.channels.get(topic)
        if channel is None or len(channel) < SETTINGS.parts:
            continue
        again = len(channel) - len(np.unique(channel.stamp))
        backwards = bool((np.diff(channel.in_order().stamp) < 0).any())
        if backwards and again > int((np.diff(channel.stamp) == 0).sum()):
            yield Finding(topic, Kind.DUPLICATES, Reason.COPIES, evidence={"count": float(again)})
