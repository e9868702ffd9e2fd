"""An inertial measurement unit that is turned about its x axis."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, added, of_kind, size
from vsense_ros.model.sensors import SensorBase


class ImuRollMisalignment(Effect):
    """The sensor's axes are turned about its x axis against those that the vehicle file gives."""

    id: ClassVar[str] = "imu_roll_misalignment"
    sentence: ClassVar[str] = "an inertial measurement unit that is turned about its x axis"
    changes_sides: ClassVar[tuple[str, ...]] = ("angle",)
    mistaken_for: ClassVar[tuple[str, ...]] = ("accelerometer_bias", "road_bank", "payload_offset")
    needs: ClassVar[tuple[str, ...]] = ("imu",)

    angle: float = size("rad", "added to the roll angle of the mounting", typical=0.03, high=0.5)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        return of_kind(sensors, "imu", lambda imu: {"attitude": added(imu.attitude, 0, self.angle)})
