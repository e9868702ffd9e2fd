"""The filters of GNSS and inertial sensors by name: what each estimates, and when to take which.

A new filter is a file with its `Definition`, and a line in `RECOMMENDED` (or a call of `add`).
"""

from __future__ import annotations

from functools import partial

from vsense_ros.estimation.catalogue import Catalogue, FilterFamily
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation import heading_bank, inertial, integrated, strapdown
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.reading_use import usable
from vsense_ros.navigation.space import Definition
from vsense_ros.navigation.thesis.catalogue import THESIS

# What a user chooses from: name → title, definition, when to take it.
RECOMMENDED: dict[str, tuple[str, Definition, str]] = {
    "heading_bank": (
        "heading by a bank of hypotheses",
        heading_bank.HEADING_BANK,
        "where the heading at start is not known and the course does not determine it yet",
    ),
    "inertial": (
        "planar INS that estimates the scale of its gyro and its distance from the rear axle",
        inertial.INERTIAL,
        "where nothing is known of the car: IMU and GNSS velocity",
    ),
    "integrated": (
        "single-track model with estimated tyre stiffness, GNSS, all sensors",
        integrated.INTEGRATED,
        "where the car is roughly known: no gates, side slip also at the limit",
    ),
    "strapdown": (
        "six-axis INS in error coordinates",
        strapdown.STRAPDOWN,
        "where the IMU has six axes, and attitude or position count",
    ),
}
DEFINITIONS: dict[str, tuple[str, Definition, str]] = {}
FILTERS = Catalogue()


def make(name: str, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> Aided:
    """The filter of this name for a vehicle, with those of its sensors that any filter here could use. Raises
    `InputError` where they cannot drive it."""
    usable_sensors = usable(sensors)
    return Aided(name, DEFINITIONS[name][1], car_numbers(vehicle, usable_sensors.values()), usable_sensors)


def add(name: str, title: str, definition: Definition, when: str, *, recommended: bool = True) -> None:
    """Let `--filter` take a filter by its name. Raises `ValueError` for a name that another filter has."""
    sensors = tuple(measurement.name for measurement in definition.measurements)
    make_named = partial(make, name)
    FILTERS.add(FilterFamily(name, title, definition.states, definition.inputs, sensors, when, make_named, recommended))
    DEFINITIONS[name] = (title, definition, when)


for _name, _entry in RECOMMENDED.items():
    add(_name, *_entry)
for _name, _entry in THESIS.items():
    add(_name, *_entry, recommended=False)
