"""The vehicle files of the cases: with no errors drawn, the tool's own model drives as the plants do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is one of the plants: make venv installs it")

from blind import cars, courses, knobs, vehicle_file
from blind.cars import CARS
from blind.plants import mujoco_tree
from blind.plants.log import PERIOD
from blind.sensors import Mounting
from blind.tyres import FORMULAS, mixed
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate

MOUNTING = Mounting((0.2, 0.0, -0.1), (-0.3, 0.0, 0.9))
NO_ERRORS = dict.fromkeys(vehicle_file.drawn_errors(np.random.default_rng(0)), 1.0)
COURSES = (
    replace(courses.steering_sweep(24.0, 3.0), duration=8.0),
    replace(courses.slalom(18.0, 6.0), duration=9.0),
    replace(courses.brake_in_turn(20.0, 4.0, 3.5), duration=9.0),
    replace(courses.coast_down(30.0), duration=5.0),
)


@pytest.fixture(scope="module")
def drives():
    """Drives of the saloon by tyre formula and course, on the plant."""
    lanes = [(formula, course) for formula in FORMULAS for course in COURSES]
    log = mujoco_tree.simulate(
        cars.side_by_side([CARS[1]] * len(lanes)),
        knobs.side_by_side([{}] * len(lanes)),
        [course for _, course in lanes],
        mixed([formula for formula, _ in lanes]),
    )
    return {(formula, course.name): log.lane(i, course.duration) for i, (formula, course) in enumerate(lanes)}


@pytest.mark.exam
@pytest.mark.timeout(900)
@pytest.mark.parametrize("model", ["tmeasy", "magic_formula"])
@pytest.mark.parametrize("formula", FORMULAS)
def test_a_file_without_errors_lets_the_tools_model_drive_as_the_plant(drives, formula, model, tmp_path):
    vehicle_file.write(tmp_path / "car.yaml", CARS[1], formula, model, MOUNTING, "automotive", NO_ERRORS)
    vehicle = load_vehicle(tmp_path / "car.yaml")
    for course in COURSES:
        lane = drives[formula, course.name]
        times = np.arange(len(lane["spin"])) * PERIOD

        def inputs(t, q, u, lane=lane, times=times):
            angle = np.interp(t, times, lane["handwheel"][:, 0]) / CARS[1].ratio
            return np.array([angle, *(np.interp(t, times, torque) for torque in lane["torque"].T)])

        q, u = rolling_straight(vehicle, lane["velocity"][0, 0])
        step = 0.001
        driven = simulate(vehicle, inputs, course.duration, step=step, keep_every=round(PERIOD / step), q=q, u=u)
        for name, theirs, ours, floor in (
            ("speed", lane["velocity"][:, 0], driven.u[:, 0], 0.3),
            ("yaw rate", lane["rates"][:, 2], driven.u[:, 5], 0.02),
            ("roll rate", lane["rates"][:, 0], driven.u[:, 3], 0.02),
            ("lateral velocity", lane["velocity"][:, 1], driven.u[:, 1], 0.1),
            ("rear wheel", lane["spin"][:, 2], driven.u[:, 12], 1.0),
        ):
            wrong = np.sqrt(np.mean((theirs - ours) ** 2)) / max(np.std(theirs), floor)
            assert wrong < 0.12, (course.name, name, wrong)


def test_a_file_can_be_silent_of_sensors_and_is_the_same_otherwise(tmp_path):
    known, silent = tmp_path / "car.yaml", tmp_path / "silent.yaml"
    vehicle_file.write(known, CARS[0], "brush", "tmeasy", MOUNTING, "simple", NO_ERRORS)
    vehicle_file.without_sensors(known, silent, ["wheel_torques", "gnss_position"])
    had, has = load_vehicle(known), load_vehicle(silent)
    assert had.physics == has.physics
    silenced = {name for name, sensor in had.sensors.items() if sensor.kind in ("wheel_torques", "gnss_position")}
    assert len(silenced) == 2
    assert has.sensors == {name: sensor for name, sensor in had.sensors.items() if name not in silenced}
    with pytest.raises(ValueError, match="no sensor sonar; there are gnss_position"):
        vehicle_file.without_sensors(known, silent, ["sonar"])
