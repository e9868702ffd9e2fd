"""Estimates at the place of a reference system: against a rigid body that is moved in closed form."""

import numpy as np
import pytest

from vsense_ros.evaluate.reference import at_reference, mounting_in_words
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Channel, Recording

SPEED, RATE = 10.0, 0.4  # [m/s], [rad/s]: a circle of 25 m


def _circle() -> Recording:
    time = np.linspace(0.0, 2.0, 201)
    stamp = (time * 1e9).astype(np.int64)
    heading = RATE * time
    radius = SPEED / RATE
    zero = np.zeros_like(time)
    columns = {
        "position": np.column_stack([radius * np.sin(heading), radius * (1 - np.cos(heading)), zero]),
        "orientation": np.column_stack([zero, zero, np.sin(heading / 2), np.cos(heading / 2)]),
        "linear": np.tile([SPEED, 0.0, 0.0], (len(time), 1)),
        "angular": np.tile([0.0, 0.0, RATE], (len(time), 1)),
    }
    slip = {"vector": np.zeros((len(time), 3))}
    return Recording(
        {
            "vsense/odometry": Channel("vsense/odometry", "nav_msgs/msg/Odometry", stamp, stamp, columns),
            "vsense/sideslip": Channel("vsense/sideslip", "geometry_msgs/msg/Vector3Stamped", stamp, stamp, slip),
        }
    )


def _mounted(position: tuple[float, float, float], yaw: float):
    vehicle = load_vehicle(vehicle_path("genesis"))
    mounting = vehicle.reference.model_copy(update={"position": position, "yaw": yaw})
    return vehicle.model_copy(update={"reference": mounting})


def test_the_velocity_at_the_reference_is_the_derivative_of_its_position():
    yaw = 0.02
    moved = at_reference(_circle(), _mounted((1.5, -0.3, 0.8), yaw))["vsense/odometry"]
    time = moved.seconds
    derivative = np.gradient(moved.columns["position"], time, axis=0)[1:-1, :2]
    heading = (RATE * time + yaw)[1:-1]
    turn = np.exp(-1j * heading) * (derivative[:, 0] + 1j * derivative[:, 1])
    velocity = moved.columns["linear"][1:-1]
    assert turn.real == pytest.approx(velocity[:, 0], abs=1e-4)
    assert turn.imag == pytest.approx(velocity[:, 1], abs=1e-4)


def test_the_side_slip_at_the_reference_follows_lever_arm_and_mounting_angle():
    moved = at_reference(_circle(), _mounted((2.0, 0.0, 0.0), 0.01))
    expected = np.arctan2(2.0 * RATE, SPEED) - 0.01
    assert moved["vsense/sideslip"].columns["vector"][:, 0] == pytest.approx(np.full(201, expected), abs=1e-12)


def test_a_reference_at_cog_changes_nothing_and_needs_no_words():
    circle, vehicle = _circle(), _mounted((0.0, 0.0, 0.0), 0.0)
    assert at_reference(circle, vehicle) is circle
    assert mounting_in_words(vehicle) == ""
