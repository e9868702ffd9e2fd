"""A road that slopes along the direction of travel."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, size


class RoadGrade(Effect):
    """The slope of the road along the car, positive uphill."""

    id: ClassVar[str] = "road_grade"
    sentence: ClassVar[str] = "a road that slopes along the direction of travel"
    excited_by: ClassVar[tuple[str, ...]] = ("accelerating and braking",)
    mistaken_for: ClassVar[tuple[str, ...]] = (
        "rolling_resistance",
        "aero_drag",
        "accelerometer_bias",
        "imu_pitch_misalignment",
    )

    grade: float = size("rad", "slope, positive uphill", typical=0.02, high=0.4)

    def slope(self) -> tuple[float, float]:
        return self.grade, 0.0
