"""The check of a vehicle file: can it be read, is it a car, and does it fit recordings?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vsense_ros.errors import InputError
from vsense_ros.evaluate.printable import Printable
from vsense_ros.files.vehicle import load_content, load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.car_check import CarFinding, check_car, check_document, in_words
from vsense_ros.prepare.recording_check import FitCheck, FitFinding, check_fit

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True, repr=False)
class VehicleCheck(Printable):
    """What was found in a vehicle file: the reason why it is no car (`refused`), or findings of one that is."""

    name: str
    vehicle: Vehicle | None
    findings: Sequence[CarFinding]
    refused: str = ""
    fit: Sequence[FitFinding] = ()
    not_compared: str = ""  # why the recordings could not be compared with the file

    @property
    def is_good(self) -> bool:
        """True if nothing was found."""
        return not (self.refused or self.findings or self.fit)

    def sentences(self) -> list[str]:
        """The findings, one sentence each."""
        of_fit = [f"{fit_finding.recording}: {fit_finding.sentence}" for fit_finding in self.fit]
        return [*self.refused.splitlines(), *(in_words(finding) for finding in self.findings), *of_fit]

    @property
    def title(self) -> str:
        """Name of the vehicle, and how much was found."""
        return f"{self.name}, {'nothing looks wrong' if self.is_good else f'{len(self.sentences())} findings'}"

    def show(self, out: Console) -> None:
        """Print what to look at, or that nothing looks wrong."""
        for sentence in self.sentences():
            out.print(f"Look at {sentence}{'' if sentence.endswith('?') else '.'}", soft_wrap=True)
        if self.not_compared:
            reason = f"The file was not compared with the sensors of the recordings. {self.not_compared}."
            out.print(reason, soft_wrap=True)
        if self.is_good:
            out.print(f"Nothing looks wrong with {self.name}.", soft_wrap=True)

    def as_dict(self) -> dict[str, Any]:
        """The findings as they are written to JSON."""
        return {
            "name": self.name,
            "refused": self.refused or None,
            "findings": [_as_dict(finding) for finding in self.findings],
            "fit": [asdict(finding) for finding in self.fit],
            "not_compared": self.not_compared or None,
        }


def check_vehicle(path: str | Path, recordings: Sequence[Recording] = ()) -> VehicleCheck:
    """Check a vehicle file, and whether it fits recordings. Raises `InputError` for one that is missing or no YAML."""
    content = load_content(path)
    try:
        vehicle = load_vehicle(path)
    except InputError as error:
        return VehicleCheck(Path(path).stem, None, check_document(content), str(error))
    return check_loaded(vehicle, recordings)


def check_loaded(vehicle: Vehicle, recordings: Sequence[Recording] = ()) -> VehicleCheck:
    """Check a vehicle that is one by its schema, and whether it fits recordings."""
    fit = check_fit(vehicle, recordings) if recordings else FitCheck(())
    return VehicleCheck(vehicle.name, vehicle, check_car(vehicle), fit=fit.findings, not_compared=fit.not_compared)


def _as_dict(finding: CarFinding) -> dict[str, Any]:
    return {
        "keys": list(finding.keys),
        "meant": finding.mistake.words if finding.mistake is not None else None,
        "figures": [
            {"name": feature.name, "place": feature.place, "value": feature.value, "unit": feature.limits.unit,
             "range": list(feature.limits.range), "source": feature.limits.source}
            for feature in finding.features
        ],
        "sentence": in_words(finding),
    }  # fmt: skip
