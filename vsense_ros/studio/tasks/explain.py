"""What the model of the car leaves out on the recordings of the project."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import vsense_ros as vs
from vsense_ros.errors import InputError
from vsense_ros.mismatch import design
from vsense_ros.studio.tasks.data import recordings_of


def explain(options: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, Any]:
    """Explain recordings; writes explain.json, report.html and, if an effect is named, vehicle.extended.yaml. For an
    ambiguous answer, the tests that would decide are designed as well."""
    drives, proof = recordings_of(options["recordings"]), recordings_of(options["held_out"])
    car = vs.load_vehicle(options["vehicle"])
    explanation = vs.explain(
        drives, car, hold_out=proof, by_lap=bool(options.get("by_lap")), mend=bool(options.get("mend")),
        observe=bool(options.get("observe", True)), progress=progress,
    )  # fmt: skip
    explanation.write(folder)
    refusal = ""
    if explanation.answer.verdict == "ambiguous":
        try:
            design.designed(folder, car, lambda share: None)
        except InputError as error:
            refusal = f"No test could be designed that decides between the explanations: {error}"
    extended = folder / "vehicle.extended.yaml"
    return {
        "answer": explanation.answer.as_json(),
        "vehicle": str(extended) if extended.exists() else "",
        "report": "report.html",
        "no_test": refusal,
    }
