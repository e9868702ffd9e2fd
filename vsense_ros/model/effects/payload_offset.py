"""A load that sits to one side."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.effects.base import Effect, size
from vsense_ros.model.spatial import skew


class PayloadOffset(Effect):
    """The centre of gravity to the left or right of the middle; the mass itself and the inertia about that centre are
    those of the vehicle file."""

    id: ClassVar[str] = "payload_offset"
    sentence: ClassVar[str] = "a load that sits to one side"
    changes_sides: ClassVar[tuple[str, ...]] = ("moment",)
    mistaken_for: ClassVar[tuple[str, ...]] = ("road_bank", "imu_roll_misalignment")

    moment: float = size("kg m", "mass times its offset to the left", typical=30.0, high=3000.0)

    def chassis(self, mass: ca.SX, moment: ca.SX, inertia: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        moved_moment = moment + ca.vertcat(0, self.moment, 0)
        before, after = skew(moment), skew(moved_moment)
        return mass, moved_moment, inertia + (before @ before - after @ after) / mass  # by Steiner's theorem
