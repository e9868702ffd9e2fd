"""Do the estimated tyre forces add up to what the inertial sensor feels? Newton's law for the whole car, which holds
whatever the model of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors.imu import Imu
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

CUTOFF = 2.0  # [Hz] above it a road shakes wheels and sensor each in its own way


@dataclass(frozen=True)
class Balance:
    """n instants; loads and the specific force are low-passed at `CUTOFF`."""

    loads: Array  # (n, 4) vertical forces [N]
    expected_sum: Array  # (n,) of the loads: mass times specific force along the normal [N]
    expected_front: Array  # (n,) of both front wheels: balance of moments about the rear axle's contact points [N]

    def select(self, rows: NDArray[np.bool_]) -> Balance:
        """Some of the instants, (n,)."""
        return Balance(self.loads[rows], self.expected_sum[rows], self.expected_front[rows])

    @property
    def sum_percent(self) -> float:
        """Root mean square by which the sum of the loads is off, of the weight at rest."""
        return _percent(self.loads.sum(axis=1) - self.expected_sum, self.expected_sum)

    @property
    def front_percent(self) -> float:
        """The same of the front axle, of its load at rest."""
        return _percent(self.loads[:, :2].sum(axis=1) - self.expected_front, self.expected_front)


def _percent(error: Array, expected: Array) -> float:
    return float(100 * np.sqrt(np.mean(error**2)) / np.median(expected))


def balance(recording: Recording, stamp: Array, attitude: Array, loads: Array, vehicle: Vehicle) -> Balance:
    """Of estimates at the times `stamp` (n,) [ns]: `attitude` (n, 2) are roll and pitch over the road
    [rad], `loads` (n, 4) the vertical forces [N]. The sensor is the vehicle's first IMU, moved to cog by the rates that
    it measures."""
    imu = next(sensor for sensor in vehicle.sensors.values() if isinstance(sensor, Imu))
    channel = recording[imu.topic]
    to_car = Rotation.from_euler("xyz", imu.attitude)
    force, rates = (to_car.apply(channel.columns[name]) for name in ("linear_acceleration", "angular_velocity"))
    at = channel.stamp * 1e-9
    sections = butter(2, CUTOFF, fs=1 / float(np.median(np.diff(at))), output="sos")
    force, rates = sosfiltfilt(sections, force, axis=0), sosfiltfilt(sections, rates, axis=0)
    arm = np.array(imu.position)
    turning = np.gradient(rates, at, axis=0)
    force = force - np.cross(turning, arm) - np.cross(rates, np.cross(rates, arm))
    now = stamp * 1e-9
    body = np.column_stack([np.interp(now, at, column) for column in force.T])
    felt = Rotation.from_euler("YX", attitude[:, ::-1]).apply(body)
    sections = butter(2, CUTOFF, fs=1 / float(np.median(np.diff(now))), output="sos")
    smooth = sosfiltfilt(sections, loads, axis=0)
    chassis = vehicle.physics.chassis
    to_front, to_rear = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    front = chassis.mass * (felt[:, 2] * to_rear - felt[:, 0] * chassis.cog_height) / (to_front + to_rear)
    return Balance(smooth, chassis.mass * felt[:, 2], front)
