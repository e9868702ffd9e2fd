"""GNSS driver: publishes `gps/fix`, `gps/velocity` and `gps/attitude` from NMEA 0183 or UBX bytes.

The bytes come from a serial port, a pty or TCP. With `sentence_topic`, NMEA sentences come from a topic
(nmea_msgs/Sentence), published by another node that owns the receiver.
"""

from __future__ import annotations

import sys
import time
from typing import Literal

from pydantic import Field

from vsense_ros.driver.gnss import GnssSettings
from vsense_ros.driver.gnss_stream import ReceiverDecoder
from vsense_ros.errors import InputError
from vsense_ros.messages import cdr_messages
from vsense_ros.node.base import run_node
from vsense_ros.node.convert import message_type
from vsense_ros.node.parameters import parameter
from vsense_ros.node.reader import Reader
from vsense_ros.node.serial_link import SerialLink
from vsense_ros.node.serial_node import SerialParameters, SerialSensorNode

_DEFAULT = GnssSettings()


class GpsDriverParameters(SerialParameters):
    """See `vsense_ros.driver.gnss.GnssSettings`."""

    protocol: Literal["nmea", "ubx"] = Field(
        "nmea", description="protocol of the receiver; UBX among NMEA is decoded, too"
    )
    sentence_topic: str = Field(
        "", description="topic of nmea_msgs/Sentence to read instead of a port, such as nmea_sentence"
    )
    fix_topic: str = Field(_DEFAULT.fix_topic, description="topic of the fixes (sensor_msgs/NavSatFix)", min_length=1)
    velocity_topic: str = Field(_DEFAULT.velocity_topic, description="topic of the ENU velocities", min_length=1)
    attitude_topic: str = Field(_DEFAULT.attitude_topic, description="topic of the headings", min_length=1)
    frame_id: str = Field(_DEFAULT.frame_id, description="frame of the antenna")
    map_frame_id: str = Field(_DEFAULT.map_frame_id, description="frame of the velocities, east north up")
    nominal_rate: float = parameter(0.0, "Hz", "expected rate; 0: no expectation", ge=0, le=1000)
    timeout: float = parameter(_DEFAULT.timeout, "s", "silence after which the receiver is stale", gt=0, le=60)
    range_error: float = parameter(_DEFAULT.range_error, "m", "horizontal standard deviation divided by HDOP", gt=0)
    speed_deviation: float = parameter(
        _DEFAULT.speed_deviation, "m/s", "standard deviation of each horizontal axis, if not stated", gt=0
    )
    heading_deviation: float = parameter(
        _DEFAULT.heading_deviation, "rad", "standard deviation of the heading, if not stated", gt=0
    )
    baseline_yaw: float = parameter(
        _DEFAULT.baseline_yaw, "rad", "from the vehicle's x axis to the line from first to second antenna", ge=-4, le=4
    )
    jump_limit: float = parameter(
        _DEFAULT.jump_limit, "m", "largest distance between a fix and the position predicted from the velocity", gt=0
    )


class GpsDriver(SerialSensorNode[GpsDriverParameters]):
    """See the module."""

    sensor = "gnss"
    _sentences: Reader | None = None

    def open_source(self) -> SerialLink | None:
        p = self.parameters
        if not p.sentence_topic:
            return super().open_source()
        if p.port or p.protocol != "nmea":
            raise InputError("parameter sentence_topic: sentences come from a topic or from a port, and are NMEA")
        kind = "nmea_msgs/msg/Sentence"
        self._sentences = Reader(self, message_type(kind), p.sentence_topic, self._on_sentence, raw=True)
        return None

    def _on_sentence(self, data: bytes) -> None:
        if self.state == "active":
            try:
                self._on_bytes(cdr_messages.decode_sentence(data) + b"\r\n", time.time_ns())
            except InputError as error:
                self.get_logger().warning(str(error), throttle_duration_sec=1.0)

    def release(self) -> None:
        super().release()
        if self._sentences is not None:
            self._sentences.close()
            self._sentences = None

    def make_decoder(self) -> ReceiverDecoder:
        p = self.parameters
        settings = GnssSettings(
            fix_topic=p.fix_topic,
            velocity_topic=p.velocity_topic,
            attitude_topic=p.attitude_topic,
            frame_id=p.frame_id,
            map_frame_id=p.map_frame_id,
            nominal_rate=p.nominal_rate or None,
            timeout=p.timeout,
            range_error=p.range_error,
            speed_deviation=p.speed_deviation,
            heading_deviation=p.heading_deviation,
            baseline_yaw=p.baseline_yaw,
            jump_limit=p.jump_limit,
        )
        return ReceiverDecoder(settings, p.protocol)

    def topics(self) -> dict[str, str]:
        p = self.parameters
        return {
            p.fix_topic: "sensor_msgs/msg/NavSatFix",
            p.velocity_topic: "geometry_msgs/msg/TwistWithCovarianceStamped",
            p.attitude_topic: "sensor_msgs/msg/Imu",
        }


def main() -> int:
    """Entry point of `ros2 run vsense_ros gps_driver`."""
    return run_node(GpsDriver, GpsDriverParameters)


if __name__ == "__main__":
    sys.exit(main())
