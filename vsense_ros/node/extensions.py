"""Extensions of the observer node: installed packages add to it by entry points of the group `vsense_ros.observer`.

The node itself imports none of them. Each is a subclass of `Extension`; its `Parameters` become parameters of the node.
One that cannot be imported is left out: the node says so in a sentence and in its diagnostics, and works without it.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from pydantic import BaseModel, create_model

from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.parameters import NodeParameters

if TYPE_CHECKING:
    from vsense_ros.node.base import SensingNode
    from vsense_ros.runner.adapter import MakeFilter

GROUP = "vsense_ros.observer"

Parameters = TypeVar("Parameters", bound=NodeParameters)


class Extension:
    """Something that the observer node does beside estimating; by default nothing.

    It lives from one configuration of `node` to the next. `parameters` are those of the node, with the fields of
    `Parameters` among them. Whatever raises `InputError` refuses the configuration with its sentence.
    """

    Parameters: ClassVar[type[BaseModel]] = BaseModel
    outputs: ClassVar[dict[str, str]] = {}  # topics that it publishes, with their message types

    def __init__(self, node: SensingNode, parameters: Any, vehicle: Vehicle) -> None:
        self.node, self.parameters, self.vehicle = node, parameters, vehicle

    @property
    def inputs(self) -> dict[str, str]:
        """Topics that it listens to beside those of the observer, with their message types."""
        return {}

    @classmethod
    def is_wanted(cls, parameters: Any) -> bool:
        """True if the parameters ask for this extension."""
        return True

    def make_filter(self) -> MakeFilter | None:
        """The filter to be used instead of the one that the parameter `filter` names; None for that one."""
        return None

    def add(self, sample: Sample) -> Iterable[Sample]:
        """Take a message that the observer has been given; returns what is to be published."""
        return ()

    def diagnostics(self) -> list[Diagnostic]:
        """Lines for the node's diagnostics."""
        return []

    def summary(self) -> dict[str, Any]:
        """Entries for the node's summary."""
        return {}

    def release(self) -> None:
        """Store what is to be kept, and close what is open; may be called more than once."""


@cache
def installed() -> tuple[tuple[type[Extension], ...], tuple[str, ...]]:
    """The extensions that are installed, by name, and a sentence for each that cannot be imported."""
    extensions: dict[str, type[Extension]] = {}
    faults: list[str] = []
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        try:
            extensions[entry.name] = entry.load()
        except Exception as error:  # of a package that is not ours
            faults.append(
                f"the extension {entry.name} ({entry.value}) cannot be imported and is left out: "
                f"{type(error).__name__}: {error}"
            )
    return tuple(extensions.values()), tuple(faults)


def with_extensions(model: type[Parameters], name: str) -> type[Parameters]:
    """Parameters of a node together with those of all installed extensions, as a class of this name."""
    extensions, faults = installed()
    bases: Any = (model, *(extension.Parameters for extension in extensions))  # of several classes, for pydantic alone
    combined: type[Parameters] = create_model(name, __base__=bases, __module__=model.__module__, __doc__=model.__doc__)
    combined.unavailable = faults
    return combined


def fault_lines() -> list[Diagnostic]:
    """Diagnostics of the extensions that cannot be imported."""
    _, faults = installed()
    return [Diagnostic("extensions", Level.WARN, sentence) for sentence in faults]
