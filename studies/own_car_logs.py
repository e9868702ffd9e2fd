"""Logs as strangers have them: CAN frames with databases of other makers, a table, a bag with other topic names.

Nothing in these files is named, placed or signed as this project does it. A frame, a row or a message has the time at
which it was logged, so that the latency of each sensor is in the log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cantools
import numpy as np
from cantools.database import Message
from numpy.typing import NDArray

from vsense_ros.bag import write_bag
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.units import to_si

Array = NDArray[np.float64]
WHEELS = ("fl", "fr", "rl", "rr")


@dataclass(frozen=True)
class Carrier:
    """A signal of a database: its quantity, name, unit (with - where it is positive to the right), step in that unit,
    number of bits, and whether it has a sign."""

    quantity: str
    name: str
    unit: str
    step: float
    bits: int = 16
    signed: bool = True


# By the name of a database's message: its identifier, the order of its bytes (1: Intel, 0: Motorola), and its signals.
Database = Mapping[str, tuple[int, int, tuple[Carrier, ...]]]


def _wheels(names: str, unit: str, step: float) -> tuple[Carrier, ...]:
    return tuple(
        Carrier(f"wheel_{wheel}", name, unit, step, signed=False)
        for wheel, name in zip(WHEELS, names.split(), strict=True)
    )


GERMAN: Database = {
    "ESP_Raeder": (0x1B2, 1, _wheels("Radgeschw_VL Radgeschw_VR Radgeschw_HL Radgeschw_HR", "km/h", 0.0075)),
    "LWI_01": (0x086, 1, (Carrier("steering", "LWI_Lenkradwinkel", "deg", 0.1),)),
    "ESP_02": (
        0x101, 1,
        (
            Carrier("yaw_rate", "ESP_Gierrate", "deg/s", 0.01), Carrier("left", "ESP_Querbeschl", "g", 0.0005),
            Carrier("forward", "ESP_Laengsbeschl", "m/s²", 0.005),
        ),
    ),
    "Ortung_Position": (
        0x640, 1,
        (
            Carrier("latitude", "GPS_Breitengrad", "deg", 1e-7, 32),
            Carrier("longitude", "GPS_Laengengrad", "deg", 1e-7, 32),
        ),
    ),
    "Ortung_Fahrt": (
        0x641, 1,
        (
            Carrier("speed", "GPS_Geschw", "km/h", 0.01, 16, False),
            Carrier("course", "GPS_Kurs", "deg", 0.01, 16, False),
        ),
    ),
}  # fmt: skip
AMERICAN: Database = {
    "WheelSpeed": (0x215, 0, _wheels("WhlFl_W_Meas WhlFr_W_Meas WhlRl_W_Meas WhlRr_W_Meas", "rad/s", 0.01)),
    "SteeringPinion": (0x07D, 0, (Carrier("steering", "StePin_An_Est", "-deg", 0.1),)),
    "Yaw_Data": (0x091, 0, (Carrier("yaw_rate", "VehYaw_W_Actl", "rad/s", 0.0002),)),
    "Accel_Data": (
        0x092, 0,
        (Carrier("left", "VehLat_A_Actl", "m/s²", 0.005), Carrier("forward", "VehLong_A_Actl", "m/s²", 0.005)),
    ),
    "GPS_Position": (
        0x465, 0,
        (
            Carrier("latitude", "Gps_Latitude_Actl", "deg", 1e-7, 32),
            Carrier("longitude", "Gps_Longitude_Actl", "deg", 1e-7, 32),
        ),
    ),
    "GPS_Motion": (
        0x466, 0,
        (
            Carrier("speed", "Gps_Speed_Actl", "m/s", 0.005, 16, False),
            Carrier("course", "Gps_Heading_Actl", "deg", 0.01, 16, False),
        ),
    ),
}  # fmt: skip
ASIAN: Database = {
    "WHEEL_SPEEDS": (0x0AA, 0, _wheels("WS_FL WS_FR WS_RL WS_RR", "km/h", 0.01)),
    "STEER_ANGLE_SENSOR": (0x025, 0, (Carrier("steering", "STEER_ANGLE", "deg", 0.1),)),
    "KINEMATICS": (
        0x024, 0,
        (
            Carrier("yaw_rate", "YAW_RATE", "-deg/s", 0.01), Carrier("left", "ACCEL_LAT", "-m/s²", 0.005),
            Carrier("forward", "ACCEL_LON", "m/s²", 0.005),
        ),
    ),
    "GNSS_POS": (
        0x500, 1,
        (Carrier("latitude", "GNSS_LAT", "deg", 1e-7, 32), Carrier("longitude", "GNSS_LON", "deg", 1e-7, 32)),
    ),
    "GNSS_VEL": (
        0x501, 1, (Carrier("north", "GNSS_VEL_N", "m/s", 0.005), Carrier("east", "GNSS_VEL_E", "m/s", 0.005)),
    ),
}  # fmt: skip


def quantities(recording: Recording) -> dict[str, tuple[NDArray[np.int64], Array]]:
    """Times of arrival [ns] and values (n,) [SI, ISO 8855; latitude and longitude in rad] of what cars log."""
    imu, twist, fix = recording["imu/data"], recording["gps/velocity"], recording["gps/fix"]
    east, north = twist.columns["linear"][:, :2].T
    spin = recording["vehicle/wheel_speeds"]
    steering = recording["vehicle/steering"]

    def of(channel: Channel, values: Array) -> tuple[NDArray[np.int64], Array]:
        return channel.received, values

    return {
        "yaw_rate": of(imu, imu.columns["angular_velocity"][:, 2]),
        "forward": of(imu, imu.columns["linear_acceleration"][:, 0]),
        "left": of(imu, imu.columns["linear_acceleration"][:, 1]),
        "steering": of(steering, steering.columns["position"][:, 0]),
        **{f"wheel_{wheel}": of(spin, spin.columns["velocity"][:, i]) for i, wheel in enumerate(WHEELS)},
        "east": of(twist, east),
        "north": of(twist, north),
        "speed": of(twist, np.hypot(east, north)),
        "course": of(twist, np.arctan2(east, north) % (2 * np.pi)),
        "latitude": of(fix, np.radians(fix.columns["latitude"][:, 0])),
        "longitude": of(fix, np.radians(fix.columns["longitude"][:, 0])),
    }


def _carried(values: Array, one: Carrier, radius: float) -> Array:
    """Values as a signal of the database carries them: within what its bits can hold."""
    most = (2 ** (one.bits - one.signed) - 1) * one.step
    least = -most if one.signed else 0.0
    return np.clip(_in_unit(values, one.unit, one.quantity, radius), least, most)


def _in_unit(values: Array, unit: str, quantity: str, radius: float) -> Array:
    if quantity.startswith("wheel_") and unit == "km/h":
        values = values * radius
    return values / to_si(unit.lstrip("-")) * (-1 if unit.startswith("-") else 1)


def database_text(database: Database) -> str:
    """The database as DBC."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: X"]
    for name, (identifier, order, carriers) in database.items():
        lines.append(f"BO_ {identifier} {name}: 8 X")
        at = 0
        for one in carriers:
            start = at if order else at // 8 * 8 + 7
            sign, unit = "-" if one.signed else "+", one.unit.lstrip("-")
            lines.append(f' SG_ {one.name} : {start}|{one.bits}@{order}{sign} ({one.step},0) [0|0] "{unit}" X')
            at += one.bits
    lines.append("BO_ 1365 Motor_07: 8 X")  # what a bus has besides
    lines.append(' SG_ Motordrehzahl : 0|16@1+ (0.25,0) [0|0] "rpm" X')
    return "\n".join(lines) + "\n"


def write_can(recording: Recording, path: Path, database: Database, radius: float) -> None:
    """A candump log of a recording; `radius` [m] turns the spin of a wheel into its speed over ground."""
    known = cantools.database.load_string(database_text(database), "dbc")
    values = quantities(recording)
    frames: list[tuple[int, str]] = []
    for name, (_, _, carriers) in database.items():
        message = known.get_message_by_name(name)
        assert isinstance(message, Message)
        stamps = values[carriers[0].quantity][0]
        columns = {one.name: _carried(values[one.quantity][1], one, radius) for one in carriers}
        frames += _frames(message, stamps, columns)
    idle = known.get_message_by_name("Motor_07")
    assert isinstance(idle, Message)
    stamps = values["steering"][0]
    frames += _frames(idle, stamps, {"Motordrehzahl": 2000 + 500 * np.sin(np.arange(len(stamps)) / 70)})
    path.write_text("".join(line for _, line in sorted(frames)), encoding="utf-8")


def _frames(message: Message, stamps: NDArray[np.int64], columns: Mapping[str, Array]) -> Iterator[tuple[int, str]]:
    for row, stamp in enumerate(stamps.tolist()):
        data = message.encode({name: float(column[row]) for name, column in columns.items()}, strict=False)
        yield stamp, f"({stamp / 1e9:.6f}) can0 {message.frame_id:03X}#{data.hex().upper()}\n"


_TABLE = {
    "FrontLeftWheelSpeed [km/h]": "wheel_fl", "FrontRightWheelSpeed [km/h]": "wheel_fr",
    "RearLeftWheelSpeed [km/h]": "wheel_rl", "RearRightWheelSpeed [km/h]": "wheel_rr",
    "Steering wheel angle [deg]": "steering", "Yaw rate [deg/s]": "yaw_rate", "Lat acceleration [g]": "left",
    "Long acceleration [g]": "forward", "GPS latitude [deg]": "latitude", "GPS longitude [deg]": "longitude",
    "GPS speed [km/h]": "speed", "GPS heading [deg]": "course",
}  # fmt: skip


def write_table(recording: Recording, path: Path, radius: float) -> None:
    """A table with a row every 10 ms; a cell is empty until its sensor has a new value."""
    values = quantities(recording)
    stamps = values["yaw_rate"][0]
    cells = []
    for heading, quantity in _TABLE.items():
        unit = heading.split("[")[1].rstrip("]")
        arrived, column = values[quantity]
        written = np.searchsorted(stamps, arrived)
        made = [""] * len(stamps)
        for row, value in zip(written.tolist(), _in_unit(column, unit, quantity, radius).tolist(), strict=True):
            if row < len(made):
                made[row] = f"{value:.7f}"
        cells.append(made)
    rows = [f"{(stamp - stamps[0]) / 1e9:.3f}," + ",".join(row) for stamp, *row in zip(stamps, *cells, strict=True)]
    path.write_text("\n".join(["Time [s]," + ",".join(_TABLE), *rows]) + "\n", encoding="utf-8")


_TOPICS = {
    "imu/data": "sensing/imu/raw", "vehicle/wheel_speeds": "chassis/wheel_encoders",
    "vehicle/steering": "chassis/steering_report", "gps/fix": "sensing/gnss/fix", "gps/velocity": "sensing/gnss/vel",
}  # fmt: skip
_JOINTS = {
    "wheel_fl": "front_left_wheel", "wheel_fr": "front_right_wheel", "wheel_rl": "rear_left_wheel",
    "wheel_rr": "rear_right_wheel", "steering_wheel": "steering_wheel_joint",
}  # fmt: skip


def write_foreign_bag(recording: Recording, path: Path, radius: float = 0.0) -> None:
    """A bag with names of topics, joints and frames of another project."""
    channels = {}
    for topic, name in _TOPICS.items():
        channel = recording[topic]
        joints = tuple(_JOINTS[joint] for joint in channel.names)
        channels[name] = replace(channel, topic=name, names=joints, frame_id="sensor" if channel.frame_id else "")
    write_bag(path, Recording(channels, name=path.name))


Writer = Callable[[Recording, Path, float], None]


@dataclass(frozen=True)
class LogFormat:
    """How a stranger's car logs: `write` makes a file that ends in `suffix`; `database` is the text of the DBC to it.
    With `logs_arrival` its times are those at which messages arrived, not at which they were measured."""

    write: Writer
    suffix: str
    database: str = ""
    logs_arrival: bool = True


def _can(database: Database) -> LogFormat:
    return LogFormat(
        lambda recording, path, radius: write_can(recording, path, database, radius), ".log", database_text(database)
    )


FORMATS: Mapping[str, LogFormat] = {
    "German CAN": _can(GERMAN), "American CAN": _can(AMERICAN), "Asian CAN": _can(ASIAN),
    "table": LogFormat(write_table, ".csv"), "foreign bag": LogFormat(write_foreign_bag, "", logs_arrival=False),
}  # fmt: skip
