"""The single-track model whose wheels turn by themselves, driven by torques (Leung 2010, section 3.4.3).

J_i ω̇_i = τ_i - R_i F_x,i
"""

from __future__ import annotations

from typing import Any

from studies.handling.bicycle_3dof import Bicycle3Dof
from studies.handling.planar import CHASSIS, Planar
from vsense_ros.model.handling.base import AXLES, Tyres
from vsense_ros.model.parameter import Scalar


class Bicycle5Dof(Bicycle3Dof):
    """`tyres` are those of one wheel at "front" and "rear"; an axle has two. Spin inertias are those of an axle."""

    states = (*Planar.motion, "spin_front", "spin_rear")
    inputs = ("steering", "torque_front", "torque_rear")
    driven = ("torque_rear",)

    def __init__(self, tyres: Tyres) -> None:
        super().__init__(tyres)
        wheels = ("front_radius", "rear_radius", "front_spin_inertia", "rear_spin_inertia")
        self.parameters = (*CHASSIS, *wheels, *tyres.parameters)

    def spins(self, x: Any, u: Any) -> tuple[Scalar, Scalar]:
        return x.spin_front, x.spin_rear

    def rates(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        forces = self.forces(x, u, p)
        wheels = [
            (u[f"torque_{axle}"] - p[f"{axle}_radius"] * along) / p[f"{axle}_spin_inertia"]
            for axle, along in zip(AXLES, forces[3], strict=True)
        ]
        return [*self.body(x, forces, p), *wheels]

    def rolling(self, speed: float, p: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        moving, spins = super().rolling(speed, p)
        return moving | spins, {}
