"""A calibration for the terminal and as JSON."""

from __future__ import annotations

from typing import Any

from vsense_ros.prepare.calibration import Calibration


def as_dict(found: Calibration) -> dict[str, Any]:
    """Every quantity, and what to drive next."""
    return {
        "quantities": [
            {"name": one.name, "unit": one.unit, "before": one.before, "after": one.after, "deviation": one.deviation,
             "prior_deviation": one.prior, "determined": one.determined,
             "changes": {path: value for path, value, _ in one.written() if value is not None}}
            for one in found.quantities
        ],
        "missing": list(found.missing),
        "prediction": None if found.verdict is None else found.verdict.as_dict(),
        "refused": list(found.refused),
        "drive_next": list(found.advice),
    }  # fmt: skip
