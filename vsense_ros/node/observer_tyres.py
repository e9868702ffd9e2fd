"""Extension of the observer node: rolling radii of the tyres, and a warning of one that has lost pressure."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import BaseModel

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.tyre_radii import TOPIC, TyreRadii
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.extensions import Extension
from vsense_ros.node.parameters import path_parameter

if TYPE_CHECKING:
    from vsense_ros.node.base import SensingNode


class TyreParameters(BaseModel):
    """Where radii are stored."""

    tyres: str = path_parameter(
        "file of tyre radii that belong to right pressures, written at the end of the first drive; remove it after "
        "tyres were changed or filled; empty: tyres are not watched"
    )


class Tyres(Extension):
    """The tyre radii of one vehicle, published after each second of gentle driving."""

    Parameters = TyreParameters
    outputs: ClassVar[dict[str, str]] = {TOPIC: "sensor_msgs/msg/JointState"}

    def __init__(self, node: SensingNode, parameters: Any, vehicle: Vehicle) -> None:
        super().__init__(node, parameters, vehicle)
        self._radii = TyreRadii(load_vehicle(vehicle_path(parameters.vehicle)), Path(parameters.tyres))

    @classmethod
    def is_wanted(cls, parameters: Any) -> bool:
        """True if a file for the radii is named."""
        return bool(parameters.tyres)

    def add(self, sample: Sample) -> Iterable[Sample]:
        """Hand a message to the filter; returns the radii where they are new."""
        return (self._radii.sample(),) if self._radii.add(sample) else ()

    def diagnostics(self) -> list[Diagnostic]:
        """Which tyre is smaller than it should be."""
        return [self._radii.diagnostic()]

    def release(self) -> None:
        """Store the radii if there were none."""
        self._radii.save()
