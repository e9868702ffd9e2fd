"""Extension of the observer node: mass of the car and grade of its road, by the torques at its wheels."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import BaseModel, Field

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.mass_and_grade import TOPIC, MassAndGrade
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.extensions import Extension

if TYPE_CHECKING:
    from vsense_ros.node.base import SensingNode


class MassParameters(BaseModel):
    """Parameters of the estimate of the mass."""

    mass: bool = Field(
        False, description="estimate mass and grade, which needs wheel speeds, and wheel torques for mass"
    )


class Mass(Extension):
    """Mass and grade of one vehicle, published after each second that says something of them."""

    Parameters = MassParameters
    outputs: ClassVar[dict[str, str]] = {TOPIC: "sensor_msgs/msg/JointState"}

    def __init__(self, node: SensingNode, parameters: Any, vehicle: Vehicle) -> None:
        super().__init__(node, parameters, vehicle)
        self._mass = MassAndGrade(load_vehicle(vehicle_path(parameters.vehicle)))

    @classmethod
    def is_wanted(cls, parameters: Any) -> bool:
        """True if the mass is asked for."""
        return bool(parameters.mass)

    def add(self, sample: Sample) -> Iterable[Sample]:
        """Hand a message to the filter; returns mass and grade where they are new."""
        return (self._mass.sample(),) if self._mass.add(sample) else ()

    def diagnostics(self) -> list[Diagnostic]:
        """The mass, or why there is none."""
        return [self._mass.diagnostic()]
