"""Rear steering, beside the linear single-track model, and what a filter is without it."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

import vsense_ros as vs
from vsense_ros.errors import InputError
from vsense_ros.manoeuvre import drive, generate
from vsense_ros.manoeuvre.driver import SpeedKeeper
from vsense_ros.model.coordinates import YAW_RATE
from vsense_ros.model.sensors import RearSteering
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle

BEFORE = vs.load_vehicle("prototype_real")


def steered(*, rear: bool = True) -> Vehicle:
    """The prototype with rear steering, and a sensor of it."""
    physics = BEFORE.physics
    physics = physics.model_copy(update={"steering": physics.steering.model_copy(update={"rear": rear})})
    sensors = {**BEFORE.sensors, **({"rear": RearSteering()} if rear else {})}
    return BEFORE.model_copy(update={"physics": physics, "sensors": sensors})


def turned(front: float, rear: float, speed: float = 20.0, seconds: float = 5.0) -> Trajectory:
    """A car with both angles [rad] from the beginning."""
    car = steered()
    feet = SpeedKeeper(car, lambda t: speed)
    q, u = rolling_straight(car, speed)
    return simulate(car, lambda t, q, u: np.array([front, *feet(t, u), rear]), seconds, q=q, u=u, keep_every=10)


@pytest.mark.slow
@pytest.mark.parametrize(("front", "rear"), [(0.004, 0.002), (0.0, -0.002), (0.001, -0.001)])
def test_a_steady_turn_is_that_of_the_difference_of_both_angles_and_slips_by_the_rear_one(
    front: float, rear: float
) -> None:
    """A linear single track turns with ψ̇ = v (δ_f - δ_r) / (L + K v²) and slips by β = δ_r + (b - a m v² / (L C_r))
    (δ_f - δ_r) / (L + K v²): but for δ_r in β these are the gains of front steering alone."""
    motion, usual = turned(front, rear), turned(front - rear, 0.0)
    assert motion.u[-1, YAW_RATE] == pytest.approx(usual.u[-1, YAW_RATE], rel=0.005)
    assert motion.side_slip[-1] - usual.side_slip[-1] == pytest.approx(rear, rel=0.01)


@pytest.mark.slow
def test_equal_angles_of_both_axles_move_the_car_sideways_without_turning_it() -> None:
    motion = turned(0.01, 0.01, seconds=8.0)
    assert abs(motion.u[-1, YAW_RATE]) < 0.01 * abs(turned(0.01, 0.0).u[-1, YAW_RATE])
    assert motion.side_slip[-1] == pytest.approx(0.01, rel=1e-2)


@pytest.mark.slow
def test_an_observer_that_is_given_the_angle_knows_the_side_slip_of_a_car_with_rear_steering() -> None:
    recording = generate("rear_step_steer", steered())
    assert "vehicle/rear_steering" in recording
    with_angle, without = (vs.estimate(recording, car)["side_slip"].rmse for car in (steered(), steered(rear=False)))
    assert with_angle is not None
    assert without is not None
    assert np.degrees(with_angle) < 0.2
    assert without > 3 * with_angle


def test_cars_and_files_that_do_not_fit_are_refused_in_a_sentence() -> None:
    with pytest.raises(InputError, match="does not steer its rear wheels"):
        drive("rear_step_steer", BEFORE)
    content = BEFORE.model_dump()
    content["sensors"]["rear"] = {"kind": "rear_steering"}
    with pytest.raises(ValidationError, match="set it to true"):
        Vehicle.model_validate(content)
