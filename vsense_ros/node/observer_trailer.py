"""Extension of the observer node: articulation, pull and sway of a trailer, and a warning of a sway badly damped."""

from __future__ import annotations

from typing import ClassVar

from pydantic import BaseModel, Field

from vsense_ros.identification.towing import TOPIC, Towing
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.beside import FilterBeside


class TrailerParameters(BaseModel):
    """Parameters of the estimate of a trailer."""

    trailer: bool = Field(False, description="estimate the trailer that the vehicle file has as physics.trailer")


class TrailerBehind(FilterBeside):
    """The trailer of one vehicle, published 20 times a second from 18 km/h on."""

    Parameters = TrailerParameters
    parameter: ClassVar[str] = "trailer"
    outputs: ClassVar[dict[str, str]] = {TOPIC: "sensor_msgs/msg/JointState"}

    def make(self, vehicle: Vehicle) -> Towing:
        """The filter of the trailer."""
        return Towing(vehicle)
