"""An effect that is no part of the package: a constant push from behind."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, size

if TYPE_CHECKING:
    from vsense_ros.model.car.car import Car


class TailWind(Effect):
    """A force along the car that does not depend on what it does."""

    id: ClassVar[str] = "tail_wind"
    sentence: ClassVar[str] = "a constant push from behind"
    mistaken_for: ClassVar[tuple[str, ...]] = ("aero_drag",)

    force: float = size("N", "force, positive from behind", typical=100.0, high=5000.0)

    def chassis_force(self, force: ca.SX, car: Car, internal_state: ca.SX) -> ca.SX:
        return force + ca.vertcat(0, 0, 0, self.force, 0, 0)
