"""A gyro that reads a multiple of the rate."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, of_kind, size
from vsense_ros.model.sensors import Imu, SensorBase


class GyroScale(Effect):
    """A scale factor other than 1."""

    id: ClassVar[str] = "gyro_scale"
    sentence: ClassVar[str] = "a gyro that reads a multiple of the rate"
    mistaken_for: ClassVar[tuple[str, ...]] = ("steering_ratio", "roll_steer")
    needs: ClassVar[tuple[str, ...]] = ("imu",)

    x: float = size("-", "relative error of the gyro about x", typical=0.02, high=0.5)
    y: float = size("-", "relative error of the gyro about y", typical=0.02, high=0.5)
    z: float = size("-", "relative error of the gyro about z", typical=0.02, high=0.5)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        def with_scale(imu: Imu) -> dict[str, object]:
            x, y, z = imu.rate_scale
            return {"rate_scale": (x + self.x, y + self.y, z + self.z)}

        return of_kind(sensors, "imu", with_scale)
