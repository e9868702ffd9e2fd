"""How well the polynomials of a suspension follow its linkages, as a table."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Console

from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.model.schema.suspension_tables import SuspensionTables

ANGLES = ("camber", "toe", "caster")


def show(tables: SuspensionTables, errors: Mapping[str, Mapping[str, float]], console: Console) -> None:
    """Print coefficients and largest error [m or rad] of each quantity of each axle."""
    numbers = ("coefficients", "largest error")
    table = plain_table("axle", "quantity", *numbers, right=numbers)
    for axle, columns in errors.items():
        for name, error in columns.items():
            count = sum(c != 0 for row in getattr(getattr(tables, axle), name) for c in row)
            unit = "µrad" if name in ANGLES else "µm"
            table.add_row(axle, name, str(count), f"{1e6 * error:.1f} {unit}")
    console.print(table)
