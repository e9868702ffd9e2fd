"""An estimate in the terms of the car, and as messages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.model.car import PITCH, ROLL, WHEELS, YAW, X
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.kalman import SURROUND
from vsense_ros.recording import Sample

Array = NDArray[np.float64]

_SMALLEST_SPEED = 0.5  # [m/s] below it a side-slip angle has no meaning


@dataclass(frozen=True)
class Estimate:
    """State of the car at one time."""

    stamp: int  # [ns]
    position: Array  # (3,) of cog in the map [m]
    attitude: Array  # (3,) roll, pitch, yaw [rad]
    velocity: Array  # (3,) of cog in body axes [m/s]
    rates: Array  # (3,) body rates [rad/s]
    acceleration: Array  # (3,) kinematic, of cog in body axes [m/s²]
    angular_acceleration: Array  # (3,) [rad/s²]
    wheels: Array  # (7, 4) as Car.wheel_outputs
    pose_covariance: Array  # (6, 6) position, attitude
    twist_covariance: Array  # (6, 6) velocity, rates
    parameter_names: tuple[str, ...]
    parameters: Array  # (k,)
    parameter_deviations: Array  # (k,)

    @classmethod
    def of(cls, stamp: int, ekf: ErrorEkf) -> Estimate:
        """Read a filter whose accelerations belong to its present state."""
        state, covariance = ekf.state, ekf.covariance
        velocity, rates, udot = state[14:17].copy(), state[17:20].copy(), ekf.udot[:, 0]
        slow = slice(SURROUND.start, len(state))
        return cls(
            stamp=stamp,
            position=state[X : X + 3].copy(),
            attitude=state[[ROLL, PITCH, YAW]].copy(),
            velocity=velocity,
            rates=rates,
            acceleration=udot[:3] + np.cross(rates, velocity),
            angular_acceleration=udot[3:6].copy(),
            wheels=ekf.wheel_outputs().copy(),
            pose_covariance=covariance[:6, :6].copy(),
            twist_covariance=covariance[14:20, 14:20].copy(),
            parameter_names=ekf.layout.names[slow],
            parameters=state[slow].copy(),
            parameter_deviations=np.sqrt(np.maximum(covariance.diagonal()[slow], 0)),
        )

    @property
    def side_slip(self) -> tuple[float, float, float]:
        """Angle [rad], its standard deviation [rad] and its rate [rad/s]; zero with an infinite deviation at rest."""
        forward, lateral = self.velocity[0], self.velocity[1]
        square = forward**2 + lateral**2
        if square < _SMALLEST_SPEED**2:
            return 0.0, float("inf"), 0.0
        gradient = np.array([-lateral, forward]) / square
        deviation = float(np.sqrt(max(gradient @ self.twist_covariance[:2, :2] @ gradient, 0.0)))
        body_rate = self.acceleration[:2] - self.rates[2] * np.array([-lateral, forward])
        return float(np.arctan2(lateral, forward)), deviation, float(gradient @ body_rate)


def estimate_samples(e: Estimate) -> list[Sample]:
    """An estimate as the messages of the output topics."""
    slip = np.array(e.side_slip)
    samples = [
        Sample(
            "vsense/odometry",
            "nav_msgs/msg/Odometry",
            e.stamp,
            {
                "position": e.position,
                "orientation": Rotation.from_euler("ZYX", e.attitude[::-1]).as_quat(),
                "pose_covariance": e.pose_covariance.ravel(),
                "linear": e.velocity,
                "angular": e.rates,
                "twist_covariance": e.twist_covariance.ravel(),
            },
            "map",
            child_frame_id="cog",
        ),
        Sample(
            "vsense/acceleration",
            "geometry_msgs/msg/AccelWithCovarianceStamped",
            e.stamp,
            {"linear": e.acceleration, "angular": e.angular_acceleration, "covariance": np.zeros(36)},
            "cog",
        ),
        Sample("vsense/sideslip", "geometry_msgs/msg/Vector3Stamped", e.stamp, {"vector": slip}, "cog"),
        Sample(
            "vsense/parameters",
            "sensor_msgs/msg/JointState",
            e.stamp,
            {"position": e.parameters, "velocity": e.parameter_deviations, "effort": np.zeros(0)},
            names=e.parameter_names,
        ),
    ]
    for i, wheel in enumerate(WHEELS):
        force, slips = e.wheels[:4, i], e.wheels[4:, i]
        frame = f"contact_{wheel}"
        samples.append(
            Sample(
                f"vsense/wheel_force/{wheel}",
                "geometry_msgs/msg/WrenchStamped",
                e.stamp,
                {"force": force[:3], "torque": np.array([0.0, 0.0, force[3]])},
                frame,
            )
        )
        samples.append(
            Sample(f"vsense/wheel_slip/{wheel}", "geometry_msgs/msg/Vector3Stamped", e.stamp, {"vector": slips}, frame)
        )
    return samples
