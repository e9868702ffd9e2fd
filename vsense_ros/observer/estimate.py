"""An estimate in the terms of the car, and as messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.model.car import PITCH, ROLL, SURROUNDINGS, WHEELS, YAW, X, Y
from vsense_ros.model.vehicle import Chassis
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.kalman import FORCE, SURROUND
from vsense_ros.recording import Sample

Array = NDArray[np.float64]

_STEERING_OFFSET = SURROUNDINGS.index("steering_offset")
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
    wheels: Array  # (7, 4) as Car.wheel_outputs, lateral forces with the error that the filter found
    pose_covariance: Array  # (6, 6) position, attitude
    twist_covariance: Array  # (6, 6) velocity, rates
    parameter_names: tuple[str, ...]
    parameters: Array  # (k,)
    parameter_deviations: Array  # (k,)

    @classmethod
    def of(cls, stamp: int, ekf: ErrorEkf) -> Estimate:
        """Read a filter, and leave it as it is."""
        state, covariance = ekf.state, ekf.covariance
        velocity, rates = state[14:17].copy(), state[17:20].copy()
        udot, wheels = ekf.present()
        slow = slice(SURROUND.start, len(state))
        steering = float(ekf.inputs[0] - state[SURROUND][_STEERING_OFFSET])
        return cls(
            stamp=stamp,
            position=state[X : X + 3].copy(),
            attitude=state[[ROLL, PITCH, YAW]].copy(),
            velocity=velocity,
            rates=rates,
            acceleration=udot[:3] + _cross(rates, velocity),
            angular_acceleration=udot[3:6].copy(),
            wheels=with_lateral_error(wheels, state[FORCE], steering, ekf.vehicle.physics.chassis),
            pose_covariance=covariance[:6, :6].copy(),
            twist_covariance=covariance[14:20, 14:20].copy(),
            parameter_names=ekf.layout.names[slow],
            parameters=state[slow].copy(),
            parameter_deviations=np.sqrt(np.maximum(covariance.diagonal()[slow], 0)),
        )

    @property
    def side_slip(self) -> Array:
        """Angle [rad], its standard deviation [rad] and its rate [rad/s], (3,); zero with an infinite deviation at
        rest."""
        forward, lateral = self.velocity[..., 0], self.velocity[..., 1]
        square = forward**2 + lateral**2
        rests = square < _SMALLEST_SPEED**2
        across = np.stack([-lateral, forward], axis=-1)
        gradient = across / np.where(rests, 1.0, square)[..., None]
        variance = np.einsum("...i,...ij,...j", gradient, self.twist_covariance[..., :2, :2], gradient)
        deviation = np.where(rests, np.inf, np.sqrt(np.maximum(variance, 0.0)))
        body_rate = self.acceleration[..., :2] - self.rates[..., 2:3] * across
        rate = (gradient * body_rate).sum(axis=-1)
        angle = np.arctan2(lateral, forward)
        return np.stack([np.where(rests, 0.0, angle), deviation, np.where(rests, 0.0, rate)], axis=-1)


def _cross(a: Array, b: Array) -> Array:
    """Of two vectors, in a tenth of the time that `numpy.cross` takes."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def stacked(estimates: Sequence[Estimate]) -> Estimate:
    """Many estimates as one, whose arrays have one more axis in front; its stamp is that of the first."""
    arrays: dict[str, Any] = {
        f.name: np.array([getattr(e, f.name) for e in estimates])
        for f in fields(Estimate)
        if f.name not in ("stamp", "parameter_names")
    }
    return replace(estimates[0], **arrays)


def with_lateral_error(wheels: Array, force: Array, steering: float, chassis: Chassis) -> Array:
    """Outputs of the wheels (7, 4) as the model has them, with its lateral force error given to the tyres.

    `force` (14) are the generalized forces that the filter found missing, `steering` is the road-wheel angle [rad].

    The filter finds what the model's lateral force and yaw moment lack, but not which force element they belong to. Of
    all that acts across the car (tyres, wind, the road's slope) the tyres are by far the largest and the least known,
    so they get it: force and moment determine the sum of each axle, F_f + F_r = ΔQ_y and l_f F_f - l_r F_r = ΔQ_ψ,
    and its two tyres share it in proportion to their loads, as an error of the friction would be shared. With a
    friction of 0.6 or 0.8 where the model has 1.0 this takes more than half of the error of the lateral forces away.
    The longitudinal error stays where it is: torque and force of a wheel cannot be told apart where neither is
    measured, and a wrong guess is worse than none.
    """
    to_front, to_rear = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    front = (to_rear * force[Y] + force[YAW]) / (to_front + to_rear)
    corrected = wheels.copy()
    for axle, error in ((slice(0, 2), front / np.cos(steering)), (slice(2, 4), force[Y] - front)):
        load = wheels[2, axle]
        if load.sum() > 0:
            corrected[1, axle] += error * load / load.sum()
    return corrected


def estimate_samples(e: Estimate) -> list[Sample]:
    """An estimate as the messages of the output topics; of `stacked` ones, fields have one row for each."""
    rows = e.velocity.shape[:-1]
    samples = [
        Sample(
            "vsense/odometry",
            "nav_msgs/msg/Odometry",
            e.stamp,
            {
                "position": e.position,
                "orientation": Rotation.from_euler("ZYX", e.attitude[..., ::-1]).as_quat(),
                "pose_covariance": e.pose_covariance.reshape(*rows, 36),
                "linear": e.velocity,
                "angular": e.rates,
                "twist_covariance": e.twist_covariance.reshape(*rows, 36),
            },
            "map",
            child_frame_id="cog",
        ),
        Sample(
            "vsense/acceleration",
            "geometry_msgs/msg/AccelWithCovarianceStamped",
            e.stamp,
            {"linear": e.acceleration, "angular": e.angular_acceleration, "covariance": np.zeros((*rows, 36))},
            "cog",
        ),
        Sample("vsense/sideslip", "geometry_msgs/msg/Vector3Stamped", e.stamp, {"vector": e.side_slip}, "cog"),
        Sample(
            "vsense/parameters",
            "sensor_msgs/msg/JointState",
            e.stamp,
            {"position": e.parameters, "velocity": e.parameter_deviations, "effort": np.zeros((*rows, 0))},
            names=e.parameter_names,
        ),
    ]
    for i, wheel in enumerate(WHEELS):
        frame = f"contact_{wheel}"
        torque = np.zeros((*rows, 3))
        torque[..., 2] = e.wheels[..., 3, i]
        samples.append(
            Sample(
                f"vsense/wheel_force/{wheel}",
                "geometry_msgs/msg/WrenchStamped",
                e.stamp,
                {"force": e.wheels[..., :3, i], "torque": torque},
                frame,
            )
        )
        slips = {"vector": e.wheels[..., 4:, i]}
        samples.append(Sample(f"vsense/wheel_slip/{wheel}", "geometry_msgs/msg/Vector3Stamped", e.stamp, slips, frame))
    return samples
