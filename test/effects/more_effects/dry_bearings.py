"""An effect that no car of the project has: wheel bearings without grease."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, size
from vsense_ros.model.moving_car import Corner, MovingCar


class DryBearings(Effect):
    """A constant torque holds back every wheel, however fast it turns."""

    id: ClassVar[str] = "dry_bearings"
    sentence: ClassVar[str] = "wheel bearings without grease"
    mistaken_for: ClassVar[tuple[str, ...]] = ("rolling_resistance",)

    torque: float = size("N m", "that holds back each wheel", typical=10.0, high=200.0)

    def wheel_torque(self, torque: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        return torque - self.torque
