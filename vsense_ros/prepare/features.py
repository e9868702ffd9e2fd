"""Figures by which a vehicle file is judged, each with the keys of the file that it comes from."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from pydantic import BaseModel, ConfigDict, TypeAdapter

from vsense_ros.messages import yaml_text

FILE = Path(__file__).with_name("ranges.yaml")


class Range(BaseModel):
    """Least and largest figure of real cars, with its unit, its meaning and its source."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    range: tuple[float, float]
    unit: str
    meaning: str
    source: str


@dataclass(frozen=True)
class Feature:
    """A figure of a car: the name of its range, its value, and the keys of the file that it is computed from. `place`
    says which axle or sensor it is about."""

    name: str
    value: float
    keys: tuple[str, ...]
    place: str = ""

    @property
    def limits(self) -> Range:
        """The range of real cars."""
        return ranges()[self.name]

    @property
    def off(self) -> bool:
        """True if no real car has such a figure."""
        low, high = self.limits.range
        return not low <= self.value <= high


@cache
def ranges() -> dict[str, Range]:
    """The ranges of real cars by name."""
    return TypeAdapter(dict[str, Range]).validate_python(yaml_text.load_file(FILE))
