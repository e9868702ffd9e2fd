"""IMU driver: publishes `imu/data` from the bytes of an Xsens IMU (XBus, MTData2) on a serial port, a pty or TCP."""

from __future__ import annotations

import sys

from pydantic import Field

from vsense_ros.driver.imu import ImuSettings, XbusDecoder
from vsense_ros.node.base import run_node
from vsense_ros.node.parameters import parameter
from vsense_ros.node.serial_node import SerialParameters, SerialSensorNode

_DEFAULT = ImuSettings()


class ImuDriverParameters(SerialParameters):
    """See `vsense_ros.driver.imu.ImuSettings`."""

    topic: str = Field(_DEFAULT.topic, description="topic of the measurements (sensor_msgs/Imu)", min_length=1)
    frame_id: str = Field(_DEFAULT.frame_id, description="frame of the measurements")
    mounting: str = Field("x,y,z", description="which sensor axis points forward, left and up, such as x,-y,-z")
    nominal_rate: float = parameter(0.0, "Hz", "expected rate; 0: no expectation", ge=0, le=10000)
    timeout: float = parameter(_DEFAULT.timeout, "s", "silence after which the sensor is stale", gt=0, le=60)
    latency: float = parameter(
        _DEFAULT.latency, "s", "delay from the measurement to the time stamp of the sensor", ge=0, le=1
    )
    rate_range: float = parameter(_DEFAULT.rate_range, "rad/s", "largest rate that the sensor can measure", gt=0)
    acceleration_range: float = parameter(
        _DEFAULT.acceleration_range, "m/s²", "largest specific force that the sensor can measure", gt=0
    )
    rate_deviation: float = parameter(_DEFAULT.rate_deviation, "rad/s", "standard deviation of rates", gt=0)
    acceleration_deviation: float = parameter(
        _DEFAULT.acceleration_deviation, "m/s²", "standard deviation of specific forces", gt=0
    )


class ImuDriver(SerialSensorNode[ImuDriverParameters]):
    """See the module."""

    sensor = "imu"

    def make_decoder(self) -> XbusDecoder:
        p = self.parameters
        return XbusDecoder(
            ImuSettings(
                topic=p.topic,
                frame_id=p.frame_id,
                mounting=p.mounting,
                nominal_rate=p.nominal_rate or None,
                timeout=p.timeout,
                latency=p.latency,
                rate_range=p.rate_range,
                acceleration_range=p.acceleration_range,
                rate_deviation=p.rate_deviation,
                acceleration_deviation=p.acceleration_deviation,
            )
        )

    def topics(self) -> dict[str, str]:
        return {self.parameters.topic: "sensor_msgs/msg/Imu"}


def main() -> int:
    """Entry point of `ros2 run vsense_ros imu_driver`."""
    return run_node(ImuDriver, ImuDriverParameters)


if __name__ == "__main__":
    sys.exit(main())
