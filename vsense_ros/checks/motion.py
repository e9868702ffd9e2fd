"""How the car turns and gains speed by each sensor that measures it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import AlignedSignals, robust_deviation, spread
from vsense_ros.checks.lags import Match, match
from vsense_ros.checks.roles import Role
from vsense_ros.checks.setting import JUDGEMENT, setting

Array = NDArray[np.float64]

GNSS, WHEELS, GYRO, ACCELEROMETER = "gnss", "wheels", "gyro", "accelerometer"  # sources of a motion
OWN_VELOCITY, OWN_SPEED = "own velocity", "own speed"  # sources of a speed that the car itself publishes
STEERING_WHEEL, ROAD_WHEEL = "steering_wheel", "road_wheel_front"  # likewise, and names of joints
STEERED = (ROAD_WHEEL, STEERING_WHEEL)  # the best first
ROLE_OF = {
    GNSS: Role.VELOCITY, WHEELS: Role.WHEELS, GYRO: Role.IMU, ACCELEROMETER: Role.IMU,
    STEERING_WHEEL: Role.STEERING, ROAD_WHEEL: Role.STEERING, OWN_VELOCITY: Role.BODY_VELOCITY, OWN_SPEED: Role.SPEED,
}  # fmt: skip


@dataclass(frozen=True)
class MotionSettings:
    """Averages and limits by which signals become motions, and sizes of a usual passenger car for what is unknown."""

    span: float = setting(0.3, "s", "of the means in which fast signals are compared", JUDGEMENT)
    slowest: float = setting(3.0, "m/s", "below it ratios of signals to the speed say little", JUDGEMENT)
    slowest_course: float = setting(5.0, "m/s", "below it the course of a GNSS velocity says little", JUDGEMENT)
    hard_braking: float = setting(4.0, "m/s²", "of braking from where on wheels may lock, which do not steer")
    least_turning: float = setting(0.02, "rad/s", "standard deviation of a turning rate that shows how the car turns")
    axles_contradict: float = setting(-0.3, "-", "correlation of the turning rates by the front and rear wheels")
    slipping: float = setting(0.5, "-", "of the fastest wheel, below which another does not roll", JUDGEMENT)
    wheel_spin: float = setting(0.5, "rad/s", "of a wheel, below which no rolling radius follows", JUDGEMENT)
    rolling_radius: float = setting(0.32, "m", "of a wheel of a passenger car", "ETRTO, 205/55 R16: 0.316 m")
    track_width: float = setting(1.5, "m", "of a passenger car", "Milliken, Race Car Vehicle Dynamics (1995)")
    wheelbase: float = setting(2.7, "m", "of a passenger car", "Milliken, Race Car Vehicle Dynamics (1995)")
    understeer: float = setting(0.004, "s²/m", "by which understeer adds to the wheelbase", JUDGEMENT)
    steering_ratio: float = setting(16.0, "-", "of a passenger car", "Milliken, Race Car Vehicle Dynamics (1995)")
    slow_course: float = setting(2.0, "s", "over which a position is averaged where it replaces a velocity", JUDGEMENT)
    quick_rolling: float = setting(0.1, "s", "over which wheel speeds are averaged before their slope", JUDGEMENT)


SETTINGS = MotionSettings()


@dataclass
class Motion:
    """One motion by several sensors, at the common times of `signals`; NaN where a source says nothing.

    `turns` has turning rates [rad/s] and `pushes` accelerations along the car [m/s²], each by source; `speed` is that
    over ground, or by the wheels [m/s].
    """

    signals: AlignedSignals
    gnss_span: float  # [s] over which what GNSS says is averaged
    speed: Array
    turns: dict[str, Array] = field(default_factory=dict)
    pushes: dict[str, Array] = field(default_factory=dict)
    radius: float | None = None  # by which wheels roll [m], negative where they turn backwards; None: not measured
    radius_scatter: float = 0.0  # standard deviation of it over the drive [m]

    @property
    def has_speed(self) -> bool:
        """True if any sensor measures the speed."""
        return bool(np.isfinite(self.speed).any())

    def smooth(self, values: Array, span: float | None = None) -> Array:
        """Means of a signal over the span of GNSS, or that given."""
        return self.signals.smooth(values, self.gnss_span if span is None else span)

    def compare(self, one: Array, other: Array) -> Match | None:
        """How two signals go together."""
        return match(one, other, self.signals.step)

    def compared(self, of: dict[str, Array], one: str, other: str) -> Match | None:
        """How two sources of `turns` or `pushes` go together, both averaged as the slower of them is."""
        slow = GNSS in (one, other) and self.gnss_span > SETTINGS.span
        a, b = (self.smooth(of[name]) if slow and name != GNSS else of[name] for name in (one, other))
        return self.compare(a, b)

    def first_turning(self, *sources: str, least: float = SETTINGS.least_turning) -> str | None:
        """The first of some sources by which the car turns; None where it does by none of them."""
        return next((name for name in sources if name in self.turns and spread(self.turns[name]) > least), None)

    @property
    def along(self) -> Array | None:
        """Acceleration along the car [m/s²] by GNSS or the wheels, in means over `gnss_span`; None without both."""
        if GNSS in self.pushes:
            return self.pushes[GNSS]
        return self.smooth(self.pushes[WHEELS]) if WHEELS in self.pushes else None

    def to_the_left(self, source: str) -> Array:
        """Acceleration to the left [m/s²] that goes with the speed and how a source says that the car turns, in means
        over `gnss_span`."""
        turn = self.turns[source] if source == GNSS else self.smooth(self.turns[source])
        return self.smooth(self.speed) * turn


def ground_span(signals: AlignedSignals) -> float:
    """Seconds over which what GNSS says is averaged: two of its periods at least."""
    periods = [signals.period[role] for role in (Role.VELOCITY, Role.POSITION) if role in signals.period]
    return max(SETTINGS.span, 2.0 * max(periods, default=0.0))


def motion_of(signals: AlignedSignals, *, course_by_position: bool) -> Motion:
    """The motion that signals measure; without a speed what the inertial sensor alone says of it. `course_by_position`
    says that the GNSS velocity cannot be used."""
    span = ground_span(signals)
    ground: tuple[Array, Array] | None = None
    if "east" in signals and not course_by_position:
        ground = signals.signals["east"], signals.signals["north"]
    elif "x" in signals:
        span = max(span, SETTINGS.slow_course)
        ground = signals.velocity_by_position(span / 2)
    motion = Motion(signals, span, np.full(len(signals.t), np.nan))
    if ground is not None:
        motion.speed = np.hypot(*ground)
        motion.turns[GNSS] = signals.course_rate(*ground, span, SETTINGS.slowest_course)
        motion.pushes[GNSS] = signals.slope(motion.speed, span)
    _add_wheels(motion, known=ground is not None)
    _add_own_speeds(motion)
    _add_inertial(motion)
    if not motion.has_speed:
        return motion
    _add_steering(motion)
    # With wheels that may be locked the car does not turn as it is steered.
    push = motion.pushes.get(GNSS, motion.pushes.get(WHEELS))
    braking = np.zeros(len(signals.t)) if push is None else signals.smooth(np.nan_to_num(push), 1.0)
    useless = ~(motion.speed > SETTINGS.slowest) | (np.abs(braking) > SETTINGS.hard_braking)
    for turn in motion.turns.values():
        turn[useless] = np.nan
    return motion


def _add_wheels(motion: Motion, *, known: bool) -> None:
    """Add what the wheels say; the speed over ground is `known` without them, or becomes theirs."""
    signals, m = motion.signals.signals, motion.signals
    names = [name for name in signals if name.startswith("wheel_")]
    if not names:
        return
    rolls, mean = _rolling(np.array([signals[name] for name in names]))
    moving = (motion.speed > SETTINGS.slowest) & (np.abs(mean) > SETTINGS.wheel_spin)
    if known and moving.sum() > m.rows(1.0):
        ratio = motion.speed[moving] / mean[moving]
        motion.radius, motion.radius_scatter = float(np.median(ratio)), robust_deviation(ratio)
    radius = abs(motion.radius or SETTINGS.rolling_radius)
    rolling = mean * radius
    if not known:
        motion.speed = np.abs(rolling)
    motion.pushes[WHEELS] = m.slope(m.smooth(rolling, SETTINGS.quick_rolling), SETTINGS.span)
    by_axle = []
    for axle in "rf":
        left, right = f"wheel_{axle}l", f"wheel_{axle}r"
        if left in signals and right in signals:
            both_roll = rolls[[names.index(left), names.index(right)]].all(axis=0)
            difference = m.smooth(np.where(both_roll, signals[right] - signals[left], np.nan), SETTINGS.span)
            by_axle.append(difference * radius / SETTINGS.track_width)
    if by_axle and not _contradict(motion, by_axle):
        motion.turns[WHEELS] = by_axle[0]


def _rolling(spins: Array) -> tuple[NDArray[np.bool_], Array]:
    """Which of the wheels (k, n) roll and neither lock nor spin freely nor are silent, and the mean spin (n,) of these.

    One that locks says nothing of the speed, and nothing of how the car turns.
    """
    sizes = np.abs(spins)
    rolls = sizes >= SETTINGS.slipping * sizes.max(axis=0)
    return rolls, np.where(rolls, spins, 0.0).sum(axis=0) / np.maximum(rolls.sum(axis=0), 1)


def _add_own_speeds(motion: Motion) -> None:
    """Add the forward velocities that the car itself publishes; they are its speed where nothing else measures it."""
    m = motion.signals
    for source in (OWN_VELOCITY, OWN_SPEED):
        values = m.signals.get(ROLE_OF[source])
        if values is None:
            continue
        if not motion.has_speed:
            motion.speed = np.abs(values)
        motion.pushes[source] = m.slope(m.smooth(values, SETTINGS.quick_rolling), SETTINGS.span)


def _contradict(motion: Motion, by_axle: list[Array]) -> bool:
    """Check whether the wheels of one axle turn the car against those of the other, as they do where a torque is moved
    from one side of an axle to the other. Wheels whose sides are exchanged turn it the same way on both."""
    if len(by_axle) < 2 or min(map(spread, by_axle)) < SETTINGS.least_turning:
        return False
    compared = motion.compare(*by_axle)
    return compared is not None and compared.correlation < SETTINGS.axles_contradict


def _add_inertial(motion: Motion) -> None:
    signals, m = motion.signals.signals, motion.signals
    if "wz" in signals:
        motion.turns[GYRO] = m.smooth(signals["wz"], SETTINGS.span)
    if "ay" in signals:
        motion.turns[ACCELEROMETER] = m.smooth(signals["ay"], SETTINGS.span) / _fast(motion)
    if "ax" in signals:
        motion.pushes[ACCELEROMETER] = m.smooth(signals["ax"], SETTINGS.span)


def _add_steering(motion: Motion) -> None:
    fast = _fast(motion)
    for name, ratio in ((STEERING_WHEEL, SETTINGS.steering_ratio), (ROAD_WHEEL, 1.0)):
        if name in motion.signals:
            angle = motion.signals.smooth(motion.signals.signals[name], SETTINGS.span) / ratio
            motion.turns[name] = angle * fast / (SETTINGS.wheelbase + SETTINGS.understeer * fast**2)


def _fast(motion: Motion) -> Array:
    return np.where(motion.speed > SETTINGS.slowest, motion.speed, np.nan)
