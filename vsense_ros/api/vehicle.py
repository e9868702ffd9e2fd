"""Vehicles by name or file."""

from __future__ import annotations

from pathlib import Path

from vsense_ros.files import vehicle as vehicle_file
from vsense_ros.files.installed import vehicle_path
from vsense_ros.model.vehicle import Vehicle


def load_vehicle(vehicle: str | Path | Vehicle) -> Vehicle:
    """The vehicle of a YAML file, or one that comes with the project, by its name: `genesis`, `rav4`, …

    A `Vehicle` is returned as it is. Raises `InputError` for a name that is not known (with those that are), and for a
    file that is no vehicle (with line, key, and what is allowed there).
    """
    if isinstance(vehicle, Vehicle):
        return vehicle
    return vehicle_file.load_vehicle(vehicle_path(str(vehicle)))
