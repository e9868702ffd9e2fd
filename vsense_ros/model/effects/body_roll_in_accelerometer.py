"""An accelerometer that leans more, or less, than the body."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, of_kind, size
from vsense_ros.model.sensors import SensorBase


class BodyRollInAccelerometer(Effect):
    """The sensor leans by more than the body, on a soft mounting, or its values are already corrected for roll."""

    id: ClassVar[str] = "body_roll_in_accelerometer"
    sentence: ClassVar[str] = "gravity that reaches the lateral accelerometer as the body rolls"
    mistaken_for: ClassVar[tuple[str, ...]] = ("imu_yaw_misalignment", "steering_ratio")
    needs: ClassVar[tuple[str, ...]] = ("imu",)

    gain: float = size("-", "additional roll of the sensor per roll of the body", typical=0.5, low=-2.0, high=5.0)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        return of_kind(sensors, "imu", lambda imu: {"roll_gain": imu.roll_gain + self.gain})
