"""The road under the car against a rigid body that is moved over a surface in space."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from vsense_ros.model.car.kinematics import kinematics, motion_of, road_kinematics
from vsense_ros.model.car.pose import angles, orientation_on_map, position_on_map, tilt_on_map
from vsense_ros.model.car.road import Road
from vsense_ros.model.coordinates import INPUTS
from vsense_ros.model.simulation.surface import Surface, Waves

Array = np.ndarray
seeds = st.integers(0, 2**32 - 1)
relaxed = settings(deadline=None, max_examples=30)
H = 1e-4  # [s]
HILLS = Waves(((4.0, 0.4, 300.0), (0.6, 2.1, 60.0), (2.0, -1.0, 130.0)))


def axes_of_road(surface: Surface, x: float, y: float, heading: float) -> tuple[Array, Array]:
    """Point of the surface, and the road's axes as columns (3, 3), by finite differences of the height alone."""
    eps = 1e-3
    height = surface.shape(x, y)[0]
    slope = np.array(
        [surface.shape(x + dx, y + dy)[0] - surface.shape(x - dx, y - dy)[0] for dx, dy in eps * np.eye(2)]
    )
    normal = np.array([*-slope / (2 * eps), 1.0])
    normal /= np.linalg.norm(normal)
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    ahead[2] = -(normal[:2] @ ahead[:2]) / normal[2]
    ahead /= np.linalg.norm(ahead)
    return np.array([x, y, height]), np.column_stack([ahead, np.cross(normal, ahead), normal])


def coordinates_over(surface: Surface, place: Array, body: Array, guess: Array) -> Array:
    """x, y of cog, height over the road, roll, pitch, and heading of the road's axes, of a body in space."""

    def gap(unknown: Array) -> Array:
        x, y, z, heading = unknown
        foot, axes = axes_of_road(surface, x, y, heading)
        return np.append(foot + z * axes[:, 2] - place, (axes.T @ body)[1, 0])

    x, y, z, heading = fsolve(gap, guess, xtol=1e-13)
    over = axes_of_road(surface, x, y, heading)[1].T @ body
    return np.array([*place[:2], z, np.arctan2(over[2, 1], over[2, 2]), -np.arcsin(over[2, 0]), heading])


def standing(random: np.random.Generator) -> tuple[Array, Array, Array, Array, Array, Array]:
    """A body somewhere over the hills: foot (2), road's axes, place and attitude in space, coordinates, road."""
    foot, heading, z = random.uniform(-100, 100, 2), random.uniform(-3, 3), 0.5
    roll, pitch = random.uniform(-0.05, 0.05, 2)
    point, axes = axes_of_road(HILLS, *foot, heading)
    place = point + z * axes[:, 2]
    body = axes @ Rotation.from_euler("ZYX", [0.0, pitch, roll]).as_matrix()
    q, road = np.zeros(14), np.zeros(7)
    q[:6] = *place[:2], z, roll, pitch, heading
    road[:5] = HILLS.under(*foot, heading)
    return foot, axes, place, body, q, road


@relaxed
@given(seed=seeds)
def test_a_body_that_moves_in_space_goes_over_the_surface_as_the_kinematics_say(seed: int) -> None:
    random = np.random.default_rng(seed)
    foot, axes, place, body, q, road = standing(random)
    z, heading = q[2], q[5]
    u = np.zeros(14)
    u[:3] = random.uniform(-1, 1, 3) * [30, 3, 0.5]
    u[3:6] = random.uniform(-0.5, 0.5, 3)
    ends, roads = [], []
    for sign in (-1, 1):
        turned = body @ Rotation.from_rotvec(sign * H * u[3:6]).as_matrix()
        moved = place + sign * H * body @ u[:3]
        there = coordinates_over(HILLS, moved, turned, np.array([*foot, z, heading]))
        ends.append(there)
        below = fsolve(
            lambda xy, at=moved, t=there: at[:2] - xy - t[2] * axes_of_road(HILLS, *xy, t[5])[1][:2, 2], foot
        )
        roads.append(HILLS.under(*below, there[5]))

    rate = np.asarray(ca.evalf(kinematics(ca.SX(q), ca.SX(u), ca.SX(road))))[:6, 0]
    change = np.asarray(ca.evalf(road_kinematics(ca.SX(q), ca.SX(u), ca.SX(road))))[:, 0]

    # A curvature across the car, which the equations leave out, turns the road under a car that slides sideways.
    second, sideways = HILLS.shape(*foot)[2], (axes.T @ body @ u[:3])[1]
    crown = axes[:2, 1] @ second @ axes[:2, 1] * axes[2, 2]
    rate[3] -= crown * sideways
    change[1] += crown * sideways
    # The axes' origin stays below cog: on a surface that is bent by 0.01 1/m it is slower than cog by half a per cent.
    expected = (ends[1] - ends[0]) / (2 * H)
    bent = (np.abs(road[2:4]).sum() + abs(crown)) * z
    assert_allclose(rate, expected, atol=1e-4 + 2 * bent * np.abs(expected).max() * 0.05)
    expected = (np.array(roads[1]) - np.array(roads[0])) / (2 * H)
    assert_allclose(change[:2], expected[:2], atol=1e-4 + 2 * bent * np.abs(expected[:2]).max())
    assert change[2] == pytest.approx(expected[4], abs=1e-4 + 0.2 * bent * np.abs(u[:3]).max())


@relaxed
@given(seed=seeds)
def test_place_and_attitude_on_the_map_are_those_in_space(seed: int) -> None:
    _, _, place, body, q, road = standing(np.random.default_rng(seed))

    orientation = orientation_on_map(q, road)
    symbolic = motion_of(*(ca.SX(x) for x in (q, np.zeros(14), np.zeros(14), road)), ca.SX.zeros(len(INPUTS)))

    assert_allclose(Rotation.from_quat(orientation).as_matrix(), body, atol=1e-5)
    roll_pitch_yaw = Rotation.from_quat(orientation).as_euler("ZYX")[::-1]
    assert_allclose(angles(orientation), roll_pitch_yaw, atol=1e-12)
    tilt = tilt_on_map(q[3], q[4], *road[:2].tolist())
    assert tilt == pytest.approx(np.abs(roll_pitch_yaw[:2]).max(), abs=1e-9)
    assert_allclose(position_on_map(q, road), place, atol=1e-6)
    assert_allclose(np.asarray(ca.evalf(symbolic.attitude)), body, atol=1e-5)
    assert_allclose(np.asarray(ca.evalf(symbolic.position))[:, 0], place, atol=1e-6)
    assert_allclose(np.asarray(ca.evalf(symbolic.gravity))[:, 0], body.T @ [0, 0, -9.80665], atol=1e-4)


def test_the_road_under_a_wheel_is_the_surface_there() -> None:
    """Its tangent plane, on a surface of constant curvature and twist."""
    bend, twist = 0.01, 0.004
    x, y, z = 1.4, -0.8, 0.55
    under = Road(ca.SX([0, 0, bend, twist, 0, 0, 0])).under(ca.SX(x), ca.SX(y), ca.SX(z))
    normal, height = (np.asarray(ca.evalf(value))[:, 0] for value in under)
    gradient = np.array([bend * x + twist * y, twist * x])
    assert_allclose(normal, np.array([*-gradient, 1]) / np.linalg.norm([*gradient, 1]), rtol=1e-12)
    point = np.array([x, y, bend * x**2 / 2 + twist * x * y])
    assert height[0] == pytest.approx(normal @ ([0, 0, z] - point), rel=1e-12)
