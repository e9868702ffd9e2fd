"""A drive in closed form, by the signals that its sensors would give at common times.

Its turning and its speed are sums of sines whose periods have no common multiple, so that it resembles itself at no
other time. Axes are forward, left, up; the wheels roll without slip.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import AlignedSignals
from vsense_ros.checks.motion import SETTINGS as CAR
from vsense_ros.checks.motion import Motion, motion_of
from vsense_ros.checks.roles import USUAL_TOPICS, Role
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.recording import Channel, Recording

Array = NDArray[np.float64]

STEP = 0.02  # [s]
GRAVITY = 9.80665  # [m/s²]
IMU, POSITION, VELOCITY, WHEELS, STEERING = (
    USUAL_TOPICS[role] for role in (Role.IMU, Role.POSITION, Role.VELOCITY, Role.WHEELS, Role.STEERING)
)
GNSS_SIGNALS = ("east", "north")
INERTIAL = ("wx", "wy", "wz", "ax", "ay", "az")
WHEEL_SIGNALS = ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
STEERED = ("steering_wheel", "road_wheel_front")


@dataclass(frozen=True)
class Drive:
    """A drive of `duration` seconds; it turns and changes its speed `turning` and `pushing` times as much as usual."""

    duration: float = 40.0  # [s]
    speed: float = 15.0  # [m/s]
    turning: float = 1.0
    pushing: float = 1.0
    heading: float = 0.0  # [rad] at its beginning

    def signals(self, delay: Mapping[str, float] | None = None) -> dict[str, Array]:
        """All signals by their names, each as late [s] as `delay` says of it, if at all."""
        late = delay or {}
        names = (*GNSS_SIGNALS, "x", "y", *INERTIAL, *WHEEL_SIGNALS, *STEERED)
        t = np.arange(0.0, self.duration, STEP)
        return {name: self._at(t - late.get(name, 0.0))[name] for name in names}

    def _at(self, t: Array) -> dict[str, Array]:
        a, b = self.turning, self.pushing
        yaw_rate, angle = sines(t, ((0.2, 0.5, 0.0), (0.15, 1.3, 1.0), (0.08, 2.9, 2.0)))
        push, gained = sines(t, ((0.25, 0.37, 0.0), (1.2, 0.9, 0.5), (1.2, 2.3, 2.5)))
        yaw_rate, heading, push, speed = a * yaw_rate, self.heading + a * angle, b * push, self.speed + b * gained
        east, north = speed * np.cos(heading), speed * np.sin(heading)
        zero, half = 0.0 * t, CAR.track_width / 2
        road_wheel = yaw_rate * (CAR.wheelbase + CAR.understeer * speed**2) / speed
        left, right = ((speed + side * half * yaw_rate) / CAR.rolling_radius for side in (-1.0, 1.0))
        return {
            "east": east, "north": north, "x": integral(east), "y": integral(north),
            "wx": 0.1 * np.cos(2.1 * t), "wy": 0.05 * np.cos(1.7 * t + 0.3), "wz": yaw_rate,
            "ax": push, "ay": speed * yaw_rate, "az": zero + GRAVITY,
            "wheel_fl": left, "wheel_fr": right, "wheel_rl": left, "wheel_rr": right,
            "steering_wheel": CAR.steering_ratio * road_wheel, "road_wheel_front": road_wheel,
        }  # fmt: skip


def sines(t: Array, parts: Iterable[tuple[float, float, float]]) -> tuple[Array, Array]:
    """A sum of cosines, each by amplitude, angular frequency [rad/s] and phase, and its integral over time."""
    return (
        np.sum([size * np.cos(rate * t + phase) for size, rate, phase in parts], axis=0),
        np.sum([size / rate * np.sin(rate * t + phase) for size, rate, phase in parts], axis=0),
    )


def integral(values: Array) -> Array:
    """Integral of a signal by trapezia, from zero on."""
    return np.concatenate([[0.0], np.cumsum((values[1:] + values[:-1]) / 2) * STEP])


def late(seconds: float, *names: str) -> dict[str, float]:
    """So many seconds of delay for each of some signals."""
    return dict.fromkeys(names, seconds)


def only(signals: Mapping[str, Array], *names: str) -> dict[str, Array]:
    """Those of these names."""
    return {name: values for name, values in signals.items() if name in names}


def aligned_of(signals: Mapping[str, Array], *, period: float = 0.1, begin: float = 0.0) -> AlignedSignals:
    """Signals at common times, with GNSS messages `period` seconds apart, in a recording that began `begin` seconds
    before them."""
    count = len(next(iter(signals.values())))
    periods = {role: period for role, name in ((Role.VELOCITY, "east"), (Role.POSITION, "x")) if name in signals}
    start = 1_600_000_000_000_000_000
    return AlignedSignals(
        start, start - round(begin * 1e9), np.arange(count) * STEP, USUAL_TOPICS, periods, dict(signals)
    )


def motion_by(signals: Mapping[str, Array], *, period: float = 0.1) -> Motion:
    """The motion that signals measure."""
    return motion_of(aligned_of(signals, period=period), course_by_position=False)


def subject_of(
    signals: Mapping[str, Array], *, period: float = 0.1, radius: float | None = None, begin: float = 0.0
) -> Subject:
    """A recording of which the signals at common times are known already."""
    subject = Subject(Recording({}), radius=radius)
    subject.__dict__["aligned"] = aligned_of(signals, period=period, begin=begin)
    return subject


def recorded(*channels: Channel) -> Subject:
    """A recording of some channels."""
    return Subject(Recording({channel.topic: channel for channel in channels}))
