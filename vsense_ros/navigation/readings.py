"""The vocabulary: which inputs and measurements of filters come from which sensor of a car, and how.

A sensor is known by what it measures (`model.sensors.base.MeasuredQuantity`), so that any kind which measures the same
will do. A measurement that no sensor gives is a condition, such as rolling without side slip: it is applied at each
inertial reading, with its own standard deviations, where its `when` says so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, cos, hypot, nan, sin
from typing import NamedTuple

import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.model.sensors.base import MeasuredQuantity

SLOWEST_COURSE = 1.0  # [m/s] below it the direction of a velocity means nothing to any filter here


class FromSensor(NamedTuple):
    """Components of a reading: `measures` says of which sensor."""

    measures: MeasuredQuantity
    places: tuple[int, ...]


# Readings of the inertial sensor are in the axes of the car, and at cog but for its angular acceleration.
INPUTS = {
    "roll_rate": FromSensor("rates and forces", (0,)),
    "pitch_rate": FromSensor("rates and forces", (1,)),
    "yaw_rate": FromSensor("rates and forces", (2,)),
    "acceleration_x": FromSensor("rates and forces", (3,)),
    "acceleration_y": FromSensor("rates and forces", (4,)),
    "acceleration_z": FromSensor("rates and forces", (5,)),
    "steer_angle": FromSensor("steering", (0,)),
    "spin_rear_left": FromSensor("rolling speed", (2,)),
    "spin_rear_right": FromSensor("rolling speed", (3,)),
    "held_east": FromSensor("course", (0,)),
    "held_north": FromSensor("course", (1,)),
}
# Which number of the car (`car_numbers`) is the standard deviation of an input; others are as if without noise.
NOISE_OF_INPUTS = {
    **dict.fromkeys(("roll_rate", "pitch_rate", "yaw_rate"), "gyro_noise"),
    **dict.fromkeys(("acceleration_x", "acceleration_y", "acceleration_z"), "acceleration_noise"),
    **dict.fromkeys(("spin_rear_left", "spin_rear_right"), "spin_noise"),
    "steer_angle": "steering_noise",
}
SPEED = "speed"  # an input besides: of the rear wheels, or over ground where a vehicle file has no wheel speeds
SINCE_FIX = "since_fix"  # an input besides: how long ago the last GNSS velocity was [s]


class Measured(NamedTuple):
    """A measurement that is made of a reading: value (m,) and variances (m,), NaN where it means nothing. For filters
    that are written as C, readings.c has `of` under the same name."""

    measures: MeasuredQuantity
    of: Callable[[Array, Array], tuple[Array, Array]]


def course(value: Array, variance: Array) -> tuple[Array, Array]:
    """Direction of travel; its standard deviation is σ_V / V, in every direction (correction C8 of Leung 2010, B.2).
    Below twice its own standard deviation a velocity has no direction."""
    east, north = value.tolist()
    speed, noise = hypot(east, north), float(variance.max())
    if not speed > max(SLOWEST_COURSE, 2 * noise**0.5):
        return np.array([nan]), variance[:1]
    return np.array([atan2(north, east)]), np.array([noise / speed**2])


def speed_over_ground(value: Array, variance: Array) -> tuple[Array, Array]:
    """Speed over ground, of a velocity (2,)."""
    return np.array([hypot(*value.tolist())]), variance.max(keepdims=True)


def heading(value: Array, variance: Array) -> tuple[Array, Array]:
    """Heading by two antennas, from its cosine and sine."""
    return np.array([atan2(value[1], value[0])]), variance[:1]


SPIN_SLIP = 0.005  # of a spin, by which wheels that drive or brake differ from rolling


def rear_spin(value: Array, variance: Array) -> tuple[Array, Array]:
    """Mean of both rear wheels, with the slip of wheels that drive."""
    mean = 0.5 * (value[2] + value[3])
    return np.array([mean]), np.array([0.25 * (variance[2] + variance[3]) + (SPIN_SLIP * mean) ** 2])


@dataclass(frozen=True)
class Components:
    """Some components of a reading as they are."""

    places: list[int]

    def __call__(self, value: Array, variance: Array) -> tuple[Array, Array]:
        return value[self.places], variance[self.places]


@dataclass(frozen=True)
class RollingSpeed:
    """Speed of the rear wheels with this rolling radius [m]."""

    radius: float

    def __call__(self, value: Array) -> float:
        return 0.5 * self.radius * float(value[2] + value[3])


def travelling_speed(value: Array) -> float:
    """Over ground, of a velocity (2,)."""
    return hypot(*value.tolist())


MEASUREMENTS = {
    "course": Measured("course", course),
    "gnss_speed": Measured("course", speed_over_ground),
    "gnss_velocity": Measured("course", Components([0, 1])),
    "gnss_position": Measured("position", Components([0, 1])),
    "heading": Measured("heading", heading),
    "roll": Measured("tilt", Components([0])),
    "pitch": Measured("tilt", Components([1])),
    "steering": Measured("steering", Components([0])),
    "gyro": Measured("rates and forces", Components([2])),
    "lateral_force": Measured("rates and forces", Components([4])),
    "rear_spin": Measured("rolling speed", rear_spin),
    "rear_spins": Measured("rolling speed", Components([2, 3])),
}
CONDITIONS_AT: MeasuredQuantity = "rates and forces"  # readings with which conditions are applied


def turned(east: float, north: float, yaw: float) -> tuple[float, float]:
    """A velocity on the map in the axes of a car that heads to `yaw` [rad]."""
    c, s = cos(yaw), sin(yaw)
    return c * east + s * north, c * north - s * east
