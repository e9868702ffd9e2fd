from __future__ import annotations

from pathlib import Path

import pytest

from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.vehicle import Vehicle


@pytest.fixture(scope="session")
def genesis() -> Vehicle:
    return load_vehicle(Path(__file__).parents[2] / "config/vehicles/genesis.yaml")
