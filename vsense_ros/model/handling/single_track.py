"""The single-track model with similarity tyres: lateral and yaw motion at a speed that is measured (Riekert & Schunck
1940; tyres of Best & Bogdanski 2016)."""

from __future__ import annotations

from typing import Any

import casadi as ca

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.handling.best_4dof import SLOWEST, TYRE, tyre
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.tyres.base import TyreInput

LATERAL = tuple(name for name in TYRE if name != "longitudinal_ratio")


class SingleTrack:
    """States: lateral velocity [m/s] and yaw rate [rad/s] at the centre of gravity. Inputs: road-wheel angle [rad],
    speed [m/s]. Outputs: lateral acceleration [m/s²], yaw rate [rad/s]. Wheels carry their loads at rest."""

    states: tuple[str, ...] = ("lateral_velocity", "yaw_rate")
    inputs: tuple[str, ...] = ("steering", "speed")
    outputs: tuple[str, ...] = ("lateral_acceleration", "yaw_rate")
    parameters: tuple[str, ...] = (
        "front_weight", "rear_weight", "wheelbase", "friction", "yaw_inertia",
        *(f"{axle}_{name}" for axle in ("front", "rear") for name in TYRE),
    )  # fmt: skip

    def rates(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Time derivatives of the states, (2,)."""
        front, rear, to_front, to_rear = self._axles(x, u, p)
        mass = (p.front_weight + p.rear_weight) / GRAVITY
        return [
            (front + rear) / mass - u.speed * x.yaw_rate,
            (to_front * front - to_rear * rear) / p.yaw_inertia,
        ]

    def measured(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        """Outputs (2,)."""
        front, rear, _, _ = self._axles(x, u, p)
        return [(front + rear) / (p.front_weight + p.rear_weight) * GRAVITY, x.yaw_rate]

    def _axles(self, x: Any, u: Any, p: Any) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        """Lateral forces of the axles [N], and how far they are from the centre of gravity [m]."""
        to_front = p.wheelbase * p.rear_weight / (p.front_weight + p.rear_weight)
        to_rear = p.wheelbase - to_front
        speed, cos, sin = ca.fmax(u.speed, SLOWEST), ca.cos(u.steering), ca.sin(u.steering)
        left = x.lateral_velocity + to_front * x.yaw_rate
        ahead, across = speed * cos + left * sin, left * cos - speed * sin
        wheel = TyreInput(p.front_weight / 2, ca.fmax(ahead, SLOWEST), across, ahead, p.friction)
        front = 2 * tyre(p, "front").forces(wheel).lateral * cos
        wheel = TyreInput(p.rear_weight / 2, speed, x.lateral_velocity - to_rear * x.yaw_rate, speed, p.friction)
        return front, 2 * tyre(p, "rear").forces(wheel).lateral, to_front, to_rear
