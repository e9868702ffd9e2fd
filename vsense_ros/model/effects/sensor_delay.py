"""Measurements that are older than their stamps say."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import ClassVar

from vsense_ros.model.effects.base import Effect, VehicleFile, of_kind, size
from vsense_ros.model.sensors import Imu, SensorBase

MOST = 3.0  # [s]


class SensorDelay(Effect):
    """A constant time between the measurement and its stamp."""

    id: ClassVar[str] = "sensor_delay"
    sentence: ClassVar[str] = "measurements that are older than their stamps say"
    mistaken_for: ClassVar[tuple[str, ...]] = ("tyre_relaxation",)
    each: ClassVar[str] = "sensor"
    delays: ClassVar[Mapping[str, str]] = {
        "imu": "imu",
        "gyro": "gyro",
        "accelerometer": "accelerometer",
        "steering": "steering",
        "wheel_speeds": "wheel_speeds",
        "gnss_velocity": "gnss",
    }

    imu: float = size("s", "additional age of the inertial measurements", typical=0.03, low=-0.5, high=MOST)
    gyro: float = size("s", "additional age of the gyros alone", typical=0.03, low=-0.5, high=MOST)
    accelerometer: float = size("s", "additional age of the accelerometers alone", typical=0.03, low=-0.5, high=MOST)
    steering: float = size("s", "additional age of the steering angle", typical=0.03, low=-0.5, high=MOST)
    wheel_speeds: float = size("s", "additional age of the wheel speeds", typical=0.03, low=-0.5, high=MOST)
    gnss: float = size("s", "additional age of the GNSS velocities and positions", typical=0.03, low=-0.5, high=MOST)

    @classmethod
    def prior(cls, vehicle: VehicleFile) -> dict[str, float]:
        return {"steering": 0.005}  # a few periods of a bus

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        ages = {
            "imu": self.imu,
            "steering": self.steering,
            "wheel_speeds": self.wheel_speeds,
            "gnss_position": self.gnss,
            "gnss_velocity": self.gnss,
        }
        late = {
            name: sensor.model_copy(update={"latency": sensor.latency + ages.get(sensor.kind, 0.0)})
            for name, sensor in sensors.items()
        }

        def with_latencies(imu: Imu) -> dict[str, object]:
            return {
                "rate_latency": imu.rate_latency + self.gyro, "force_latency": imu.force_latency + self.accelerometer
            }  # fmt: skip

        return of_kind(late, "imu", with_latencies)

    def left_out_of_observer(self, sensors: Collection[SensorBase]) -> str:
        if self.gyro != 0 or self.accelerometer != 0:
            return "how much older the gyros are than the accelerometers, as both come in one message"
        return super().left_out_of_observer(sensors)
