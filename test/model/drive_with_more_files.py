"""Drive with files that are no part of the package: `python drive_with_more_files.py PACKAGE FOLDER VEHICLE`.

The folder counts as part of the package (`vsense_ros.model.tyres`, say), as if its files lay there; so this is a
process of its own. Drives for two seconds from 20 m/s, with a small steering angle and no torques, and prints speed
[m/s] and yaw rate [rad/s] at the end as JSON.
"""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec, module_from_spec
from pathlib import Path

import numpy as np

STEP, STEPS = 0.005, 400


def add_files(package: str, folder: str) -> None:
    """Load a package with one more folder of files."""
    spec = find_spec(package)
    spec.submodule_search_locations.append(folder)
    sys.modules[package] = module = module_from_spec(spec)
    spec.loader.exec_module(module)


def drive(vehicle_file: Path) -> dict[str, float]:
    from vsense_ros.files.vehicle import load_vehicle
    from vsense_ros.model.car.car import car_of
    from vsense_ros.model.coordinates import DISTURBANCES, INPUTS, SPEED_X, STEERING, YAW_RATE
    from vsense_ros.model.simulation.closed_loop import rolling_straight
    from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop

    vehicle = load_vehicle(vehicle_file)
    inputs = np.zeros((STEPS, len(INPUTS)))
    inputs[:, STEERING] = 0.002
    driven = Inputs(STEP, inputs, np.zeros((STEPS, len(DISTURBANCES))))
    u = OpenLoop(car_of(vehicle), 1).run(*rolling_straight(vehicle, 20.0), driven, vehicle.parameter_vector()).u
    return {"speed": float(u[-1, SPEED_X]), "yaw_rate": float(u[-1, YAW_RATE])}


if __name__ == "__main__":
    add_files(sys.argv[1], sys.argv[2])
    print(json.dumps(drive(Path(sys.argv[3]))))
