"""A road that slopes along the direction of travel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from vsense_ros.model.effects.base import RoadEffect, form, size


class RoadGrade(RoadEffect):
    """The slope of the road along the car, positive uphill."""

    id: ClassVar[str] = "road_grade"
    sentence: ClassVar[str] = "a road that slopes along the direction of travel"
    mistaken_for: ClassVar[tuple[str, ...]] = (
        "rolling_resistance",
        "aero_drag",
        "accelerometer_bias",
        "imu_pitch_misalignment",
    )

    variants: ClassVar[Mapping[str, Mapping[str, float]]] = {"on a plane": {"follows": 0.0}}

    grade: float = size("rad", "slope, positive uphill", typical=0.02, high=0.4)

    follows: float = form(
        "1 where the road turns as the car does, 0 for a plane that slopes along the way the car sets out", default=1.0
    )

    def slope(self, turned: Any) -> tuple[Any, Any]:
        turned = (1 - self.follows) * turned
        return self.grade * np.cos(turned), -self.grade * np.sin(turned)
