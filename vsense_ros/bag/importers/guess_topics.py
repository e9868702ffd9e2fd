"""Which topics of a bag are those of this project: by their types, and by what must hold among them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pymap3d
from numpy.typing import NDArray

from vsense_ros.bag.can_names import WHEEL_SIDES, side_keys
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import TOPICS

Array = NDArray[np.float64]

_TWISTS = ("geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped")


@dataclass(frozen=True)
class VelocityMatchSettings:
    """How velocities and positions of a recording are matched: decisions of this project."""

    like: float = 0.3  # [-] of a speed, up to which two velocities differ that are the same
    tie: float = 0.1  # [-] of a speed, by which one explanation of a velocity must be better than another
    least_north: float = 0.3  # [m/s] standard deviation of a velocity to the north, below which it says nothing
    along: float = 0.3  # [-] correlation of two velocities to the north that are the same, positions being noisy
    across: float = 0.25  # [-] of the speed, up to which a car moves sideways


SETTINGS = VelocityMatchSettings()


def topics_of(recording: Recording) -> tuple[dict[str, Any], list[str]]:
    """The topics of a mapping as `topic_mapping` reads it, and what was assumed."""
    mapping: dict[str, Any] = {}
    remarks: list[str] = []
    free = {name: channel for name, channel in recording.channels.items() if len(channel) and name not in TOPICS}
    for name, expected in _in_other_frames(recording).items():
        mapping[name] = f"/{name}"
        remarks.append(f"/{name}: its frame is {recording[name].frame_id!r}, taken for {expected!r}")

    def of_kind(kind: str) -> list[Channel]:
        return [channel for channel in free.values() if channel.kind == kind]

    def take(topic: str, channel: Channel | None, names: dict[str, str] | None = None, why: str = "") -> None:
        if channel is None or topic in mapping or topic in recording:
            return
        name = f"/{channel.topic}"
        mapping[topic] = {"topic": name, "names": names} if names else name
        remarks.append(f"{name}: {why}")
        free.pop(channel.topic, None)

    imus = [channel for channel in of_kind("sensor_msgs/msg/Imu") if _measures_rates(channel)]
    take("imu/data", max(imus, key=len, default=None), why="an IMU that measures rates, of several the fastest")
    fixes = of_kind("sensor_msgs/msg/NavSatFix")
    take("gps/fix", max(fixes, key=len, default=None), why="positions of a satellite receiver")
    fix = recording.channels.get("gps/fix") or max(fixes, key=len, default=None)
    _velocities([c for c in free.values() if c.kind in _TWISTS], fix, take)
    for channel in of_kind("sensor_msgs/msg/JointState"):
        _joints(channel, take)
    poses = of_kind("nav_msgs/msg/Odometry")
    take("reference/odometry", max(poses, key=len, default=None), why="a pose, taken for the reference")
    remarks += [f"/{name}: not used ({channel.kind})" for name, channel in free.items()]
    return mapping, remarks


def _in_other_frames(recording: Recording) -> dict[str, str]:
    """The topics with the usual name and type whose messages have another frame, each with the frame expected."""
    expected: dict[str, str] = {}
    for name, channel in recording.channels.items():
        about = TOPICS.get(name)
        frame = about.frame_id if about is not None and about.kind == channel.kind else ""
        if frame and channel.frame_id not in ("", frame):
            expected[name] = frame
    return expected


def _measures_rates(channel: Channel) -> bool:
    rates = channel.columns["angular_velocity"]
    return bool(np.isfinite(rates).any() and np.nanmax(np.abs(rates)) > 0)


def _velocities(twists: list[Channel], fix: Channel | None, take: Any) -> None:
    """Tell velocities over ground, east and north, from those in the axes of the car."""
    for channel in twists:
        linear = channel.columns["linear"]
        moved = _moved(fix, channel) if fix is not None else None
        if moved is not None:
            forward = np.column_stack([np.hypot(*moved.T), np.zeros(len(moved))])
            over_ground, of_car = _apart(linear[:, :2], moved), _apart(linear[:, :2], forward)
            if min(over_ground, of_car) < SETTINGS.like:
                if abs(over_ground - of_car) < SETTINGS.tie:  # the car drives about to the east
                    is_ground = _goes_along(linear[:, 1], moved[:, 1])
                else:
                    is_ground = over_ground < of_car
                if is_ground:
                    take("gps/velocity", channel, why="a velocity to the east and north, as the positions move")
                else:
                    take("vehicle/velocity", channel, why="a velocity forward, as fast as the positions move")
                continue
        across = np.abs(linear[:, 1]) <= SETTINGS.across * np.abs(linear[:, 0]) + 0.3
        if any(word in channel.topic.lower() for word in ("gps", "gnss", "fix", "ublox")):
            take("gps/velocity", channel, why="a velocity of a satellite receiver, by its name")
        elif float(np.mean(across)) > 0.95:
            take("vehicle/velocity", channel, why="a velocity that is nearly all forward")
        else:
            take("gps/velocity", channel, why="a velocity in changing directions, taken for east and north")


def _moved(fix: Channel, channel: Channel) -> Array | None:
    """Velocity of the positions to the east and north (n, 2) [m/s] at the stamps of a channel; NaN where unknown."""
    latitude, longitude = (fix.columns[name][:, 0] for name in ("latitude", "longitude"))
    good = np.isfinite(latitude) & np.isfinite(longitude) & (np.abs(latitude) <= 90)
    stamp, first = np.unique(fix.stamp[good], return_index=True)
    if len(stamp) < 10:
        return None
    latitude, longitude = latitude[good][first], longitude[good][first]
    east, north, _ = pymap3d.geodetic2enu(latitude, longitude, 0.0, latitude[0], longitude[0], 0.0)
    time = (stamp - stamp[0]) * 1e-9
    at = (channel.stamp - stamp[0]) * 1e-9
    span = max(2.0, 4 * float(np.median(np.diff(time))))  # [s] over which a position's noise is small
    velocity = [(np.interp(at + span / 2, time, x) - np.interp(at - span / 2, time, x)) / span for x in (east, north)]
    velocities = np.column_stack(velocity)
    velocities[(at < time[0] + span) | (at > time[-1] - span)] = np.nan
    return velocities if np.isfinite(velocities).any() else None


def _apart(one: Array, other: Array) -> float:
    """Root mean square of the difference of two velocities (n, 2), as a share of the second; infinite if that hardly
    moves."""
    good = np.isfinite(one).all(axis=1) & np.isfinite(other).all(axis=1)
    if good.sum() < 10:
        return np.inf
    size = float(np.sqrt(np.mean(np.sum(other[good] ** 2, axis=1))))
    apart = float(np.sqrt(np.mean(np.sum((one - other)[good] ** 2, axis=1))))
    return apart / size if size > 1.0 else np.inf


def _goes_along(one: Array, other: Array) -> bool:
    """True if two velocities (n,) change together."""
    good = np.isfinite(one) & np.isfinite(other)
    if good.sum() < 10 or float(np.std(one[good])) < SETTINGS.least_north or float(np.std(other[good])) == 0:
        return False
    return float(np.corrcoef(one[good], other[good])[0, 1]) > SETTINGS.along


def _joints(channel: Channel, take: Any) -> None:
    """Wheel speeds and steering angles among the joints of a JointState."""
    if channel.columns.get("velocity", np.zeros((0, 0))).shape[1] == len(channel.names):
        families: dict[tuple[int, str], dict[str, str]] = {}
        for name in channel.names:
            for row, side, key in side_keys(name):
                families.setdefault((row, key), {}).setdefault(side, name)
        whole = [family for family in families.values() if set(family) == set(WHEEL_SIDES)]
        if whole:
            names = {f"wheel_{side}": whole[0][side] for side in WHEEL_SIDES}
            same = all(ours == theirs for ours, theirs in names.items())
            take(
                "vehicle/wheel_speeds", channel, None if same else names, "speeds of four wheels, by the joints' names"
            )
    if channel.columns.get("position", np.zeros((0, 0))).shape[1] == len(channel.names):
        if set(channel.names) & {"steering_wheel", "road_wheel_front"}:
            take("vehicle/steering", channel, None, "a steering angle")
            return
        steering = [name for name in channel.names if "steer" in name.lower()]
        if len(steering) == 1:
            joint = "steering_wheel" if "wheel" in steering[0].lower() else "road_wheel_front"
            take("vehicle/steering", channel, {joint: steering[0]}, f"a steering angle, taken for that of {joint}")
