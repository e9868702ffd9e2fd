"""Tables of the Genesis: how well the observer did on the third lap, and what was identified from the two others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees

from rich.console import Console

from studies.genesis import FREE_PARAMETERS, IDENTIFIED_FROM
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.identify.parameter_set import of_vehicle
from vsense_ros.identify.side_slip import SideSlipFit
from vsense_ros.model.vehicle import Vehicle


def show_examination(results: Mapping[str, Mapping[str, float]], console: Console) -> None:
    """Print the figures of each case."""
    rows = [(name, *(f"{figure:.3f}" for figure in figures.values())) for name, figures in results.items()]
    _show(console, ("case", "side slip RMSE [°]", "lateral velocity NRMSD [%]"), rows)


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
