"""One calibrated quantity, and how it enters a vehicle file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from vsense_ros.errors import InputError
from vsense_ros.model.schema.uncertainty import Uncertainty
from vsense_ros.model.vehicle import Vehicle

# A quantity is determined if the drives leave no more of what was uncertain than this share.
DETERMINED_SHARE = 0.6


@dataclass(frozen=True)
class Change:
    """A new number of the file, and its standard deviation; 0 for a number that is itself a deviation."""

    value: float
    deviation: float = 0.0


@dataclass(frozen=True)
class Calibrated:
    """A quantity in words, with its unit, its value before and after, and its standard deviations before and after.

    `changes` are the numbers of the file that follow from it, by dotted path; `drive_next` says which driving would
    determine it.
    """

    name: str
    unit: str
    before: float
    after: float
    prior: float
    deviation: float
    changes: Mapping[str, Change]
    drive_next: str = ""

    @property
    def determined(self) -> bool:
        """True if the drives say so much of it that the file is changed."""
        return self.deviation <= DETERMINED_SHARE * self.prior


def apply(vehicle: Vehicle, quantities: Iterable[Calibrated], source: str) -> Vehicle:
    """The vehicle with the determined quantities, and their standard deviations and `source` as its uncertainty.

    Raises `InputError` where there can be no such car.
    """
    document = vehicle.model_dump(mode="json")
    for quantity in quantities:
        for path, change in quantity.changes.items() if quantity.determined else ():
            _put(document, path, change.value)
            if change.deviation > 0:
                stated = Uncertainty(deviation=float(f"{change.deviation:.2g}"), source=source)
                document["uncertainty"][path] = stated.model_dump()
    try:
        return Vehicle.model_validate(document)
    except ValidationError as error:
        message = str(error.errors()[0]["msg"]).removeprefix("Value error, ")
        raise InputError(f"{source} gives no car: {message}; run vsense check on the file") from None


def _put(document: Any, path: str, value: float) -> None:
    """Change a number in the content of a vehicle file; lists by index."""
    *parents, last = path.split(".")
    for key in parents:
        document = document[int(key)] if isinstance(document, list) else document[key]
    document[int(last) if isinstance(document, list) else last] = value
