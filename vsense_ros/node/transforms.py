"""The estimate as transforms (REP-105): `map` → `odom` → `base_link`, the contact patches, and the car's fixed frames.

`odom` → `base_link` is what the estimated velocity and yaw rate sum up to from the start: continuous, and drifting.
`map` → `odom` is what leads from there to the estimate, jumps and all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import asin, atan2, cos, sin

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.messages.cdr_messages import Transform, encode_transforms
from vsense_ros.messages.recording import Sample
from vsense_ros.model.frames import Frame, contact_frames, fixed_frames
from vsense_ros.model.parameter import Triple
from vsense_ros.model.vehicle import Vehicle

_LONGEST_STEP = 1_000_000_000  # [ns] over which a velocity is taken to last


def _angles(x: float, y: float, z: float, w: float) -> Triple:
    """Roll, pitch and yaw [rad] of a quaternion, intrinsic z-y-x."""
    pitch = asin(min(max(2 * (w * y - z * x), -1.0), 1.0))
    return (
        atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        pitch,
        atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )


def _quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """x, y, z, w of the same angles."""
    cr, sr, cp, sp = cos(roll / 2), sin(roll / 2), cos(pitch / 2), sin(pitch / 2)
    cy, sy = cos(yaw / 2), sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _turned(vector: Sequence[float], roll: float, pitch: float, yaw: float) -> Triple:
    """A vector of the body in the axes that it is turned against."""
    x, y, z = vector
    y, z = cos(roll) * y - sin(roll) * z, sin(roll) * y + cos(roll) * z
    x, z = cos(pitch) * x + sin(pitch) * z, -sin(pitch) * x + cos(pitch) * z
    return cos(yaw) * x - sin(yaw) * y, sin(yaw) * x + cos(yaw) * y, z


class Odometry:
    """Where the car came from its start by its velocity alone: heading and place in `odom`; height, roll and pitch are
    those in the map."""

    def __init__(self) -> None:
        self._stamp = 0
        self.place = (0.0, 0.0)  # [m]
        self.heading = 0.0  # [rad]

    def step(self, stamp: int, roll: float, pitch: float, velocity: Sequence[float], rates: Sequence[float]) -> None:
        """Go on to `stamp` [ns] with velocity (3,) [m/s] and rates (3,) [rad/s] in body axes."""
        step = 1e-9 * min(max(stamp - self._stamp, 0), _LONGEST_STEP) if self._stamp else 0.0
        self._stamp = max(stamp, self._stamp)
        turn = step * (sin(roll) * rates[1] + cos(roll) * rates[2]) / max(cos(pitch), 0.1)
        east, north, _ = _turned(velocity, roll, pitch, self.heading + turn / 2)
        self.place = (self.place[0] + step * east, self.place[1] + step * north)
        self.heading += turn


class Transforms:
    """Transforms of one car, as messages."""

    def __init__(self, vehicle: Vehicle, names: Mapping[str, str]) -> None:
        """`names` are those of the frames `map`, `odom`, `base_link` and of all others, where they differ."""
        self._vehicle, self._names = vehicle, names
        chassis = vehicle.physics.chassis
        self._base_in_cog = (-chassis.cog_to_rear_axle, 0.0, -chassis.cog_height)
        self._odometry = Odometry()

    def static(self) -> bytes:
        """The frames that do not move on the car."""
        return encode_transforms(0, [self._of(frame) for frame in fixed_frames(self._vehicle)])

    def moving(self, odometry: Sample, steering: float) -> bytes:
        """Where the car is, by an estimate's message, and which way its front wheels point [rad]; a coordinate that
        the estimate lacks is zero."""
        values = odometry.values
        roll, pitch, yaw = _angles(*values["orientation"].tolist())
        arm = _turned(self._base_in_cog, roll, pitch, yaw)
        east, north, up = (p + a for p, a in zip(np.nan_to_num(values["position"]).tolist(), arm, strict=True))
        (u, v, w), (p, q, r) = values["linear"].tolist(), values["angular"].tolist()
        x, y, z = self._base_in_cog
        velocity = (u + q * z - r * y, v + r * x - p * z, w + p * y - q * x)
        own = self._odometry
        own.step(odometry.stamp, roll, pitch, velocity, (p, q, r))
        turned = yaw - own.heading
        away_east, away_north, _ = _turned((*own.place, 0.0), 0.0, 0.0, turned)
        transforms = [
            self._named("map", "odom", (east - away_east, north - away_north, 0.0), _quaternion(0.0, 0.0, turned)),
            self._named("odom", "base_link", (*own.place, up), _quaternion(roll, pitch, own.heading)),
            *(self._of(frame) for frame in contact_frames(self._vehicle, steering)),
        ]
        return encode_transforms(odometry.stamp, transforms)

    def _of(self, frame: Frame) -> Transform:
        if frame.attitude[:2] == (0.0, 0.0):
            turned: Sequence[float] = _quaternion(*frame.attitude)
        else:
            turned = Rotation.from_euler("xyz", frame.attitude).as_quat().tolist()
        return self._named(frame.parent, frame.name, frame.position, turned)

    def _named(self, parent: str, child: str, position: Sequence[float], orientation: Sequence[float]) -> Transform:
        return Transform(self._names.get(parent, parent), self._names.get(child, child), position, orientation)
