"""Parts of a driver: hands that steer, feet that drive and brake.

All of them know the car as a driver does, by its size, weight and feel, and act on where it is and how fast it goes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.manoeuvre.track import Along, Track
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import SPEED_X, SPEED_Y, SPIN, YAW, X, Y
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DriverSettings:
    """Abilities of drivers and brakes."""

    front_brake_share: float = 0.6  # [-] of the braking force; the rest is the rear axle's
    # [rad/s] of the road wheels: 480 °/s at a steering wheel of ratio 14; ISO 7401 asks for 200 to 500
    steering_rate: float = 0.6
    largest_angle: float = 0.7  # [rad] of the road wheels: a turning circle of 9 m at a wheelbase of 2.9 m
    # [rad/s] spin below which a brake fades, so that it holds a wheel and does not turn it back
    locked_spin: float = 2.0
    # [m] from the middle of a track: a car that is further off does not drive on it any more
    beside_track: float = 5.0


DRIVER = DriverSettings()


def ramp(t: float, start: float, duration: float) -> float:
    """From 0 to 1 within `duration` [s] after `start` [s]."""
    return min(max((t - start) / duration, 0.0), 1.0)


def within(value: float, limit: float) -> float:
    """The value, or what of ± `limit` is nearest."""
    return min(max(value, -limit), limit)


def wheelbase(vehicle: Vehicle) -> float:
    """Distance of the axles [m]."""
    return vehicle.physics.chassis.cog_to_front_axle + vehicle.physics.chassis.cog_to_rear_axle


def cornering_stiffness(axle: Axle, load: float) -> float:
    """Cornering stiffness of both tyres of an axle together, each under `load` [N]; [N/rad]."""
    return 2 * float(axle.tyre.cornering_stiffness_at(load)) * axle.cornering_scale


def understeer_gradient(vehicle: Vehicle) -> float:
    """Steering beyond the geometric one per lateral acceleration, of the linear bicycle model [rad s²/m]."""
    chassis = vehicle.physics.chassis
    slip = []
    for axle, arm in (
        (vehicle.physics.front, chassis.cog_to_rear_axle),
        (vehicle.physics.rear, chassis.cog_to_front_axle),
    ):
        mass = chassis.mass * arm / wheelbase(vehicle)
        slip.append(mass / cornering_stiffness(axle, mass * GRAVITY / 2))
    return slip[0] - slip[1]


def steady_steering(vehicle: Vehicle, speed: float, lateral_acceleration: float) -> float:
    """Road-wheel angle of the linear bicycle model in a steady turn [rad]."""
    return lateral_acceleration * (wheelbase(vehicle) / speed**2 + understeer_gradient(vehicle))


class Pedals:
    """Wheel torques for a wanted acceleration: driven as the vehicle file says, at the rear if it does not, and braked
    at all wheels."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._mass = vehicle.physics.chassis.mass
        self._radii = rolling_radii(vehicle)
        self._drive = np.array(vehicle.drivetrain.driving_shares or (0.0, 0.0, 0.5, 0.5))
        self._brake = 0.5 * np.array([DRIVER.front_brake_share] * 2 + [1 - DRIVER.front_brake_share] * 2)

    def torques(self, acceleration: float, u: Array) -> Array:
        """(4,) [N m] that accelerate the car's mass by `acceleration` [m/s²], negative: brake."""
        force = self._mass * acceleration
        if force >= 0:
            return force * self._drive * self._radii
        return force * self._brake * self._radii * np.clip(u[SPIN] / DRIVER.locked_spin, -1, 1)


@dataclass
class SpeedKeeper:
    """Feet that keep a speed, which may change with time."""

    vehicle: Vehicle
    speed: Callable[[float], float]  # time [s] → wanted speed [m/s]
    time_constant: float = 0.5  # [s]
    limit: float = 4.0  # [m/s²]
    integral: float = 0.0  # of the resistances that a constant pedal makes up for [m/s²]
    _pedals: Pedals = field(init=False)
    _last: float = 0.0

    def __post_init__(self) -> None:
        self._pedals = Pedals(self.vehicle)

    def __call__(self, t: float, u: Array) -> Array:
        """Wheel torques (4,) [N m]."""
        error = (self.speed(t) - float(u[SPEED_X])) / self.time_constant
        self.integral = within(self.integral + 0.5 * error * (t - self._last), 1.0)
        self._last = t
        return self._pedals.torques(within(error + self.integral, self.limit), u)


class Path(Protocol):
    """A line to be followed."""

    def offset(self, x: float, y: float) -> float:
        """How far the line is to the left of a point in the map [m]."""
        ...


@dataclass(frozen=True)
class Circle:
    """Turning left from the origin, where it runs along x."""

    radius: float

    def offset(self, x: float, y: float) -> float:
        return float(np.hypot(x, y - self.radius)) - self.radius


@dataclass
class PathFollower:
    """Hands that aim at a point ahead on a path.

    The angle is that of the circle through the aim, plus what the car's understeer takes (pure pursuit: κ = 2 e / d²);
    hands and arms follow it with a lag and a limited rate.
    """

    vehicle: Vehicle
    path: Path
    preview: float = 0.4  # [s]
    nearest: float = 3.0  # the aim is never closer [m]
    lag: float = 0.05  # [s]
    angle: float = 0.0  # of the road wheels [rad]
    _last: float = 0.0
    _feel: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        self._feel = wheelbase(self.vehicle), understeer_gradient(self.vehicle)

    def __call__(self, t: float, q: Array, u: Array) -> float:
        """Road-wheel angle [rad]."""
        speed = float(u[SPEED_X])
        ahead = max(self.preview * speed, self.nearest)
        heading = float(q[YAW])
        error = self.path.offset(float(q[X]) + ahead * np.cos(heading), float(q[Y]) + ahead * np.sin(heading))
        curvature = 2 * error / ahead**2
        length, understeer = self._feel
        target = curvature * (length + understeer * speed**2)
        h, self._last = t - self._last, t
        largest = DRIVER.steering_rate * h
        self.angle += within((target - self.angle) * min(h / self.lag, 1.0), largest)
        return self.angle


@dataclass
class TrackFollower:
    """Hands that keep to the middle of a track with little corner cutting. They raise `InputError` where the car leaves
    it.

    They know the curvature that comes and steer for it as the car needs in a steady turn, early by their own lag; what
    is left beside the track at a point ahead is steered back as in `PathFollower`. The car's course counts, not its
    heading: a car that slips sideways through a bend still follows it.
    """

    vehicle: Vehicle
    track: Track
    preview: float = 0.5  # [s]
    nearest: float = 3.0  # the aim is never closer [m]
    lag: float = 0.05  # [s]
    early: float = 0.15  # [s] for lag of the hands and of the car
    angle: float = 0.0  # of the road wheels [rad]
    _last: float = 0.0
    _along: Along = field(init=False)
    _feel: tuple[float, float] = field(init=False)

    def __post_init__(self) -> None:
        self._along = Along(self.track)
        self._feel = wheelbase(self.vehicle), understeer_gradient(self.vehicle)

    def __call__(self, t: float, q: Array, u: Array) -> float:
        """Road-wheel angle [rad]."""
        speed = float(u[SPEED_X])
        distance, offset, heading = self._along.find(float(q[X]), float(q[Y]))
        if abs(offset) > DRIVER.beside_track:
            raise InputError(
                f"{self.vehicle.name} leaves the track after {distance:.0f} m, at {3.6 * speed:.0f} km/h: "
                "take a slower drive, or a car with more grip"
            )
        course = float(q[YAW]) + float(np.arctan2(u[SPEED_Y], max(speed, 1.0)))
        ahead = max(self.preview * speed, self.nearest)
        target = self._along.curvature(distance + self.early * speed)
        target -= 2 * (offset + ahead * np.sin(course - heading)) / ahead**2
        length, understeer = self._feel
        target *= length + understeer * speed**2
        target = within(target, DRIVER.largest_angle)
        h, self._last = t - self._last, t
        largest = DRIVER.steering_rate * h
        self.angle += within((target - self.angle) * min(h / self.lag, 1.0), largest)
        return self.angle
