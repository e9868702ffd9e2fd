"""An inertial measurement unit that is turned about its y axis."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, added, of_kind, size
from vsense_ros.model.sensors import SensorBase


class ImuPitchMisalignment(Effect):
    """The sensor's axes are turned about its y axis against those that the vehicle file gives."""

    id: ClassVar[str] = "imu_pitch_misalignment"
    sentence: ClassVar[str] = "an inertial measurement unit that is turned about its y axis"
    mistaken_for: ClassVar[tuple[str, ...]] = ("accelerometer_bias", "road_grade")
    needs: ClassVar[tuple[str, ...]] = ("imu",)

    angle: float = size("rad", "added to the pitch angle of the mounting", typical=0.03, high=0.5)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        return of_kind(sensors, "imu", lambda imu: {"attitude": added(imu.attitude, 1, self.angle)})
