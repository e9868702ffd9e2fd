"""Extension of the observer node: mass of the car and grade of its road, by the torques at its wheels."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, Field

from vsense_ros.identification.mass_and_grade import TOPIC, MassAndGrade
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.beside import FilterBeside


class MassParameters(BaseModel):
    """Parameters of the estimate of the mass."""

    mass: bool = Field(
        False, description="estimate mass and grade, which needs wheel speeds, and wheel torques for mass"
    )


class Mass(FilterBeside):
    """Mass and grade of one vehicle, published after each second that says something of them."""

    Parameters = MassParameters
    parameter: ClassVar[str] = "mass"
    outputs: ClassVar[dict[str, str]] = {TOPIC: "sensor_msgs/msg/JointState"}

    def make(self, vehicle: Vehicle) -> MassAndGrade:
        """The filter of the mass."""
        return MassAndGrade(vehicle)
