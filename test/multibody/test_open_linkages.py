"""Linkages without loops against Pinocchio, with joints of every kind on random topologies."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros.errors import InputError
from vsense_ros.model import spatial
from vsense_ros.model.multibody.augmented_lagrangian import Equations
from vsense_ros.model.multibody.joints import Floating, Guided, Prismatic, Revolute, Spherical, Universal
from vsense_ros.model.multibody.mechanism import BASE, Base, Between, Body, Linkage, Mechanism, Point, Spring
from vsense_ros.model.multibody.semi_recursive import Forces, Motion

pin = pytest.importorskip("pinocchio", reason="the oracle Pinocchio is not installed (pip install pin)")

seeds = st.integers(0, 2**32 - 1)
GRAVITY = np.array([0.3, -0.2, -9.8])


@dataclass(frozen=True)
class Twins:
    """One random linkage in both libraries; `guided` are the places of guided axes among Pinocchio's velocities."""

    linkage: Linkage
    model: pin.Model
    data: pin.Data
    guided: list[int]


def random_inertia(random: np.random.Generator) -> pin.Inertia:
    turn = pin.exp3(random.normal(size=3))
    return pin.Inertia(
        random.uniform(0.5, 20), random.normal(size=3) * 0.3, turn @ np.diag(random.uniform(0.5, 1, 3)) @ turn.T
    )


def random_joint(random: np.random.Generator, point: np.ndarray, name: str, guides: bool):
    """A joint of ours, and the same of Pinocchio's in a frame at `point`."""
    axis, other = random.normal(size=3), random.normal(size=3)
    axis /= np.linalg.norm(axis)
    other -= axis * (axis @ other)
    other /= np.linalg.norm(other)
    kind = random.integers(6 if guides else 5)
    if kind == 0:
        return Revolute(point, axis), pin.JointModelRevoluteUnaligned(axis)
    if kind == 1:
        return Prismatic(axis), pin.JointModelPrismaticUnaligned(axis)
    if kind == 2:
        both = pin.JointModelComposite(pin.JointModelRevoluteUnaligned(axis))
        both.addJoint(pin.JointModelRevoluteUnaligned(other), pin.SE3.Identity())
        return Universal(point, axis, other), both
    if kind == 3:
        return Spherical(point), pin.JointModelSphericalZYX()
    if kind == 4:
        free = pin.JointModelComposite(pin.JointModelTranslation())
        free.addJoint(pin.JointModelSphericalZYX(), pin.SE3.Identity())
        return Floating(point), free
    return Guided(Prismatic(axis), name), pin.JointModelPrismaticUnaligned(axis)


def twins(count: int, random: np.random.Generator, guides: bool = False, floating: bool = False) -> Twins:
    model = pin.Model()
    model.gravity = pin.Motion(GRAVITY, np.zeros(3))
    bodies: list[Body] = []
    joints, points = [0], [np.zeros(3)]
    if floating:
        free = pin.JointModelComposite(pin.JointModelTranslation())
        free.addJoint(pin.JointModelSphericalZYX(), pin.SE3.Identity())
        joints = [model.addJoint(0, free, pin.SE3.Identity(), "root")]
        model.appendBodyToJoint(joints[0], ROOT, pin.SE3.Identity())
    branch = [0]  # Pinocchio wants bodies in depth-first order
    guided: list[int] = []
    for i in range(count):
        branch = branch[: int(random.integers(1, len(branch) + 1))]
        parent = branch[-1]
        branch.append(i + 1)
        point = random.normal(size=3) * 0.5
        ours, theirs = random_joint(random, point, f"guide_{i}", guides)
        inertia = random_inertia(random)
        placement = pin.SE3(np.eye(3), point - points[parent])
        joints.append(model.addJoint(joints[parent], theirs, placement, f"joint_{i}"))
        points.append(point)
        model.appendBodyToJoint(joints[-1], inertia, pin.SE3.Identity())
        if isinstance(ours, Guided):
            guided.append(model.joints[joints[-1]].idx_v)
        bodies.append(
            Body(
                f"body_{i}", BASE if parent == 0 else f"body_{parent - 1}", ours, inertia.mass, point + inertia.lever,
                ca.SX(inertia.inertia),
            )
        )  # fmt: skip
    return Twins(Linkage("tree", tuple(bodies)), model, model.createData(), guided)


ROOT = random_inertia(np.random.default_rng(1))


def numeric(expression: ca.SX) -> np.ndarray:
    return np.asarray(ca.evalf(expression)).squeeze()


def near(found: np.ndarray, expected: np.ndarray) -> None:
    assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * max(1.0, np.abs(expected).max()))


@settings(deadline=None, max_examples=20)
@given(st.integers(1, 8), seeds)
def test_the_forces_that_a_motion_takes_agree_with_pinocchio(count: int, seed: int):
    random = np.random.default_rng(seed)
    twin = twins(count, random, guides=True)
    n = twin.model.nv
    q, v, a = random.uniform(-1, 1, n), random.normal(size=n), random.normal(size=n)
    free = [i for i in range(n) if i not in twin.guided]

    guides = ca.SX(np.column_stack([q, v, a])[twin.guided])
    motion = Motion(twin.linkage, ca.SX(q[free]), ca.SX(v[free]), ca.SX(a[free]), guides)
    forces = Forces(motion, ca.SX(6, 1), ca.vertcat(ca.SX(3, 1), ca.SX(-GRAVITY)), ca.SX([0, 0, 1]), ca.SX(0))

    expected = pin.rnea(twin.model, twin.data, q, v, a)
    if free:
        near(numeric(forces.residual).reshape(-1), expected[free])
        mass = pin.crba(twin.model, twin.data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        near(numeric(forces.mass_matrix).reshape(len(free), -1), mass[np.ix_(free, free)])
        composite = numeric(forces.tangent(ca.SX(0), ca.SX(0))[0]).reshape(len(free), -1)
        near(composite, mass[np.ix_(free, free)])


@settings(deadline=None, max_examples=10)
@given(st.integers(1, 5), seeds)
def test_a_linkage_on_a_floating_base_agrees_with_pinocchio(count: int, seed: int):
    random = np.random.default_rng(seed)
    twin = twins(count, random, floating=True)
    n = twin.model.nv
    q, v, a = random.uniform(-1, 1, n), random.normal(size=n), random.normal(size=n)
    mechanism = Mechanism(Base(ROOT.mass, ROOT.lever, ca.SX(ROOT.inertia)), (twin.linkage,))
    function = Equations(mechanism).dynamics_function()
    order = [0, 1, 2, 5, 4, 3, *range(6, n)]  # ours are roll, pitch, yaw

    mass, forces, *_ = function(q[order], v[order], a[order], [], [], ca.DM(0, 3), GRAVITY, np.zeros(6), [], 1.0)

    expected = pin.crba(twin.model, twin.data, q)
    expected = np.triu(expected) + np.triu(expected, 1).T
    near(np.asarray(mass), expected[np.ix_(order, order)])
    near(-np.asarray(forces).reshape(-1), pin.nonLinearEffects(twin.model, twin.data, q, v)[order])


def test_a_body_of_revolution_moves_the_same_whether_or_not_its_frame_turns_with_it():
    inertia = ca.diag(ca.SX([0.2, 0.5, 0.2]))
    results = []
    for follows in (True, False):
        linkage = Linkage(
            "wheel",
            (
                Body("arm", BASE, Spherical((0, 0, 0)), 3.0, (0.1, 0, 0.2), ca.SX.eye(3) * 0.1),
                Body("wheel", "arm", Revolute((0.2, 0.4, 0), (0, 1, 0), follows), 10.0, (0.2, 0.4, 0), inertia),
            ),
        )
        motion = Motion(linkage, ca.SX([0.3, -0.2, 0.4, 1.7]), ca.SX([1, 2, -1, 50]), ca.SX([1, -3, 2, 7]), ca.SX(0, 3))
        felt = ca.SX([0, 0, 0, 0, 0, 9.8])
        results.append(numeric(Forces(motion, ca.SX(6, 1), felt, ca.SX([0, 0, 1]), ca.SX(0)).residual))
    near(results[0], results[1])


def test_a_linkage_that_mentions_an_unknown_body_is_refused():
    body = Body("arm", BASE, Revolute((0, 0, 0), (0, 1, 0)), 1.0, (1, 0, 0), ca.SX.eye(3))
    with pytest.raises(InputError, match=r"mentions body 'leg'; it has arm, base"):
        Linkage("robot", (body,), springs=(Spring(Between(Point("arm", (1, 0, 0)), Point("leg", (0, 0, 0))), 1.0),))
    with pytest.raises(InputError, match="hangs from 'leg', which is no body before it"):
        Linkage("robot", (Body("arm", "leg", body.joint, 1.0, (1, 0, 0), ca.SX.eye(3)),))
    with pytest.raises(InputError, match="two bodies named 'arm'"):
        Linkage("robot", (body, body))


def test_spatial_inertia_of_a_body_is_the_same_wherever_its_joint_is():
    body = Body("arm", BASE, Revolute((0, 5, 0), (0, 1, 0)), 2.0, (1, 0, 0), ca.SX.eye(3))
    motion = Motion(Linkage("arm", (body,)), ca.SX([0]), ca.SX([0]), ca.SX([0]), ca.SX(0, 3))
    still = ca.SX(6, 1)
    composite = Forces(motion, still, still, ca.SX([0, 0, 1]), ca.SX(0)).tangent(ca.SX(0), ca.SX(0))[3]
    near(numeric(composite), numeric(spatial.rigid_inertia(ca.SX(2), ca.SX([1, 0, 0]), ca.SX.eye(3))))
