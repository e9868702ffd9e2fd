from __future__ import annotations

from pathlib import Path

import pytest

from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.vehicle import Vehicle

VEHICLES = Path(__file__).parents[2] / "config/vehicles"


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    """The prototype, with its linkages."""
    return load_vehicle(VEHICLES / "prototype_real.yaml")
