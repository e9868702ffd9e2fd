"""Plants and model, two derivations of the same car, asked for the same accelerations.

With the model's own tyre on the plant and the plant's parameters in the model nothing is left that may differ but the
mechanics: an effect that the tool finds on such a car is a fault of one of the two.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is one of the plants: make venv installs it")

from blind import cars, courses, knobs, vehicle_file
from blind.cars import CARS
from blind.plants import log, mujoco_tree, newton_euler
from blind.sensors import GRADES, Mounting
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.parameter import numbers

PLANTS = {"newton_euler": newton_euler.simulate, "mujoco_tree": mujoco_tree.simulate}
FORWARD = 20.0  # [m/s]: these tyres know slips, not speeds
COURSES = (
    replace(courses.slalom(22.0, 6.0), duration=4.0),
    replace(courses.brake_in_turn(22.0, 5.0, 3.0), duration=5.0),
)


def _model(car: cars.Car, folder: Path) -> tuple[Car, np.ndarray]:
    path = folder / "vehicle.yaml"
    exact = dict.fromkeys(vehicle_file.drawn_errors(np.random.default_rng(0)), 1.0)
    mounting = Mounting.drawn(np.random.default_rng(0))
    vehicle_file.write(path, car, "brush", "tmeasy", mounting, next(iter(GRADES)), exact)
    vehicle = load_vehicle(path)
    return car_of(vehicle), np.array([value for _, value in numbers(vehicle.physics)])


def _tyre_of(model: Car, parameters: np.ndarray, lanes: int):
    """The model's tyre in the form of the plants' formulas."""
    motions = ca.SX.sym("motions", 5, 4)
    forces = ca.Function("forces", [motions, model.p], [model.tyre_forces(motions)])
    mapped = forces.map(lanes)
    repeated = np.tile(parameters[:, None], lanes)

    def formula(tyre, kappa, alpha, load, friction):
        rows = np.stack([load, 0 * load + FORWARD, -np.tan(alpha) * FORWARD, FORWARD * (1 + kappa), 0 * load])
        by_lane = rows.transpose(0, 2, 1).reshape(5, -1)  # the four wheels of a lane beside each other
        found = np.array(mapped(by_lane, repeated)).reshape(4, lanes, 4)
        return found[0].T.copy(), found[1].T.copy()

    return formula


@pytest.mark.exam
@pytest.mark.parametrize("plant", PLANTS)
def test_a_plant_with_the_models_tyre_accelerates_as_the_model_does_where_it_is(plant, tmp_path):
    car = CARS[1]
    model, parameters = _model(car, tmp_path)
    batch = cars.side_by_side([car] * len(COURSES))
    nothing = knobs.side_by_side([{} for _ in COURSES])
    drive = PLANTS[plant](batch, nothing, list(COURSES), _tyre_of(model, parameters, len(COURSES)))
    asked = [model.q, model.u, model.force, model.disturbances, model.inputs, model.p]
    accelerations = ca.Function("accelerations", asked, [model.dynamics])
    level, none = np.zeros(model.disturbances.numel()), np.zeros(model.force.numel())
    for i, course in enumerate(COURSES):
        lane = drive.lane(i, course.duration)
        change = {name: (values[2:] - values[:-2]) / (2 * log.PERIOD) for name, values in lane.items()}
        plants, models = [], []
        for k in range(20, len(lane["spin"]) - 1, 4):
            turned = np.zeros(4)  # of the wheels: they are round
            q = np.concatenate([lane["position"][k], lane["angles"][k], lane["travel"][k], turned])
            u = np.concatenate([lane["velocity"][k], lane["rates"][k], change["travel"][k - 1], lane["spin"][k]])
            inputs = np.concatenate([lane["handwheel"][k] / car.ratio, lane["torque"][k]])
            found = np.array(accelerations(q, u, none, level, inputs, parameters)).ravel()
            models.append(np.concatenate([found[:6], found[10:]]))
            plants.append(np.concatenate([change[name][k - 1] for name in ("velocity", "rates", "spin")]))
        off = np.sqrt(np.mean((np.array(models) - plants) ** 2, axis=0))
        # What is left is how a tyre's aligning moment fades, each by its own formula, and 1 ms of the driver's torque.
        assert np.all(off[:3] < 0.01), (course.name, off)  # m/s²
        assert np.all(off[3:6] < 0.01), (course.name, off)  # rad/s²
        assert np.all(off[6:] < 0.8), (course.name, off)  # rad/s² of a wheel that brakes with 10
