"""The topics of a recording: their message type, frames and joint names, as every part of the project expects them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

WHEELS = ("fl", "fr", "rl", "rr")


@dataclass(frozen=True)
class Topic:
    """What a topic carries. An empty `frame_id` leaves the frame open; `names` are the joints that it may have."""

    kind: str
    frame_id: str = ""
    child_frame_id: str = ""
    names: tuple[str, ...] = ()


def _wheels(prefix: str) -> tuple[str, ...]:
    return tuple(f"{prefix}_{wheel}" for wheel in WHEELS)


INPUTS: Mapping[str, Topic] = MappingProxyType(
    {
        "imu/data": Topic("sensor_msgs/msg/Imu", "imu_link"),
        "gps/fix": Topic("sensor_msgs/msg/NavSatFix", "gnss_link"),
        "gps/velocity": Topic("geometry_msgs/msg/TwistWithCovarianceStamped", "map"),
        "gps/attitude": Topic("sensor_msgs/msg/Imu", "gnss_link"),
        "vehicle/velocity": Topic("geometry_msgs/msg/TwistWithCovarianceStamped", "velocity_link"),
        "vehicle/speed": Topic("geometry_msgs/msg/TwistStamped"),
        "vehicle/wheel_speeds": Topic("sensor_msgs/msg/JointState", names=_wheels("wheel")),
        "vehicle/steering": Topic("sensor_msgs/msg/JointState", names=("steering_wheel", "road_wheel_front")),
        "vehicle/wheel_torques": Topic("sensor_msgs/msg/JointState", names=_wheels("wheel")),
        "vehicle/brake_pressure": Topic("sensor_msgs/msg/JointState", names=_wheels("wheel")),
        "vehicle/suspension": Topic("sensor_msgs/msg/JointState", names=_wheels("suspension")),
        "vehicle/rear_steering": Topic("sensor_msgs/msg/JointState", names=("road_wheel_rear",)),
        "vehicle/articulation": Topic("sensor_msgs/msg/JointState", names=("hitch",)),
    }
)

REFERENCES: Mapping[str, Topic] = MappingProxyType(
    {
        "reference/odometry": Topic("nav_msgs/msg/Odometry", "map", "cog"),
        **{f"reference/wheel_force/{w}": Topic("geometry_msgs/msg/WrenchStamped", f"contact_{w}") for w in WHEELS},
        "reference/acceleration": Topic("geometry_msgs/msg/AccelStamped", "cog"),
        "reference/articulation": Topic("sensor_msgs/msg/JointState", names=("hitch",)),
    }
)

TOPICS: Mapping[str, Topic] = MappingProxyType({**INPUTS, **REFERENCES})
