"""The reference of a recording against itself and against the sensors: it may be what is wrong in a comparison.

Position, heading, velocity and yaw rate of one odometry describe the same motion twice: the velocity, turned by the
heading, is the change of the position, and the yaw rate is that of the heading. A reference in another unit, with axes
of another convention or with a clock of its own does not agree with itself, or with what the sensors measure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.checks.aligned import means_around
from vsense_ros.checks.finding import Confidence, Finding, Kind
from vsense_ros.checks.lags import LagSettings, match
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import Role
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.recording import Channel

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

TOPIC = "reference/odometry"
_ODOMETRY = "nav_msgs/msg/Odometry"


@dataclass(frozen=True)
class ReferenceSettings:
    """Limits by which a reference contradicts itself or the sensors."""

    span: float = setting(1.0, "s", "over which changes of place and heading are taken", JUDGEMENT)
    step: float = setting(0.05, "s", "from one time that is compared to the next", JUDGEMENT)
    least: float = setting(3.0, "s", "of driving, of less of which nothing is said", JUDGEMENT)
    moving: float = setting(3.0, "m/s", "above which the car drives", JUDGEMENT)
    ratio: tuple[float, float] = setting((0.9, 1.1), "-", "ratio of two speeds or two yaw rates that are the same")
    angle: float = setting(0.2, "rad", "between two directions of travel that are the same", JUDGEMENT)
    better: float = setting(0.5, "-", "of the error with the axes as they are, below which others are right")
    unlike: float = setting(0.3, "-", "error of a velocity over its size, from which on it is another motion")
    turning: float = setting(0.03, "rad/s", "standard deviation of the turning by which yaw rates are compared")
    alike: float = setting(0.9, "-", "correlation, from which on two yaw rates are of one motion")
    late: float = setting(0.3, "s", "by which a reference may be late: sensors have latencies, too", JUDGEMENT)
    explained: float = setting(3.0, "-", "variance that is unexplained without a lag over that which is with it")


SETTINGS = ReferenceSettings()
LAGS = LagSettings(longest=5.0, least_overlap=3.0)

# The velocity on the map by velocity (forward + i left) and heading, by what would be wrong about them.
_FORMS: Mapping[str, Callable[[Complex, Array], Complex]] = {
    "": lambda velocity, heading: velocity * np.exp(1j * heading),
    "y were to the right": lambda velocity, heading: velocity.conj() * np.exp(1j * heading),
    "the heading were clockwise": lambda velocity, heading: velocity * np.exp(-1j * heading),
    "y were to the right and the heading clockwise": lambda velocity, heading: (velocity * np.exp(1j * heading)).conj(),
    "the velocity were east and north, expected forward and left": lambda velocity, _: velocity,
    "the velocity were north and east, expected forward and left": lambda velocity, _: velocity.conj(),
}


class _Reference:
    """Motion of a reference at common times `at` (n,) [s after its first message]."""

    def __init__(self, channel: Channel) -> None:
        stamps, rows = np.unique(channel.stamp, return_index=True)
        self.first = int(stamps[0])
        self._t = np.asarray((stamps - self.first) * 1e-9, dtype=np.float64)
        columns = {name: channel.columns[name][rows] for name in ("position", "orientation", "linear", "angular")}
        half = SETTINGS.span / 2
        self.at = np.arange(half, self._t[-1] - half, SETTINGS.step)
        self.yaw_rate = columns["angular"][:, 2]
        orientation = columns["orientation"]
        known = np.linalg.norm(orientation, axis=1) > 0.5
        self._heading = np.full(len(rows), np.nan)
        if known.any():
            self._heading[known] = np.unwrap(Rotation.from_quat(orientation[known]).as_euler("ZYX")[:, 0])
        self._velocity = columns["linear"][:, 0] + 1j * columns["linear"][:, 1]
        self.travelled = self._changes(columns["position"][:, 0]) + 1j * self._changes(columns["position"][:, 1])
        self.turned = self._changes(self._heading)

    def means(self, values: Array) -> Array:
        """Means of a signal (m,) over a span around the common times."""
        return means_around(self.at, self._t, values, SETTINGS.span)

    def velocity(self, form: str) -> Complex:
        """Velocity on the map, (n,) east + i north [m/s], by velocity and heading taken in a form."""
        values = _FORMS[form](self._velocity, self._heading)
        return np.asarray(self.means(values.real) + 1j * self.means(values.imag))

    @property
    def speed(self) -> Array:
        """Speed (n,) by the velocity [m/s]."""
        return self.means(np.abs(self._velocity))

    def _changes(self, values: Array) -> Array:
        """Change of a signal (m,) per second over a span around the common times."""
        known = np.isfinite(values)
        if known.sum() < 2:
            return np.full(len(self.at), np.nan)
        half = SETTINGS.span / 2
        after, before = (np.interp(self.at + way, self._t[known], values[known]) for way in (half, -half))
        return np.asarray((after - before) / SETTINGS.span)


def contradictions(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """A reference that does not agree with itself, or with the sensors."""
    for topic, channel in subject.recording.channels.items():
        known = channel.kind == _ODOMETRY and (topic.strip("/") == TOPIC or topic.endswith(f"/{TOPIC}"))
        if known and len(channel) and np.ptp(channel.seconds) > SETTINGS.least + SETTINGS.span:
            reference = _Reference(channel)
            yield from _velocity(topic, reference)
            yield from _yaw_rate(topic, reference)
            yield from _against_sensors(topic, reference, subject)


def _velocity(topic: str, reference: _Reference) -> Iterator[Finding]:
    """A velocity that is not the change of the position."""
    travelled = reference.travelled
    forms = {form: reference.velocity(form) for form in _FORMS}
    driven = np.abs(travelled) > SETTINGS.moving
    driven &= np.isfinite(forms[""]) & np.isfinite(travelled)
    if driven.sum() * SETTINGS.step < SETTINGS.least:
        return
    fits = {form: _scaled(velocity[driven], travelled[driven]) for form, velocity in forms.items()}
    scale, error = fits[""]
    ratio, angle = float(np.abs(scale)), float(np.angle(scale))
    best = min(fits, key=lambda form: fits[form][1])
    low, high = SETTINGS.ratio
    evidence = {"ratio": ratio, "angle": float(np.degrees(angle)), "error": error}
    if best and fits[best][1] < SETTINGS.better * error:
        names = {"actual": best}
        yield Finding(topic, Kind.AXES, Reason.REFERENCE_AXES, evidence=evidence, names=names)
    elif ratio > low and error > SETTINGS.unlike:
        yield Finding(topic, Kind.AXES, Reason.REFERENCE_UNLIKE, evidence=evidence)
    elif not low < ratio < high:
        yield Finding(topic, Kind.UNIT, Reason.REFERENCE_SPEED, evidence=evidence)
    elif abs(angle) > SETTINGS.angle:
        yield Finding(topic, Kind.AXES, Reason.REFERENCE_ANGLE, evidence=evidence)


def _scaled(velocity: Complex, travelled: Complex) -> tuple[complex, float]:
    """The complex number by which the change of the position becomes the velocity, and the size of what remains over
    that of the velocity."""
    scale = complex(np.vdot(travelled, velocity) / np.vdot(travelled, travelled).real)
    size = float(np.linalg.norm(velocity))
    return scale, float(np.linalg.norm(velocity - scale * travelled)) / size if size > 0 else 0.0


def _yaw_rate(topic: str, reference: _Reference) -> Iterator[Finding]:
    """A yaw rate that is not the change of the heading."""
    measured, turned = reference.means(reference.yaw_rate), reference.turned
    known = np.isfinite(measured) & np.isfinite(turned)
    if known.sum() * SETTINGS.step < SETTINGS.least or np.std(turned[known]) < SETTINGS.turning:
        return
    ratio = float(measured[known] @ turned[known] / (turned[known] @ turned[known]))
    if not SETTINGS.ratio[0] < ratio < SETTINGS.ratio[1]:
        kind = Kind.SIGN if ratio < 0 else Kind.UNIT
        yield Finding(topic, kind, Reason.REFERENCE_YAW_RATE, evidence={"ratio": ratio})


def _against_sensors(topic: str, reference: _Reference, subject: Subject) -> Iterator[Finding]:
    """A reference that is of another time than the sensors, or faster than GNSS measures."""
    imu, gnss = subject.channel(Role.IMU), subject.channel(Role.VELOCITY)
    spans = [channel.stamp for channel in (imu, gnss) if channel is not None]
    if not spans:
        return
    at = reference.first + reference.at * 1e9
    begin, end = min(int(stamps.min()) for stamps in spans), max(int(stamps.max()) for stamps in spans)
    apart = max(begin - float(at[-1]), float(at[0]) - end) * 1e-9
    if apart > 0:
        evidence = {"distance": apart}
        certain = Confidence.CERTAIN
        yield Finding(topic, Kind.CLOCK, Reason.NO_COMMON_TIME, confidence=certain, evidence=evidence)
        return
    if imu is not None:
        yield from _late(topic, reference, imu)
    if gnss is not None and not np.isfinite(reference.travelled).any():
        speed = np.hypot(*gnss.columns["linear"][:, :2].T)
        seconds = np.asarray((gnss.stamp - reference.first) * 1e-9, dtype=np.float64)
        theirs = means_around(reference.at, seconds, speed, SETTINGS.span)
        driven = (theirs > SETTINGS.moving) & np.isfinite(reference.speed)
        if driven.sum() * SETTINGS.step > SETTINGS.least:
            ratio = float(np.median(reference.speed[driven] / theirs[driven]))
            if not SETTINGS.ratio[0] < ratio < SETTINGS.ratio[1]:
                evidence = {"ratio": ratio}
                yield Finding(topic, Kind.UNIT, Reason.REFERENCE_SPEED_BY_GNSS, against=gnss.topic, evidence=evidence)


def _late(topic: str, reference: _Reference, imu: Channel) -> Iterator[Finding]:
    """A reference that turns later or earlier than the gyro."""
    turned = reference.turned if np.isfinite(reference.turned).any() else reference.means(reference.yaw_rate)
    order = np.argsort(imu.stamp, kind="stable")
    seconds = np.asarray((imu.stamp[order] - reference.first) * 1e-9, dtype=np.float64)
    measured = means_around(reference.at, seconds, imu.columns["angular_velocity"][order, 2], SETTINGS.span)
    measured[(reference.at < seconds[0]) | (reference.at > seconds[-1])] = np.nan
    known = np.isfinite(turned) & np.isfinite(measured)
    if known.sum() * SETTINGS.step < SETTINGS.least or np.std(measured[known]) < SETTINGS.turning:
        return
    matched = match(turned, measured, SETTINGS.step, LAGS)
    if matched is None or matched.best < SETTINGS.alike or matched.explained < SETTINGS.explained or matched.clear <= 0:
        return
    if abs(matched.lag) > SETTINGS.late:
        evidence = {imu.topic: matched.lag}
        yield Finding(topic, Kind.LAG, Reason.REFERENCE_LATE, against=imu.topic, evidence=evidence)
