"""Readings of an inertial sensor that is mounted in other axes than those of the car, and away from cog."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vsense_ros.estimation.timeline import Event
from vsense_ros.model.sensors import GnssVelocity, Imu
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.catalogue import DEFINITIONS
from vsense_ros.runner.kinematic_axes import KinematicAxes

NUMBERS = {"gyro_noise": 0.002, "sample_time": 0.01, "straight_rate": 0.02}
ARM = np.array([0.8, -0.3, 0.4])  # from cog to the sensor [m]


@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2), (0.3, -0.2, 2.0)])
def test_a_reading_is_turned_into_the_axes_of_the_car_and_brought_to_cog(attitude: tuple[float, float, float]) -> None:
    imu = Imu(position=tuple(ARM), attitude=attitude)
    sensors = {"imu": imu, "velocity": GnssVelocity()}
    axes = KinematicAxes(Aided("yaw_kkf", DEFINITIONS["yaw_kkf"][1], NUMBERS, sensors), sensors)
    rates, forces = np.array([0.1, -0.2, 0.5]), np.array([1.0, -2.0, 9.8])
    at_sensor = forces + np.cross(rates, np.cross(rates, ARM))
    mounted = Rotation.from_euler("ZYX", attitude[::-1]).inv()
    value = np.concatenate([mounted.apply(rates), mounted.apply(at_sensor)])
    event = Event(0, 0, value, np.ones(6))
    np.testing.assert_allclose(axes.in_axes_of_car(event), np.concatenate([rates, forces]), atol=1e-12)
