"""What the planar models of Leung 2010 with forward velocity, lateral velocity and yaw rate have in common."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import casadi as ca

from vsense_ros.model.handling.base import HANDLING, HandlingModel, Tyres
from vsense_ros.model.parameter import Scalar

CHASSIS = ("mass", "yaw_inertia", "to_front", "to_rear", "air_density", "drag_area")


class Planar(HandlingModel):
    """What the models with forward velocity, lateral velocity and yaw rate have in common (Leung 2010, eqs. 3.1 to
    3.12): a rigid body in the plane, tyre forces on it, the drag of the air, and no roll or pitch.

    The wheels carry their static loads.
    """

    motion = ("forward_velocity", "lateral_velocity", "yaw_rate")
    outputs = ("longitudinal_acceleration", "lateral_acceleration", "yaw_rate", "lateral_velocity", "side_slip")

    def __init__(self, tyres: Tyres) -> None:
        self.tyres = tyres

    @abstractmethod
    def forces(self, x: Any, u: Any, p: Any) -> tuple[Scalar, Scalar, Scalar, list[Scalar]]:
        """Forces of all tyres on the car: ahead and to the left [N], moment about the upward axis [N m], and for each
        wheel of the model the force along itself [N]."""

    def accelerations(self, x: Any, ahead: Scalar, left: Scalar, p: Any) -> tuple[Scalar, Scalar]:
        """Accelerations of the centre of gravity over ground, ahead and to the left [m/s²]."""
        speed = x.forward_velocity
        drag = 0.5 * p.air_density * p.drag_area * speed * ca.fabs(speed)
        return (ahead - drag) / p.mass, left / p.mass

    def body(self, x: Any, forces: tuple[Scalar, Scalar, Scalar, list[Scalar]], p: Any) -> list[Scalar]:
        """Derivatives of forward velocity, lateral velocity and yaw rate (eqs. 3.1 to 3.3)."""
        ahead, left, moment, _ = forces
        along, across = self.accelerations(x, ahead, left, p)
        return [
            along + x.yaw_rate * x.lateral_velocity,
            across - x.yaw_rate * x.forward_velocity,
            moment / p.yaw_inertia,
        ]

    def rates(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        return self.body(x, self.forces(x, u, p), p)

    def measured(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        ahead, left, *_ = self.forces(x, u, p)
        along, across = self.accelerations(x, ahead, left, p)
        slip = ca.atan2(x.lateral_velocity, ca.fmax(x.forward_velocity, HANDLING.smallest_speed))
        return [along, across, x.yaw_rate, x.lateral_velocity, slip]

    def tyre_numbers(self) -> dict[str, float]:
        return self.tyres.numbers()


def in_wheel_axes(ahead: Scalar, left: Scalar, steering: Scalar) -> tuple[Scalar, Scalar]:
    """A vector of the car along and across a wheel that is turned to the left by `steering` [rad]."""
    cos, sin = ca.cos(steering), ca.sin(steering)
    return ahead * cos + left * sin, left * cos - ahead * sin


def in_car_axes(along: Scalar, across: Scalar, steering: Scalar) -> tuple[Scalar, Scalar]:
    """The inverse of `in_wheel_axes`."""
    return in_wheel_axes(along, across, -steering)
