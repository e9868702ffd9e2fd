"""A file of every format with the same drive in it, made by other libraries where there are any.

Each maker writes `seconds` of a drive into a folder and returns the file and what its importer needs to read it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import numpy as np

RATE = 100  # [Hz]
SPEED, YAW_RATE = 20.0, 0.1  # [m/s, rad/s], of a circle
START = 1_714_564_800  # 2024-05-01 12:00:00 UTC
ORIGIN = (48.0, 11.0)  # [deg]

Made = tuple[Path, dict[str, Any]]

DBC = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 768 YAWM: 8 X
 SG_ YR : 0|16@1- (0.01,0) [-320|320] "deg/s" X
BO_ 770 WHEELS: 8 X
 SG_ FL : 0|16@1+ (0.01,0) [0|300] "km/h" X
 SG_ FR : 16|16@1+ (0.01,0) [0|300] "km/h" X
 SG_ RL : 32|16@1+ (0.01,0) [0|300] "km/h" X
 SG_ RR : 48|16@1+ (0.01,0) [0|300] "km/h" X
"""
CAN_MAPPING = """name: car
outputs:
  - kind: imu
    topic: imu/data
    frame_id: imu_link
    message: YAWM
    axes: {angular_velocity_z: {signals: YR, unit: deg/s, standard_deviation: 0.01}}
  - kind: joint_state
    topic: vehicle/wheel_speeds
    message: WHEELS
    field: velocity
    joints:
      wheel_fl: {signals: FL, unit: km/h, rolling_radius: 0.3}
      wheel_fr: {signals: FR, unit: km/h, rolling_radius: 0.3}
      wheel_rl: {signals: RL, unit: km/h, rolling_radius: 0.3}
      wheel_rr: {signals: RR, unit: km/h, rolling_radius: 0.3}
"""
COLUMNS = {
    "time": {"column": "time", "unit": "s", "start": "2024-05-01T12:00:00Z"},
    "topics": {
        "gps/velocity": {"speed": {"column": "speed", "unit": "km/h"}, "course": {"column": "course", "unit": "deg"}},
        "imu/data": {"angular_velocity": [None, None, {"column": "yaw_rate", "unit": "deg/s"}]},
    },
}


def circle(seconds: float) -> dict[str, np.ndarray]:
    """The drive as columns: time [s], speed [km/h], course [deg], yaw rate [deg/s], latitude, longitude [deg]."""
    t = np.arange(round(seconds * RATE)) / RATE
    yaw = YAW_RATE * t
    radius = SPEED / YAW_RATE
    east, north = radius * np.sin(yaw), radius * (1 - np.cos(yaw))
    return {
        "time": t,
        "speed": np.full(len(t), SPEED * 3.6),
        "course": (90.0 - np.degrees(yaw)) % 360.0,
        "yaw_rate": np.full(len(t), np.degrees(YAW_RATE)) + 0.01 * (np.arange(len(t)) % 3),
        "latitude": ORIGIN[0] + north / 111_200.0,
        "longitude": ORIGIN[1] + east / 111_200.0 / np.cos(np.radians(ORIGIN[0])),
    }


def csv(folder: Path, seconds: float) -> Made:
    data = circle(seconds)
    path = folder / "drive.csv"
    with path.open("w") as file:
        file.write(",".join(data) + "\n")
        np.savetxt(file, np.column_stack(list(data.values())), fmt="%.7f", delimiter=",")
    return path, {"mapping": COLUMNS}


def aim(folder: Path, seconds: float) -> Made:
    data = circle(seconds)
    path = folder / "aim.csv"
    with path.open("w") as file:
        file.write(
            '"Format","AiM CSV File"\n"Date","Wednesday, May 1, 2024"\n"Time","12:00 PM"\n"Sample Rate","100"\n\n'
        )
        file.write('"Time","GPS Speed","GPS Heading","GPS Latitude","GPS Longitude"\n"s","km/h","deg","deg","deg"\n\n')
        columns = [data[name] for name in ("time", "speed", "course", "latitude", "longitude")]
        np.savetxt(file, np.column_stack(columns), fmt='"%.7f"', delimiter=",")
    return path, {}


def racechrono(folder: Path, seconds: float) -> Made:
    data = circle(seconds)
    path = folder / "racechrono.csv"
    with path.open("w") as file:
        file.write(
            'This file is created using RaceChrono v9.1.3\nFormat,3\nSession title,"lap"\nCreated,01/05/2024,12:00\n\n'
        )
        file.write("timestamp,lap_number,latitude,longitude,altitude,speed,bearing,speed\n")
        file.write("unix time,,deg,deg,m,m/s,deg,m/s\n,,100: gps,100: gps,100: gps,100: gps,100: gps,calc\n")
        rows = np.column_stack(
            [START + data["time"], 1 + 0 * data["time"], data["latitude"], data["longitude"], 500 + 0 * data["time"],
             data["speed"] / 3.6, data["course"], 0 * data["time"]]
        )  # fmt: skip
        np.savetxt(file, rows, fmt="%.7f", delimiter=",")
    return path, {}


def vbo(folder: Path, seconds: float) -> Made:
    data = circle(seconds)
    path = folder / "drive.vbo"
    t = data["time"] + 12 * 3600
    packed = t // 3600 * 10_000 + t % 3600 // 60 * 100 + t % 60
    with path.open("w", newline="") as file:
        file.write(
            "File created on 01/05/2024 @ 12:00\r\n\r\n[header]\r\nsatellites\r\ntime\r\nlatitude\r\nlongitude\r\n\r\n"
        )
        file.write("[column names]\r\nsats time lat long velocity heading height yaw_rate\r\n\r\n[data]\r\n")
        rows = zip(
            packed,
            data["latitude"] * 60,
            -data["longitude"] * 60,
            data["speed"],
            data["course"],
            data["yaw_rate"],
            strict=True,
        )
        for clock, lat, lon, speed, course, rate in rows:
            file.write(
                f"010 {clock:09.2f} {lat:+012.6f} {lon:+012.6f} {speed:07.3f} {course:07.3f} +0500.00 {rate:+09.5f}\r\n"
            )
    return path, {"mapping": {"topics": {"imu/data": COLUMNS["topics"]["imu/data"]}}}  # type: ignore[index]


def mat(folder: Path, seconds: float) -> Made:
    import scipy.io

    path = folder / "drive.mat"
    data = circle(seconds)
    scipy.io.savemat(path, {"log": data, "note": "x"})
    return path, {"mapping": _dotted("log.")}


def mat73(folder: Path, seconds: float) -> Made:
    import h5py

    path = folder / "drive73.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        for name, values in circle(seconds).items():
            group.create_dataset(name, data=values[None, :], compression="gzip")
    with path.open("r+b") as head:
        head.write(b"MATLAB 7.3 MAT-file".ljust(124) + struct.pack("<H", 0x0200) + b"IM")
    return path, {"mapping": _dotted("log.")}


def _dotted(prefix: str) -> dict[str, Any]:
    topics = {
        "gps/velocity": {
            "speed": {"column": f"{prefix}speed", "unit": "km/h"},
            "course": {"column": f"{prefix}course", "unit": "deg"},
        },
        "imu/data": {"angular_velocity": [None, None, {"column": f"{prefix}yaw_rate", "unit": "deg/s"}]},
    }
    return {"time": {**COLUMNS["time"], "column": f"{prefix}time"}, "topics": topics}  # type: ignore[dict-item]


def mdf4(folder: Path, seconds: float) -> Made:
    from datetime import UTC, datetime

    from asammdf import MDF, Signal

    data = circle(seconds)
    path = folder / "drive.mf4"
    with MDF(version="4.10") as file:
        file.header.start_time = datetime(2024, 5, 1, 12, tzinfo=UTC)
        units = {"speed": "km/h", "course": "deg", "yaw_rate": "deg/s"}
        file.append([Signal(data[name], data["time"], name=name, unit=unit) for name, unit in units.items()])
        file.save(path, overwrite=True)
    return path, {"mapping": {"topics": COLUMNS["topics"]}}


def frames(seconds: float) -> list[can.Message]:
    """The drive on CAN: yaw rate and wheel speeds."""
    found = []
    for i in range(round(seconds * RATE)):
        wheels = struct.pack("<4H", *[round(SPEED * 360) + (i + k) % 3 for k in range(4)])
        yaw = struct.pack("<h6x", round(np.degrees(YAW_RATE) * 100) + i % 3)
        for late, identifier, data in ((0.0, 770, wheels), (0.002, 768, yaw)):
            found.append(can.Message(START + i / RATE + late, identifier, is_extended_id=False, data=data, channel=0))
    return found


def _can(ending: str) -> Callable[[Path, float], Made]:
    def make(folder: Path, seconds: float) -> Made:
        path = folder / f"bus{ending}"
        with can.Logger(path) as logger:
            for message in frames(seconds):
                logger(message)
        return path, _can_options(folder)

    return make


def _can_options(folder: Path) -> dict[str, Any]:
    (folder / "car.dbc").write_text(DBC)
    (folder / "can.yaml").write_text(CAN_MAPPING)
    return {"dbc": folder / "car.dbc", "mapping": folder / "can.yaml"}


def candump_view(folder: Path, seconds: float) -> Made:
    path = folder / "view.txt"
    with path.open("w") as file:
        for m in frames(seconds):
            file.write(
                f" ({m.timestamp:.6f})  can0  {m.arbitration_id:03X}   [{len(m.data)}]  {m.data.hex(' ').upper()}\n"
            )
    return path, _can_options(folder)


def gvret(folder: Path, seconds: float) -> Made:
    path = folder / "gvret.csv"
    with path.open("w") as file:
        file.write("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n")
        for m in frames(seconds):
            data = ",".join(f"{byte:02X}" for byte in m.data)
            file.write(f"{round(m.timestamp * 1e6)},{m.arbitration_id:08X},false,Rx,0,{len(m.data)},{data}\n")
    return path, _can_options(folder)


def _bag_channels(seconds: float) -> dict[str, Any]:
    from vsense_ros.bag.importers import build

    data = circle(seconds)
    stamp = build.nanoseconds(data["time"], START * 10**9)
    rates = np.column_stack([0 * data["time"], 0 * data["time"], np.radians(data["yaw_rate"])])
    velocity = build.course_velocity(data["speed"] / 3.6, np.radians(data["course"]))
    return {"imu/data": build.imu(stamp, rates, rates + 1.0), "gps/velocity": build.velocity(stamp, velocity)}


def mcap(folder: Path, seconds: float) -> Made:
    from vsense_ros.bag import write_bag
    from vsense_ros.messages.recording import Recording

    write_bag(folder / "mcap", Recording(_bag_channels(seconds)), overwrite=True)
    return folder / "mcap", {}


def _rosbag2(name: str, mode: str, plugin: str) -> Callable[[Path, float], Made]:
    def make(folder: Path, seconds: float) -> Made:
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        from vsense_ros.messages import cdr

        store = get_typestore(Stores.ROS2_JAZZY)
        writer = Writer(folder / name, version=9, storage_plugin=StoragePlugin[plugin])
        if mode:
            writer.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
        with writer:
            for topic, channel in _bag_channels(seconds).items():
                connection = writer.add_connection(f"/{topic}", channel.kind, typestore=store)
                for row, time in zip(cdr.encode_channel(channel), channel.received.tolist(), strict=True):
                    writer.write(connection, time, row.tobytes())
        return folder / name, {}

    return make


def rosbag1(folder: Path, seconds: float) -> Made:
    from rosbags.convert.converter import generate_message_converter
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    from vsense_ros.messages import cdr

    ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
    path = folder / "drive.bag"
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.LZ4)
    with writer:
        for topic, channel in _bag_channels(seconds).items():
            connection = writer.add_connection(f"/{topic}", channel.kind, typestore=ros1)
            turn = generate_message_converter(ros2, ros1, channel.kind, channel.kind, {}, src_is2=True, dst_is2=False)
            for row, time in zip(cdr.encode_channel(channel), channel.received.tolist(), strict=True):
                writer.write(connection, time, turn(row.tobytes()))
    return path, {}


MAKERS: dict[str, Callable[[Path, float], Made]] = {
    "csv": csv,
    "aim": aim,
    "racechrono": racechrono,
    "vbo": vbo,
    "mat": mat,
    "mat73": mat73,
    "mdf4": mdf4,
    "candump": _can(".log"),
    "candump_view": candump_view,
    "asc": _can(".asc"),
    "blf": _can(".blf"),
    "trc": _can(".trc"),
    "gvret": gvret,
    "mdf4_bus": _can(".mf4"),
    "mcap": mcap,
    "sqlite3": _rosbag2("sqlite3", "", "SQLITE3"),
    "sqlite3_packed_file": _rosbag2("sqlite3_file", "FILE", "SQLITE3"),
    "sqlite3_packed_messages": _rosbag2("sqlite3_messages", "MESSAGE", "SQLITE3"),
    "mcap_packed_file": _rosbag2("mcap_file", "FILE", "MCAP"),
    "mcap_packed_messages": _rosbag2("mcap_messages", "MESSAGE", "MCAP"),
    "rosbag1": rosbag1,
}
