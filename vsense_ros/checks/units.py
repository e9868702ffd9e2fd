"""Units, by the sizes that signals can have: of each alone, and against the motion that others measure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import spread
from vsense_ros.checks.finding import Confidence, Finding, Kind, Scale
from vsense_ros.checks.motion import GNSS, GYRO, ROAD_WHEEL, STEERING_WHEEL, WHEELS, Motion
from vsense_ros.checks.motion import SETTINGS as MOTION
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import Role
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.units import to_si

Array = NDArray[np.float64]

GRAVITY = to_si("g")
_AXES = "xyz"


@dataclass(frozen=True)
class UnitSettings:
    """Sizes that signals of a car have."""

    in_g: float = setting(0.1, "-", "relative difference from 1 of a specific force at rest that is in g")
    no_gravity: float = setting(1.0, "m/s²", "of mean specific force, below which gravity has been taken off")
    gravity_error: float = setting(1.5, "m/s²", "by which the mean specific force may differ from gravity")
    known_radius: float = setting(0.1, "-", "relative difference from the vehicle file's radius that is no question")
    least_radius: float = setting(0.2, "m", "rolling radius of a car", "smaller than the wheels of a kart")
    largest_radius: float = setting(0.6, "m", "rolling radius of a car", "larger than those of a lorry")
    speed_unit: float = setting(0.03, "-", "relative error of the rolling radius of wheels given as speeds")
    spin_unit: float = setting(0.4, "-", "relative error of a usual car's rolling radius")
    least_driving: float = setting(1.0, "s", "in which wheels are compared with GNSS", JUDGEMENT)
    radius_scatter: float = setting(0.1, "-", "of the radius, beyond which it is not determined", JUDGEMENT)
    steady: float = setting(
        0.5, "m/s²", "mean acceleration, below which slip by driving and braking cancels", JUDGEMENT
    )
    antenna: float = setting(2.0, "m", "that an antenna may be beside the middle of a car", JUDGEMENT)
    antenna_share: float = setting(0.01, "-", "of the speed by which such an antenna may be faster", JUDGEMENT)
    road_wheel: float = setting(1.2, "rad", "largest angle of a road wheel", "taxis reach 1.0 rad")
    steering_wheel: float = setting(15.0, "rad", "largest angle of a steering wheel", "lorries: 2.5 turns to a side")
    correlation: float = setting(0.6, "-", "of a signal and the turning of GNSS by which it is judged")
    road_wheel_ratio: float = setting(2.0, "s", "steering angle over yaw rate, (wheelbase / speed + understeer)")
    steering_wheel_ratio: float = setting(40.0, "s", "likewise, times the steering ratio")
    steering_turns: tuple[float, float] = setting(
        (0.2, 5.0),
        "-",
        "turning by a steering angle over the true one, by a usual ratio and wheelbase; racing cars 2, lorries 0.5",
    )
    in_degrees: tuple[float, float] = setting((30.0, 100.0), "-", "ratio of a rate in deg/s to the turning")
    by_gnss: tuple[float, float] = setting((0.5, 2.0), "-", "ratio of a right yaw rate to the turning of GNSS")
    by_wheels: tuple[float, float] = setting((0.3, 3.0), "-", "likewise, to that of wheels on an unknown track")
    size_correlation: float = setting(0.9, "-", "at the best lag, by which a ratio is judged")
    latitude: float = setting(1.6, "deg", "below which both coordinates are radians, or nothing", "just above π/2")
    longitude: float = setting(3.2, "deg", "likewise", "just above π")
    pressure: tuple[float, float] = setting((0.5, 1000.0), "Pa", "of a largest brake pressure that brakes nothing")


SETTINGS = UnitSettings()


def gravity(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Specific forces whose mean is not gravity upwards: in g, without gravity, or on another axis."""
    imu, s = subject.channel(Role.IMU), SETTINGS
    if imu is None:
        return
    columns = imu.measured["linear_acceleration"].T
    mean = np.array([np.nanmedian(c) if np.isfinite(c).any() else np.nan for c in columns])
    size = float(np.linalg.norm(mean))
    if np.isnan(size):
        return
    reason = None
    mend = None
    if abs(size - 1.0) < s.in_g:
        reason, mend = Reason.FORCE_IN_G, Scale("linear_acceleration", GRAVITY, given="g", expected="m/s²")
    elif size < s.no_gravity:
        reason = Reason.NO_GRAVITY
    elif abs(size - GRAVITY) > s.gravity_error:
        reason = Reason.FORCE_SIZE
    if reason is not None:
        yield Finding(
            imu.topic, Kind.UNIT, reason, "linear_acceleration", confidence=Confidence.CERTAIN,
            evidence={"size": size}, mend=mend,
        )  # fmt: skip
    axis = int(np.argmax(np.abs(mean)))
    if size >= 1.0 - s.in_g and (axis != 2 or mean[2] < 0):
        yield Finding(
            imu.topic, Kind.AXES, Reason.GRAVITY_AXIS, "linear_acceleration", confidence=Confidence.CERTAIN,
            evidence={"size": float(mean[axis])}, names={"axis": f"{'-' if mean[axis] < 0 else '+'}{_AXES[axis]}"},
        )  # fmt: skip


def rolling(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Wheel speeds whose ratio to the speed over ground is no rolling radius, but one of a unit or a sign."""
    motion, wheels = subject.motion, subject.topics[Role.WHEELS]
    if motion is None or motion.radius is None or subject.velocity_is_wrong:
        return
    if motion.radius_scatter > SETTINGS.radius_scatter * abs(motion.radius):
        return
    radius, known, velocity = motion.radius, subject.radius, subject.topics[Role.VELOCITY]
    if radius < 0:
        yield Finding(
            wheels, Kind.SIGN, Reason.WHEELS_BACKWARDS, against=velocity, evidence={"ratio": radius},
            mend=Scale("velocity", -1.0),
        )  # fmt: skip
    radius = abs(radius)
    if known is not None and abs(radius / known - 1.0) < SETTINGS.known_radius:
        return
    rolls_at = known or MOTION.rolling_radius
    # The ratio of a speed over ground to wheels in a unit, what takes the unit to rad/s, and how well it is known.
    units = (
        ("m/s", 1.0, 1 / rolls_at, SETTINGS.speed_unit),
        ("km/h", to_si("km/h"), to_si("km/h") / rolls_at, SETTINGS.speed_unit),
        ("rpm", to_si("rpm") * MOTION.rolling_radius, to_si("rpm"), SETTINGS.spin_unit),
        ("deg/s", to_si("deg/s") * MOTION.rolling_radius, to_si("deg/s"), SETTINGS.spin_unit),
    )
    for unit, ratio, factor, tolerance in units:
        if abs(radius / ratio - 1.0) < tolerance and (unit != "km/h" or _radius_is_sure(motion)):
            yield Finding(
                wheels, Kind.UNIT, Reason.WHEELS_UNIT, against=velocity, evidence={"ratio": radius},
                mend=Scale("velocity", factor, given=unit, expected="rad/s"),
            )  # fmt: skip
            return
    if not SETTINGS.least_radius < radius < SETTINGS.largest_radius:
        yield Finding(wheels, Kind.UNIT, Reason.WHEELS_RADIUS, against=velocity, evidence={"ratio": radius})
    elif known is not None and abs(radius / known - 1.0) > SETTINGS.known_radius + _antenna_share(motion):
        evidence = {"ratio": radius, "known": known}
        yield Finding(wheels, Kind.UNIT, Reason.WHEELS_RADIUS_OF_FILE, against=velocity, evidence=evidence)


def _radius_is_sure(motion: Motion) -> bool:
    """True if a ratio near that of km/h cannot be a small wheel: one that slips as the car brakes or accelerates all
    the time, or one of a car with an antenna beside its middle."""
    speed = motion.speed[np.isfinite(motion.speed)]
    if len(speed) and abs(speed[-1] - speed[0]) > SETTINGS.steady * len(speed) / motion.signals.rows(1.0):
        return False
    return _antenna_share(motion) < SETTINGS.antenna_share


def _antenna_share(motion: Motion) -> float:
    """Share of the speed by which an antenna beside the middle of a car may be faster than the wheels on the whole: it
    is in bends to one side, and slower in others."""
    if GNSS not in motion.turns:
        return 0.0
    bent = motion.turns[GNSS] / motion.speed
    bent = bent[np.isfinite(bent)]
    return SETTINGS.antenna * abs(float(np.mean(bent))) if len(bent) else 0.0


def steering_range(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Steering angles that no car reaches, or that are too large for how the car turns: in degrees."""
    steering, motion = subject.channel(Role.STEERING), subject.motion
    if steering is None or steering.columns["position"].shape[1] == 0:
        return
    by_gnss = None if motion is None else motion.first_turning(GNSS)
    for name, values in zip(steering.names, steering.columns["position"].T, strict=True):
        road_wheel = name.startswith("road_wheel")
        mend = Scale("position", np.pi / 180, name, "deg", "rad")
        largest = float(np.nanmax(np.abs(values))) if np.isfinite(values).any() else 0.0
        if largest > (SETTINGS.road_wheel if road_wheel else SETTINGS.steering_wheel):
            yield Finding(
                steering.topic, Kind.UNIT, Reason.STEERING_RANGE, name, confidence=Confidence.CERTAIN,
                evidence={"largest": largest}, mend=mend,
            )  # fmt: skip
        elif motion is not None and by_gnss is not None and name in motion.signals:
            # Steering angle over yaw rate is (wheelbase / speed + understeer) times the ratio: below 5 s for any car at
            # more than 5 m/s; in degrees it is at least 57 times the smallest, 0.1 s.
            matched = motion.compare(motion.smooth(motion.signals.signals[name]), motion.turns[GNSS])
            limit = SETTINGS.road_wheel_ratio if road_wheel else SETTINGS.steering_wheel_ratio
            if matched is not None and abs(matched.correlation) > SETTINGS.correlation and matched.ratio > limit:
                yield Finding(
                    steering.topic, Kind.UNIT, Reason.STEERING_SIZE, name, GNSS,
                    evidence={"ratio": matched.ratio}, mend=mend,
                )  # fmt: skip


def steering_size(subject: Subject, before: Sequence[Finding]) -> Iterator[Finding]:
    """Steering angles with which no car, whatever its ratio, turns as this one: in another unit, or of another part."""
    motion, topic = subject.motion, subject.topics.get(Role.STEERING)
    reference = None if motion is None else motion.first_turning(GNSS, GYRO, WHEELS)
    if motion is None or topic is None or reference is None:
        return
    # Slip makes wheels differ on a straight road, too, which GNSS or a gyro that is not frozen shows.
    if reference == WHEELS and any(spread(motion.turns[name]) > 0 for name in (GNSS, GYRO) if name in motion.turns):
        return
    low, high = SETTINGS.steering_turns
    for name in (STEERING_WHEEL, ROAD_WHEEL):
        known = any(one.topic == topic and one.signal == name for one in before)
        matched = None if known or name not in motion.turns else motion.compared(motion.turns, name, reference)
        if matched is None or abs(matched.best) < SETTINGS.size_correlation or low < matched.ratio < high:
            continue
        yield Finding(topic, Kind.UNIT, Reason.STEERING_TURNS, name, reference, evidence={"ratio": matched.ratio})


def yaw_rate(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """A yaw rate that is larger or smaller than the turning by GNSS, or by the wheels."""
    motion, s = subject.motion, SETTINGS
    reference = None if motion is None else motion.first_turning(GNSS, WHEELS)
    if motion is None or reference is None or GYRO not in motion.turns:
        return
    matched = motion.compared(motion.turns, GYRO, reference)
    if matched is None or abs(matched.best) < s.size_correlation:
        return
    reason, mend = None, None
    low, high = s.by_gnss if reference == GNSS else s.by_wheels
    if s.in_degrees[0] < matched.ratio < s.in_degrees[1]:
        reason = Reason.RATE_IN_DEGREES
        mend = Scale("angular_velocity", to_si("deg/s"), given="deg/s", expected="rad/s")
    elif not low < matched.ratio < high:
        reason = Reason.RATE_SIZE
    if reason is not None:
        topic = subject.topics[Role.IMU]
        yield Finding(
            topic, Kind.UNIT, reason, "angular_velocity.z", reference, evidence={"ratio": matched.ratio}, mend=mend
        )


def position_range(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Latitudes and longitudes that are no degrees."""
    channel = subject.channel(Role.POSITION)
    if channel is None:
        return
    latitude, longitude = (np.abs(channel.columns[name][:, 0]) for name in ("latitude", "longitude"))
    if not (np.isfinite(latitude) & np.isfinite(longitude)).any():
        return
    north, east = float(np.nanmax(latitude)), float(np.nanmax(longitude))
    reason = None
    if north > 90 or east > 180:
        reason = Reason.POSITION_RANGE
    elif north < SETTINGS.latitude and east < SETTINGS.longitude:
        reason = Reason.POSITION_ZERO
    if reason is not None:
        yield Finding(
            channel.topic, Kind.UNIT, reason, confidence=Confidence.CERTAIN,
            evidence={"latitude": north, "longitude": east},
        )  # fmt: skip


def brake_pressure(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """Brake pressures that brake nothing if they are in pascals."""
    channel = subject.channel(Role.BRAKES)
    if channel is None or channel.columns["effort"].shape[1] == 0:
        return
    largest = float(np.nanmax(channel.columns["effort"]))
    if SETTINGS.pressure[0] < largest < SETTINGS.pressure[1]:
        yield Finding(channel.topic, Kind.UNIT, Reason.PRESSURE_SIZE, evidence={"largest": largest})
