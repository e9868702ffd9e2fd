from __future__ import annotations

from pathlib import Path

import pytest

from vsense_ros.model.vehicle import Vehicle
from vsense_ros.vehicle_file import load_vehicle


@pytest.fixture(scope="session")
def genesis() -> Vehicle:
    return load_vehicle(Path(__file__).parents[2] / "config/vehicles/genesis.yaml")
