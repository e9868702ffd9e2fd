"""A road that slopes across the direction of travel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from vsense_ros.model.effects.base import RoadEffect, form, size


class RoadBank(RoadEffect):
    """The slope of the road across the car, positive where the left side is higher."""

    id: ClassVar[str] = "road_bank"
    sentence: ClassVar[str] = "a road that slopes across the direction of travel"
    changes_sides: ClassVar[tuple[str, ...]] = ("bank",)
    mistaken_for: ClassVar[tuple[str, ...]] = (
        "accelerometer_bias",
        "imu_roll_misalignment",
        "payload_offset",
        "crosswind",
    )

    variants: ClassVar[Mapping[str, Mapping[str, float]]] = {"on a plane": {"follows": 0.0}}

    bank: float = size("rad", "slope, positive where the left side is higher", typical=0.02, high=0.4)

    follows: float = form(
        "1 where the road turns as the car does, 0 for a plane that slopes across the way the car sets out", default=1.0
    )

    def slope(self, turned: Any) -> tuple[Any, Any]:
        turned = (1 - self.follows) * turned
        return self.bank * np.sin(turned), self.bank * np.cos(turned)
