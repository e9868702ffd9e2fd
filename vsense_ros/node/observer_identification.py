"""Extension of the observer node: a filter beside the observer identifies parameters of the car while it drives."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, ClassVar

from pydantic import BaseModel

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.online import ONLINE, TOPIC, OnlineIdentification
from vsense_ros.messages.recording import Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.base import SensingNode
from vsense_ros.node.extensions import Extension
from vsense_ros.node.parameters import path_parameter


class IdentificationParameters(BaseModel):
    """Where identified parameters are stored."""

    identify: str = path_parameter(
        "file that the identifying filter goes on from and stores its parameters in; empty: none runs"
    )


class Identification(Extension):
    """The identifying filter of one vehicle, which is published once a second."""

    Parameters = IdentificationParameters
    outputs: ClassVar[dict[str, str]] = {TOPIC: "sensor_msgs/msg/JointState"}

    def __init__(self, node: SensingNode, parameters: Any, vehicle: Vehicle) -> None:
        super().__init__(node, parameters, vehicle)
        own_copy = load_vehicle(vehicle_path(parameters.vehicle))
        self._identification = OnlineIdentification(own_copy, Path(parameters.identify))
        self._next_published = 0

    @classmethod
    def is_wanted(cls, parameters: Any) -> bool:
        """True if a file for the parameters is named."""
        return bool(parameters.identify)

    def add(self, sample: Sample) -> Iterable[Sample]:
        """Hand a message to the filter; once a second returns what is identified."""
        identification = self._identification
        identification.add(sample)
        if identification.stamp and abs(sample.stamp - self._next_published) * 1e-9 >= ONLINE.period:
            self._next_published = sample.stamp
            return (identification.sample(),)
        return ()

    def release(self) -> None:
        """Store the parameters for the next drive."""
        self._identification.save()
