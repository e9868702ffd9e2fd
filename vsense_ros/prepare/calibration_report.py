"""A calibration for the terminal and as JSON."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.prepare.calibration import Calibration


def show(found: Calibration, out: Console) -> None:
    """Print a table of what changed, by how much and how sure that is, and what to drive next."""
    table = plain_table("quantity", "before", "after", "±", "unit", "", right=("before", "after", "±"))
    for one in found.quantities:
        stays = "agrees with the file, stays" if one.determined else "not determined, stays"
        after, words = (f"{one.after:.4g}", "") if one.is_changed else (f"({one.after:.4g})", stays)
        table.add_row(one.name, f"{one.before:.4g}", after, f"{one.deviation:.2g}", one.unit, words)
    out.print(table)
    for sentence in found.missing:
        out.print(sentence)
    for advice in found.advice:
        out.print(f"To drive next: {advice}.")


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
        "drive_next": list(found.advice),
    }  # fmt: skip
