"""The topics of a recording by the role that their sensor plays, as the vehicle file names them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import StrEnum
from types import MappingProxyType
from typing import Protocol

from vsense_ros.messages.topics import INPUTS


class Role(StrEnum):
    """What a topic carries. The values are the kinds of sensors in vehicle files."""

    IMU = "imu"
    POSITION = "gnss_position"
    VELOCITY = "gnss_velocity"
    ATTITUDE = "gnss_attitude"
    BODY_VELOCITY = "body_velocity"
    SPEED = "vehicle_speed"
    WHEELS = "wheel_speeds"
    STEERING = "steering"
    TORQUES = "wheel_torques"
    BRAKES = "brake_pressure"
    SUSPENSION = "suspension"
    REAR_STEERING = "rear_steering"
    ARTICULATION = "articulation"


Topics = Mapping[Role, str]

# The topic of each role where no vehicle file names another one, in the order of `messages.topics.INPUTS`.
USUAL_TOPICS: Topics = MappingProxyType(dict(zip(Role, INPUTS, strict=True)))


class NamedSensor(Protocol):
    """A sensor of a vehicle file, as far as its topic is concerned."""

    @property
    def kind(self) -> str: ...
    @property
    def topic(self) -> str: ...


def topics_of(sensors: Iterable[NamedSensor]) -> Topics:
    """The topic of each role: that of the first sensor of its kind, or the usual one where there is no such sensor."""
    named: dict[str, str] = {}
    for sensor in sensors:
        named.setdefault(sensor.kind, sensor.topic)
    return {role: named.get(role, usual) for role, usual in USUAL_TOPICS.items()}


def message_type(role: Role) -> str:
    """The message type that a topic of this role has."""
    return INPUTS[USUAL_TOPICS[role]].kind
