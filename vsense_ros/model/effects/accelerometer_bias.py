"""An accelerometer that does not read zero."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, VehicleFile, of_kind, size
from vsense_ros.model.sensors import Imu, SensorBase


class AccelerometerBias(Effect):
    """An accelerometer that does not read zero, by a constant."""

    id: ClassVar[str] = "accelerometer_bias"
    sentence: ClassVar[str] = "an accelerometer that does not read zero"
    changes_sides: ClassVar[tuple[str, ...]] = ("y",)
    mistaken_for: ClassVar[tuple[str, ...]] = (
        "imu_roll_misalignment",
        "imu_pitch_misalignment",
        "road_bank",
        "road_grade",
    )
    needs: ClassVar[tuple[str, ...]] = ("imu",)

    # More than the rest of the bias that every such sensor has, and as much as a likely error of mounting (0.03 rad)
    # makes of gravity: of two that look alike, none is the likelier.
    x: float = size("m/s²", "added by the sensor along x", typical=0.3, high=5.0)
    y: float = size("m/s²", "added by the sensor along y", typical=0.3, high=5.0)
    z: float = size("m/s²", "added by the sensor along z", typical=0.3, high=5.0)

    @classmethod
    def prior(cls, vehicle: VehicleFile) -> dict[str, float]:
        deviation = max((s.force_bias for s in vehicle.sensing().values() if isinstance(s, Imu)), default=0.0)
        return dict.fromkeys("xyz", deviation)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        def with_bias(imu: Imu) -> dict[str, object]:
            x, y, z = imu.force_offset
            return {"force_offset": (x + self.x, y + self.y, z + self.z)}

        return of_kind(sensors, "imu", with_bias)
