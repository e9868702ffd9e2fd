"""From signals of a CAN database to numbers in SI: what the outputs of all kinds in a mapping are made of."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from vsense_ros.messages.units import QUANTITIES, canonical, quantity_of, to_si

UNITS = tuple(
    unit
    for quantity in ("angle", "angular velocity", "velocity", "acceleration", "length", "pressure", "torque")
    for unit in QUANTITIES[quantity]
)


class Part(BaseModel):
    """A part of a mapping file, which has no other keys than it knows."""

    model_config = ConfigDict(extra="forbid", frozen=True)


_Values = Annotated[
    tuple[float | str, ...], BeforeValidator(lambda v: tuple(v) if isinstance(v, list | tuple) else (v,))
]


class Valid(Part):
    """A signal of the same message that says whether a value may be believed, as quality flags do."""

    signal: str = Field(description="signal of the DBC")
    values: _Values = Field(description="numbers or names (VAL_) at which the value is believed", min_length=1)


class SignBit(Part):
    """A signal of the same message that says the direction of another, which is a magnitude."""

    signal: str = Field(description="signal of the DBC")
    negative: _Values = Field(
        default=(1,), description="its numbers or names (VAL_) where the magnitude counts as negative", min_length=1
    )


class Signal(Part):
    """From a signal of the DBC to SI: (sum of the signals × factor + offset), which is then in `unit`.

    A negative factor turns a signal whose positive direction is not that of ISO 8855.
    """

    signals: Annotated[tuple[str, ...], BeforeValidator(lambda v: (v,) if isinstance(v, str) else v)] = Field(
        description="signal of the DBC, or several that are added", min_length=1
    )
    unit: str = Field(description=f"unit after factor and offset, one of {', '.join(UNITS)}")
    factor: float = Field(default=1.0, description="unit per unit of the DBC's physical value")
    offset: float = Field(default=0.0, description="added after the factor [unit]")
    sign: SignBit | None = Field(
        default=None, description="signal that says the direction, where `signals` are a magnitude"
    )
    rolling_radius: float | None = Field(
        default=None, gt=0, lt=2, description="turns a wheel's speed over ground into its angular velocity [m]"
    )
    range: tuple[float, float] | None = Field(
        default=None, description="plausible values [unit]; replaces the ranges of the DBC"
    )
    standard_deviation: float | None = Field(default=None, gt=0, description="of the noise [SI]; for Imu messages")
    ignore_stated_unit: bool = Field(default=False, description="the unit that the DBC gives is wrong")
    valid: Valid | None = Field(default=None, description="when the value is believed")

    @model_validator(mode="after")
    def _consistent(self) -> Signal:
        if canonical(self.unit) not in UNITS:
            raise ValueError(f"unit {self.unit!r} is not known; known are {', '.join(UNITS)}")
        if self.factor == 0 or not math.isfinite(self.factor):
            raise ValueError(f"factor is {self.factor}, expected a finite number other than 0")
        if self.range is not None and self.range[0] >= self.range[1]:
            raise ValueError(f"range is {list(self.range)}, expected [lowest, highest]")
        if self.rolling_radius is not None and self.si_unit != "m/s":
            raise ValueError(f"rolling_radius needs a unit of speed over ground (m/s, km/h, mph), found {self.unit!r}")
        return self

    @property
    def si_unit(self) -> str:
        """SI unit before a rolling radius is applied."""
        return next(iter(QUANTITIES[quantity_of(self.unit) or "number"]))

    @property
    def to_si(self) -> float:
        """Size of the unit in SI."""
        return to_si(self.unit)

    @property
    def output_unit(self) -> str:
        """SI unit of the value in the message."""
        return "rad/s" if self.rolling_radius is not None else self.si_unit


class Output(Part):
    """What outputs of all kinds have."""

    topic: str = Field(min_length=1, description="topic of the message that is made")
    message: str = Field(description="message of the DBC, or NAME@0x123 where several have one name")
    valid: Valid | None = Field(default=None, description="when all of its values are believed")

    @property
    def message_kind(self) -> str:
        """Type of the messages that are made."""
        raise NotImplementedError

    def named_signals(self) -> dict[str, Signal]:
        """Signals by the name of the value that each gives."""
        raise NotImplementedError
