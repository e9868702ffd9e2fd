"""A gyro that does not read zero at rest."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, VehicleFile, of_kind, size
from vsense_ros.model.sensors import Imu, SensorBase


class GyroBias(Effect):
    """A gyro that does not read zero at rest, by a constant."""

    id: ClassVar[str] = "gyro_bias"
    sentence: ClassVar[str] = "a gyro that does not read zero at rest"
    changes_sides: ClassVar[tuple[str, ...]] = ("x", "z")
    mistaken_for: ClassVar[tuple[str, ...]] = ("tyre_conicity", "steering_offset")
    needs: ClassVar[tuple[str, ...]] = ("imu",)

    x: float = size("rad/s", "added by the sensor about x", typical=0.005, high=0.2)
    y: float = size("rad/s", "added by the sensor about y", typical=0.005, high=0.2)
    z: float = size("rad/s", "added by the sensor about z", typical=0.005, high=0.2)

    @classmethod
    def prior(cls, vehicle: VehicleFile) -> dict[str, float]:
        deviation = max((s.rate_bias for s in vehicle.sensing().values() if isinstance(s, Imu)), default=0.0)
        return dict.fromkeys("xyz", deviation)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        def with_bias(imu: Imu) -> dict[str, object]:
            x, y, z = imu.rate_offset
            return {"rate_offset": (x + self.x, y + self.y, z + self.z)}

        return of_kind(sensors, "imu", with_bias)
