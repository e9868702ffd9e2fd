"""A lane change of a car, and the observer that has followed it: fixtures of several folders of tests."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from drives import feed, messages
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner

VEHICLES = Path(__file__).parents[1] / "config/vehicles"


@pytest.fixture(scope="session")
def plant() -> Vehicle:
    return load_vehicle(VEHICLES / "prototype_real.yaml")


@pytest.fixture(scope="session")
def vehicle(plant: Vehicle) -> Vehicle:
    """The observer's car: lighter and on a better road than the one that drives."""
    return load_vehicle(VEHICLES / "prototype_model.yaml")


@pytest.fixture(scope="session")
def lane_change() -> Recording:
    """12 s: IMU at 250 Hz, wheel speeds and steering at 100 Hz, GNSS at 10 Hz 0.1 s late; with the truth."""
    return _generated()


@cache
def _generated() -> Recording:
    """Once for the fixtures of all folders."""
    return generate("double_lane_change", load_vehicle(VEHICLES / "prototype_real.yaml"), seed=1)


@pytest.fixture(scope="session")
def clean(lane_change: Recording, vehicle: Vehicle) -> Runner:
    """The observer after the undisturbed drive."""
    return feed(Runner(vehicle, lane_change.map_origin), messages(lane_change))
