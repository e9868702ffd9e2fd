"""Drive with the tyres of another folder: `python drive_with_more_tyres.py FOLDER VEHICLE`, a process of its own.

The folder counts as part of `vsense_ros/model/tyres`, as if its files lay there. Prints the yaw rate [rad/s] after two
seconds of a small steering angle at 20 m/s.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec, module_from_spec
from pathlib import Path

import numpy as np

STEP, STEPS = 0.005, 400


def add_tyres(folder: str) -> None:
    """Load the package of tyres with one more folder of files."""
    spec = find_spec("vsense_ros.model.tyres")
    spec.submodule_search_locations.append(folder)
    sys.modules[spec.name] = module = module_from_spec(spec)
    spec.loader.exec_module(module)


def yaw_rate(vehicle_file: Path) -> float:
    from vsense_ros.files.vehicle import load_vehicle
    from vsense_ros.model.car.car import car_of
    from vsense_ros.model.coordinates import DISTURBANCES, INPUTS, STEERING, YAW_RATE
    from vsense_ros.model.simulation.closed_loop import rolling_straight
    from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop

    vehicle = load_vehicle(vehicle_file)
    inputs = np.zeros((STEPS, len(INPUTS)))
    inputs[:, STEERING] = 0.002
    driven = Inputs(STEP, inputs, np.zeros((STEPS, len(DISTURBANCES))))
    motion = OpenLoop(car_of(vehicle), 1).run(*rolling_straight(vehicle, 20.0), driven, vehicle.parameter_vector())
    return float(motion.u[-1, YAW_RATE])


if __name__ == "__main__":
    add_tyres(sys.argv[1])
    print(yaw_rate(Path(sys.argv[2])))
