"""Where the frames of a car are: `base_link` in the middle of the rear axle on the ground, all else on it.

Axes of all frames: x forward, y left, z up (ISO 8855, REP-103). The wheels are in the design position.
"""

from __future__ import annotations

from dataclasses import dataclass

from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.parameter import Triple
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.vehicle import Vehicle

NOT_OF_THE_CAR = ("", "map", "odom")


@dataclass(frozen=True)
class Frame:
    """A frame on its parent: where it is [m], and its roll, pitch and yaw [rad]."""

    name: str
    parent: str
    position: Triple
    attitude: Triple = (0.0, 0.0, 0.0)


def axle_of(vehicle: Vehicle, wheel: str) -> Axle:
    """The axle of a wheel (fl, fr, rl, rr)."""
    return vehicle.physics.front if wheel.startswith("f") else vehicle.physics.rear


def wheel_on_ground(vehicle: Vehicle, wheel: str) -> Triple:
    """The middle of a contact patch in `base_link` [m]."""
    chassis = vehicle.physics.chassis
    forward = chassis.cog_to_front_axle + chassis.cog_to_rear_axle if wheel.startswith("f") else 0.0
    half = 0.5 * axle_of(vehicle, wheel).track
    return (forward, half if wheel.endswith("l") else -half, 0.0)


def sensor_frames(vehicle: Vehicle) -> list[Frame]:
    """Frames of the sensors on the car, one for each frame name that their messages have."""
    frames: dict[str, Frame] = {}
    for sensor in vehicle.sensors.values():
        position = getattr(sensor, "position", None)
        if sensor.frame_id in NOT_OF_THE_CAR or sensor.frame_id in frames or position is None:
            continue
        attitude = getattr(sensor, "attitude", (0.0, 0.0, getattr(sensor, "yaw", 0.0)))
        frames[sensor.frame_id] = Frame(sensor.frame_id, "cog", position, attitude)
    return list(frames.values())


def fixed_frames(vehicle: Vehicle, base: str = "base_link") -> list[Frame]:
    """All that do not move on the car: the centre of gravity in the design position, and the sensors."""
    chassis = vehicle.physics.chassis
    cog = Frame("cog", base, (chassis.cog_to_rear_axle, 0.0, chassis.cog_height))
    return [cog, *sensor_frames(vehicle)]


def contact_frames(vehicle: Vehicle, steering: float, base: str = "base_link") -> list[Frame]:
    """Frames of the contact patches, x along the wheels' heading: `steering` [rad] is that of the front wheels."""
    return [
        Frame(
            f"contact_{wheel}",
            base,
            wheel_on_ground(vehicle, wheel),
            (0.0, 0.0, steering if wheel.startswith("f") else 0.0),
        )
        for wheel in WHEELS
    ]
