"""Coast with the effects of another folder: `python drive_with_more_effects.py FOLDER VEHICLE TORQUE`, a process of its
own.

The folder counts as part of `vsense_ros/model/effects`, as if its files lay there. Prints the speed [m/s] after ten
seconds from 20 m/s under TORQUE [N m] at each wheel, and the parameters that the mismatch search would try.
"""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec, module_from_spec
from pathlib import Path

import numpy as np


def add_effects(folder: str) -> None:
    """Load the package of effects with one more folder of files."""
    spec = find_spec("vsense_ros.model.effects")
    spec.submodule_search_locations.append(folder)
    sys.modules[spec.name] = module = module_from_spec(spec)
    spec.loader.exec_module(module)


def coasted(vehicle_file: Path, torque: float) -> float:
    from vsense_ros.files.vehicle import load_vehicle
    from vsense_ros.model.car.car import car_of
    from vsense_ros.model.coordinates import INPUTS, TORQUES
    from vsense_ros.model.simulation.closed_loop import rolling_straight
    from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop

    vehicle = load_vehicle(vehicle_file)
    inputs = np.zeros((2000, len(INPUTS)))
    inputs[:, TORQUES] = torque
    recorded = Inputs(0.005, inputs, np.zeros((2000, 7)))
    drive = OpenLoop(car_of(vehicle), 1).run(*rolling_straight(vehicle, 20.0), recorded, vehicle.parameter_vector())
    return float(drive.u[-1, 0])


def searched() -> list[str]:
    from vsense_ros.mismatch.candidates import candidates

    return [str(candidate) for candidate in candidates()]


if __name__ == "__main__":
    add_effects(sys.argv[1])
    print(json.dumps({"speed": coasted(Path(sys.argv[2]), float(sys.argv[3])), "searched": searched()}))
