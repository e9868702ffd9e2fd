"""The single-track model with forward velocity, lateral velocity and yaw rate, driven by measured wheel speeds (Leung
2010, section 3.4.2).

The longitudinal force comes from the slip of the wheels, whose spin is known; each axle is one wheel that carries both
tyres. Slip counts against the velocity in the plane of the wheel, where eq. 3.21 has all of it.
"""

from __future__ import annotations

from typing import Any

from studies.handling.planar import CHASSIS, Planar, in_car_axes, in_wheel_axes
from vsense_ros.model.handling.base import AXLES, TyreKind, Tyres, loads_at_rest
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.tyres import TyreInput
from vsense_ros.model.vehicle import Vehicle


class Bicycle3Dof(Planar):
    """`tyres` are those of one wheel at "front" and "rear"; an axle has two."""

    states: tuple[str, ...] = Planar.motion
    inputs: tuple[str, ...] = ("steering", "spin_front", "spin_rear")
    driven: tuple[str, ...] = ("spin_rear",)

    def __init__(self, tyres: Tyres) -> None:
        super().__init__(tyres)
        self.parameters = (*CHASSIS, "front_radius", "rear_radius", *tyres.parameters)

    @classmethod
    def of_vehicle(cls, vehicle: Vehicle, kind: TyreKind = "linear") -> Bicycle3Dof:
        """The model with the vehicle's tyres, made linear or as they are."""
        return cls(Tyres.of_vehicle(vehicle, AXLES, kind))

    def spins(self, x: Any, u: Any) -> tuple[Scalar, Scalar]:
        """Spin speeds of both axles [rad/s]."""
        return u.spin_front, u.spin_rear

    def forces(self, x: Any, u: Any, p: Any) -> tuple[Scalar, Scalar, Scalar, list[Scalar]]:
        arms, angles, radii = (p.to_front, -p.to_rear), (u.steering, 0.0), (p.front_radius, p.rear_radius)
        ahead: Scalar = 0.0
        left: Scalar = 0.0
        moment: Scalar = 0.0
        along: list[Scalar] = []
        for i, (place, load, spin) in enumerate(zip(AXLES, loads_at_rest(p), self.spins(x, u), strict=True)):
            moving = in_wheel_axes(x.forward_velocity, x.lateral_velocity + arms[i] * x.yaw_rate, angles[i])
            force_x, force_y = self.tyres.forces(place, TyreInput(load, *moving, radii[i] * spin), p)
            on_car = in_car_axes(2 * force_x, 2 * force_y, angles[i])
            ahead, left, moment = ahead + on_car[0], left + on_car[1], moment + arms[i] * on_car[1]
            along.append(2 * force_x)
        return ahead, left, moment, along

    def rolling(self, speed: float, p: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        spins = {"spin_front": speed / p["front_radius"], "spin_rear": speed / p["rear_radius"]}
        return {"forward_velocity": speed}, spins
