"""The state of the car as its observers have it: where what stands, what is known of it at start, where it goes.

The state (n,) holds the coordinates, velocities and generalized forces of the car (14 each), the slow disturbances, and
the biases of each sensor; the errors of the same elements have accelerations in place of the forces.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model import coordinates
from vsense_ros.model.coordinates import (
    BANK,
    BANK_CHANGE,
    COORDINATES,
    DISTURBANCES,
    DYNAMIC_COORDINATES,
    GRADE,
    GRADE_CHANGE,
    PITCH,
    ROAD_HEIGHT,
    ROLL,
    SPEED_X,
    SPEED_Y,
    SPIN,
    WHEELS,
    YAW,
    X,
    Y,
    Z,
)
from vsense_ros.model.schema.observer_settings import Disturbances
from vsense_ros.model.sensors import Bias, SensorBase
from vsense_ros.model.sensors.wheel_speeds import LOADED
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.wheel_torques import BRAKING, TorqueErrors

Array = NDArray[np.float64]

# Parts of the state.
Q, U, FORCE = (slice(i * COORDINATES, (i + 1) * COORDINATES) for i in range(3))
SPIN_FORCES = slice(FORCE.start + SPIN.start, FORCE.start + SPIN.stop)
DISTURB = slice(FORCE.stop, FORCE.stop + len(DISTURBANCES))
SLOPES = slice(DISTURB.start + GRADE, DISTURB.start + BANK + 1)  # of the road, along and across
SLOPE_CHANGES = slice(DISTURB.start + GRADE_CHANGE, DISTURB.start + BANK_CHANGE + 1)  # along the way
ROAD_STATES = slice(DISTURB.start + coordinates.ROAD.start, DISTURB.start + coordinates.ROAD.stop)
FORM = slice(DISTURB.start + coordinates.SURFACE.start, DISTURB.start + coordinates.SURFACE.stop)  # of the road
TWIST = slice(U.start + coordinates.TWIST.start, U.start + coordinates.TWIST.stop)  # velocity and rates of the body
FORWARD, LATERAL, YAW_RATE = (U.start + i for i in (SPEED_X, SPEED_Y, coordinates.YAW_RATE))
TURNED, TURNING = [ROLL, PITCH], [Y, X]  # what errors of the tyres' forces turn, and which
_HEIGHT = 100.0  # [m] standard deviation of a height of which nothing is known
_PLACED = 1e-6  # [m], [rad] deviations of a place and a heading that are known
_FIXED = 1e-6  # [-] deviation of the radius of tyres whose wheels nothing measures: no sensor can determine it
# Errors that those of the velocities depend on after a step.
DYNAMIC = np.array(DYNAMIC_COORDINATES)
GAIN_COLUMNS = np.concatenate([DYNAMIC, np.arange(U.start, DISTURB.stop)])
FOLLOWED = np.r_[TWIST, FORM]  # errors that those of the road follow


@dataclass(frozen=True)
class Layout:
    """The place of each sensor's biases in the state."""

    biases: tuple[slice, ...]  # of each sensor
    names: tuple[str, ...]  # of all elements of the state
    size: int


def layout(sensors: dict[str, SensorBase]) -> Layout:
    """State of a vehicle with these sensors."""
    coordinates = ["x", "y", "z", "roll", "pitch", "yaw"] + [f"travel_{w}" for w in WHEELS]
    coordinates += [f"spin_{w}" for w in WHEELS]
    names = [*coordinates, *(f"{c}_rate" for c in coordinates), *(f"{c}_force" for c in coordinates), *DISTURBANCES]
    slices = []
    for name, sensor in sensors.items():
        first = len(names)
        names += [f"{name}.{bias.name}" for bias in sensor.biases()]
        slices.append(slice(first, len(names)))
    return Layout(tuple(slices), tuple(names), len(names))


@dataclass(frozen=True)
class Prior:
    """What is known of the state before any measurement, and how fast that is forgotten."""

    deviation: Array  # (n,) standard deviations of the errors at start
    rate: Array  # (n,) [1/s] at which errors decay, 0: not at all
    density: Array  # (n,) variance added in one second where they do not
    reversion_mean: Array  # (n,) what the state goes back to, and where that behind the velocities starts
    # (2,) roll acceleration per lateral one, and pitch acceleration per longitudinal one [rad/m], of errors of forces:
    # they are the tyres', and act on the road below cog
    levers: Array
    # (2, 3) of grade and bank: one over the distance along which their change is forgotten [1/m], its variance
    # [rad²/m²], and what their own distance from the mean adds to its own rate [1/m²]
    roughness: Array
    torques: TorqueErrors  # of the wheels; rows and columns of their spins are those of brakes that may act

    @classmethod
    def of(cls, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> Prior:
        """The prior of a vehicle with these sensors."""
        places, torques = layout(sensors), TorqueErrors.of(vehicle, sensors)
        errors, around = vehicle.observer.force_errors, vehicle.observer.surroundings
        spin = np.sqrt(torques.covariance[BRAKING].diagonal()).tolist()
        drive = 0.0 if torques.measured else errors.unmeasured_drive
        longitudinal = float(np.hypot(errors.longitudinal, drive))
        body = [longitudinal, errors.lateral, errors.vertical, errors.roll, errors.pitch, errors.yaw]
        deviation = np.zeros(places.size)
        deviation[Q] = [100.0, 100.0, 0.02, 0.02, 0.02, np.pi, *[0.01] * 4, *[1e-3] * 4]
        deviation[U] = [1.0, 0.3, 0.1, 0.05, 0.05, 0.1, *[0.1] * 4, *[2.0] * 4]
        if not any(sensor.on_map for sensor in sensors.values()):
            deviation[[X, Y, YAW]] = _PLACED  # the map is laid by where the car is at start
        deviation[FORCE] = body + [errors.suspension] * 4 + spin
        chassis = vehicle.physics.chassis
        by_lever = chassis.mass * chassis.cog_height
        levers = np.array([by_lever / chassis.roll_inertia, -by_lever / chassis.pitch_inertia])
        deviation[FORCE][TURNED] = np.hypot(deviation[FORCE][TURNED], levers * deviation[FORCE][TURNING])
        deviation[DISTURB] = [
            *(around.grade, around.bank, *np.sqrt(_roughness(around)[:, 1])),
            *(_PLACED, around.steering_offset, around.radius_error if torques.measured else _FIXED),
        ]
        if any("position" in sensor.measures for sensor in sensors.values()):
            deviation[DISTURB][ROAD_HEIGHT] = _HEIGHT  # over an origin that somebody else may have chosen
        time_constant = np.full(places.size, np.inf)
        time_constant[FORCE] = errors.time_constant
        time_constant[FORCE][SPIN] = 1 / torques.rate[BRAKING]
        drift = np.zeros(places.size)
        drift[DISTURB][-2:] = around.steering_offset_drift, around.radius_error_drift if torques.measured else 0.0
        for sensor, part in zip(sensors.values(), places.biases, strict=True):
            biases: tuple[Bias, ...] = sensor.biases()
            deviation[part] = [b.deviation for b in biases]
            drift[part] = [b.drift for b in biases]
            time_constant[part] = [b.time_constant for b in biases]
        reversion_mean = np.zeros(places.size)
        reversion_mean[SLOPES] = np.sum([effect.mean_slope for effect in vehicle.physics.effects.present()], axis=0)
        density = np.where(np.isinf(time_constant), drift**2, 0.0)
        return cls(deviation, 1 / time_constant, density, reversion_mean, levers, _roughness(around), torques)

    @property
    def covariance(self) -> Array:
        """Covariance of the errors at start, (n, n)."""
        covariance = np.diag(self.deviation**2)
        couple(covariance, covariance.diagonal()[FORCE].copy(), FORCE.start, self.levers)
        covariance[SPIN_FORCES, SPIN_FORCES] = self.torques.covariance[BRAKING]
        return covariance

    def placed(self) -> Prior:
        """What is assumed where place and heading are known at start: the map is laid by them."""
        deviation = self.deviation.copy()
        deviation[[X, Y, YAW]] = _PLACED
        return replace(self, deviation=deviation)


def couple(covariance: Array, added: Array, first: int, levers: Array) -> None:
    """Where variances `added` (k,) of the forces' errors were added to a covariance (n, n), from row `first` on, add
    what belongs beside them, as `Prior.levers` has it."""
    for lever, turned, turning in zip(levers.tolist(), TURNED, TURNING, strict=True):
        i, j, shared = first + turned, first + turning, lever * float(added[turning])
        covariance[i, j] += shared
        covariance[j, i] += shared


def _roughness(around: Disturbances) -> Array:
    """As in `Prior`: a slope that is bent at random, and bent back, has this spread in the long run; one that is known
    to be as its mean is not bent."""
    rows = []
    for slope, change in ((around.grade, around.grade_change), (around.bank, around.bank_change)):
        bent = (change**2, (change / slope) ** 2) if slope > 0 else (0.0, 0.0)
        rows.append([1 / around.change_length, *bent])
    return np.array(rows)


def rolling_state(vehicle: Vehicle, speed: float) -> Array:
    """Coordinates and velocities (28,) of a car that rolls straight ahead at `speed` [m/s] on level ground."""
    physics = vehicle.physics
    state = np.zeros(U.stop)
    state[Z] = physics.chassis.cog_height
    state[FORWARD] = speed
    for i, axle in enumerate((physics.front, physics.front, physics.rear, physics.rear)):
        state[U][SPIN][i] = speed / (axle.unloaded_radius * LOADED)
    return state


def largest_state(size: int) -> Array:
    """Amounts (n,) beyond which no car's state is."""
    largest = np.full(size, 1e15)
    largest[[ROLL, PITCH]] = 1.5, 1.4
    largest[[FORWARD, LATERAL, YAW_RATE]] = 150.0, 150.0, 20.0
    return largest
