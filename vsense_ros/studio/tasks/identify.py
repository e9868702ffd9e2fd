"""Parameters of a car from the recordings of the project."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import vsense_ros as vs
from vsense_ros.api.identification import write_identification
from vsense_ros.identification.identified import unit_of
from vsense_ros.studio.tasks.data import recordings_of


def identify(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Identify a car; writes vehicle.yaml, report.html and identification.json as the command does."""
    drives, proof = recordings_of(options["recordings"]), recordings_of(options["held_out"])
    identification = vs.identify(drives, options["vehicle"], model=options["model"], hold_out=proof, progress=progress)
    write_identification(identification, folder)
    files = {"vehicle": str(folder / "vehicle.yaml"), "report": "report.html"}
    estimated = identification.information
    names = estimated.names
    refused = {refusal.name for refusal in identification.refused}
    rows = [
        {
            "name": name, "before": identification.start[name], "after": float(value), "deviation": float(deviation),
            "unit": unit_of(name), "determined": name not in refused and name in identification.free,
            "of_sensor": name not in identification.free,
        }
        for name, value, deviation in zip(names, estimated.values, estimated.deviations, strict=True)
    ]  # fmt: skip
    passes = [
        [identification.start[name] for name in names],
        *(one.values.tolist() for one in identification.rinsed.passes),
    ]
    return {
        **files,
        "rows": rows,
        "passes": passes,
        "fits": identification.fits,
        "held_out": list(identification.held_out),
        "side_slip": identification.side_slip,
        "sentences": identification.sentences(),
    }
