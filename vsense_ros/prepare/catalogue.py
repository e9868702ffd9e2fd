"""What a catalogue says of a car, as a newcomer has it."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vsense_ros.errors import InputError
from vsense_ros.prepare.rules import CarKind

Driven = Literal["front", "rear", "all"]


class CatalogueValues(BaseModel):
    """Numbers of a catalogue, in SI units; what is None is filled by a rule.

    `mass` is that of the car as it is driven, `axle_load_front` the part of it on the front axle, both in kilograms.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str = Field(default="My car", min_length=1)
    mass: float = Field(gt=50, lt=40_000)
    wheelbase: float = Field(gt=0.8, lt=8)
    track: float = Field(gt=0.5, lt=3)
    tyre: str
    track_rear: float | None = Field(default=None, gt=0.5, lt=3)
    tyre_rear: str | None = None
    axle_load_front: float | None = Field(default=None, gt=10)
    driven: Driven = "front"
    steering_ratio: float | None = Field(default=None, gt=1, lt=40)
    height: float | None = Field(default=None, gt=0.5, lt=5)
    like: CarKind | None = None

    @property
    def kind(self) -> CarKind:
        """The kind of car whose rules are used: the one that is given, else one that its size makes likely."""
        if self.like is not None:
            return self.like
        if self.mass < 450:
            return "formula-student"
        if self.height is not None and self.height > 1.58:
            return "van" if self.height > 1.85 else "suv"
        return "compact" if self.wheelbase < 2.75 and self.mass < 1550 else "saloon"


def catalogue_values(**values: object) -> CatalogueValues:
    """Catalogue values, checked. Raises `InputError` with one sentence that names what is missing or cannot be."""
    try:
        car = CatalogueValues.model_validate({key: value for key, value in values.items() if value is not None})
    except ValidationError as error:
        faults = error.errors()
        if missing := [_option(fault["loc"]) for fault in faults if fault["type"] == "missing"]:
            raise InputError(f"a new vehicle needs {', '.join(missing)} as well; a catalogue has them") from None
        fault = faults[0]
        raise InputError(
            f"{_option(fault['loc'])}: {fault['msg'][:1].lower()}{fault['msg'][1:]}, found {fault['input']}; masses "
            "are in kg, lengths in m"
        ) from None
    load = car.axle_load_front
    if load is not None and not 0.25 * car.mass < load < 0.8 * car.mass:
        raise InputError(
            f"--axle-load-front: expected 25 to 80 % of the mass, found {load:g} kg of {car.mass:g} kg; it is the "
            "part of the mass on both front wheels"
        )
    return car


def _option(location: tuple[int | str, ...]) -> str:
    return "--" + str(location[-1]).replace("_", "-")
