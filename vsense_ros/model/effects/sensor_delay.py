"""Measurements that are older than their stamps say."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from vsense_ros.model.effects.base import Effect, size

if TYPE_CHECKING:
    from vsense_ros.model.sensors import SensorBase
    from vsense_ros.model.vehicle import Vehicle


class SensorDelay(Effect):
    """A constant time between the measurement and its stamp."""

    id: ClassVar[str] = "sensor_delay"
    sentence: ClassVar[str] = "measurements that are older than their stamps say"
    mistaken_for: ClassVar[tuple[str, ...]] = ("tyre_relaxation",)
    each: ClassVar[str] = "sensor"

    imu: float = size("s", "additional age of the inertial measurements", typical=0.03, low=-0.2, high=1.0)
    steering: float = size("s", "additional age of the steering angle", typical=0.03, low=-0.2, high=1.0)
    wheel_speeds: float = size("s", "additional age of the wheel speeds", typical=0.03, low=-0.2, high=1.0)
    gnss: float = size("s", "additional age of the GNSS velocities and positions", typical=0.03, low=-0.2, high=1.0)

    @classmethod
    def prior(cls, vehicle: Vehicle) -> dict[str, float]:
        return {"steering": 0.005}  # a few periods of a bus

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        ages = {
            "imu": self.imu,
            "steering": self.steering,
            "wheel_speeds": self.wheel_speeds,
            "gnss_position": self.gnss,
            "gnss_velocity": self.gnss,
        }
        return {
            name: sensor.model_copy(update={"latency": sensor.latency + ages.get(sensor.kind, 0.0)})
            for name, sensor in sensors.items()
        }
