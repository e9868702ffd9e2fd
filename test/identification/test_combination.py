"""The car with a trailer beside Lagrange's equations of two bodies, made from their kinetic energy alone."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from pydantic import ValidationError

import vsense_ros as vs
from vsense_ros.identification.combination import SingleTrack, critical_speed, damping_ratio, linear
from vsense_ros.model.trailer import Trailer

CAR = SingleTrack.of(vs.load_vehicle("rav4"))
TRAILER = Trailer(mass=1400, hitch_damping=500.0)
HITCH, ON_AXLE = CAR.to_rear + 1.1, 0.95 * 1400 * 9.80665
# Coordinates x, y, ψ, γ and their rates.
Q, RATE = ca.SX.sym("q", 4), ca.SX.sym("rate", 4)
PLACE, YAW, THETA = Q[:2], Q[2], Q[2] + Q[3]


def ahead(angle: ca.SX) -> ca.SX:
    return ca.vertcat(ca.cos(angle), ca.sin(angle))


FRONT, REAR = PLACE + CAR.to_front * ahead(YAW), PLACE - CAR.to_rear * ahead(YAW)
AXLE = PLACE - HITCH * ahead(YAW) - TRAILER.length * ahead(THETA)


def inertia() -> tuple[ca.SX, ca.SX]:
    """Mass matrix, and what stands beside it in d/dt ∂T/∂q̇ - ∂T/∂q."""
    speed = ca.jacobian(AXLE + 0.05 * TRAILER.length * ahead(THETA), Q) @ RATE
    energy = (
        CAR.mass * ca.sumsqr(RATE[:2]) + CAR.yaw_inertia * RATE[2] ** 2
        + TRAILER.mass * ca.sumsqr(speed) + TRAILER.yaw_inertia * (RATE[2] + RATE[3]) ** 2
    ) / 2  # fmt: skip
    momenta = ca.gradient(energy, RATE)
    return ca.jacobian(momenta, RATE), ca.jacobian(momenta, Q) @ RATE - ca.gradient(energy, Q)


def work(at: ca.SX, angle: ca.SX, along: ca.SX | float, aside: ca.SX | float) -> ca.SX:
    """Generalized force (4,) of a force in axes turned by an angle, on a point."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.jacobian(at, Q).T @ ca.vertcat(c * along - s * aside, s * along + c * aside)


def aside(at: ca.SX, angle: ca.SX) -> ca.SX:
    """Velocity of a point across a direction [m/s]."""
    velocity = ca.jacobian(at, Q) @ RATE
    return ca.cos(angle) * velocity[1] - ca.sin(angle) * velocity[0]


DAMPER = ca.vertcat(0, 0, 0, -500.0 * RATE[3])


def drag(speed: ca.SX | float) -> ca.SX | float:
    return 0.5 * 1.204 * 0.08 * 4.2**2 * speed**2 + 0.012 * ON_AXLE


def test_small_sways_are_those_of_lagrange_s_equations() -> None:
    """Linearised about straight driving, where two eigenvalues more are zero: place and direction matter to nobody."""
    mass, rest = inertia()
    slip, speed = ca.SX.sym("slip"), 27.0
    force = DAMPER + work(AXLE, THETA, -drag(speed), -TRAILER.cornering_stiffness * slip)
    force += work(PLACE, YAW, drag(speed), 0)  # which keeps the speed
    for at, stiffness in ((FRONT, CAR.front_stiffness), (REAR, CAR.rear_stiffness)):
        force += work(at, YAW, 0, -stiffness * aside(at, YAW) / speed)
    follow = (aside(AXLE, THETA) / speed - slip) * speed / 0.4
    variables = ca.vertcat(Q[1:], RATE[1:], slip)
    rates = ca.vertcat(RATE[1:], ca.solve(mass, force - rest)[1:], follow)
    matrix = ca.Function("a", [Q, RATE, slip], [ca.jacobian(rates, variables)])(0, [speed, 0, 0, 0], 0)
    expected = np.linalg.eigvals(np.array(matrix))
    expected = expected[np.abs(expected) > 1e-3]
    found = np.linalg.eigvals(linear(CAR, TRAILER, speed))
    assert np.sort_complex(found) == pytest.approx(np.sort_complex(expected), rel=1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_accelerations_at_any_articulation_are_those_of_lagrange_s_equations(seed: int) -> None:
    random = np.random.default_rng(seed)
    speed, steering, along = random.uniform(8, 30), random.normal() * 0.05, random.normal() * 2
    lateral, yaw_rate, spin, slip = random.normal(size=4) * (0.5, 0.3, 0.4, 0.03)
    angle = random.uniform(-1.2, 1.2)
    state = ca.SX(ca.DM([lateral, yaw_rate, angle, spin, slip]))
    found = np.array(ca.evalf(CAR.rates(TRAILER, state, steering, speed, along))).ravel()

    def side(stiffness: float, alpha: ca.SX, load: float) -> ca.SX:
        return 0.9 * load * ca.tanh(stiffness * alpha / (0.9 * load))

    weight = CAR.mass * 9.80665 / (CAR.to_front + CAR.to_rear)
    front = side(CAR.front_stiffness, steering - ca.atan(aside(FRONT, YAW) / speed), weight * CAR.to_rear)
    rear = side(CAR.rear_stiffness, -ca.atan(aside(REAR, YAW) / speed), weight * CAR.to_front)
    pulled = (ca.jacobian(AXLE, Q) @ RATE).T @ ahead(THETA)
    force = DAMPER + work(FRONT, YAW, 0, np.cos(steering) * front) + work(REAR, YAW, 0, rear)
    force += work(AXLE, THETA, -drag(pulled), side(TRAILER.cornering_stiffness, ca.SX(-slip), ON_AXLE))
    # One more unknown: the force along the car that gives it its specific force there.
    mass, rest = inertia()
    left = ca.vertcat(ca.horzcat(mass, -work(PLACE, YAW, 1, 0)), ca.SX([[1, 0, 0, 0, 0]]))
    solved = ca.solve(left, ca.vertcat(force - rest, along))
    at = [0, 0, 0, angle], [speed, lateral, yaw_rate, spin - yaw_rate]
    expected = np.array(ca.Function("a", [Q, RATE], [solved])(*at)).ravel()
    assert found[0] + speed * yaw_rate == pytest.approx(expected[1], rel=1e-3)
    assert found[[1, 3]] == pytest.approx([expected[2], expected[2] + expected[3]], rel=1e-3)


@pytest.mark.parametrize("name", ["jaguar_saloon", "genesis", "rav4"])
@pytest.mark.parametrize("changes", [{}, {"nose_load": -50.0}, {"yaw_inertia": 6000.0}, {"hitch_damping": 1000.0}])
def test_damping_falls_with_speed_and_is_none_at_the_critical_one(name: str, changes: dict[str, float]) -> None:
    car, trailer = SingleTrack.of(vs.load_vehicle(name)), Trailer(mass=1400, **changes)
    ratios = [damping_ratio(car, trailer, speed) for speed in range(10, 42, 4)]
    assert np.all(np.diff(ratios) < 0)
    critical = critical_speed(car, trailer)
    assert (critical is None) == (damping_ratio(car, trailer, 60.0) > 0)
    if critical is not None:
        assert damping_ratio(car, trailer, critical) == pytest.approx(0, abs=1e-3)
        heavy_nose = trailer.model_copy(update={"nose_load": trailer.nose_load + 60})
        assert (critical_speed(car, heavy_nose) or 99.0) > critical


def test_what_is_not_given_follows_from_the_mass_and_what_cannot_be_is_refused_in_a_sentence() -> None:
    light, heavy = Trailer(mass=700), Trailer(mass=1400)
    assert heavy.length == pytest.approx(4.2)
    assert heavy.length / light.length == pytest.approx(2 ** (1 / 3))
    assert heavy.nose_load == pytest.approx(70)
    for changes, words in (
        ({"nose_load": 800.0}, "less than half"),
        ({"yaw_inertia": 3e6}, "is it about its cog"),
        ({"length": 0.0}, "leave it out"),
        ({"mass": 0.0}, "greater than 0"),
    ):
        with pytest.raises(ValidationError, match=words):
            Trailer(**{"mass": 1400.0, **changes})
