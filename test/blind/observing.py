"""How the observer fares with what the tool has named, on the held-out recordings of a case: with the vehicle file that
the tool was given, with other noise levels alone, and with the extended file, as `vsense explain` compares them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.mismatch.answer_schema import ObserverComparison
from vsense_ros.mismatch.explain import EXTENDED
from vsense_ros.mismatch.observed import comparison
from vsense_ros.mismatch.spoilt import without_spoilt

OBSERVED = "observer.json"


@dataclass(frozen=True)
class Observed:
    """How it fares."""

    improved: bool  # as the tool's report has it
    rises: float  # of the log-likelihood per held-out message, with the extended file [nat]
    fault: str = ""  # why the observer could not be run

    @property
    def likelier(self) -> bool:
        """True if held-out measurements are likelier with the extended file."""
        return not self.fault and self.rises > 0


def observe(case: Path, report: Path) -> None:
    """Run the observer on a case whose answer in `report` has an extended file; what is there is kept."""
    if not (report / EXTENDED).exists() or (report / OBSERVED).exists():
        return
    files = json.loads((case / "case.json").read_text(encoding="utf-8"))
    train, held_out = ([import_recording(case / name) for name in files[role]] for role in ("train", "held_out"))
    vehicle, extended = (load_vehicle(path) for path in (case / "vehicle.yaml", report / EXTENDED))
    try:
        compared, _ = comparison(train, held_out, without_spoilt(train, vehicle), vehicle, extended)
        kept: dict[str, Any] = {"observer": compared.as_json(), "fault": ""}
    except (InputError, FloatingPointError) as error:
        kept = {"observer": None, "fault": str(error)}
    (report / OBSERVED).write_text(json.dumps(kept), encoding="utf-8")


def observed(report: Path) -> Observed | None:
    """What `observe` has left in a folder, if there is something."""
    try:
        kept = json.loads((report / OBSERVED).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    if kept["observer"] is None:
        return Observed(improved=False, rises=0.0, fault=kept["fault"])
    found = ObserverComparison.model_validate(kept["observer"])
    return Observed(found.improved, found.extended.log_likelihood - found.as_it_was.log_likelihood)
