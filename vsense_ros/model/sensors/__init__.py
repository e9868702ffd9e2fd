"""Sensors, one file for each kind.

A kind is a class that says all that it is (`SensorBase`): where its messages come from and how to read one, its
equation, noise and biases, what its errors look like in a simulation, in which signals the search for missing physics
compares it, and how data that cannot be true are recognised. To add one, write its file, with the name of its
kind.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import reduce
from importlib import import_module
from operator import or_
from pkgutil import iter_modules
from typing import Annotated, Any

from pydantic import Field

from vsense_ros.messages.topics import TOPICS, Topic
from vsense_ros.model.sensors.articulation import Articulation
from vsense_ros.model.sensors.base import (
    Bias,
    ComparedSignal,
    Component,
    JointSensor,
    MeasuredQuantity,
    Response,
    SensorBase,
)
from vsense_ros.model.sensors.body_velocity import BodyVelocity
from vsense_ros.model.sensors.gnss_attitude import GnssAttitude
from vsense_ros.model.sensors.gnss_position import GnssPosition
from vsense_ros.model.sensors.gnss_velocity import GnssVelocity
from vsense_ros.model.sensors.imu import Imu
from vsense_ros.model.sensors.rear_steering import RearSteering
from vsense_ros.model.sensors.steering import Steering
from vsense_ros.model.sensors.suspension import Suspension
from vsense_ros.model.sensors.vehicle_speed import VehicleSpeed
from vsense_ros.model.sensors.wheel_speeds import WheelSpeeds
from vsense_ros.model.sensors.wheel_torques import WheelTorques


def _every() -> Iterator[type[SensorBase]]:
    """The kinds that the modules of this folder define."""
    for module in (import_module(f"{__name__}.{entry.name}") for entry in iter_modules(__path__)):
        for value in vars(module).values():
            defined_here = isinstance(value, type) and value.__module__ == module.__name__
            if defined_here and issubclass(value, SensorBase) and value.model_fields["kind"].default is not _NO_KIND:
                yield value


_NO_KIND = SensorBase.model_fields["kind"].default

# All kinds by name. One that is defined elsewhere may be added; `Vehicle.admit_kinds` lets vehicle files have it.
KINDS: dict[str, type[SensorBase]] = {
    str(kind.model_fields["kind"].default): kind
    for kind in sorted(_every(), key=lambda kind: (kind.place, kind.model_fields["kind"].default))
}


def any_sensor() -> Any:
    """The type of a sensor of any kind, which the key `kind` names."""
    return Annotated[reduce(or_, KINDS.values()), Field(discriminator="kind")]


def compared_signals() -> dict[str, ComparedSignal]:
    """The signals of all kinds by name."""
    return {signal.name: signal for kind in KINDS.values() for signal in kind.signals}


def known_topics() -> dict[str, Topic]:
    """What the topics of a recording carry: those of the project, and those of kinds that were added."""
    topics = {}
    for kind in KINDS.values():
        topic, frame = (kind.model_fields[name].default for name in ("topic", "frame_id"))
        topics[topic] = Topic(kind.message, frame, names=kind.joints)
    return {**topics, **TOPICS}


def unheard(topics: Iterable[str], sensors: Iterable[SensorBase], vehicle: str) -> list[str]:
    """Sentences about the topics of a recording to which no sensor of a vehicle listens."""
    heard = {sensor.topic for sensor in sensors}
    kinds = {str(kind.model_fields["topic"].default): name for name, kind in reversed(KINDS.items())}
    return [
        f"{vehicle} has no sensor for {topic}, which the recording has: add {kinds[topic]} to sensors"
        for topic in topics
        if topic in kinds and topic not in heard
    ]


def words_of(kind: str) -> str:
    """What a kind of sensor gives, after "it needs"."""
    return KINDS[kind].words or kind.replace("_", " ")


def best_measuring(sensors: Iterable[tuple[str, SensorBase]], quantity: MeasuredQuantity) -> str | None:
    """The name of the sensor that measures something best, among names and sensors: of the kind that comes first in
    lists of kinds, the last; None if there is none."""
    names: dict[tuple[int, str], str] = {}
    for name, sensor in sensors:
        if quantity in sensor.measures:
            names[sensor.place, sensor.kind] = name
    return names[min(names)] if names else None


def place_of(sensors: Iterable[SensorBase], quantity: MeasuredQuantity) -> int:
    """The place of the first sensor that measures something, -1 for none."""
    return next((i for i, sensor in enumerate(sensors) if quantity in sensor.measures), -1)


__all__ = [
    "KINDS",
    "Articulation",
    "Bias",
    "BodyVelocity",
    "ComparedSignal",
    "Component",
    "GnssAttitude",
    "GnssPosition",
    "GnssVelocity",
    "Imu",
    "JointSensor",
    "MeasuredQuantity",
    "RearSteering",
    "Response",
    "SensorBase",
    "Steering",
    "Suspension",
    "VehicleSpeed",
    "WheelSpeeds",
    "WheelTorques",
    "any_sensor",
    "best_measuring",
    "compared_signals",
    "known_topics",
    "place_of",
    "unheard",
    "words_of",
]
