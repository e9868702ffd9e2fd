"""`vsense check` on files with planted mistakes, and `vsense can` on databases of many makers."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ruamel.yaml import YAML

from studies import can_survey
from vsense_ros.files.installed import shared_folder
from vsense_ros.prepare.vehicle_check import check_vehicle

MISTAKES = Path(__file__).parents[1] / "test" / "prepare"


def planted() -> dict[str, Any]:
    """How many of the planted mistakes are found with their key, and how many findings there are in files that have
    none: the shipped ones, and those made from catalogue values."""
    if str(MISTAKES) not in sys.path:
        sys.path.append(str(MISTAKES))
    mistakes = import_module("planted_mistakes")
    missed, false = [], 0
    with TemporaryDirectory() as temporary:
        path = Path(temporary) / "car.yaml"

        def written(tree: Any) -> Path:
            with path.open("w", encoding="utf-8") as file:
                YAML().dump(tree, file)
            return path

        for title, car, plant, key in mistakes.PLANTED:
            tree = mistakes.content(car)
            plant(tree)
            found = check_vehicle(written(tree))
            named = [one for finding in found.findings for one in finding.keys]
            if not (any(key in one for one in named) or key in found.refused):
                missed.append(title)
        for name in mistakes.GENERATED:
            false += len(check_vehicle(written(mistakes.content(name))).sentences())
    for path in sorted((shared_folder("config") / "vehicles").glob("*.yaml")):
        false += len(check_vehicle(path).sentences())
    of = len(mistakes.PLANTED)
    return {"found": of - len(missed), "of": of, "false": false, "missed": missed}


def buses(databases: Path) -> dict[str, Any]:
    """On how many cars of opendbc `vsense can` finds all signals that their databases have."""
    found = can_survey.examine(databases)
    return {"found": found["found"], "of": found["of"]}
