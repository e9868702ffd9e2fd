"""Values that no sensor of a car gives: jumps, coarse steps, held and frozen signals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import robust_deviation, runs_of_equal_values, stretches
from vsense_ros.checks.finding import Confidence, Finding, Kind
from vsense_ros.checks.held import period_of_updates
from vsense_ros.checks.motion import GYRO, ROAD_WHEEL, STEERING_WHEEL
from vsense_ros.checks.motion import SETTINGS as MOTION
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import Role
from vsense_ros.checks.setting import EXAMINATION, JUDGEMENT, setting
from vsense_ros.checks.subject import Subject, measured
from vsense_ros.messages.recording import Channel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SignalLimits:
    """What a car does at most to one kind of signal, in its SI unit."""

    unit: str
    fastest: float  # change per second that a car makes
    noise: float  # change from one message to the next below which noise of any sensor stays
    resolution: float  # step of the values that raises no question


# By field of a message, or joint. Sources: engines and kerbs shake an inertial sensor by 2000 m/s³; a wheel that locks
# on a dry road stops within 0.15 s; hands turn a steering wheel by 20 rad/s at most; resolutions are twice those of
# series sensors (Bosch SMI, CAN databases of `config/can`).
LIMITS: Mapping[str, SignalLimits] = {
    "angular_velocity": SignalLimits("rad/s", 60.0, 0.25, 0.008),
    "linear_acceleration": SignalLimits("m/s²", 2000.0, 6.0, 0.15),
    "velocity": SignalLimits("rad/s", 600.0, 2.0, 0.3),
    STEERING_WHEEL: SignalLimits("rad", 20.0, 0.05, 0.035),
    ROAD_WHEEL: SignalLimits("rad", 2.0, 0.02, 0.0035),
    "linear": SignalLimits("m/s", 30.0, 1.5, 0.08),
}


@dataclass(frozen=True)
class ValueSettings:
    """Limits by which values cannot be measurements."""

    least_values: int = setting(20, "-", "of a signal, of fewer of which no jump is said", JUDGEMENT)
    deviations: float = setting(7.0, "-", "standard deviations of noise that a jump is larger than")
    longest_step: float = setting(1.0, "s", "between two messages between which a jump is one", JUDGEMENT)
    usual_step: float = setting(0.01, "s", "between messages without a usual step", JUDGEMENT)
    most_jumps: float = setting(0.05, "-", "share of values, above which it is noise", JUDGEMENT)
    position_resolution: float = setting(2e-6, "deg", "step of coordinates that raises no question", "0.2 m")
    least_levels: int = setting(50, "-", "values by which a resolution is found", JUDGEMENT)
    off_grid: float = setting(0.03, "-", "of a step, by which values may be beside its multiples", JUDGEMENT)
    on_grid: float = setting(0.97, "-", "share of steps that are multiples of the smallest")
    small_steps: float = setting(20.0, "-", "multiples of the smallest step that are small", JUDGEMENT)
    small_share: float = setting(0.5, "-", "share of steps that are small", JUDGEMENT)
    metres_per_degree: float = setting(111_200.0, "m/deg", "of latitude", "mean radius of the earth, 6371 km")
    reach: float = setting(1.5, "-", "times the way that the speed makes, beyond which a position jumps")
    reach_added: float = setting(5.0, "m", "likewise, added: noise of receivers", EXAMINATION)
    reach_noise: float = setting(5.0, "-", "standard deviations of fixes that a jump is larger than")
    longest_pause: float = setting(60.0, "s", "between two fixes between which a jump is one", JUDGEMENT)
    frozen_gnss: float = setting(1.5, "s", "for which a receiver repeats a velocity that is frozen")
    frozen_gnss_speed: float = setting(1.0, "m/s", "above which a velocity changes", JUDGEMENT)
    frozen_gnss_rows: int = setting(5, "-", "messages in that time", JUDGEMENT)
    frozen_wheel: float = setting(1.5, "s", "for which a wheel keeps a speed that is frozen")
    frozen_wheel_spin: float = setting(5.0, "rad/s", "of the others meanwhile", JUDGEMENT)
    frozen_wheel_others: float = setting(0.5, "-", "share of time in which the others change theirs")
    frozen_steering: float = setting(2.0, "s", "for which a steering angle is frozen if the car turns otherwise")
    response: float = setting(0.5, "s", "in which a car follows what went before", JUDGEMENT)
    foresight: float = setting(0.3, "s", "by which means and clocks reach beyond an end", JUDGEMENT)
    other_turning: float = setting(1.5, "m/s²", "change of lateral acceleration that steering must have made")
    other_shape: float = setting(0.5, "-", "of its largest amount by which the curvature changes meanwhile")


SETTINGS = ValueSettings()
_ROUNDING = 1e-9  # by which means of equal values differ
_SIGNALS = (Role.IMU, Role.VELOCITY, Role.WHEELS, Role.STEERING)


def held(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Topics that are sent more often than their source measures."""
    for role, channel in subject.channels():
        parts = [v for _, v in measured(channel) if np.isfinite(v).all() and np.ptp(v) > 0.0]
        if not parts:
            continue
        groups = [[part] for part in parts] if role == Role.IMU else [parts]
        periods = [n for group in groups if (n := period_of_updates(np.column_stack(group))) is not None]
        if len(periods) > len(groups) / 2:
            step = float(np.median(np.diff(channel.stamp))) * 1e-9
            sent = 1 / step if step > 0 else np.nan
            evidence = {"rows": float(min(periods)), "sent": sent, "measured": sent / min(periods)}
            yield Finding(channel.topic, Kind.HELD, Reason.REPEATED_VALUES, evidence=evidence)


def limits_of(role: Role, name: str) -> SignalLimits | None:
    """What a signal of a topic, by its name, can do; None where nothing is known."""
    field, _, component = name.partition(".")
    if role == Role.STEERING:
        return LIMITS.get(component)
    return None if role == Role.VELOCITY and field != "linear" else LIMITS.get(field)


def jumps(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Changes from one message to the next that no car makes."""
    for role, channel in subject.channels(*_SIGNALS):
        for name, values in measured(channel):
            limits = limits_of(role, name)
            if limits is None or (role == Role.VELOCITY and name == "linear.z"):
                continue
            good = np.isfinite(values)
            seconds, values = channel.stamp[good] * 1e-9, values[good]
            if len(values) < SETTINGS.least_values:
                continue
            step, change = np.diff(seconds), np.diff(values)
            usual = float(np.median(step[step > 0])) if (step > 0).any() else SETTINGS.usual_step
            allowed = limits.fastest * np.clip(step, usual, 1.0)
            allowed = allowed + SETTINGS.deviations * robust_deviation(change) + limits.noise
            rows = np.flatnonzero((np.abs(change) > allowed) & (step < SETTINGS.longest_step) & (step >= 0))
            if len(rows) and len(rows) < SETTINGS.most_jumps * len(values):
                when = subject.seconds(channel.stamp[good][rows[0] + 1])
                reason = Reason.SIGNAL_JUMPS if len(rows) == 1 else Reason.SIGNAL_JUMPS_OFTEN
                evidence = {"change": float(change[rows[0]]), "count": float(len(rows))}
                yield Finding(channel.topic, Kind.JUMP, reason, name, span=(when, when), evidence=evidence)


def quantised(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Signals of which only coarse steps are recorded."""
    for role, channel in subject.channels(*_SIGNALS, Role.POSITION):
        coarse = {}
        for name, values in measured(channel):
            if role == Role.POSITION:
                limit = SETTINGS.position_resolution if name in ("latitude", "longitude") else np.inf
            else:
                limits = limits_of(role, name)
                limit = np.inf if limits is None else limits.resolution
            if (step := resolution(values)) > limit:
                coarse[name] = step
        if coarse:
            name = max(coarse, key=lambda one: coarse[one])
            reason = Reason.COARSE if len(coarse) == 1 else Reason.COARSE_LIKEWISE
            also = ", ".join(other for other in coarse if other != name)
            limits = None if role == Role.POSITION else limits_of(role, name)
            names = {"unit": " deg" if limits is None else f" {limits.unit}", "also": also}
            evidence = {"step": coarse[name]}
            yield Finding(channel.topic, Kind.QUANTISED, reason, name, evidence=evidence, names=names)


def resolution(values: Array) -> float:
    """The step of which all values (n,) are multiples; 0 where there is none, or too few values to say."""
    values = values[np.isfinite(values)]
    if len(values) < SETTINGS.least_levels:
        return 0.0
    levels = np.unique(values)
    steps = np.diff(levels)
    step = float(np.min(steps[steps > 1e-9 * np.abs(levels).max()], initial=np.inf))
    if len(levels) < 3 or not np.isfinite(step):
        return 0.0
    multiples = np.rint(steps / step)
    on_grid = np.mean(np.abs(steps / step - multiples) < SETTINGS.off_grid) > SETTINGS.on_grid
    return step if on_grid and np.mean(multiples < SETTINGS.small_steps) > SETTINGS.small_share else 0.0


def position_jumps(subject: Subject, earlier: Sequence[Finding]) -> Iterator[Finding]:
    """Fixes that are farther from the one before than the speed of GNSS explains."""
    fixes, velocity = subject.channel(Role.POSITION), subject.channel(Role.VELOCITY)
    if fixes is None or velocity is None or any(f.topic == fixes.topic and f.kind == Kind.UNIT for f in earlier):
        return
    s = SETTINGS
    order = np.argsort(velocity.stamp, kind="stable")
    east, north = velocity.columns["linear"][order, :2].T
    known = np.isfinite(east) & np.isfinite(north)
    if known.sum() < s.least_values:
        return
    at = (velocity.stamp[order][known] - velocity.stamp[order][0]) * 1e-9
    seconds = (fixes.stamp - velocity.stamp[order][0]) * 1e-9
    pause = np.diff(seconds)
    latitude, longitude = fixes.columns["latitude"][:, 0], fixes.columns["longitude"][:, 0]
    latitude, longitude = (np.where(np.isfinite(one), one, np.nan) for one in (latitude, longitude))
    moved = s.metres_per_degree * np.array([np.diff(longitude) * np.cos(np.radians(latitude[:-1])), np.diff(latitude)])
    speed = np.interp(seconds, at, np.hypot(east, north)[known])
    reach = np.maximum(speed[:-1], speed[1:]) * np.abs(pause) * s.reach + s.reach_added
    # Where the velocity leads, and how far fixes usually are from there: noise of a fix is no jump.
    middle = seconds[:-1] + pause / 2
    off = moved - np.array([np.interp(middle, at, part[known]) * pause for part in (east, north)])
    present = off[:, np.isfinite(off).all(axis=0)]
    noise = max((robust_deviation(part) for part in present), default=0.0) if present.size else 0.0
    beyond = np.hypot(*off) > s.reach_noise * noise + s.reach_added
    distance = np.hypot(*moved)
    for row in np.flatnonzero((distance > reach) & beyond & (np.abs(pause) < s.longest_pause)):
        when = subject.seconds(fixes.stamp[row + 1])
        yield Finding(
            fixes.topic, Kind.JUMP, Reason.POSITION_JUMPS, against=velocity.topic, span=(when, when),
            evidence={"distance": float(distance[row]), "speed": float(speed[row])},
        )  # fmt: skip


def frozen_gnss(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """A GNSS velocity that repeats itself while the car moves."""
    channel = subject.channel(Role.VELOCITY)
    if channel is None:
        return
    east, north = channel.columns["linear"][:, :2].T
    same = np.concatenate([[False], (np.diff(east) == 0) & (np.diff(north) == 0)])
    for begin, end in stretches(same & (np.hypot(east, north) > SETTINGS.frozen_gnss_speed)):
        span = subject.seconds(channel.stamp[begin]), subject.seconds(channel.stamp[end - 1])
        if span[1] - span[0] > SETTINGS.frozen_gnss and end - begin >= SETTINGS.frozen_gnss_rows:
            yield Finding(channel.topic, Kind.FROZEN, Reason.VALUE_STANDS, span=span, confidence=Confidence.CERTAIN)
            return


def frozen_wheels(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """A wheel that keeps its speed while the others change theirs."""
    signals, s = subject.aligned, SETTINGS
    names = [] if signals is None else [name for name in signals.signals if name.startswith("wheel_")]
    if signals is None or len(names) < 2:
        return
    for name in names:
        others = np.array([signals.signals[other] for other in names if other != name])
        for first, length in zip(*runs_of_equal_values(signals.signals[name], _ROUNDING), strict=True):
            if length <= round(signals.rows(s.frozen_wheel)):
                continue
            part = others[:, first : first + length]
            part = part[:, np.isfinite(part).all(axis=0)]
            if part.shape[1] < 2 or float(np.median(np.abs(part))) < s.frozen_wheel_spin:
                continue
            # A wheel at constant speed keeps its value only if it is coarse, and then the others do so, too.
            if float(np.median(np.mean(np.abs(np.diff(part, axis=1)) > _ROUNDING, axis=1))) > s.frozen_wheel_others:
                begin = signals.seconds(first + 1)
                span = begin, begin + (length - 1) * signals.step
                yield Finding(subject.topics[Role.WHEELS], Kind.FROZEN, Reason.VALUE_STANDS, name, span=span)
                break


def frozen_steering(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """A steering angle that keeps its value while the car changes how it turns."""
    motion, s = subject.motion, SETTINGS
    if motion is None or GYRO not in motion.turns:
        return
    signals = motion.signals
    lateral = motion.smooth(motion.speed * motion.turns[GYRO], MOTION.span)
    for name in (STEERING_WHEEL, ROAD_WHEEL):
        if name not in signals:
            continue
        for first, length in zip(*runs_of_equal_values(signals.signals[name], _ROUNDING), strict=True):
            if length <= signals.rows(s.frozen_steering):
                continue
            last = first + length
            inside = slice(first + 1 + round(signals.rows(s.response)), last - round(signals.rows(s.foresight)))
            if turns_otherwise(lateral[inside], motion.speed[inside], s.other_turning, s.other_shape):
                begin = signals.seconds(first + 1)
                span = begin, begin + (length - 1) * signals.step
                topic = subject.topics[Role.STEERING]
                yield Finding(topic, Kind.FROZEN, Reason.STEERING_STANDS, name, GYRO, span=span)
                break


def turns_otherwise(lateral: Array, speed: Array, least: float, share: float) -> bool:
    """True if a car changes how it turns: its lateral acceleration (n,) by `least` [m/s²], and its curvature by a
    `share` of the largest, as it does not by a change of the speed (n,) [m/s] alone."""
    curvature = lateral / np.maximum(speed, 1.0) ** 2
    good = np.isfinite(curvature)
    if good.sum() <= 10 or np.ptp(lateral[good]) <= least:
        return False
    return bool(np.ptp(curvature[good]) > share * np.max(np.abs(curvature[good])))


def standing_signals(channel: Channel, longest: float, rows: int) -> Iterator[tuple[str, float, float]]:
    """Name, begin and end [s since the first message] of each signal that keeps its value for `longest` seconds and so
    many `rows` somewhere, where that is longest."""
    for name, values in measured(channel):
        good = np.isfinite(values)
        if good.sum() < 2:
            continue
        seconds = channel.seconds[good]
        first, length = runs_of_equal_values(values[good])
        duration = seconds[first + length - 1] - seconds[first]
        at = int(np.argmax(duration))
        if duration[at] >= longest and length[at] > rows:
            yield name, float(seconds[first[at]]), float(seconds[first[at] + length[at] - 1])
