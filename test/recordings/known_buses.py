"""Logs of buses, measurement files and bags for which a mapping is proposed."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from recordings.known_logs import PLACE, WHEELS
from recordings.logs import BEGIN, RADIUS, Columns, Log, degrees, kmh

DBC = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 768 ESP_Gierrate: 8 X
 SG_ ESP_YawRate : 0|16@1- (0.01,0) [-320|320] "deg/s" X
 SG_ ESP_LatAcc : 16|16@1- (0.001,0) [-32|32] "m/s2" X
BO_ 770 WHEEL_SPEEDS: 8 X
 SG_ WHEEL_SPEED_FL : 0|16@1+ (0.01,0) [0|600] "km/h" X
 SG_ WHEEL_SPEED_FR : 16|16@1+ (0.01,0) [0|600] "km/h" X
 SG_ WHEEL_SPEED_RL : 32|16@1+ (0.01,0) [0|600] "km/h" X
 SG_ WHEEL_SPEED_RR : 48|16@1+ (0.01,0) [0|600] "km/h" X
BO_ 772 STEERING: 8 X
 SG_ STEER_ANGLE : 0|16@1- (0.1,0) [-1000|1000] "deg" X
"""


def bus(name: str) -> Callable[[Path, Columns], Path]:
    """A writer of a CAN log by python-can, in the format of its ending."""
    import can

    def write(folder: Path, d: Columns) -> Path:
        path = folder / name
        with can.Logger(path) as logger:
            for i, t in enumerate(d["t"]):
                rates = struct.pack("<hh4x", round(np.degrees(d["wz"][i]) * 100), round(d["ay"][i] * 1000))
                wheels = struct.pack("<4H", *(round(d[wheel][i] * RADIUS * 360) for wheel in WHEELS))
                steering = struct.pack("<h6x", round(np.degrees(d["steering"][i]) * 10))
                for late, identifier, data in ((0.0, 770, wheels), (0.001, 768, rates), (0.002, 772, steering)):
                    stamp = BEGIN.timestamp() + t + late
                    logger(can.Message(stamp, identifier, is_extended_id=False, data=data, channel=0))
        return path

    return write


_ON_BUS = ("wz", "ay", "steering", *WHEELS)


def measurement(folder: Path, d: Columns) -> Path:
    """MDF 4, by asammdf."""
    from asammdf import MDF, Signal

    given = {
        "VehSpeed": (kmh(d), "km/h"), "SteeringWheelAngle": (degrees(d, "steering"), "deg"),
        "YawRate": (degrees(d, "wz"), "deg/s"), "LatAcc": (d["ay"], "m/s^2"), "LongAcc": (d["ax"], "m/s^2"),
        **{f"WheelSpeed_{w.upper()}": (d[w], "rad/s") for w in WHEELS},
    }  # fmt: skip
    path = folder / "drive.mf4"
    with MDF(version="4.10") as file:
        file.header.start_time = BEGIN
        file.append([Signal(values, d["t"], name=name, unit=unit) for name, (values, unit) in given.items()])
        file.save(path, overwrite=True)
    return path


def matlab(folder: Path, d: Columns) -> Path:
    """MATLAB 5, by scipy."""
    import scipy.io

    path = folder / "drive.mat"
    names = {"t": "t", "vx": "speed", "yaw_rate": "wz", "ax": "ax", "ay": "ay", "steering_wheel_angle": "steering"}
    scipy.io.savemat(path, {ours: d[theirs][:, None] for ours, theirs in names.items()} | {"note": "a lap"})
    return path


def bag(folder: Path, d: Columns) -> Path:
    """A ROS 2 bag with names of topics of a driver, by rosbags."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    header, time = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    vector, zero9 = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    path = folder / "bag"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        imu = writer.add_connection("/sensing/imu/imu_raw", "sensor_msgs/msg/Imu", typestore=store)
        fix = writer.add_connection("/ublox/fix", "sensor_msgs/msg/NavSatFix", typestore=store)
        for i, t in enumerate(d["t"]):
            stamp = round((BEGIN.timestamp() + t) * 1e9)
            head = header(time(stamp // 10**9, stamp % 10**9), "base")
            rates, forces = (vector(*(d[f"{letter}{axis}"][i] for axis in "xyz")) for letter in "wa")
            level = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
            message = types["sensor_msgs/msg/Imu"](head, level, zero9, rates, zero9, forces, zero9)
            writer.write(imu, stamp, store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
            if i % 5 == 0:
                status = types["sensor_msgs/msg/NavSatStatus"](0, 1)
                place = (float(d[name][i]) for name in PLACE)
                message = types["sensor_msgs/msg/NavSatFix"](head, status, *place, zero9, 0)
                writer.write(fix, stamp, store.serialize_cdr(message, "sensor_msgs/msg/NavSatFix"))
    return path


BUSES = {
    "candump": Log(bus("drive.log"), _ON_BUS, dbc=DBC),
    "Vector BLF": Log(bus("drive.blf"), _ON_BUS, dbc=DBC),
    "Vector ASC": Log(bus("drive.asc"), _ON_BUS, dbc=DBC),
    "PEAK TRC": Log(bus("drive.trc"), _ON_BUS, dbc=DBC),
    "MDF 4": Log(measurement, ("speed", "steering", "wz", "ax", "ay", *WHEELS)),
    "MATLAB": Log(matlab, ("speed", "wz", "ax", "ay", "steering"), None),
    "ROS 2 bag of drivers": Log(bag, (*PLACE, "wz", "ax", "ay", "az")),
}
