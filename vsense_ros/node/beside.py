"""What extensions of the observer node have in common that are a filter beside the observer."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.extensions import Extension

if TYPE_CHECKING:
    from vsense_ros.node.base import SensingNode


class Beside(Protocol):
    """A filter that takes messages, and now and then has something new to say."""

    @property
    def topics(self) -> dict[str, str]:
        """Topics that it listens to, with their message types."""

    def add(self, sample: Sample) -> bool:
        """Take a message. Returns whether there is something new."""

    def sample(self) -> Sample:
        """What it has to say."""

    def diagnostic(self) -> Diagnostic:
        """What it has to say, as a sentence."""


class FilterBeside(Extension):
    """A filter of one vehicle, published whenever it says something new; wanted where `parameter` is given."""

    parameter: ClassVar[str]

    def __init__(self, node: SensingNode, parameters: Any, vehicle: Vehicle) -> None:
        super().__init__(node, parameters, vehicle)
        self.filter = self.make(load_vehicle(vehicle_path(parameters.vehicle)))

    @abstractmethod
    def make(self, vehicle: Vehicle) -> Beside:
        """The filter, for the vehicle as its file has it."""

    @classmethod
    def is_wanted(cls, parameters: Any) -> bool:
        """True if the parameter is given."""
        return bool(getattr(parameters, cls.parameter))

    @property
    def inputs(self) -> dict[str, str]:
        """The topics of the filter."""
        return self.filter.topics

    def add(self, sample: Sample) -> Iterable[Sample]:
        """Hand a message to the filter; returns what it says where that is new."""
        return (self.filter.sample(),) if self.filter.add(sample) else ()

    def diagnostics(self) -> list[Diagnostic]:
        """What the filter says, in a sentence."""
        return [self.filter.diagnostic()]
