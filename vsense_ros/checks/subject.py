"""A recording as the checks look at it: its channels by role, and the motion that they measure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import AlignedSignals, align
from vsense_ros.checks.finding import Finding
from vsense_ros.checks.frames import course_stays, velocity_against_position
from vsense_ros.checks.motion import GNSS, Motion, motion_of
from vsense_ros.checks.roles import USUAL_TOPICS, Role, Topics, message_type
from vsense_ros.messages.recording import Channel, Recording

Array = NDArray[np.float64]

_LEAST_ROWS = 10  # of a topic about which anything is said
_COMPARED = (
    Role.IMU, Role.POSITION, Role.VELOCITY, Role.WHEELS, Role.STEERING, Role.BODY_VELOCITY, Role.SPEED,
)  # fmt: skip


class Subject:
    """A recording with the `topics` of a vehicle and its rolling `radius` [m], if that is known. What several checks
    need is computed once."""

    def __init__(self, recording: Recording, topics: Topics = USUAL_TOPICS, radius: float | None = None) -> None:
        self.recording, self.topics, self.radius = recording, topics, radius

    def channel(self, role: Role) -> Channel | None:
        """The topic of a role, if it has the right type and more than a second of data."""
        channel = self.recording.channels.get(self.topics[role])
        if channel is None or channel.kind != message_type(role) or len(channel) < _LEAST_ROWS:
            return None
        return present(channel) if np.ptp(channel.seconds) >= 1.0 else None

    def channels(self, *roles: Role) -> Iterator[tuple[Role, Channel]]:
        """Those of some roles that can be looked at, each with its role; without an argument all of them."""
        for role in roles or Role:
            if (channel := self.channel(role)) is not None:
                yield role, channel

    def seconds(self, stamp: int) -> float:
        """A time [ns] since the start of the recording [s]."""
        return (int(stamp) - self.recording.start) * 1e-9

    @cached_property
    def aligned(self) -> AlignedSignals | None:
        """Its signals at common times; None where nothing can be compared."""
        return align(dict(self.channels(*_COMPARED)), self.topics, self.recording.start)

    @cached_property
    def frame_findings(self) -> tuple[Finding, ...]:
        """What is wrong with the frame of the GNSS velocity, or with the position, before the motion is known."""
        finding = None if self.aligned is None else velocity_against_position(self.aligned)
        return () if finding is None else (finding,)

    @cached_property
    def course_findings(self) -> tuple[Finding, ...]:
        """What is wrong with the course of the GNSS velocity, given how the car turns."""
        finding = None if self.measured_motion is None or self.velocity_is_wrong else course_stays(self.measured_motion)
        return () if finding is None else (finding,)

    @property
    def velocity_is_wrong(self) -> bool:
        """True if the GNSS velocity is in another frame or unit than the position."""
        return any(finding.topic == self.topics[Role.VELOCITY] for finding in self.frame_findings)

    @cached_property
    def measured_motion(self) -> Motion | None:
        """How each sensor measures the motion, with the course of the GNSS velocity unless that is no velocity over
        ground; None where nothing of it is measured."""
        return None if self.aligned is None else motion_of(self.aligned, course_by_position=self.velocity_is_wrong)

    @cached_property
    def motion(self) -> Motion | None:
        """How each sensor measures the motion, without a GNSS velocity that is wrong; None without a speed."""
        motion = self.measured_motion
        if motion is None or self.aligned is None or not motion.has_speed:
            return None
        if not self.course_findings:
            return motion
        if "x" in self.aligned:
            return motion_of(self.aligned, course_by_position=True)
        return replace(motion, turns={name: turn for name, turn in motion.turns.items() if name != GNSS})


def present(channel: Channel) -> Channel:
    """The channel with NaN where a message marks a vector as absent, as those do that carry a part of a topic."""
    if channel.kind != message_type(Role.IMU):
        return channel
    columns = dict(channel.columns)
    for name in ("orientation", "angular_velocity", "linear_acceleration"):
        mark = columns.get(f"{name}_covariance")
        if mark is None or not mark.shape[1]:
            continue
        absent = mark[:, 0] == -1
        if absent.any() and not absent.all():
            columns[name] = np.where(absent[:, None], np.nan, columns[name])
    return replace(channel, columns=columns)


def measured(channel: Channel) -> Iterator[tuple[str, Array]]:
    """Measured values of a channel by name; fields that are marked absent are left out."""
    for name, column in channel.columns.items():
        if "covariance" in name or name in ("status", "service"):
            continue
        if channel.kind == message_type(Role.VELOCITY) and name == "angular":
            continue
        mark = channel.columns.get(f"{name}_covariance")
        if channel.kind == message_type(Role.IMU) and mark is not None and mark.shape[1] and (mark[:, 0] == -1).all():
            continue
        labels = channel.names if channel.names else ("x", "y", "z", "w")
        for index in range(column.shape[1]):
            yield (f"{name}.{labels[index]}" if column.shape[1] > 1 or channel.names else name), column[:, index]
