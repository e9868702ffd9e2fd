"""An inertial measurement unit that sits elsewhere."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, of_kind, size
from vsense_ros.model.sensors import Imu, SensorBase


class ImuLeverArm(Effect):
    """The sensor's place differs from that which the vehicle file gives."""

    id: ClassVar[str] = "imu_lever_arm"
    sentence: ClassVar[str] = "an inertial measurement unit that sits elsewhere than the vehicle file says"
    changes_sides: ClassVar[tuple[str, ...]] = ("y",)
    mistaken_for: ClassVar[tuple[str, ...]] = ("camber_thrust", "imu_yaw_misalignment")
    needs: ClassVar[tuple[str, ...]] = ("imu",)

    x: float = size("m", "added to the place of the sensor, forward", typical=0.3, high=5.0)
    y: float = size("m", "added to the place of the sensor, to the left", typical=0.3, high=3.0)
    z: float = size("m", "added to the place of the sensor, upward", typical=0.2, high=3.0)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        def moved(imu: Imu) -> dict[str, object]:
            x, y, z = imu.position
            return {"position": (x + self.x, y + self.y, z + self.z)}

        return of_kind(sensors, "imu", moved)
