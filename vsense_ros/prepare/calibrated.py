"""One calibrated quantity, and how it enters a vehicle file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import hypot
from typing import Any

from pydantic import ValidationError

from vsense_ros.errors import InputError
from vsense_ros.model.schema.uncertainty import Uncertainty
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibration_drive import CALIBRATION


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
        """True if the drives leave clearly less uncertain than there was before."""
        return self.deviation <= CALIBRATION.determined_share * self.prior

    @property
    def is_changed(self) -> bool:
        """True if the file gets a new value: one that is determined, and further from the present one than its own
        standard deviation, since a smaller correction is not significant. Numbers that are themselves standard
        deviations change in any case."""
        deviations = [change.deviation for change in self.changes.values()]
        if not (self.determined and deviations):
            return False
        return not any(deviations) or abs(self.after - self.before) > self.deviation

    def written(self) -> Iterator[tuple[str, float | None, float]]:
        """Numbers of the file that a determined quantity changes: path, new value (None: it stays) and standard
        deviation (0 for a number that is itself one)."""
        for path, change in self.changes.items() if self.determined else ():
            if self.is_changed:
                yield path, change.value, change.deviation
            else:
                shift = change.deviation * (self.after - self.before) / self.deviation
                yield path, None, hypot(change.deviation, shift)


def apply(vehicle: Vehicle, quantities: Iterable[Calibrated], source: str) -> Vehicle:
    """The vehicle with the determined quantities, and their standard deviations and `source` as its uncertainty.

    A value that agrees with the file within its own standard deviation stays as it is, with that deviation.

    Raises `InputError` where there can be no such car.
    """
    document = vehicle.model_dump(mode="json")
    for path, value, deviation in (number for quantity in quantities for number in quantity.written()):
        if value is not None:
            _put(document, path, value)
        if deviation > 0:
            stated = Uncertainty(deviation=float(f"{deviation:.2g}"), source=source)
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
