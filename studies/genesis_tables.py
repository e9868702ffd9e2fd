"""Tables of the Genesis: how well the observer did on the third lap, and what was identified from the two others."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees

from rich.console import Console

from studies.coverage import coverage_table
from studies.genesis import FREE_PARAMETERS, IDENTIFIED_FROM, Examination
from studies.side_slip_fit import SideSlipFit
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.identification.parameter_set import of_vehicle
from vsense_ros.model.vehicle import Vehicle


def show_examination(found: Examination, console: Console) -> None:
    """Print the side slip of each case by all of the lap, after the transient of the reference and without it; then
    errors and standard deviations of all signals."""
    rows = []
    for case, whole in found.whole.items():
        parts = [one[case].scores for one in (found.whole, found.settled, found.without_transient)]
        slips = [f"{degrees(scores['side_slip'].rmse):.3f}" for scores in parts]
        rows.append((case, *slips, f"{whole.scores['lateral_velocity'].nrmsd_percent:.3f}"))
    for formula, scores in found.formulas.items():
        rows.append(
            (formula, f"{degrees(scores['side_slip'].rmse):.3f}", "", "",
             f"{scores['lateral_velocity'].nrmsd_percent:.3f}")
        )  # fmt: skip
    headings = (
        "case", "side slip RMSE\nwhole [°]", f"after {found.transient.over:.0f} s\n[°]", "without the\ntransient [°]",
        "lateral velocity\nNRMSD [%]",
    )  # fmt: skip
    _show(console, headings, rows)
    console.print(f"Fitted {found.transient}.\n")
    after = f"after {found.transient.over:.0f} s"
    console.print(coverage_table(found.whole, "case"))
    console.print(f"\nThe same {after}:")
    console.print(coverage_table({name: one for name, one in found.settled.items() if name != "outage"}, "case"))


def show_identification(start: Vehicle, fit: SideSlipFit, console: Console) -> None:
    """Print each identified number, and the error of the side slip on each lap, before and after."""
    cars = (start, fit.vehicle)
    values = [of_vehicle(car).values for car in cars]
    numbers = [(one.name, *(f"{one.value(of_car):.4g}" for of_car in values)) for one in FREE_PARAMETERS]
    yaw = ("mounting angle of the reference", *(f"{car.reference.yaw:.4g}" for car in cars))
    errors = [
        (f"side slip RMSE on {name} [°]", *(f"{degrees(error):.3f}" for error in pair))
        for name, *pair in zip(IDENTIFIED_FROM, fit.before, fit.after, strict=True)
    ]
    _show(console, ("identified", "start", "found"), [*numbers, yaw, *errors])


def _show(console: Console, headings: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> None:
    table = plain_table(*headings, right=headings[1:])
    for row in rows:
        table.add_row(*row)
    console.print(table)
