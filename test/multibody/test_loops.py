"""Closed loops: against closed-form kinematics, for conservation of energy, for their order, and what is refused."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros.errors import InputError
from vsense_ros.model.multibody.assembly import assemble, check
from vsense_ros.model.multibody.integrator import Integrator
from vsense_ros.model.multibody.joints import Guided, Prismatic, Revolute, Spherical, Universal
from vsense_ros.model.multibody.mechanism import (
    BASE,
    Along,
    Between,
    Body,
    Closure,
    Coincide,
    Distance,
    Linkage,
    Mechanism,
    Perpendicular,
    Point,
    Spring,
)
from vsense_ros.model.multibody.semi_recursive import Motion

Y = (0.0, 1.0, 0.0)
IN_PLANE = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
CRANK, COUPLER, ROCKER, GROUND = 0.2, 0.55, 0.4, 0.5  # [m]; Grashof: the crank turns right round
NOTHING = np.zeros(0)


def four_bar(closures: tuple[Closure, ...], springs: tuple[Spring, ...] = ()) -> Linkage:
    """Crank at the origin, rocker at x = GROUND, in the design position both upright."""
    inertia = ca.diag(ca.SX([0.01, 0.02, 0.015]))
    return Linkage(
        "four_bar",
        (
            Body("crank", BASE, Revolute((0, 0, 0), Y), 1.0, (0, 0, CRANK / 2), inertia),
            Body("coupler", "crank", Revolute((0, 0, CRANK), Y), 2.0, (0.25, 0, 0.3), inertia),
            Body("rocker", BASE, Revolute((GROUND, 0, 0), Y), 1.5, (GROUND, 0, ROCKER / 2), inertia),
        ),
        closures,
        springs,
    )


def pin(directions: tuple[tuple[float, float, float], ...] | None = IN_PLANE) -> Coincide:
    """Joins coupler and rocker; the coupler's end lies where its length says."""
    return Coincide("pin", Point("coupler", (COUPLER, 0, CRANK)), Point("rocker", (GROUND, 0, ROCKER)), directions)


def closed_form(crank: float) -> float:
    """Rocker angle by the triangle of crank end, rocker pivot and pin (Freudenstein's geometry)."""
    end = CRANK * np.array([np.sin(crank), np.cos(crank)])
    to_end = end - np.array([GROUND, 0])
    distance = np.hypot(*to_end)
    opening = np.arccos((ROCKER**2 + distance**2 - COUPLER**2) / (2 * ROCKER * distance))
    return float(np.arctan2(to_end[0], to_end[1]) + opening)


@settings(deadline=None, max_examples=40)
@given(st.floats(-3.1, 3.1))
def test_a_four_bar_closes_where_its_triangles_say(crank: float):
    rocker = closed_form(crank)
    end = CRANK * np.array([np.sin(crank), np.cos(crank)])
    to_pin = np.array([GROUND, 0]) + ROCKER * np.array([np.sin(rocker), np.cos(rocker)]) - end
    coupler = np.arctan2(-to_pin[1], to_pin[0])  # about y, from lying along x

    # Two positions close the loop; starting off by 6° finds the one looked for.
    start = np.array([crank, coupler - crank + 0.1, rocker + 0.1])
    z = assemble(four_bar((pin(),)), NOTHING, start, held={0: crank})

    assert_allclose(np.sin(z[2]), np.sin(rocker), atol=1e-9)
    assert_allclose(np.cos(z[0] + z[1] - coupler), 1, atol=1e-9)


def test_a_rod_without_mass_closes_the_loop_as_the_coupler_does():
    linkage = four_bar((pin(),))
    bars = Linkage(
        "bars",
        (linkage.bodies[0], linkage.bodies[2]),
        (Distance("rod", Point("crank", (0, 0, CRANK)), Point("rocker", (GROUND, 0, ROCKER)), COUPLER),),
    )
    z = assemble(bars, NOTHING, np.array([0.7, closed_form(0.7)]), held={0: 0.7})
    assert_allclose(z[1], closed_form(0.7), atol=1e-9)


def test_a_double_wishbone_carries_its_upright_where_circle_and_spheres_meet():
    """Both ball joints turn about their arms' axes at fixed radius; their distance is that of the upright."""
    lower_axis, upper_axis = np.array([1, 0.05, 0.02]), np.array([1, -0.1, 0.06])
    lower_pivot, upper_pivot = np.array([0, 0.3, -0.1]), np.array([0, 0.35, 0.1])
    lower_ball, upper_ball = np.array([0.01, 0.62, -0.12]), np.array([-0.01, 0.58, 0.13])
    inertia = ca.SX.eye(3) * 0.01
    linkage = Linkage(
        "wishbones",
        (
            Body("lower", BASE, Revolute(lower_pivot, lower_axis), 1.0, lower_ball, inertia),
            Body("upper", BASE, Revolute(upper_pivot, upper_axis), 1.0, upper_ball, inertia),
            Body("upright", "lower", Universal(lower_ball, (1, 0, 0), (0, 1, 0)), 1.0, (0, 0.65, 0), inertia),
        ),
        (Coincide("upper ball", Point("upper", upper_ball), Point("upright", upper_ball)),),
    )

    def turned(point: np.ndarray, pivot: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
        u = axis / np.linalg.norm(axis)
        arm = point - pivot
        return pivot + u * (u @ arm) + np.cos(angle) * (arm - u * (u @ arm)) + np.sin(angle) * np.cross(u, arm)

    for travel in np.linspace(-0.3, 0.3, 9):
        z = assemble(linkage, NOTHING, held={0: travel})
        # |pivot + c + cos·e + sin·f - ball|² = length²: A cos + B sin = C.
        ball = turned(lower_ball, lower_pivot, lower_axis, travel)
        u = upper_axis / np.linalg.norm(upper_axis)
        arm = upper_ball - upper_pivot
        along, e = u * (u @ arm), arm - u * (u @ arm)
        f = np.cross(u, arm)
        base = upper_pivot + along - ball
        length = np.linalg.norm(upper_ball - lower_ball)
        a, b, c = 2 * base @ e, 2 * base @ f, length**2 - base @ base - e @ e
        middle, half = np.arctan2(b, a), np.arccos(c / np.hypot(a, b))
        candidates = [(middle + s * half + np.pi) % (2 * np.pi) - np.pi for s in (1, -1)]
        assert min(abs(z[1] - angle) for angle in candidates) < 1e-9


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_rates_and_accelerations_of_constraints_are_their_derivatives(seed: int):
    random = np.random.default_rng(seed)
    points = random.normal(size=(6, 3))
    inertia = ca.SX.eye(3)
    linkage = Linkage(
        "mixed",
        (
            Body("a", BASE, (Guided(Prismatic(points[0]), "rack"), Spherical(points[1])), 1.0, points[2], inertia),
            Body("b", BASE, Universal(points[3], (1, 0, 0), (0, 0, 1)), 1.0, points[4], inertia),
        ),
        (
            Coincide("all", Point("a", points[5]), Point("b", points[0])),
            Coincide("some", Point("a", points[2]), Point("b", points[3]), ((1, 2, 3),)),
            Distance("rod", Point("a", points[1]), Point("b", points[2]), 2.0),
            Perpendicular("square", "a", points[0], "b", points[1]),
        ),
    )
    t = ca.SX.sym("t")
    factors = ca.SX(random.normal(size=(6, 3)))
    path = ca.mtimes(factors, ca.vertcat(ca.sin(t), t, t**2))
    rate = ca.jacobian(path, t)
    acceleration = ca.jacobian(rate, t)
    motion = Motion(linkage, path[:5], rate[:5], acceleration[:5], ca.horzcat(path[5], rate[5], acceleration[5]))
    value = motion.constraint
    once = ca.jacobian(value, t)
    multipliers = random.normal(size=6)
    z = ca.SX.sym("z", 5)
    still = Motion(linkage, z, ca.SX(5, 1), ca.SX(5, 1), ca.SX(1, 3))
    check_all = ca.Function(
        "check",
        [t, z],
        [
            motion.constraint_rate - once,
            motion.constraint_acceleration - ca.jacobian(once, t),
            still.constraint_jacobian - ca.jacobian(still.constraint, z),
            # All but the right angle, whose curvature is left out.
            still.constraint_curvature(ca.vertcat(multipliers[:5], 0))
            - ca.jacobian(still.constraint_jacobian[:5, :].T @ multipliers[:5], z),
        ],
    )
    for difference in check_all(0.4, random.normal(size=5)):
        assert np.abs(np.asarray(difference)).max() < 1e-9


@pytest.fixture(scope="module")
def swinging() -> Callable[[float], Integrator]:
    """A four-bar without friction, with a spring, that starts with a turning crank; its step length to be chosen."""
    spring = Spring(Between(Point("coupler", (0.3, 0, 0.3)), Point(BASE, (0.2, 0, 0.8))), 400.0, rest=0.3)
    mechanism = Mechanism(None, (four_bar((pin(),), (spring,)),))
    start = assemble(mechanism.branches[0], NOTHING, np.array([0.5, 0.0, closed_form(0.5)]), held={0: 0.5})

    def make(h: float) -> Integrator:
        integrator = Integrator(mechanism, NOTHING, h, tolerance=1e-11, name="four_bar")
        integrator.state.z[:] = start
        integrator.settle()
        return integrator

    return make


def energy(integrator: Integrator) -> float:
    """Kinetic energy, and that of gravity and spring by their own formulas."""
    mass, *_ = integrator.dynamics()
    z, dz = integrator.state.z, integrator.state.dz
    total = 0.5 * dz @ mass @ dz

    def at(angle: float, x: float, height: float) -> np.ndarray:
        return np.array([np.cos(angle) * x + np.sin(angle) * height, np.cos(angle) * height - np.sin(angle) * x])

    crank_end = at(z[0], 0, CRANK)
    centre = crank_end + at(z[0] + z[1], 0.25, 0.3 - CRANK)
    hook = crank_end + at(z[0] + z[1], 0.3, 0.3 - CRANK)
    heights = at(z[0], 0, CRANK / 2)[1], centre[1], at(z[2], 0, ROCKER / 2)[1]
    total += 9.80665 * (1.0 * heights[0] + 2.0 * heights[1] + 1.5 * heights[2])
    return float(total + 200.0 * (np.hypot(*(hook - [0.2, 0.8])) - 0.3) ** 2)


def test_energy_stays_and_constraints_hold_over_ten_seconds(swinging: Callable[[float], Integrator]):
    integrator = swinging(1e-3)
    before = energy(integrator)
    drift, kinetic, violation = 0.0, 0.0, 0.0
    for i in range(10_000):
        integrator.step()
        if i % 20 == 0:
            mass, _, *constraints, _ = integrator.dynamics()
            kinetic = max(kinetic, 0.5 * integrator.state.dz @ mass @ integrator.state.dz)
            drift = max(drift, abs(energy(integrator) - before))
            violation = max(violation, *(np.abs(c).max() for c in constraints))
    assert kinetic > 1.0
    assert drift < 5e-5 * kinetic
    assert violation < 1e-9


def test_the_error_falls_with_the_square_of_the_step_length(swinging: Callable[[float], Integrator]):
    ends = []
    for h in (8e-3, 4e-3, 2e-3, 2.5e-4):
        integrator = swinging(h)
        for _ in range(round(0.4 / h)):
            integrator.step()
        ends.append(np.concatenate([integrator.state.z, integrator.state.dz]))
    errors = [np.abs(end - ends[-1]).max() for end in ends[:-1]]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert np.all((orders > 1.9) & (orders < 2.1)), orders


def test_accelerations_and_multipliers_solve_the_equations_with_their_constraints(
    swinging: Callable[[float], Integrator],
):
    integrator = swinging(1e-4)
    for _ in range(200):
        integrator.step()
    stepped = integrator.state.copy()
    integrator.state.dz[:] *= [1.1, 1.0, 0.9]
    integrator.settle()
    # Dense: [M Jᵀ; J 0] [z̈; λ] = [Q; -bias], where the bias is d²Φ/dt² without accelerations.
    settled = integrator.state.copy()
    integrator.state.ddz[:] = 0
    mass, forces, _, rate, bias, jacobian = integrator.dynamics()
    matrix = np.block([[mass, jacobian.T], [jacobian, np.zeros((2, 2))]])
    expected = np.linalg.solve(matrix, np.concatenate([forces, -bias]))
    assert np.abs(rate).max() < 1e-9
    assert_allclose(np.concatenate([settled.ddz, settled.multipliers]), expected, rtol=1e-6)
    integrator.state.take(stepped)
    integrator.settle()
    assert_allclose(integrator.state.ddz, stepped.ddz, atol=2e-3 * np.abs(stepped.ddz).max())


def test_a_long_step_takes_more_iterations_and_still_closes_the_loop(swinging: Callable[[float], Integrator]):
    integrator = swinging(0.02)
    for _ in range(100):
        integrator.step()
    assert integrator.calls > 100
    _, _, *constraints, _ = integrator.dynamics()
    assert max(np.abs(c).max() for c in constraints) < 1e-9


def test_a_step_that_does_not_converge_is_refused_and_leaves_the_state(swinging: Callable[[float], Integrator]):
    integrator = swinging(0.02)
    integrator.step()
    before = integrator.state.copy()
    integrator.gravity[2] = np.nan
    with pytest.raises(InputError, match=r"a step of 0\.02 s does not converge: .* use a shorter"):
        integrator.step()
    assert_allclose(integrator.state.z, before.z, rtol=0)
    assert_allclose(integrator.state.multipliers, before.multipliers, rtol=0)


def test_a_spring_on_a_joint_swings_with_the_period_of_its_pendulum():
    """Without gravity: period 2π √(I/k)."""
    body = Body("bar", BASE, Revolute((0, 0, 0), Y), 2.0, (0, 0, 0.5), ca.SX.eye(3) * 0.1)
    inertia, stiffness = 0.1 + 2 * 0.25, 30.0
    integrator = Integrator(
        Mechanism(None, (Linkage("bar", (body,), springs=(Spring(Along("bar"), stiffness),)),)),
        NOTHING,
        1e-3,
        name="bar",
    )
    integrator.gravity[:] = 0
    integrator.state.z[0] = 0.2
    integrator.settle()
    for _ in range(2000):
        integrator.step()
    assert_allclose(integrator.state.z[0], 0.2 * np.cos(2.0 * np.sqrt(stiffness / inertia)), atol=2e-5)


def test_a_redundant_constraint_is_refused_by_name():
    linkage = four_bar((pin(None),))  # its third equation holds the flat mechanism in its plane, where it is anyway
    z = assemble(linkage, NOTHING, np.array([0.5, 0.0, closed_form(0.5)]), held={0: 0.5})
    with pytest.raises(InputError, match="has 3 constraints of which only 2 are independent: pin repeats in part"):
        check(linkage, NOTHING, z)
    twice = four_bar(
        (pin(), Distance("rod", Point("crank", (0, 0, CRANK)), Point("rocker", (GROUND, 0, ROCKER)), COUPLER))
    )
    with pytest.raises(InputError, match="of which only 2 are independent: rod repeats"):
        check(twice, NOTHING, z)


def test_contradictory_constraints_are_refused_by_name_with_what_stays_open():
    rod = Distance("rod", Point("crank", (0, 0, CRANK)), Point("rocker", (GROUND, 0, ROCKER)), COUPLER + 0.01)
    with pytest.raises(InputError, match=r"'four_bar' does not close: .* rod by .* mm"):
        assemble(four_bar((pin(), rod)), NOTHING)


def test_a_linkage_with_too_short_a_link_is_refused():
    rod = Distance("rod", Point("crank", (0, 0, CRANK)), Point("rocker", (GROUND, 0, ROCKER)), 1.3)
    bodies = four_bar(()).bodies
    with pytest.raises(InputError, match="does not close"):
        assemble(Linkage("bars", (bodies[0], bodies[2]), (rod,)), NOTHING)


def test_an_assembled_four_bar_has_one_degree_of_freedom():
    linkage = four_bar((pin(),))
    z = assemble(linkage, NOTHING, np.array([0.5, 0.0, closed_form(0.5)]), held={0: 0.5})
    assert check(linkage, NOTHING, z) == 1
