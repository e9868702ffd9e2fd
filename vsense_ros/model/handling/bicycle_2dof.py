"""The single-track model in side slip and yaw rate at a given speed (Leung 2010, eq. 3.20; Riekert & Schunck 1940).

    β̇ = (F_f + F_r) / (m V) - r,  ṙ = (a F_f - b F_r) / J
    F_f = C_f (δ - β - a r / V),  F_r = C_r (b r / V - β)

The thesis has b² C_R with the wrong sign in its ṙ. Small angles, constant speed, left and right wheel in one.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from vsense_ros.model.handling.base import AXLES, HandlingModel, Tyres, loads_at_rest
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.tyres import TyreInput
from vsense_ros.model.vehicle import Vehicle

SLOWEST = 2.0  # [m/s] below which the model, whose equations divide by the speed, goes on as at this speed


class Bicycle2Dof(HandlingModel):
    """Linear with axle stiffnesses [N/rad] as parameters, or with `tyres` at "front" and "rear" in their place."""

    states = ("side_slip", "yaw_rate")
    inputs = ("steering", "speed")
    outputs = ("lateral_acceleration", "yaw_rate", "lateral_velocity", "side_slip")

    def __init__(self, tyres: Tyres | None = None) -> None:
        self.tyres = tyres
        of_tyres = ("front_stiffness", "rear_stiffness") if tyres is None else tyres.parameters
        self.parameters = ("mass", "yaw_inertia", "to_front", "to_rear", *of_tyres)

    @classmethod
    def of_vehicle(cls, vehicle: Vehicle) -> Bicycle2Dof:
        """The model with the tyres of the vehicle file."""
        return cls(Tyres.of_vehicle(vehicle, AXLES, "own"))

    def axle_forces(self, x: Any, u: Any, p: Any) -> tuple[Scalar, Scalar]:
        """Lateral forces of the front and of the rear axle, both wheels together, to the left [N]."""
        speed = ca.fmax(u.speed, SLOWEST)
        front = x.side_slip + p.to_front * x.yaw_rate / speed - u.steering
        rear = x.side_slip - p.to_rear * x.yaw_rate / speed
        if self.tyres is None:
            return -p.front_stiffness * front, -p.rear_stiffness * rear
        axle_forces = [
            2 * self.tyres.forces(place, TyreInput(load, speed, speed * angle, speed), p)[1]
            for place, load, angle in zip(AXLES, loads_at_rest(p), (front, rear), strict=True)
        ]
        return axle_forces[0], axle_forces[1]

    def rates(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        front, rear = self.axle_forces(x, u, p)
        return [
            (front + rear) / (p.mass * ca.fmax(u.speed, SLOWEST)) - x.yaw_rate,
            (p.to_front * front - p.to_rear * rear) / p.yaw_inertia,
        ]

    def measured(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        front, rear = self.axle_forces(x, u, p)
        return [(front + rear) / p.mass, x.yaw_rate, u.speed * x.side_slip, x.side_slip]

    def rolling(self, speed: float, p: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        return {}, {"speed": speed}

    def tyre_numbers(self) -> dict[str, float]:
        return {} if self.tyres is None else self.tyres.numbers()
