"""The twin-track model whose wheels turn by themselves, driven by torques (Leung 2010, section 3.4.5, eqs. 3.1 to
3.12).

J_i ω̇_i = τ_i - R_i F_x,i
"""

from __future__ import annotations

from typing import Any

from studies.handling.planar import Planar
from studies.handling.twin_track_3dof import TwinTrack3Dof
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.handling.base import Tyres
from vsense_ros.model.parameter import Scalar


class TwinTrack7Dof(TwinTrack3Dof):
    """`tyres` are those of the wheels fl, fr, rl, rr."""

    states = (*Planar.motion, *(f"spin_{wheel}" for wheel in WHEELS))
    inputs = ("steering_fl", "steering_fr", *(f"torque_{wheel}" for wheel in WHEELS))
    driven = ("torque_rl", "torque_rr")

    def __init__(self, tyres: Tyres) -> None:
        super().__init__(tyres)
        self.parameters = (*self.parameters, *(f"spin_inertia_{wheel}" for wheel in WHEELS))

    def spins(self, x: Any, u: Any) -> list[Scalar]:
        return [x[f"spin_{wheel}"] for wheel in WHEELS]

    def rates(self, x: Any, u: Any, p: Any) -> list[Scalar]:
        forces = self.forces(x, u, p)
        wheels = [
            (u[f"torque_{wheel}"] - p[f"radius_{wheel}"] * along) / p[f"spin_inertia_{wheel}"]
            for wheel, along in zip(WHEELS, forces[3], strict=True)
        ]
        return [*self.body(x, forces, p), *wheels]

    def rolling(self, speed: float, p: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        moving, spins = super().rolling(speed, p)
        return moving | spins, {}

    def following(self, x: Any, u: Any, p: Any) -> dict[str, Scalar]:
        return {}
