"""The handling model of Best & Bogdanski (2016): conservation laws, symmetry, and its printed numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from vsense_ros.estimation.state_space import Named, expression
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.handling.best_4dof import PAPER, Best4Dof, roll_axis_height

MODEL = Best4Dof()
MASS = (PAPER["front_weight"] + PAPER["rear_weight"]) / GRAVITY


def named(states: np.ndarray, inputs: np.ndarray) -> tuple[Named, Named, Named]:
    p = ca.SX(np.array(list(PAPER.values())))
    return Named(ca.SX(states), MODEL.states), Named(ca.SX(inputs), MODEL.inputs), Named(p, MODEL.parameters)


def rates(states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    return np.array(ca.evalf(expression(MODEL.rates(*named(states, inputs)))))[:, 0]


def settled(steering: float, speed: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """The steady turn that the car comes to with wheels that keep their spin."""
    state, spin = np.zeros(13), np.full(4, speed / PAPER["wheel_radius"])
    state[0], inputs = speed, np.concatenate([[steering], spin])
    x, u = ca.SX.sym("x", 13), ca.SX.sym("u", 5)
    p = ca.SX(np.array(list(PAPER.values())))
    found = MODEL.rates(Named(x, MODEL.states), Named(u, MODEL.inputs), Named(p, MODEL.parameters))
    function = ca.Function("rates", [x, u], [expression(found)])
    for _ in range(6000):
        state = state + 0.002 * np.array(function(state, inputs))[:, 0]
    return state, inputs


def test_derived_quantities_are_those_that_follow_from_the_paper() -> None:
    assert pytest.approx(1855.5, rel=1e-3) == MASS
    assert PAPER["wheelbase"] * PAPER["rear_weight"] / (MASS * GRAVITY) == pytest.approx(1.380, abs=1e-3)
    assert roll_axis_height(PAPER) == pytest.approx(0.1013, abs=1e-4)


def test_in_a_steady_turn_the_wheel_loads_balance_the_moments_about_the_road() -> None:
    """c (F_zR - F_zL) = M a_y h_G + M g h φ: no roll acceleration, whichever way the loads are made."""
    state, inputs = settled(0.05)
    assert np.abs(rates(state, inputs)[[1, 2, 4]]).max() < 1e-6
    x, u, p = named(state, inputs)
    loads = [float(ca.evalf(load)) for load in MODEL.loads(x, u, p)]
    lateral = float(ca.evalf(expression(MODEL.measured(x, u, p)))[1])
    h = PAPER["cog_height"] - roll_axis_height(PAPER)
    moment = PAPER["half_track"] * (loads[1] + loads[3] - loads[0] - loads[2])
    assert lateral > 2.0
    assert state[3] > 0  # to the right in a left turn
    assert moment == pytest.approx(MASS * lateral * PAPER["cog_height"] + MASS * GRAVITY * h * state[3], rel=1e-4)


def test_the_car_turns_right_as_it_turns_left() -> None:
    random = np.random.default_rng(0)
    state = random.normal(size=13) * [3, 1, 0.3, 0.05, 0.2, *[1500] * 8] + [20, *[0] * 12]
    inputs = np.concatenate([[0.05], 60 + random.normal(size=4)])
    mirror = np.array([1, -1, -1, -1, -1, *[1] * 4, *[-1] * 4])
    swap = [0, 1, 2, 3, 4, 6, 5, 8, 7, 10, 9, 12, 11]
    other = rates((mirror * state)[swap], np.concatenate([[-0.05], inputs[[2, 1, 4, 3]]]))
    assert other == pytest.approx((mirror * rates(state, inputs))[swap], rel=1e-9, abs=1e-9)


def test_the_printed_longitudinal_equation_lacks_what_the_swinging_body_adds() -> None:
    state = np.zeros(13)
    state[[0, 2, 4]] = 20.0, 0.5, 0.3
    inputs = np.concatenate([[0.0], np.full(4, 60.0)])
    printed = Best4Dof(as_printed=True).rates(*named(state, inputs))[0]
    h = PAPER["cog_height"] - roll_axis_height(PAPER)
    assert float(ca.evalf(printed)) - rates(state, inputs)[0] == pytest.approx(h * 0.5 * 0.3, rel=1e-9)


def test_motion_is_that_of_lagrange_for_a_mass_that_swings_out() -> None:
    """Lagrange's equations in quasi-velocities (Meirovitch 1970, section 4.6), from the kinetic energy alone."""
    random = np.random.default_rng(4)
    h = PAPER["cog_height"] - roll_axis_height(PAPER)
    motion = ca.SX.sym("motion", 4)  # U, V, r, p
    roll, rate = ca.SX.sym("roll"), ca.SX.sym("rate", 4)
    ahead, left, yaw, rolling = ca.vertsplit(motion)
    about_axis = PAPER["roll_inertia"] - MASS * h**2  # the paper's is about the roll axis
    velocity = ca.vertcat(ahead + h * roll * yaw, left - h * rolling)
    energy = (MASS * ca.sumsqr(velocity) + PAPER["yaw_inertia"] * yaw**2 + about_axis * rolling**2) / 2
    momentum = ca.gradient(energy, motion)
    change = ca.jtimes(momentum, motion, rate) + ca.jacobian(momentum, roll) * rolling
    turned = ca.vertcat(-yaw * momentum[1], yaw * momentum[0], ahead * momentum[1] - left * momentum[0], 0)
    generalized = change + turned - ca.vertcat(0, 0, 0, ca.gradient(energy, roll))
    force = ca.Function("force", [motion, roll, rate], [generalized])
    for _ in range(5):
        state = random.normal(size=13) * [3, 1, 0.4, 0.08, 0.3, *[2000] * 8] + [20, *[0] * 12]
        inputs = np.concatenate([[0.05], 60 + random.normal(size=4)])
        x, u, p = named(state, inputs)
        along, across = (np.array([float(ca.evalf(f)) for f in each]) for each in MODEL.road_forces(x, u))
        loads = [float(ca.evalf(load)) for load in MODEL.loads(x, u, p)]
        to_front = PAPER["wheelbase"] * PAPER["rear_weight"] / (MASS * GRAVITY)
        half = PAPER["half_track"]
        about_road = to_front * across[:2].sum() - (PAPER["wheelbase"] - to_front) * across[2:].sum()
        about_road += half * (along[1] + along[3] - along[0] - along[2])
        about_roll = MASS * GRAVITY * h * state[3] + roll_axis_height(PAPER) * across.sum()
        about_roll += half * (loads[0] + loads[2] - loads[1] - loads[3])
        found = np.array(force(state[[0, 1, 2, 4]], state[3], rates(state, inputs)[[0, 1, 2, 4]]))[:, 0]
        expected = np.array([along.sum(), across.sum(), about_road, about_roll])
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)
