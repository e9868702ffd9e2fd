"""The cars of the generated manoeuvres, loaded once."""

from __future__ import annotations

from pathlib import Path

import pytest

from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.vehicle import Vehicle

VEHICLES = Path(__file__).resolve().parents[2] / "config" / "vehicles"


@pytest.fixture(scope="session")
def plant() -> Vehicle:
    return load_vehicle(VEHICLES / "prototype_real.yaml")


@pytest.fixture(scope="session")
def model() -> Vehicle:
    return load_vehicle(VEHICLES / "prototype_model.yaml")
