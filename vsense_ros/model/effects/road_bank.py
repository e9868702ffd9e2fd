"""A road that slopes across the direction of travel."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, size


class RoadBank(Effect):
    """The slope of the road across the car, positive where the left side is higher."""

    id: ClassVar[str] = "road_bank"
    sentence: ClassVar[str] = "a road that slopes across the direction of travel"
    excited_by: ClassVar[tuple[str, ...]] = ("any driving",)
    mistaken_for: ClassVar[tuple[str, ...]] = (
        "accelerometer_bias",
        "imu_roll_misalignment",
        "payload_offset",
        "crosswind",
    )

    bank: float = size("rad", "slope, positive where the left side is higher", typical=0.02, high=0.4)

    def slope(self) -> tuple[float, float]:
        return 0.0, self.bank
