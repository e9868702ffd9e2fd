"""Extension of the observer node: rolling radii of the tyres, and a warning of one that has lost pressure."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from pydantic import BaseModel

from vsense_ros.identification.tyre_radii import TOPIC, TyreRadii
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.beside import FilterBeside
from vsense_ros.node.parameters import path_parameter


class TyreParameters(BaseModel):
    """Where radii are stored."""

    tyres: str = path_parameter(
        "file of tyre radii that belong to right pressures, written at the end of the first drive; remove it after "
        "tyres were changed or filled; empty: tyres are not watched"
    )


class Tyres(FilterBeside):
    """The tyre radii of one vehicle, published after each second of gentle driving."""

    Parameters = TyreParameters
    parameter: ClassVar[str] = "tyres"
    outputs: ClassVar[dict[str, str]] = {TOPIC: "sensor_msgs/msg/JointState"}
    filter: TyreRadii

    def make(self, vehicle: Vehicle) -> TyreRadii:
        """The filter of the radii."""
        return TyreRadii(vehicle, Path(self.parameters.tyres))

    def release(self) -> None:
        """Store the radii if there were none."""
        self.filter.save()
