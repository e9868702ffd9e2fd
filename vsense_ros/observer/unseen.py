"""Errors that no innovation shows, added to the covariances that are published.

A filter's covariance is true if its model is right but for white noise. An error that stays the same for minutes and
moves sensors and state together leaves innovations as they should be, so that no estimate of noise from innovations
shows it (a "considered" parameter, Schmidt 1966). Seven of them are in every car and recording:

1. *Where the rear axle points.* Side slip follows from yaw rate and lateral force by the direction in which the rear
   axle rolls. Thrust angle, toe, conicity and roll steer turn it by a tenth of a degree or two. GNSS measures the
   direction of motion, which is heading plus side slip: what one has too much, the other has too little.
2. *When it was.* Stamps are true to about half an interval of a bus; a state that is late by τ is wrong by τ ẋ.
3. *What the gyro does in bends.* Its scale, mounting and bandwidth are in proportion to what it measures.
4. *Where the receiver believes to be.* The errors of satellites, air and reflections last for minutes.
5. *How the road leans.* Roads fall to one side all along, for water to run off, and an inertial sensor that sits askew
   by as much feels the same.
6. *How far the rear axle slips.* Load and stiffness of its tyres are known to a tenth, and the angle with them.
7. *What passed for a bias.* An accelerometer feels a slope and a bias alike; a bias that is far beyond what the file
   expects may be a road's. Across the car tyres hold it on a slope, and slip by as much.

They are added to what is published alone: the filter itself, and with it every estimate, stays as it is.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.schema.observer_settings import UnseenErrors
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.imu import FORCES

Array = NDArray[np.float64]

_ROLL, _PITCH, _YAW = 3, 4, 5  # of position and attitude
_LATERAL, _YAW_RATE = 1, 5  # of velocity and rates
_PLACE = [0, 1]  # of position and attitude
_TWIST_SIZE = 6
_SLOWEST = 1.0  # [m/s] below it a slip angle has no meaning


@dataclass(frozen=True)
class UnseenSettings:
    """How fast a filter corrects what passed for something else: decisions of this project."""

    heading_corrected: float = 4.0  # [s] in which courses correct a heading


SETTINGS = UnseenSettings()


class Motion(Protocol):
    """The motion of a car at one moment, or at many: then all arrays have one more axis in front."""

    @property
    def velocity(self) -> Array:
        """Velocity (3,) in the axes of the car [m/s]."""

    @property
    def rates(self) -> Array:
        """Rates (3,) about the axes of the car [rad/s]."""

    @property
    def udot(self) -> Array:
        """Derivatives (14,) of the generalized velocities."""

    @property
    def orientation(self) -> Array:
        """Attitude on the map as a quaternion (4,), x, y, z, w."""


def add_unseen(
    pose: Array, twist: Array, motion: Motion, unseen: UnseenErrors, receiver_noise: float, to_rear: Array
) -> None:
    """Add what innovations do not show to the covariances (…, 6, 6) of position and attitude, of velocity and rates.

    `receiver_noise` is the standard deviation of the best GNSS position that the vehicle file has [m], 0 for none;
    `to_rear` (…,) are distances from cog to the rear axle [m].
    """
    velocity = motion.velocity
    along, across = velocity[..., 0], velocity[..., 1] - to_rear * motion.rates[..., 2]
    slip = unseen.rear_slip * across / np.maximum(np.abs(along), _SLOWEST)
    axle = unseen.rear_axle_direction**2 + slip**2
    twist[..., _LATERAL, _LATERAL] += axle * along**2
    pose[..., _YAW, _YAW] += axle
    twist[..., _YAW_RATE, _YAW_RATE] += unseen.yaw_rate**2
    pose[..., _PLACE, _PLACE] += (unseen.position_share * receiver_noise) ** 2
    pose[..., _ROLL, _ROLL] += unseen.crossfall**2
    if unseen.timing > 0:
        change = unseen.timing * motion.udot[..., :_TWIST_SIZE]
        twist += outer(change)
        on_map = turned(motion.orientation, velocity)
        pose += outer(unseen.timing * np.concatenate([on_map, motion.rates], axis=-1))


def unlikely_bias(state: Array, sensors: Iterable[SensorBase], biases: Iterable[slice], known: Array) -> Array:
    """Variances (…, 2) along and across the car [m²/s⁴] that the accelerometers' biases in a state (…, n) have beyond
    their standard deviations at start, which `known` (n,) has; the mean of all inertial sensors."""
    added: list[Array] = []
    for sensor, part in zip(sensors, biases, strict=True):
        if "rates and forces" in sensor.measures:
            forces = slice(part.start + FORCES.start, part.start + FORCES.stop)
            shares = _shares_of_axes(*sensor.mounting()[3:6].tolist())
            added.append(np.maximum(state[..., forces] ** 2 - known[forces] ** 2, 0.0) @ shares)
    return np.asarray(sum(added) / len(added)) if added else np.zeros((*state.shape[:-1], 2))


@cache
def _shares_of_axes(roll: float, pitch: float, yaw: float) -> Array:
    """Shares (3, 2) of the axes' variances of a sensor with this attitude [rad] in those along and across the car."""
    return np.asarray(Rotation.from_euler("xyz", (roll, pitch, yaw)).as_matrix()[:2].T ** 2)


def add_tilt(pose: Array, motion: Motion, bias: Array, change_length: float, bend: Array) -> None:
    """Add to the covariance (…, 6, 6) of position and attitude that a slope may have been taken for a bias.

    An accelerometer feels a slope and a bias alike, and the filter parts them by what the file expects of both. What a
    bias has beyond its standard deviation, as `unlikely_bias` has it (…, 2), may be the road's. Where the car turns,
    roll that is wrong makes a pitch rate, which passes for a grade that changes along `change_length` [m], and pitch
    that is wrong a roll rate. Such a grade lasts beyond the bend: `bend` (…) is the curvature of late [1/m].
    """
    speed = np.maximum(np.abs(motion.velocity[..., 0]), _SLOWEST)
    curvature = np.maximum(np.abs(motion.rates[..., 2]) / speed, bend)
    turned_by = np.minimum(curvature * change_length, 1.0) ** 2
    pitch, roll = bias[..., 0] / GRAVITY**2, bias[..., 1] / GRAVITY**2
    pose[..., _ROLL, _ROLL] += roll + turned_by * pitch
    pose[..., _PITCH, _PITCH] += pitch + turned_by * roll


def add_drift(pose: Array, twist: Array, motion: Motion, bias: Array, rear_slip: float) -> None:
    """Add to the covariances (…, 6, 6) of position and attitude, of velocity and rates that the rear tyres may slip by
    what passed for a bias across the car, as `unlikely_bias` has it (…, 2): a force that a slope takes up is no force
    of tyres. They slip by `rear_slip` per acceleration [rad s²/m]. While the heading is corrected by as much, the gyro
    seems to have a bias."""
    angle = rear_slip**2 * bias[..., 1]
    twist[..., _LATERAL, _LATERAL] += angle * motion.velocity[..., 0] ** 2
    twist[..., _YAW_RATE, _YAW_RATE] += angle / SETTINGS.heading_corrected**2
    pose[..., _YAW, _YAW] += angle


def outer(vectors: Array) -> Array:
    """Outer products of vectors (…, n) with themselves, (…, n, n)."""
    return vectors[..., :, None] * vectors[..., None, :]


def turned(orientation: Array, vector: Array) -> Array:
    """Vectors (…, 3) turned by quaternions x, y, z, w (…, 4); SciPy takes five times as long for one."""
    x, y, z, w = orientation.T
    a, b, c = vector.T
    u, v, r = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
    return np.array([a + w * u + y * r - z * v, b + w * v + z * u - x * r, c + w * r + x * v - y * u]).T


def receiver_noise(sensors: Iterable[SensorBase]) -> float:
    """Standard deviation of the best of the positions that sensors measure [m]; 0 if none does."""
    noises = (float(sensor.deviations()[:2].max()) for sensor in sensors if "position" in sensor.measures)
    return min(noises, default=0.0)
