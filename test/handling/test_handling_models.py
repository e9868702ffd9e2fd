"""Handling models against closed forms, conservation laws, other libraries, and each other."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.integrate import solve_ivp

from studies.handling.bicycle_3dof import Bicycle3Dof
from studies.handling.bicycle_5dof import Bicycle5Dof
from studies.handling.linear import output_values, system_matrices
from studies.handling.twin_track_3dof import TwinTrack3Dof
from studies.handling.twin_track_7dof import TwinTrack7Dof
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.handling.base import HandlingModel, Tyres
from vsense_ros.model.handling.bicycle_2dof import Bicycle2Dof
from vsense_ros.model.handling.response import Response, Values
from vsense_ros.model.tyres import Fiala, Linear

# Leung 2010, table A.1 and eqs. 3.28 and 3.29: axle stiffnesses are twice those of a tyre.
SALOON = {
    "mass": 1858.0, "yaw_inertia": 3515.0, "to_front": 1.360, "to_rear": 1.546, "air_density": 1.205,
    "drag_area": 0.305 * 2.2, "front_stiffness": 154_780.0, "rear_stiffness": 147_540.0, "front_half_track": 0.768,
    "rear_half_track": 0.768, "front_radius": 0.288, "rear_radius": 0.288, "front_spin_inertia": 2.0,
    "rear_spin_inertia": 2.0, **{f"radius_{wheel}": 0.288 for wheel in WHEELS},
    **{f"spin_inertia_{wheel}": 1.0 for wheel in WHEELS},
}  # fmt: skip
FRONT = Linear(model="linear", slip_stiffness=1.688e5, cornering_stiffness=77_390.0, standstill_speed=1e-3)
REAR = Linear(model="linear", slip_stiffness=1.438e5, cornering_stiffness=73_770.0, standstill_speed=1e-3)
FREE = ("slip_stiffness", "cornering_stiffness")
AXLES = Tyres({"front": FRONT, "rear": REAR}, FREE)
FOUR = Tyres(dict(zip(WHEELS, (FRONT, FRONT, REAR, REAR), strict=True)), FREE)
MODELS: tuple[HandlingModel, ...] = (
    Bicycle2Dof(), Bicycle3Dof(AXLES), Bicycle5Dof(AXLES), TwinTrack3Dof(FOUR), TwinTrack7Dof(FOUR),
)  # fmt: skip
WHEELBASE = SALOON["to_front"] + SALOON["to_rear"]
UNDERSTEER = SALOON["mass"] / WHEELBASE * (SALOON["to_rear"] / 154_780.0 - SALOON["to_front"] / 147_540.0)

every_model = pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)


def numbers(model: HandlingModel) -> dict[str, float]:
    known = SALOON | model.tyre_numbers()
    return {name: known[name] for name in model.parameters}


def response(model: HandlingModel) -> Response:
    return Response(model, numbers(model))


@every_model
@given(st.floats(3.0, 30.0))
@settings(max_examples=10, deadline=None)
def test_the_steady_turn_is_that_of_the_closed_form(model: HandlingModel, speed: float) -> None:
    a, b, mass = SALOON["to_front"], SALOON["to_rear"], SALOON["mass"]
    held = WHEELBASE + UNDERSTEER * speed**2
    still = np.array([1e-9])
    found = response(model)
    yaw = found.frequency_response(speed, still, "yaw_rate")[0]
    slip = found.frequency_response(speed, still, "side_slip")[0]
    # Longitudinal forces of the driven wheels against the drag turn a little with the front wheels: none here is.
    tolerance = 2e-3 if "Twin" in type(model).__name__ else 1e-4
    assert yaw.real == pytest.approx(speed / held, rel=tolerance)
    assert slip.real == pytest.approx(
        (b - a * mass * speed**2 / (WHEELBASE * 147_540.0)) / held, rel=tolerance, abs=1e-3
    )


def test_gains_are_those_computed_from_the_thesis_numbers() -> None:
    """Static gains [m/s/rad] and peaks of lateral velocity over road-wheel angle, from eq. 3.20 and eq. 3.29."""
    found = response(Bicycle2Dof())
    for kph, gain in ((10, 1.43), (40, 3.06), (50, 1.89), (60, -0.50), (70, -4.29), (100, -25.4)):
        at_rest = found.frequency_response(kph / 3.6, np.array([1e-9]))[0]
        assert at_rest.real == pytest.approx(gain, rel=0.005)
    for kph, peak, where in ((40, 3.28, 9.3), (50, 3.50, 11.5), (60, 4.04, 10.5), (70, 5.31, 7.0)):
        frequency = np.geomspace(0.1, 100, 2000)
        size = np.abs(found.frequency_response(kph / 3.6, frequency))
        assert size.max() == pytest.approx(peak, rel=0.005)
        assert frequency[size.argmax()] == pytest.approx(where, rel=0.05)


def test_there_is_no_side_slip_at_the_tangent_speed_and_the_car_is_stable_there() -> None:
    found = response(Bicycle2Dof())
    speed = np.sqrt(SALOON["to_rear"] * WHEELBASE * 147_540.0 / (SALOON["to_front"] * SALOON["mass"]))
    assert speed == pytest.approx(16.2, abs=0.05)
    assert abs(found.frequency_response(speed, np.array([1e-9]))[0]) < 1e-6
    for kph in range(10, 101, 10):
        assert np.linalg.eigvals(found.linear(*found.straight(kph / 3.6)).a).real.max() < -6


@pytest.mark.filterwarnings("ignore:Badly conditioned filter coefficients")  # lateral motion leaves states out
@every_model
def test_the_frequency_response_is_that_of_scipy(model: HandlingModel) -> None:
    found = response(model)
    linear = found.linear(*found.straight(15.0))
    frequency = np.geomspace(0.1, 100, 30)
    direction = np.array([[float(name.startswith("steering"))] for name in model.inputs])
    output = model.outputs.index("lateral_velocity")
    d = linear.d[[output]] @ direction
    _, expected = signal.freqresp((linear.a, linear.b @ direction, linear.c[[output]], d), frequency)
    assert found.frequency_response(15.0, frequency) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("model", [MODELS[i] for i in (0, 1, 2, 4)], ids=lambda model: type(model).__name__)
def test_a_small_sine_of_the_steering_comes_out_as_the_frequency_response_says(model: HandlingModel) -> None:
    found, speed, frequency, step = response(model), 12.0, 6.0, 0.005
    x, u = found.straight(speed)
    t = np.arange(0, 8, step)
    inputs = np.tile(u, (len(t), 1))
    sine = 1e-3 * np.sin(frequency * (t + step / 2))
    for i, name in enumerate(model.inputs):
        if name.startswith("steering"):
            inputs[:, i] = sine
    states = found.drive(x, inputs, step)[:-1]
    lateral = output_values(found, states, inputs)[:, model.outputs.index("lateral_velocity")]
    late = t > 4
    basis = np.exp(1j * frequency * t[late])
    amplitude = np.linalg.lstsq(np.column_stack([basis.real, basis.imag]), lateral[late], rcond=None)[0]
    expected = found.frequency_response(speed, np.array([frequency]))[0]
    assert np.hypot(*amplitude) / 1e-3 == pytest.approx(abs(expected), rel=0.01)


@every_model
@given(st.floats(5, 30), st.floats(-1, 1), st.floats(-0.5, 0.5), st.floats(-0.1, 0.1), st.floats(-200, 200))
@settings(max_examples=10, deadline=None)
def test_a_car_in_a_mirror_does_what_the_car_does(
    model: HandlingModel, speed: float, lateral: float, yaw_rate: float, steering: float, torque: float
) -> None:
    found = response(model)
    start, inputs = found.straight(speed)
    state = {"lateral_velocity": lateral, "side_slip": lateral / speed, "yaw_rate": yaw_rate}
    left, right = start.copy(), start.copy()
    for i, name in enumerate(model.states):
        if name in state:
            left[i], right[i] = state[name], -state[name]
    for i, name in enumerate(model.states):
        if _other_side(name) != name:
            left[i] *= 1.01 if name.endswith("l") else 0.99
            right[i] *= 0.99 if name.endswith("l") else 1.01
    u, v = inputs.copy(), inputs.copy()
    for i, name in enumerate(model.inputs):
        if name.startswith("steering"):
            u[i], v[i] = steering, -steering
        if name.startswith("torque_"):
            u[i] += torque
            v[i] += torque
    p = found.parameters
    one, other = (np.asarray(found.rates(*at, p)).ravel() for at in ((left, u), (right, v)))
    turned = [-1.0 if name in state else 1.0 for name in model.states]
    mirrored = [model.states.index(_other_side(name)) for name in model.states]
    assert one == pytest.approx((other * turned)[mirrored], rel=1e-9, abs=1e-9)


def _other_side(name: str) -> str:
    if name.startswith("spin_") and name[-1] in "lr" and len(name) == len("spin_fl"):
        return name[:-1] + ("r" if name.endswith("l") else "l")
    return name


@given(st.floats(5, 30), st.floats(-2, 2), st.floats(-0.8, 0.8), st.floats(-0.2, 0.2), st.floats(-0.05, 0.05))
@settings(max_examples=20, deadline=None)
def test_power_of_the_engine_goes_into_motion_sliding_and_air(
    speed: float, lateral: float, yaw_rate: float, steering: float, slip: float
) -> None:
    """Conservation of energy of the seven degrees of freedom."""
    model, p = TwinTrack7Dof(FOUR), SALOON | TwinTrack7Dof(FOUR).tyre_numbers()
    found = response(model)
    spin = np.array([1 + slip, 1 - slip, 1 + 2 * slip, 1.0]) * speed / 0.288
    x = np.array([speed, lateral, yaw_rate, *spin])
    u = np.array([steering, steering, 30.0, -50.0, 200.0, 100.0])
    xd = np.asarray(found.rates(x, u, found.parameters)).ravel()
    gained = p["mass"] * (x[0] * xd[0] + x[1] * xd[1]) + p["yaw_inertia"] * x[2] * xd[2] + spin @ xd[3:]
    given_power = u[2:] @ spin - 0.5 * p["air_density"] * p["drag_area"] * speed**3
    lost = 0.0
    for i, (arm, side) in enumerate(((1.36, 0.768), (1.36, -0.768), (-1.546, 0.768), (-1.546, -0.768))):
        angle = steering if i < 2 else 0.0
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        along, across = turn @ np.array([speed - side * yaw_rate, lateral + arm * yaw_rate])
        tyre = FRONT if i < 2 else REAR
        rolling = 0.288 * spin[i]
        slid = (rolling - along) / max(abs(rolling), abs(along))
        lost += tyre.slip_stiffness * slid * (rolling - along)
        lost += tyre.cornering_stiffness * np.arctan(across / along) * across
    assert gained == pytest.approx(given_power - lost, rel=1e-6, abs=1e-2 * abs(lost) * 1e-3 + 1.0)


def test_stiff_wheels_are_stepped_as_an_implicit_solver_of_scipy_does() -> None:
    found = response(TwinTrack7Dof(FOUR))
    x, u = found.straight(8.0)
    u = u + np.array([0.05, 0.05, 0, 0, 100.0, 100.0])
    ours = found.drive(x, np.tile(u, (200, 1)), 0.005)[-1]
    fun = lambda t, x: np.asarray(found.rates(x, u, found.parameters)).ravel()  # noqa: E731
    theirs = solve_ivp(fun, (0, 1), x, method="Radau", rtol=1e-9, atol=1e-10).y[:, -1]
    assert ours == pytest.approx(theirs, rel=2e-4)


def test_the_linear_matrices_are_the_jacobians_of_the_model() -> None:
    found = response(Bicycle2Dof())
    linear = found.linear(*found.straight(11.0))
    a, b = system_matrices(Values(Bicycle2Dof().parameters, found.parameters), 11.0)
    assert linear.a == pytest.approx(np.asarray(ca.DM(a)))
    assert linear.b[:, [0]] == pytest.approx(np.asarray(ca.DM(b)))


def test_a_tyre_that_saturates_can_be_exchanged_for_the_linear_one() -> None:
    fiala = Fiala(
        model="fiala", slip_stiffness=1.6e5, cornering_stiffness=77_390.0, static_friction=1.0, sliding_friction=0.9,
        standstill_speed=1e-3,
    )  # fmt: skip
    model = Bicycle2Dof(Tyres({"front": fiala, "rear": fiala}, ("cornering_stiffness",)))
    known: Mapping[str, float] = SALOON | model.tyre_numbers()
    found = Response(model, known)
    assert "front_cornering_stiffness" in model.parameters
    inputs = np.tile([0.2, 20.0], (600, 1))
    turning = found.drive(np.zeros(2), inputs, 0.01)[-1]
    linear = Response(Bicycle2Dof(), SALOON | {"front_stiffness": 154_780.0, "rear_stiffness": 154_780.0})
    assert 20.0 * abs(turning[1]) < 9.81 < 20.0 * linear.drive(np.zeros(2), inputs, 0.01)[-1][1]


@every_model
def test_a_left_turn_has_the_signs_of_iso_8855(model: HandlingModel) -> None:
    found = response(model)
    for speed, slip in ((8.0, 1), (25.0, -1)):  # below and above the tangent speed
        still = np.array([1e-9])
        assert found.frequency_response(speed, still, "yaw_rate")[0].real > 0
        assert found.frequency_response(speed, still, "lateral_acceleration")[0].real > 0
        assert np.sign(found.frequency_response(speed, still, "side_slip")[0].real) == slip


@every_model
def test_sensitivities_along_a_drive_are_finite_differences(model: HandlingModel) -> None:
    found = response(model)
    x, u = found.straight(12.0)
    t = np.arange(0, 1.5, 0.01)
    inputs = np.tile(u, (len(t), 1))
    for i, name in enumerate(model.inputs):
        if name.startswith("steering"):
            inputs[:, i] += 0.02 * np.sin(3 * t)
        if name.startswith("torque_f"):
            inputs[:, i] -= 50.0  # a wheel without any force is at the corner between driving and braking
    slopes = found.sensitivities(x, inputs, 0.01)
    for k in range(0, len(model.parameters), 3):
        changed = []
        for sign in (-1, 1):
            other = response(model)
            other.parameters[k] *= 1 + sign * 1e-5
            changed.append(output_values(other, other.drive(x, inputs, 0.01)[:-1], inputs))
        expected = (changed[1] - changed[0]) / (2e-5 * found.parameters[k])
        assert slopes[:, :, k] == pytest.approx(expected, rel=1e-3, abs=1e-5 * np.abs(expected).max() + 1e-15)


class _Model(StateSpace):
    """A handling model as a filter takes it: Heun's rule on its rates."""

    names, inputs, parameters = Bicycle2Dof.states, Bicycle2Dof.inputs, Bicycle2Dof().parameters

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> ca.SX:
        first = ca.vertcat(*Bicycle2Dof().rates(x, u, theta))
        ahead = Named(x.vector + h * first, self.names, "state")
        return x.vector + h / 2 * (first + ca.vertcat(*Bicycle2Dof().rates(ahead, u, theta)))

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> list[float]:
        return [1e-6, 1e-6]


def test_a_filter_takes_a_handling_model_and_its_outputs_as_they_are() -> None:
    """Side slip from yaw rate and lateral acceleration alone, of a car that starts sliding."""
    model = Bicycle2Dof()

    def sensed(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
        return list(model.measured(x, u, p)[:2])

    filter_ = Ekf(Dense(_Model(), [Measurement("both", sensed, (0.002, 0.1))], numbers(model)))
    filter_.start(Gaussian(np.zeros(2), np.eye(2) * 0.01))
    t = np.arange(0, 3, 0.01)
    inputs = np.column_stack([0.03 * np.sin(2 * t), np.full(len(t), 20.0)])
    found = response(model)
    states = found.drive(np.array([0.05, 0.2]), inputs, 0.01)
    outputs = output_values(found, states[:-1], inputs)
    noise = np.random.default_rng(0).standard_normal((len(t), 2)) * (0.002, 0.1)
    for i in range(len(t)):
        filter_.inputs[:] = inputs[i]
        filter_.correct("both", outputs[i, :2] + noise[i], np.array([0.002**2, 0.01]))
        filter_.predict(0.01)
    assert filter_.belief().mean == pytest.approx(states[-1], abs=3e-3)
