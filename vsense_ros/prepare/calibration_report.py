"""A calibration for the terminal and as JSON."""

from __future__ import annotations

from typing import Any

from vsense_ros.prepare.calibration import Calibration


def as_dict(calibration: Calibration) -> dict[str, Any]:
    """Every quantity, and what to drive next."""
    return {
        "quantities": [
            {"name": quantity.name, "unit": quantity.unit, "before": quantity.before, "after": quantity.after,
             "deviation": quantity.deviation, "prior_deviation": quantity.prior, "determined": quantity.determined,
             "changes": {path: value for path, value, _ in quantity.written() if value is not None}}
            for quantity in calibration.quantities
        ],
        "missing": list(calibration.missing),
        "prediction": None if calibration.verdict is None else calibration.verdict.as_dict(),
        "refused": list(calibration.refused),
        "drive_next": list(calibration.advice),
    }  # fmt: skip
