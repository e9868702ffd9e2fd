"""Trees of bodies against Pinocchio, which computes with other algorithms' implementations and other conventions."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros.model import spatial
from vsense_ros.model.multibody.tree import Body, Tree, inverse_spd, solve_dominant, solve_spd

pin = pytest.importorskip("pinocchio", reason="the oracle Pinocchio is not installed (pip install pin)")

seeds = st.integers(0, 2**32 - 1)
SWAPPED = [3, 4, 5, 0, 1, 2]  # Pinocchio puts linear before angular components


@dataclass(frozen=True)
class Twins:
    """One random tree in both libraries, at one random configuration."""

    tree: Tree
    model: pin.Model
    data: pin.Data
    q: np.ndarray


def spatial_inertia(inertia: pin.Inertia) -> ca.SX:
    return spatial.rigid_inertia(ca.SX(inertia.mass), ca.SX(inertia.lever), ca.SX(inertia.inertia))


def random_inertia(random: np.random.Generator) -> pin.Inertia:
    turn = pin.exp3(random.normal(size=3))
    return pin.Inertia(
        random.uniform(0.5, 20), random.normal(size=3) * 0.3, turn @ np.diag(random.uniform(0.5, 1, 3)) @ turn.T
    )


def twins(count: int, random: np.random.Generator) -> Twins:
    model = pin.Model()
    root_inertia = random_inertia(random)
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, root_inertia, pin.SE3.Identity())
    bodies: list[Body] = []
    joints = [root]
    branch = [-1]  # Pinocchio's mass matrix needs bodies in depth-first order: from the root to the newest body
    coordinates = [np.array([*random.normal(size=3), *pin.Quaternion(pin.exp3(random.normal(size=3))).coeffs()])]
    for i in range(count):
        branch = branch[: int(random.integers(1, len(branch) + 1))]
        parent = branch[-1]
        branch.append(i)
        placement = pin.SE3(pin.exp3(random.normal(size=3)), random.normal(size=3))
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        inertia = random_inertia(random)
        coordinate = random.uniform(-2, 2)
        if random.integers(2):
            joint, moved = pin.JointModelRevoluteUnaligned(axis), pin.SE3(pin.exp3(axis * coordinate), np.zeros(3))
            motion = np.concatenate([axis, np.zeros(3)])
        else:
            joint, moved = pin.JointModelPrismaticUnaligned(axis), pin.SE3(np.eye(3), axis * coordinate)
            motion = np.concatenate([np.zeros(3), axis])
        joints.append(model.addJoint(joints[parent + 1], joint, placement, f"joint_{i}"))
        model.appendBodyToJoint(joints[-1], inertia, pin.SE3.Identity())
        here = placement * moved
        bodies.append(
            Body(
                f"b{i}", parent, ca.SX(motion), ca.SX(here.rotation), ca.SX(here.translation), spatial_inertia(inertia)
            )
        )
        coordinates.append(np.array([coordinate]))
    model.gravity = pin.Motion.Zero()
    tree = Tree(spatial_inertia(root_inertia), tuple(bodies))
    return Twins(tree, model, model.createData(), np.concatenate(coordinates))


def numeric(expression: ca.SX) -> np.ndarray:
    return np.asarray(ca.evalf(expression)).squeeze()


@settings(deadline=None, max_examples=25)
@given(st.integers(2, 12), seeds)
def test_forward_dynamics_of_any_tree_agree_with_pinocchio(count: int, seed: int):
    random = np.random.default_rng(seed)
    twin = twins(count, random)
    root_velocity, rates, efforts = random.normal(size=6), random.normal(size=count), random.normal(size=count)
    wrenches = random.normal(size=(count + 1, 6))  # [n; f]

    root, joint = twin.tree.forward_dynamics(
        ca.SX(root_velocity), ca.SX(rates), ca.SX(efforts), ca.SX(wrenches[0]), [ca.SX(w) for w in wrenches[1:]]
    )

    v = np.concatenate([root_velocity[SWAPPED], rates])
    tau = np.concatenate([np.zeros(6), efforts])
    external = pin.StdVec_Force()
    external.append(pin.Force.Zero())
    for wrench in wrenches:
        external.append(pin.Force(wrench[3:], wrench[:3]))
    expected = pin.aba(twin.model, twin.data, twin.q, v, tau, external)
    scale = np.abs(expected).max()
    assert_allclose(numeric(root), expected[:6][SWAPPED], rtol=1e-9, atol=1e-9 * scale)
    assert_allclose(numeric(joint), expected[6:], rtol=1e-9, atol=1e-9 * scale)


@settings(deadline=None, max_examples=25)
@given(st.integers(2, 12), seeds)
def test_inverse_dynamics_of_any_tree_agree_with_pinocchio(count: int, seed: int):
    random = np.random.default_rng(seed)
    twin = twins(count, random)
    velocity, acceleration = random.normal(size=(2, 6 + count))
    wrenches = random.normal(size=(count + 1, 6))  # [n; f]

    root, joint = twin.tree.inverse_dynamics(
        *(ca.SX(part) for part in (velocity[:6], velocity[6:], acceleration[:6], acceleration[6:], wrenches[0])),
        [ca.SX(w) for w in wrenches[1:]],
    )

    external = pin.StdVec_Force()
    external.append(pin.Force.Zero())
    for wrench in wrenches:
        external.append(pin.Force(wrench[3:], wrench[:3]))
    order = [*SWAPPED, *range(6, 6 + count)]
    twin.model.gravity.setZero()
    expected = pin.rnea(twin.model, twin.data, twin.q, velocity[order], acceleration[order], external)[order]
    assert_allclose(numeric(ca.vertcat(root, joint)), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@settings(deadline=None, max_examples=25)
@given(st.integers(2, 12), seeds)
def test_the_mass_matrix_of_any_tree_agrees_with_pinocchio(count: int, seed: int):
    random = np.random.default_rng(seed)
    twin = twins(count, random)
    acceleration = random.normal(size=6 + count)

    force = numeric(twin.tree.inertia_times(ca.SX(acceleration[:6]), ca.SX(acceleration[6:])))

    mass = pin.crba(twin.model, twin.data, twin.q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    order = [*SWAPPED, *range(6, 6 + count)]
    expected = mass[np.ix_(order, order)] @ acceleration
    assert_allclose(force, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 8), seeds)
def test_a_positive_definite_system_is_solved_and_its_matrix_inverted(size: int, seed: int):
    random = np.random.default_rng(seed)
    factor = random.normal(size=(size, size))
    matrix, right = factor @ factor.T + np.eye(size), random.normal(size=(size, 2))

    solution = np.asarray(ca.evalf(solve_spd(ca.SX(matrix), ca.SX(right))))
    inverse = np.asarray(ca.evalf(inverse_spd(ca.SX(matrix))))

    assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-9, atol=1e-9)
    assert_allclose(inverse, np.linalg.inv(matrix), rtol=1e-9, atol=1e-9)


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 8), seeds)
def test_a_system_with_a_dominant_diagonal_is_solved(size: int, seed: int):
    random = np.random.default_rng(seed)
    matrix = np.diag(random.uniform(1, 100, size)) + random.normal(size=(size, size)) * 0.3 / size
    right = random.normal(size=(size, 2))

    solution = np.asarray(ca.evalf(solve_dominant(ca.SX(matrix), ca.SX(right))))

    assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-9, atol=1e-9)
