"""The drivers of a car and its observer: ros2 launch vsense_ros vehicle.launch.py vehicle:=rav4 dbc:=…."""

from typing import Any

from launch import LaunchDescription

from vsense_ros.node.launching import Given, description, node

ARGUMENTS = {
    "vehicle": (None, "vehicle file, or the name of one in config/vehicles"),
    "monitor": ("", "limits that vsense monitor --calibrate wrote; empty: the fit of the model is not judged"),
    "rate": ("", "[Hz] highest rate of the estimates; empty: 250"),
    "map_origin": ("", "latitude,longitude,height [deg, deg, m] of the map; empty: the stored one, else the first fix"),
    "map_origin_file": ("", "file that keeps the map's origin from one start to the next; empty: none"),
    "can_interface": ("socketcan", "python-can interface: socketcan, udp_multicast, slcan"),
    "can_channel": ("can0", "of the interface"),
    "can_bitrate": ("0", "[bit/s] for interfaces that set it themselves; 0: leave it"),
    "dbc": ("", "CAN database; empty: no CAN driver"),
    "can_mapping": ("", "which signals become which topics (config/can)"),
    "imu_port": ("", "serial port of an Xsens IMU, or socket://host:port; empty: no IMU driver"),
    "imu_baud_rate": ("115200", "of the serial port"),
    "imu_mounting": ("x,y,z", "which sensor axis points forward, left and up"),
    "imu_frame": ("", "frame of the measurements; empty: imu_link"),
    "imu_rate": ("0", "[Hz] expected; 0: no expectation"),
    "gnss_port": ("", "serial port of the GNSS receiver, or socket://host:port; empty: no GNSS driver"),
    "gnss_protocol": ("nmea", "nmea or ubx"),
    "gnss_baud_rate": ("115200", "of the serial port"),
    "gnss_frame": ("", "frame of the antenna; empty: gnss_link"),
    "gnss_rate": ("0", "[Hz] expected; 0: no expectation"),
    "record": ("", "folder to record everything into; empty: nothing is recorded"),
    "record_split": ("0", "[s] after which the next file of the recording begins; 0: never"),
}


def actions(given: Given) -> list[Any]:
    """Those drivers whose arguments are given, the observer, and a recorder if wanted."""
    made: list[Any] = []
    if given.text("dbc"):
        made += node(
            given,
            "can_driver",
            respawn=True,
            interface=given.text("can_interface"),
            channel=given.text("can_channel"),
            bitrate=given.integer("can_bitrate"),
            database=given.text("dbc"),
            mapping=given.text("can_mapping"),
        )
    if given.text("imu_port"):
        made += node(
            given,
            "imu_driver",
            respawn=True,
            port=given.text("imu_port"),
            baud_rate=given.integer("imu_baud_rate"),
            mounting=given.text("imu_mounting"),
            frame_id=given.text("imu_frame"),
            nominal_rate=given.number("imu_rate"),
        )
    if given.text("gnss_port"):
        made += node(
            given,
            "gps_driver",
            respawn=True,
            port=given.text("gnss_port"),
            protocol=given.text("gnss_protocol"),
            baud_rate=given.integer("gnss_baud_rate"),
            frame_id=given.text("gnss_frame"),
            nominal_rate=given.number("gnss_rate"),
        )
    made += node(
        given,
        "observer",
        respawn=True,
        vehicle=given.text("vehicle"),
        monitor=given.text("monitor"),
        rate=given.number("rate") if given.text("rate") else None,
        map_origin=given.numbers("map_origin"),
        map_origin_file=given.text("map_origin_file"),
        frame_prefix=given.text("frame_prefix"),
    )
    if given.text("record"):
        made += node(
            given,
            "recorder",
            respawn=True,
            bag=given.text("record"),
            max_bagfile_duration=given.number("record_split"),
        )
    return made


def generate_launch_description() -> LaunchDescription:
    """For `ros2 launch`."""
    return description(ARGUMENTS, actions)
