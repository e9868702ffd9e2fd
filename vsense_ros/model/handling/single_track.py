"""The single-track model with similarity tyres: lateral and yaw motion at a speed that is measured (Riekert & Schunck
1940; tyres of Best & Bogdanski 2016), whose forces build up over a distance (Pacejka 2012, sect. 5.4)."""

from __future__ import annotations

from typing import Any

import casadi as ca

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.handling.best_4dof import SMOOTHING, TYRE, tyre
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.tyres.base import TyreInput

LATERAL = tuple(name for name in TYRE if name != "longitudinal_ratio")


class SingleTrack:
    """States: lateral velocity [m/s] and yaw rate [rad/s] at the centre of gravity, lateral forces of the axles [N].
    Inputs: road-wheel angle [rad], speed [m/s]. Outputs: lateral acceleration [m/s²] as a sensor on the body reads it,
    which feels the body roll by `roll_gradient` [rad s²/m]; yaw rate [rad/s]. Wheels carry their loads at rest.

    Forces follow their steady values over the `relaxation_length` [m]: σ/v Ḟ = F(α) - F. Without it a yaw rate that
    comes late is taken for soft tyres.
    """

    states: tuple[str, ...] = ("lateral_velocity", "yaw_rate", "front_force", "rear_force")
    inputs: tuple[str, ...] = ("steering", "speed")
    outputs: tuple[str, ...] = ("lateral_acceleration", "yaw_rate")
    parameters: tuple[str, ...] = (
        "front_weight", "rear_weight", "wheelbase", "friction", "yaw_inertia", "relaxation_length", "roll_gradient",
        *(f"{axle}_{name}" for axle in ("front", "rear") for name in TYRE),
    )  # fmt: skip

    def rates(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Time derivatives of the states, (4,)."""
        front, rear, to_front, to_rear = self._axles(x, u, p)
        mass = (p.front_weight + p.rear_weight) / GRAVITY
        follow = ca.fmax(u.speed, SMOOTHING.slowest) / p.relaxation_length
        return [
            (x.front_force + x.rear_force) / mass - u.speed * x.yaw_rate,
            (to_front * x.front_force - to_rear * x.rear_force) / p.yaw_inertia,
            follow * (front - x.front_force),
            follow * (rear - x.rear_force),
        ]

    def measured(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Outputs (2,)."""
        mass = (p.front_weight + p.rear_weight) / GRAVITY
        return [(x.front_force + x.rear_force) / mass * (1 + GRAVITY * p.roll_gradient), x.yaw_rate]

    def _axles(self, x: Any, u: Any, p: Any) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """Steady lateral forces of the axles [N], and how far they are from the centre of gravity [m]."""
        to_front = p.wheelbase * p.rear_weight / (p.front_weight + p.rear_weight)
        to_rear = p.wheelbase - to_front
        speed, cos, sin = ca.fmax(u.speed, SMOOTHING.slowest), ca.cos(u.steering), ca.sin(u.steering)
        left = x.lateral_velocity + to_front * x.yaw_rate
        ahead, across = speed * cos + left * sin, left * cos - speed * sin
        wheel = TyreInput(p.front_weight / 2, ca.fmax(ahead, SMOOTHING.slowest), across, ahead, p.friction)
        front = 2 * tyre(p, "front").forces(wheel).lateral * cos
        wheel = TyreInput(p.rear_weight / 2, speed, x.lateral_velocity - to_rear * x.yaw_rate, speed, p.friction)
        return front, 2 * tyre(p, "rear").forces(wheel).lateral, to_front, to_rear
