"""What the simplified car leaves out: the car with all its bodies beside those with 14 degrees of freedom.

Each drives the generated manoeuvres with the same driver. The full car has links and uprights with masses of their own
that swing; the simplified one lumps them into hubs, which follow its suspension tables or go along straight guides.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.manoeuvre import STANDARD, Manoeuvre
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.coordinates import ROLL, SPEED_X, STEERING, YAW_RATE, Y
from vsense_ros.model.effects import Effects
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight, simulate
from vsense_ros.model.simulation.full_car import simulate_full_car
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

FULL, TABLES, GUIDES = "full car", "tables", "straight guides"
SIMPLIFIED = (TABLES, GUIDES)
FULL_STEP, SIMPLIFIED_STEP, KEPT = 0.002, 0.001, 0.01  # [s]
SLOWEST = 1.0  # [m/s] below it slip angles mean nothing


@dataclass(frozen=True)
class Signal:
    """Something both cars have: its name, its unit, and its values (n,) or (n, 4) in a trajectory."""

    name: str
    unit: str
    of: Callable[[Trajectory], Array]


def _slip_angle(motion: Trajectory) -> Array:
    angles = np.degrees(motion.wheels[:, 5])
    angles[motion.u[:, SPEED_X] < SLOWEST] = 0.0
    return angles


SIGNALS = (
    Signal("steering", "°", lambda motion: np.degrees(motion.inputs[:, STEERING])),
    Signal("lateral acceleration", "m/s²", lambda motion: motion.acceleration[:, Y]),
    Signal("yaw rate", "°/s", lambda motion: np.degrees(motion.u[:, YAW_RATE])),
    Signal("roll", "°", lambda motion: np.degrees(motion.q[:, ROLL])),
    Signal("camber of the wheels to the road", "°", lambda motion: np.degrees(motion.wheels[:, 6])),
    Signal("slip angle of the wheels", "°", _slip_angle),
    Signal("longitudinal tyre force", "N", lambda motion: motion.wheels[:, 0]),
    Signal("lateral tyre force", "N", lambda motion: motion.wheels[:, 1]),
    Signal("vertical tyre force", "N", lambda motion: motion.wheels[:, 2]),
)


@dataclass(frozen=True)
class Comparison:
    """One manoeuvre with the three cars."""

    manoeuvre: Manoeuvre
    motions: dict[str, Trajectory]

    def error(self, signal: Signal, car: str) -> Array:
        """Simplified minus full, shaped like the signal."""
        return signal.of(self.motions[car]) - signal.of(self.motions[FULL])

    def rmse(self, signal: Signal, car: str) -> float:
        """Over the whole manoeuvre and all wheels [the signal's unit]."""
        return float(np.sqrt(np.mean(self.error(signal, car) ** 2)))

    def largest(self, signal: Signal) -> float:
        """Largest magnitude in the full car."""
        return float(np.abs(signal.of(self.motions[FULL])).max())


def compare(
    vehicle: Vehicle, manoeuvres: tuple[Manoeuvre, ...] = STANDARD, progress: Callable[[float], None] | None = None
) -> Iterator[Comparison]:
    """Each manoeuvre with the three cars, of a vehicle that has linkages and suspension tables."""
    if vehicle.suspension is None or vehicle.linkage is None:
        missing = "suspension" if vehicle.suspension is None else "linkage"
        raise InputError(
            f"vehicle {vehicle.name!r} has no section `{missing}`; the comparison needs linkages and the tables that "
            "`vsense suspension` makes from them"
        )
    whole = sum(manoeuvre.duration for manoeuvre in manoeuvres)
    driven = 0.0
    for manoeuvre in manoeuvres:
        yield Comparison(manoeuvre, drive(vehicle, manoeuvre))
        driven += manoeuvre.duration
        if progress is not None:
            progress(driven / whole)


def drive(vehicle: Vehicle, manoeuvre: Manoeuvre) -> dict[str, Trajectory]:
    """A manoeuvre with each of the three cars, at the same instants; without effects, which the full car lacks."""
    vehicle = vehicle.model_copy(update={"physics": vehicle.physics.model_copy(update={"effects": Effects()})})
    if manoeuvre.friction is not None:
        vehicle = vehicle.with_parameters({"road.friction": manoeuvre.friction})
    q, u = rolling_straight(vehicle, manoeuvre.speed)

    def full() -> Trajectory:
        return simulate_full_car(
            vehicle, manoeuvre.driver(vehicle), manoeuvre.duration,
            step=FULL_STEP, keep_every=round(KEPT / FULL_STEP), q=q, u=u,
        )  # fmt: skip

    def simplified(car: Vehicle) -> Trajectory:
        return simulate(
            car, manoeuvre.driver(vehicle), manoeuvre.duration,
            step=SIMPLIFIED_STEP, keep_every=round(KEPT / SIMPLIFIED_STEP), q=q, u=u,
        )  # fmt: skip

    guided = vehicle.model_copy(update={"suspension": None})
    return {FULL: full(), TABLES: simplified(vehicle), GUIDES: simplified(guided)}


def table(comparison: Comparison) -> str:
    """RMSE of each signal as a Markdown table, with the share of the largest value in the full car."""
    lines = ["| RMSE | " + " | ".join(SIMPLIFIED) + " | largest, full car |", "|---|---:|---:|---:|"]
    for signal in SIGNALS:
        largest = comparison.largest(signal)
        cells = []
        for car in SIMPLIFIED:
            rmse = comparison.rmse(signal, car)
            cells.append(f"{rmse:.2g} ({100 * rmse / largest:.2g} %)" if largest > 0 else f"{rmse:.2g}")
        lines.append(f"| {signal.name} [{signal.unit}] | {' | '.join(cells)} | {largest:.3g} |")
    return "\n".join(lines) + "\n"


def page(vehicle: Vehicle, comparisons: list[Comparison], pictures: dict[str, str]) -> str:
    """The document; `pictures` are their paths by manoeuvre, seen from it."""
    full = FullCar(vehicle).mechanism
    parts = [
        "# What the simplified car leaves out\n\n"
        f"The full car has {full.bodies} bodies: linkages with {full.constraints} constraints, struts, uprights. The "
        "simplified one has 9: its\n"
        "hubs are points, guided by the suspension's kinematics. Both have 14 degrees of freedom, the same tyres,\n"
        "springs and dampers. Here the same driver drives the generated manoeuvres in three cars:\n\n"
        f"- **{FULL}**: its linkages, solved in every step;\n"
        f"- **{TABLES}**: the simplified car on suspension tables, made from these linkages by `vsense suspension`;\n"
        f"- **{GUIDES}**: the simplified car without tables: each wheel travels upright along a line for the roll\n"
        "  centre that the vehicle file gives, and does not steer as it travels; the front wheels follow Ackermann.\n\n"
        "What is left with tables is what they cannot hold: links that swing instead of moving with the hub, the\n"
        "inertia of uprights, the speed of the rack; and that the two integrators differ, with steps of\n"
        f"{1e3 * FULL_STEP:g} and {1e3 * SIMPLIFIED_STEP:g} ms. A driver who follows a path or keeps a speed makes up\n"
        "for some differences: look at the steering too. The slip angle holds what toe does. Where the car is\n"
        "about to spin, as at the end of braking in a turn, small differences grow. RMSE is over the whole\n"
        "manoeuvre and all wheels, in brackets as a share of the largest value in the full car.\n\n"
        f"Vehicle: {vehicle.name}. This page and its pictures are made by `python -m studies simplification`.\n"
    ]
    for comparison in comparisons:
        manoeuvre = comparison.manoeuvre
        parts.append(
            f"## {manoeuvre.title}\n\n{manoeuvre.source}.\n\n{table(comparison)}\n"
            f"![{manoeuvre.title}: the three cars, and the differences from the full one]({pictures[manoeuvre.name]})\n"
        )
    return "\n".join(parts)


def write(vehicle: Vehicle, out: Path, progress: Callable[[float], None] | None = None) -> Path:
    """Write the document and its pictures into a folder; returns the document."""
    from studies.simplification_picture import draw

    folder = out / "simplification"
    folder.mkdir(parents=True, exist_ok=True)
    comparisons, pictures = [], {}
    for comparison in compare(vehicle, progress=progress):
        name = comparison.manoeuvre.name
        draw(comparison, folder / f"{name}.png")
        pictures[name] = f"simplification/{name}.png"
        comparisons.append(comparison)
    document = out / "simplification.md"
    document.write_text(page(vehicle, comparisons, pictures), encoding="utf-8")
    return document
