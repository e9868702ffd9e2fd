"""The twin-track model with forward velocity, lateral velocity and yaw rate, driven by four measured wheel speeds
(Leung 2010, section 3.4.4).

Each wheel has its own velocity (eq. 3.22), and longitudinal forces turn the car by their lever arms.
"""

from __future__ import annotations

from typing import Any

from studies.handling.planar import CHASSIS, Planar, in_car_axes, in_wheel_axes
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.handling.base import TyreKind, Tyres, loads_at_rest
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.tyres import TyreInput
from vsense_ros.model.vehicle import Vehicle


class TwinTrack3Dof(Planar):
    """`tyres` are those of the wheels fl, fr, rl, rr."""

    states: tuple[str, ...] = Planar.motion
    inputs: tuple[str, ...] = ("steering_fl", "steering_fr", *(f"spin_{wheel}" for wheel in WHEELS))
    driven: tuple[str, ...] = ("spin_rl", "spin_rr")

    def __init__(self, tyres: Tyres) -> None:
        super().__init__(tyres)
        tracks, radii = ("front_half_track", "rear_half_track"), tuple(f"radius_{wheel}" for wheel in WHEELS)
        self.parameters = (*CHASSIS, *tracks, *radii, *tyres.parameters)

    @classmethod
    def of_vehicle(cls, vehicle: Vehicle, kind: TyreKind = "linear") -> TwinTrack3Dof:
        """The model with the vehicle's tyres, made linear or as they are."""
        return cls(Tyres.of_vehicle(vehicle, WHEELS, kind))

    def spins(self, x: Any, u: Any) -> list[Scalar]:
        """Spin speeds of the wheels [rad/s]."""
        return [u[f"spin_{wheel}"] for wheel in WHEELS]

    def forces(self, x: Any, u: Any, p: Any) -> tuple[Scalar, Scalar, Scalar, list[Scalar]]:
        arms, sides, loads = (p.to_front, -p.to_rear), (p.front_half_track, p.rear_half_track), loads_at_rest(p)
        angles = (u.steering_fl, u.steering_fr, 0.0, 0.0)
        ahead: Scalar = 0.0
        left: Scalar = 0.0
        moment: Scalar = 0.0
        along: list[Scalar] = []
        for i, (wheel, spin) in enumerate(zip(WHEELS, self.spins(x, u), strict=True)):
            arm, side = arms[i // 2], sides[i // 2] * (1 if i % 2 == 0 else -1)  # place ahead and to the left
            velocity = x.forward_velocity - side * x.yaw_rate, x.lateral_velocity + arm * x.yaw_rate
            contact = TyreInput(
                loads[i // 2], *in_wheel_axes(*velocity, angles[i]), p[f"radius_{wheel}"] * spin, side=1 - 2 * (i % 2)
            )
            force_x, force_y = self.tyres.forces(wheel, contact, p)
            on_car = in_car_axes(force_x, force_y, angles[i])
            ahead, left = ahead + on_car[0], left + on_car[1]
            moment = moment + arm * on_car[1] - side * on_car[0]
            along.append(force_x)
        return ahead, left, moment, along

    def rolling(self, speed: float, p: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        return {"forward_velocity": speed}, {f"spin_{wheel}": speed / p[f"radius_{wheel}"] for wheel in WHEELS}

    def following(self, x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        """Wheels whose spin was held would hinder the car from turning as a locked differential does."""
        sides = (p.front_half_track, -p.front_half_track, p.rear_half_track, -p.rear_half_track)
        return {
            f"spin_{wheel}": u[f"spin_{wheel}"] * (1 - side * x.yaw_rate / x.forward_velocity)
            for wheel, side in zip(WHEELS, sides, strict=True)
        }
