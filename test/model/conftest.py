from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    """A passenger car with roll centres above the road, unlike axles and Ackermann steering."""
    return load_vehicle(Path(__file__).parents[1] / "data/saloon.yaml")


@pytest.fixture(scope="session")
def car(vehicle: Vehicle) -> Car:
    return car_of(vehicle)


@pytest.fixture(scope="session")
def driving(vehicle: Vehicle) -> Callable[[int], dict[str, Array]]:
    """Makes a random state of a driving car, its inputs and its disturbances, from a seed.

    All wheels touch the ground, loaded up to several times what they carry at rest; slips reach from free rolling to
    beyond the maximum of the force.
    """
    chassis = vehicle.physics.chassis

    def state(seed: int) -> dict[str, Array]:
        random = np.random.default_rng(seed)
        q, u = np.zeros(14), np.zeros(14)
        q[:2] = random.uniform(-500, 500, 2)
        q[2] = chassis.cog_height - random.uniform(0.02, 0.04)
        q[3:5] = random.uniform(-0.01, 0.01, 2)
        q[5] = random.uniform(-4, 4)
        q[6:10] = random.uniform(-0.01, 0.01, 4)
        q[10:14] = random.uniform(-100, 100, 4)
        u[0] = random.uniform(-5, 50)
        u[1] = random.uniform(-2, 2)
        u[2:6] = random.uniform(-0.5, 0.5, 4)
        u[6:10] = random.uniform(-0.3, 0.3, 4)
        u[10:14] = u[0] / 0.34 * random.uniform(0.8, 1.2, 4)
        return {
            "q": q,
            "u": u,
            "force": random.normal(size=14) * np.array([500] * 6 + [100] * 8),
            "disturbances": random.uniform(-1, 1, 7) * np.array([0.1, 0.05, 2e-3, 2e-3, 10.0, 0.02, 0.005]),
            "inputs": np.array([random.uniform(-0.5, 0.5), *random.uniform(-1500, 1500, 4), 0.0]),
            "p": vehicle.parameter_vector(),
            "internal_state": np.zeros(0),
        }

    return state
