"""Motions near a known one are those that a simulation in full has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from vsense_ros import codegen
from vsense_ros.model.car.car import car_of
from vsense_ros.model.coordinates import INPUTS, TORQUES
from vsense_ros.model.simulation.closed_loop import rolling_straight
from vsense_ros.model.simulation.differences import Differences
from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop, Run

pytestmark = pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE other than 0")

STEPS, STEP = 1201, 0.005
# Of lanes that a secant may change by: what it is made of besides.
CHANGES = {
    "heavier": {"chassis.mass": 1.03},
    "stiffer in front": {"front.cornering_scale": 1.05},
    "less grip": {"rear.grip_scale": 0.95},
    "higher": {"chassis.cog_height": 1.05},
    "smaller wheels": {"front.unloaded_radius": 0.998, "rear.unloaded_radius": 0.998},
}


def driven(vehicle, speed: float) -> Run:
    """A slalom in which the car is driven and then braked."""
    middle = (np.arange(STEPS) + 0.5) * STEP
    inputs = np.zeros((STEPS, len(INPUTS)))
    inputs[:, 0] = 0.03 * np.sin(2.5 * middle)
    inputs[:, TORQUES] = (-65.0 - 185.0 * np.tanh((middle - 3.0) / 0.4))[:, None]
    return Run(
        *rolling_straight(vehicle, speed), Inputs(STEP, inputs, np.zeros((STEPS, 7))), vehicle.parameter_vector()
    )


@pytest.fixture(scope="module")
def loop(vehicle):
    return OpenLoop(car_of(vehicle), keep=2, renew=8)


@pytest.fixture(scope="module")
def known(vehicle, loop):
    run = driven(vehicle, 20.0)
    return Differences(loop).known([run], loop.runs([run]))[0]


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_car_with_other_parameters_goes_where_it_goes_in_full(vehicle, loop, known, change):
    values = vehicle.values()
    other = vehicle.with_parameters({name: values[name] * factor for name, factor in change.items()})
    run = replace(known.run, parameters=other.parameter_vector())
    _is_that_of_a_simulation(loop, known, run)


def test_a_car_that_is_steered_otherwise_on_another_road_goes_where_it_goes_in_full(loop, known):
    inputs = known.run.inputs.inputs.copy()
    inputs[:, 0] *= 1.05
    around = known.run.inputs.disturbances.copy()
    around[:, :2] += 0.01
    run = replace(known.run, inputs=replace(known.run.inputs, inputs=inputs, disturbances=around))
    _is_that_of_a_simulation(loop, known, run)


def test_a_car_that_a_torque_holds_at_a_speed_goes_where_it_goes_in_full(vehicle, loop):
    run = driven(vehicle, 15.0)
    target = 15.0 / 0.3 + np.linspace(0.0, 5.0, STEPS)
    held = replace(run, inputs=replace(run.inputs, target=target, gain=np.full((STEPS, 4), 150.0)))
    known = Differences(loop).known([held], loop.runs([held]))[0]
    faster = replace(held, inputs=replace(held.inputs, target=target + 0.3))
    _is_that_of_a_simulation(loop, known, faster)


def test_a_car_on_ice_that_a_torque_holds_at_a_speed_goes_where_it_goes_in_full(vehicle, loop):
    """Wheels without grip follow such a torque faster than a row lasts."""
    icy = vehicle.with_parameters({"front.grip_scale": 0.1, "rear.grip_scale": 0.1})
    run = driven(icy, 15.0)
    inputs = run.inputs.inputs.copy()
    inputs[:, TORQUES] = 0.0
    gain = np.full((STEPS, 4), icy.physics.chassis.mass * 0.3**2 / 4 / 0.15)
    held = replace(run, inputs=replace(run.inputs, inputs=inputs, target=np.full(STEPS, 15.0 / 0.3), gain=gain))
    known = Differences(loop).known([held], loop.runs([held]))[0]
    steered = inputs.copy()
    steered[:, 0] *= 1.02
    _is_that_of_a_simulation(loop, known, replace(held, inputs=replace(held.inputs, inputs=steered)))


def _is_that_of_a_simulation(loop, known, run) -> None:
    """What a run changes in velocities of the known motion is what it changes in full, within a twentieth, or a few
    ten-thousandths of the motion. The first second does not count, in which a car comes to rest on its springs."""
    (near,), (whole,) = Differences(loop).motions(known, [run]), loop.runs([run])
    settled = known.motion.t > 1.0
    missed, changed, size = (
        np.linalg.norm(velocities[settled], axis=0)
        for velocities in (near.u - whole.u, whole.u - known.motion.u, known.motion.u)
    )
    assert (missed < 0.05 * changed + 2e-4 * size).all(), (missed, changed, size)


def test_the_known_run_itself_has_the_known_motion(loop, known):
    (near,) = Differences(loop).motions(known, [known.run])
    for name in ("q", "u", "udot"):
        assert_allclose(getattr(near, name), getattr(known.motion, name), atol=1e-9)
