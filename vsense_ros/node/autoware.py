"""What Autoware hears of a vehicle, from the estimate: autoware_vehicle_msgs, as bytes, whether installed or not."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

from vsense_ros.messages.recording import Sample

VELOCITY, STEERING = "vehicle/status/velocity_status", "vehicle/status/steering_status"
TOPICS = {
    VELOCITY: "autoware_vehicle_msgs/msg/VelocityReport",
    STEERING: "autoware_vehicle_msgs/msg/SteeringReport",
}


def messages(odometry: Sample, observer: Any, frame_id: str) -> Iterator[tuple[str, bytes]]:
    """Topic and CDR bytes of each message: velocity at `base_link` [m/s] and yaw rate [rad/s], angle of the front
    wheels [rad]."""
    stamp = struct.pack("<iI", *divmod(odometry.stamp, 1_000_000_000))
    name = frame_id.encode() + b"\0"
    head = b"\x00\x01\x00\x00" + stamp
    text = struct.pack("<I", len(name)) + name
    text += b"\0" * (-len(text) % 4)
    forward, lateral, _ = odometry.values["linear"].tolist()
    yaw_rate = float(odometry.values["angular"][2])
    lateral -= yaw_rate * observer.vehicle.physics.chassis.cog_to_rear_axle
    yield VELOCITY, head + text + struct.pack("<3f", forward, lateral, yaw_rate)
    inputs = getattr(observer.filter, "inputs", None)
    if inputs is not None and len(inputs):
        yield STEERING, head + struct.pack("<f", float(inputs[0]))
