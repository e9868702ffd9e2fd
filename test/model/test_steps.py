"""The time step and the functions that observers call: order, stability, derivatives, compiled code."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from stepping import Stepper
from vsense_ros.model.car.car import Car
from vsense_ros.model.car.kinematics import kinematics, road_kinematics
from vsense_ros.model.car.steps import (
    advance_function,
    dynamics_function,
    force_function,
    kinematics_function,
    linearize_function,
    model_functions,
)
from vsense_ros.model.coordinates import DYNAMIC_COORDINATES

seeds = st.integers(0, 2**32 - 1)
relaxed = settings(deadline=None, max_examples=10)


def cornering(vehicle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates, velocities and inputs of a car that brakes in a bend."""
    q, u = np.zeros(14), np.zeros(14)
    q[2] = vehicle.physics.chassis.cog_height
    u[0], u[1], u[5] = 25.0, 0.2, 0.1
    u[10:] = 25.0 / 0.334
    return q, u, np.array([0.03, -300.0, -300.0, -150.0, -150.0, 0.0])


def sliding(vehicle) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motion of a car that brakes slowly on wheels that slide at 1.2 m/s, where steps foresee how it goes on."""
    q, u, inputs = cornering(vehicle)
    u[0], u[1], u[5] = 3.0, 0.1, 0.05
    u[10:] = (3.0 - 1.2) / 0.334
    return q, u, inputs + np.array([0.0, -1700.0, -1700.0, -1350.0, -1350.0, 0.0])


@pytest.mark.parametrize("exact_jacobian", [True, False])
@pytest.mark.parametrize(("start", "duration", "steps"), [(cornering, 0.1, 1e-4), (sliding, 2e-3, 5e-6)])
def test_a_step_is_of_second_order_with_any_jacobian(vehicle, car, start, duration, steps, exact_jacobian):
    q, u, inputs = start(vehicle)
    dynamics = dynamics_function(car)
    rate = ca.Function("rate", [car.q, car.u], [kinematics(car.q, car.u, ca.SX.zeros(7))])
    p = vehicle.parameter_vector()

    def derivative(_: float, state: np.ndarray) -> np.ndarray:
        udot = np.asarray(dynamics(state[:14], state[14:], np.zeros(14), np.zeros(7), inputs, p, [])[0])[:, 0]
        return np.concatenate([np.asarray(rate(state[:14], state[14:]))[:, 0], udot])

    exact = solve_ivp(derivative, (0, duration), np.concatenate([q, u]), "Radau", rtol=1e-9, atol=1e-10).y[:, -1]
    errors = []
    for h in (4 * steps, 2 * steps, steps):
        car_now = Stepper(vehicle, q, u)
        car_now.inputs[:] = inputs
        for _ in range(round(duration / h)):
            car_now.step(h, exact_jacobian)
        errors.append(np.abs(np.concatenate([car_now.q, car_now.u]) - exact).max())
    assert errors[0] / errors[1] > 3.5
    assert errors[1] / errors[2] > 3.5
    assert errors[2] < 1e-4


def test_one_step_longer_than_all_oscillations_ends_them(vehicle):
    car = Stepper(vehicle)
    rest = car.q.copy()
    car.q[[2, 6, 7, 8, 9]] += 1e-6, 2e-6, 2e-6, -1e-6, -1e-6
    car.step(1e3)
    assert np.abs(car.q - rest)[[2, 3, 4, 6, 7, 8, 9]].max() < 1e-8
    assert np.abs(car.u).max() < 1e-8


@pytest.mark.parametrize("h", [1e-3, 1e-2, 5e-2])
def test_small_disturbances_of_a_standing_car_fade_at_every_allowed_step_length(vehicle, h):
    random = np.random.default_rng(0)
    car = Stepper(vehicle, u=1e-4 * random.normal(size=14))
    start = np.abs(car.u).max()
    car.run(max(20.0, 100 * h), h)
    assert np.abs(car.u).max() < 1e-3 * start


@relaxed
@given(seed=seeds)
def test_jacobians_of_the_dynamics_are_their_derivatives(seed, vehicle, car, driving):
    state = driving(seed)
    dynamics, linearize = dynamics_function(car), linearize_function(car)
    udot, by_q, by_u, by_disturbances, by_q_rates = (np.asarray(r) for r in linearize(*state.values()))

    def differences(name: str, step: float) -> np.ndarray:
        columns = []
        for i in range(len(state[name])):
            ends = []
            for sign in (1, -1):
                moved = {k: v.copy() for k, v in state.items()}
                moved[name][i] += sign * step
                ends.append(np.asarray(dynamics(*moved.values())[0])[:, 0])
            columns.append((ends[0] - ends[1]) / (2 * step))
        return np.column_stack(columns)

    assert_allclose(udot[:, 0], np.asarray(dynamics(*state.values())[0])[:, 0], rtol=1e-12)
    all_q = differences("q", 1e-7)
    expected = [all_q[:, list(DYNAMIC_COORDINATES)], differences("u", 1e-6), differences("disturbances", 1e-8)]
    for found, difference in zip((by_q, by_u, by_disturbances), expected, strict=True):
        scale = np.abs(difference).max(axis=1, keepdims=True) + 1e-6
        assert_allclose(found / scale, difference / scale, atol=1e-4)
    elsewhere = [i for i in range(14) if i not in DYNAMIC_COORDINATES]
    assert_allclose(all_q[:, elsewhere], 0, atol=1e-2)  # place, heading and wheel angles change nothing
    rates = np.asarray(
        ca.Function("r", [car.q, car.u, car.disturbances], [ca.jacobian(car.kinematics, car.u)])(*_qud(state))
    )
    assert_allclose(by_q_rates, by_q @ rates[list(DYNAMIC_COORDINATES)], rtol=1e-9, atol=1e-9 * np.abs(by_q).max())


def _qud(state: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return state["q"], state["u"], state["disturbances"]


@relaxed
@given(seed=seeds)
def test_jacobians_of_the_kinematics_are_their_derivatives(seed, car, driving):
    given = _qud(driving(seed))
    state = [car.q, car.u, car.disturbances]
    rate = ca.Function("rate", state, [car.kinematics[:6], road_kinematics(*state)])
    by_angles, by_u, by_road, road, road_by_u, road_by_road = (np.asarray(r) for r in kinematics_function(car)(*given))

    def differences(argument: int, elements: range) -> list[np.ndarray]:
        found = []
        for i in elements:
            ends = []
            for sign in (1, -1):
                moved = [value.copy() for value in given]
                moved[argument][i] += sign * 1e-6
                ends.append(rate(*moved))
            found.append([np.asarray(ahead - behind)[:, 0] / 2e-6 for ahead, behind in zip(*ends, strict=True)])
        return [np.column_stack(columns) for columns in zip(*found, strict=True)]

    assert_allclose(road, np.asarray(rate(*given)[1]), rtol=1e-12)
    assert_allclose(by_angles, differences(0, range(3, 6))[0], atol=1e-6)
    for found, expected in zip((by_u, road_by_u), differences(1, range(6)), strict=True):
        assert_allclose(found, expected, atol=1e-7)
    for found, expected in zip((by_road, road_by_road), differences(2, range(4)), strict=True):
        assert_allclose(found, expected, atol=1e-6)


@relaxed
@given(seed=seeds)
def test_a_generalized_force_causes_the_acceleration_it_was_asked_for(seed, car, driving):
    state = driving(seed)
    wish = np.random.default_rng(seed).normal(size=14)
    dynamics = dynamics_function(car)
    arguments = [state[k] for k in ("q", "inputs", "disturbances", "p", "internal_state")]
    more = np.asarray(force_function(car)(*arguments, wish))[:, 0]

    before = np.asarray(dynamics(*state.values())[0])[:, 0]
    state["force"] = state["force"] + more
    after = np.asarray(dynamics(*state.values())[0])[:, 0]

    assert_allclose(after - before, wish, atol=1e-9 * (1 + np.abs(before).max()))


@relaxed
@given(seed=seeds)
def test_compiled_functions_give_what_the_virtual_machine_gives(seed, car: Car, driving):
    state = driving(seed)
    compiled = model_functions(car)
    plain = {f.name(): f for f in (dynamics_function(car), linearize_function(car), advance_function(car))}
    random = np.random.default_rng(seed)
    extra = [0.005, np.eye(14) + 0.01 * random.normal(size=(14, 14)), random.normal(size=(14, 7))]
    for name, function in plain.items():
        arguments = [*state.values(), *(extra if name == "advance" else [])]
        for found, expected in zip(compiled[name](*arguments), function(*arguments), strict=True):
            expected = np.asarray(expected)
            assert_allclose(np.asarray(found), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
