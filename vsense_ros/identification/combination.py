"""A car with a trailer as a single track, and how its sway is damped: the linear model of Pacejka (2012, section 1.6).

States are the lateral velocity of the car's cog, its yaw rate, and those of the trailer (`model.trailer`). At a speed
their eigenvalues say how fast a sway dies down; the damping ratio of the least damped oscillation falls with speed, and
beyond the critical speed a sway grows (Darling, Tilley & Gao 2009, Vehicle System Dynamics 47).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.manoeuvre.driver import cornering_stiffness
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.parameter import Scalar, symbols, vector
from vsense_ros.model.trailer import Hitch, Trailer
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class SwaySettings:
    """Where oscillations are looked for: decisions of this project."""

    slowest: float = 5.0  # [m/s]
    fastest: float = 60.0  # [m/s]
    precision: float = 0.01  # [m/s] of a critical speed
    stopped: float = 0.05  # [1/s] eigenvalues whose imaginary part is smaller do not oscillate


SWAY = SwaySettings()


@dataclass(frozen=True)
class SingleTrack:
    """The car: numbers, or expressions."""

    mass: Scalar  # [kg]
    yaw_inertia: Scalar  # [kg m²]
    to_front: Scalar  # [m] from cog to the axles
    to_rear: Scalar
    front_stiffness: Scalar  # [N/rad] of both tyres
    rear_stiffness: Scalar
    grip: float = 0.9  # [-] largest lateral force of an axle over its load

    @classmethod
    def of(cls, vehicle: Vehicle) -> SingleTrack:
        """The single track that a vehicle file describes."""
        chassis, physics = vehicle.physics.chassis, vehicle.physics
        a, b = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
        weight = chassis.mass * GRAVITY / (a + b)
        stiffness = (
            cornering_stiffness(physics.front, weight * b / 2),
            cornering_stiffness(physics.rear, weight * a / 2),
        )
        return cls(chassis.mass, chassis.yaw_inertia, a, b, *stiffness)

    def towing(
        self, trailer: Trailer, state: ca.SX, steering: Scalar, speed: Scalar, along: Scalar
    ) -> tuple[ca.SX, ca.SX, Hitch]:
        """Lateral specific force of cog [m/s²], derivative of the yaw rate [rad/s²], and what happens at the hitch, of
        a car whose specific force along is known [m/s²]. `state`: lateral velocity, yaw rate, and the trailer's."""
        lateral, rate = state[0], state[1]
        a, b, d = self.to_front, self.to_rear, trailer.behind(self.to_rear)
        weight = self.mass * GRAVITY / (a + b)
        front = self._force(self.front_stiffness, steering - ca.atan((lateral + a * rate) / speed), weight * b)
        rear = self._force(self.rear_stiffness, ca.atan((b * rate - lateral) / speed), weight * a)
        front *= ca.cos(steering)
        damper = trailer.hitch_damping * (state[3] - rate)
        side, moment = front + rear, a * front - b * rear + damper
        free = ca.vertcat(along + d * rate**2, side / self.mass - d * moment / self.yaw_inertia)
        compliance = ca.vertcat(0, 1 / self.mass + d**2 / self.yaw_inertia)
        hitch = trailer.hitch(state[2:], ca.vertcat(speed, lateral - d * rate), rate, free, compliance)
        pull = hitch.force[1]
        return (side - pull) / self.mass, (moment + d * pull) / self.yaw_inertia, hitch

    def _force(self, stiffness: Scalar, slip: ca.SX, load: Scalar) -> ca.SX:
        limit = self.grip * load
        return limit * ca.tanh(stiffness * slip / limit)

    def rates(self, trailer: Trailer, state: ca.SX, steering: Scalar, speed: Scalar, along: Scalar) -> ca.SX:
        """Derivatives of the state (5,)."""
        lateral, spin_up, hitch = self.towing(trailer, state, steering, speed, along)
        following = hitch.following * (hitch.slip - state[4])
        return ca.vertcat(lateral - speed * state[1], spin_up, state[3] - state[1], hitch.spin_up, following)


def linear(car: SingleTrack, trailer: Trailer, speed: float) -> Array:
    """Matrix of the linear model at a speed [m/s] on a straight road, (5, 5)."""
    numbers = [car.mass, car.yaw_inertia, car.to_front, car.to_rear, car.front_stiffness, car.rear_stiffness]
    return np.array(_matrix()(vector(trailer), numbers, speed))


@cache
def _matrix() -> Any:
    p, trailer = symbols(Trailer(mass=1000.0))
    car, speed, state = ca.SX.sym("car", 6), ca.SX.sym("speed"), ca.SX.sym("state", 5)
    a, b, c, d, e, f = ca.vertsplit(car)
    rates = SingleTrack(a, b, c, d, e, f).rates(trailer, state, 0.0, speed, 0.0)
    at_rest = ca.substitute(ca.jacobian(rates, state), state, ca.DM.zeros(5))
    return ca.Function("sway", [p, car, speed], [at_rest])


def damping_ratio(car: SingleTrack, trailer: Trailer, speed: float) -> float:
    """Damping ratio of the least damped oscillation at a speed [m/s]; 1 where nothing oscillates."""
    values = np.linalg.eigvals(linear(car, trailer, speed))
    swaying = values[values.imag > SWAY.stopped]
    return float(np.min(-swaying.real / np.abs(swaying), initial=1.0))


def critical_speed(car: SingleTrack, trailer: Trailer) -> float | None:
    """Speed from which on a sway grows [m/s]; None if there is none below `SWAY.fastest`."""
    low, high = SWAY.slowest, SWAY.fastest
    if damping_ratio(car, trailer, high) > 0:
        return None
    while high - low > SWAY.precision:
        middle = (low + high) / 2
        low, high = (middle, high) if damping_ratio(car, trailer, middle) > 0 else (low, middle)
    return high
