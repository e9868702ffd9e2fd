"""Grip of the road that differs from what the vehicle file says."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.effects.base import RoadEffect, size
from vsense_ros.model.moving_car import Corner


class FrictionChange(RoadEffect):
    """Wet, icy or dusty road: the grip of all tyres is another."""

    id: ClassVar[str] = "friction_change"
    sentence: ClassVar[str] = "a road with another grip"
    mistaken_for: ClassVar[tuple[str, ...]] = ("tyre_heating",)

    relative: float = size("-", "grip over that of the vehicle file, minus 1", typical=0.2, low=-0.95, high=1.0)

    def friction(self, friction: ca.SX, corner: Corner, load: ca.SX, internal_state: ca.SX) -> ca.SX:
        return friction * (1 + self.relative)
