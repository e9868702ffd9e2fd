"""The generated bags of the repository: which manoeuvres, which car, which seed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from vsense_ros.bag import write_bag
from vsense_ros.files.installed import shared_folder
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import IN_BAGS, generate
from vsense_ros.model.vehicle import Vehicle

SEED = 2020
LARGEST = 1_500_000  # [byte] of a bag's file


def plant() -> Vehicle:
    """The car that drives the manoeuvres."""
    return load_vehicle(shared_folder("config") / "vehicles" / "prototype_real.yaml")


def write_bags(out: Path, vehicle: Vehicle, seed: int = SEED) -> Iterator[Path]:
    """Generate what stands in bags/ into `out/<name>`, replacing what stands there; yields each bag when written."""
    for manoeuvre in IN_BAGS:
        path = out / manoeuvre.name
        write_bag(path, generate(manoeuvre.name, vehicle, seed), overwrite=True)
        yield path
