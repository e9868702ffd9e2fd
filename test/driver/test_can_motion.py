"""Speed, GNSS and optical sensors on CAN, messages in containers, and databases of other formats than DBC."""

from __future__ import annotations

import math
import struct
from collections import Counter
from pathlib import Path

import can
import numpy as np
import pytest
from cantools.database import Database, Message, Signal
from cantools.database.conversion import LinearConversion

from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_mapping import CanMapping
from vsense_ros.driver.samples import UNMEASURED_VARIANCE
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Sample

DBC = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 160 SPD: 8 X
 SG_ V : 0|16@1+ (0.01,0) [0|300] "km/h" X
BO_ 161 POS: 8 X
 SG_ LAT : 0|32@1- (1e-07,0) [-90|90] "deg" X
 SG_ LON : 32|32@1- (1e-07,0) [-180|180] "deg" X
BO_ 162 MOVE: 8 X
 SG_ COG : 0|16@1+ (0.01,0) [0|360] "deg" X
 SG_ SOG : 16|16@1+ (0.01,0) [0|300] "km/h" X
 SG_ VN : 32|16@1- (0.01,0) [-300|300] "m/s" X
 SG_ VE : 48|16@1- (0.01,0) [-300|300] "m/s" X
BO_ 163 OPT: 8 X
 SG_ VX : 0|16@1- (0.01,0) [-300|300] "km/h" X
 SG_ VY : 16|16@1- (0.01,0) [-300|300] "km/h" X
"""


def signal(name: str, unit: str, **more: object) -> dict:
    return {"signals": name, "unit": unit, **more}


def decoder(folder: Path, *outputs: dict) -> CanDecoder:
    (folder / "car.dbc").write_text(DBC)
    return CanDecoder(folder / "car.dbc", CanMapping.model_validate({"name": "car", "outputs": outputs}))


def one(subject: CanDecoder, identifier: int, data: bytes) -> Sample:
    """The sample of a frame, which must be as a log as a whole gives it."""
    message = can.Message(timestamp=1000.0, arbitration_id=identifier, is_extended_id=False, data=data)
    (sample,) = subject.feed(message)
    receiver = subject.receiver(identifier, False)
    assert receiver is not None
    frames = np.frombuffer(data, np.uint8)[None]
    ((output, rows, values),) = receiver.table(frames, np.array([len(data)]), Counter(), Counter())
    assert rows.tolist() == [0]
    for name, column in output.columns(values).items():  # type: ignore[union-attr]
        np.testing.assert_array_equal(column[0], sample.values[name])
    return sample


@pytest.mark.parametrize("kind", ["speed", "joint_state"])
def test_the_speed_of_the_car_is_a_speed_and_no_joint(kind: str, tmp_path: Path) -> None:
    given = {"speed": signal("V", "km/h")} if kind == "speed" else {
        "topic": "vehicle/speed", "field": "velocity", "joints": {"speed": signal("V", "km/h")}
    }  # fmt: skip
    sample = one(decoder(tmp_path, {"kind": kind, "message": "SPD", **given}), 160, struct.pack("<H6x", 7200))
    assert (sample.topic, sample.kind) == ("vehicle/speed", "geometry_msgs/msg/TwistStamped")
    np.testing.assert_allclose(sample.values["linear"], [20.0, 0.0, 0.0])


def test_a_position_keeps_its_seventh_digit(tmp_path: Path) -> None:
    fix = {"kind": "gnss_fix", "message": "POS", "latitude": signal("LAT", "deg"), "longitude": signal("LON", "deg")}
    sample = one(decoder(tmp_path, fix), 161, struct.pack("<ii", 481_234_567, -117_654_321))
    assert sample.values["latitude"][0] == pytest.approx(48.1234567, abs=1e-9)
    assert sample.values["longitude"][0] == pytest.approx(-11.7654321, abs=1e-9)
    assert math.isnan(sample.values["altitude"][0])


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"speed": signal("SOG", "km/h"), "course": signal("COG", "deg")}, [10.0, 0.0]),
        ({"east": signal("VE", "m/s"), "north": signal("VN", "m/s")}, [3.0, -4.0]),
    ],
)
def test_a_velocity_over_ground_is_east_and_north(fields: dict, expected: list[float], tmp_path: Path) -> None:
    subject = decoder(tmp_path, {"kind": "gnss_velocity", "message": "MOVE", **fields})
    sample = one(subject, 162, struct.pack("<HHhh", 9000, 3600, -400, 300))
    np.testing.assert_allclose(sample.values["linear"], [*expected, 0.0], atol=1e-12)
    assert sample.values["covariance"].reshape(6, 6)[2, 2] == UNMEASURED_VARIANCE
    assert sample.frame_id == "map"


def test_a_velocity_of_which_half_is_no_value_is_not_published(tmp_path: Path) -> None:
    fields = {"speed": signal("SOG", "km/h"), "course": signal("COG", "deg")}
    subject = decoder(tmp_path, {"kind": "gnss_velocity", "message": "MOVE", **fields})
    data = struct.pack("<HHhh", 65535, 3600, 0, 0)
    assert subject.feed(can.Message(timestamp=1.0, arbitration_id=162, is_extended_id=False, data=data)) == []


@pytest.mark.parametrize(("kind", "topic"), [("odometry", "reference/odometry"), ("body_velocity", "vehicle/velocity")])
def test_an_optical_sensor_gives_the_velocity_in_the_axes_of_the_car(kind: str, topic: str, tmp_path: Path) -> None:
    optical = {"kind": kind, "message": "OPT", "forward": signal("VX", "km/h"), "left": signal("VY", "km/h", factor=-1)}
    sample = one(decoder(tmp_path, optical), 163, struct.pack("<hh4x", 7200, 360))
    assert sample.topic == topic
    np.testing.assert_allclose(sample.values["linear"], [20.0, -1.0, np.nan])


def test_a_heading_becomes_a_yaw_from_east(tmp_path: Path) -> None:
    subject = decoder(tmp_path, {"kind": "gnss_attitude", "message": "MOVE", "heading": signal("COG", "deg")})
    x, y, z, w = one(subject, 162, struct.pack("<HHhh", 3000, 0, 0, 0)).values["orientation"]
    assert (x, y) == (0.0, 0.0)
    assert 2 * math.atan2(z, w) == pytest.approx(math.radians(60.0))


@pytest.mark.parametrize(
    ("output", "expected"),
    [
        ({"kind": "gnss_velocity", "message": "MOVE", "speed": signal("SOG", "km/h")}, "speed and course, or east and"),
        ({"kind": "gnss_fix", "message": "POS", "latitude": signal("LAT", "deg"), "longitude": signal("LON", "m")},
         "longitude is in rad, but the signal gives m"),
        ({"kind": "speed", "message": "SPD", "speed": signal("V", "deg/s")}, "speed is in m/s"),
    ],
)  # fmt: skip
def test_an_output_that_cannot_be_made_is_refused_in_words(output: dict, expected: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=expected):
        decoder(tmp_path, output)


def boxed(name: str, header: int, place: int) -> Message:
    rate = Signal(f"S{place}", 0, 16, is_signed=True, conversion=LinearConversion(0.01, 0, False), unit="deg/s")
    return Message(1, name, 2, [rate], header_id=header)


@pytest.fixture
def in_container() -> CanDecoder:
    parts = [boxed("FIRST", 0x0A0B0C, 1), boxed("SECOND", 0x010203, 2)]
    database = Database([Message(102, "BOX", 64, [], contained_messages=parts, is_fd=True)])
    axis = {"signals": "S2", "unit": "deg/s", "standard_deviation": 0.01}
    output = {"kind": "imu", "topic": "imu/data", "frame_id": "imu_link", "message": "SECOND"}
    mapping = {"name": "car", "outputs": [output | {"axes": {"angular_velocity_z": axis}}]}
    return CanDecoder(database, CanMapping.model_validate(mapping))


def box(*parts: tuple[int, int]) -> bytes:
    return b"".join(header.to_bytes(3, "big") + b"\x02" + struct.pack("<h", value) for header, value in parts)


@pytest.mark.parametrize("order", [1, -1])
def test_a_message_in_a_container_is_found_at_whatever_place(in_container: CanDecoder, order: int) -> None:
    data = box(*[(0x0A0B0C, 500), (0x010203, 900), (0x777777, 1)][::order]).ljust(64, b"\0")
    message = can.Message(timestamp=5.0, arbitration_id=102, is_extended_id=False, is_fd=True, data=data)
    (sample,) = in_container.feed(message)
    assert sample.values["angular_velocity"][2] == pytest.approx(math.radians(9.0))
    container = in_container.container(102, False)
    assert container is not None
    frames = np.frombuffer(data, np.uint8)[None]
    ((receiver, rows, table),) = container.parts(frames, np.array([64]))
    assert (receiver.message.name, rows.tolist()) == ("SECOND", [0])
    assert table.tobytes() == struct.pack("<h", 900)
    for cut in range(64):  # damaged frames cost themselves
        in_container.feed(
            can.Message(timestamp=6.0, arbitration_id=102, is_extended_id=False, is_fd=True, data=data[:cut])
        )


@pytest.mark.parametrize("ending", ["kcd", "sym"])
def test_databases_of_other_formats_are_read(ending: str, tmp_path: Path) -> None:
    (tmp_path / "car.dbc").write_text(DBC)
    database = read_database(tmp_path / "car.dbc").database
    (tmp_path / f"car.{ending}").write_text(getattr(database, f"as_{ending}_string")())
    speed = {"kind": "speed", "message": "SPD", "speed": signal("V", "km/h")}
    subject = CanDecoder(tmp_path / f"car.{ending}", CanMapping.model_validate({"name": "car", "outputs": [speed]}))
    sample = one(subject, 160, struct.pack("<H6x", 7200))
    assert sample.values["linear"][0] == pytest.approx(20.0)


@pytest.mark.parametrize("ending", ["arxml", "kcd", "sym", "dbc"])
@pytest.mark.parametrize("content", [b"", b"<a>", b"\0\xff", b"<NetworkDefinition/>", b"{Enum}"])
def test_a_file_under_the_name_of_a_database_is_refused_in_words(ending: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / f"car.{ending}").write_bytes(content)
    speed = {"kind": "speed", "message": "SPD", "speed": signal("V", "km/h")}
    with pytest.raises(InputError):
        CanDecoder(tmp_path / f"car.{ending}", CanMapping.model_validate({"name": "car", "outputs": [speed]}))


@pytest.mark.parametrize("place", ["-2147483649|8", "2147483647|8", "0|99999999", "7|-8", "0|0"])
def test_a_signal_that_lies_nowhere_is_left_out(place: str, tmp_path: Path) -> None:
    (tmp_path / "car.dbc").write_text(DBC + f' SG_ BAD : {place}@1+ (1,0) [0|1] "" X\n')
    read = read_database(tmp_path / "car.dbc")
    assert {m.name: [s.name for s in m.signals] for m in read.database.messages}["OPT"] == ["VX", "VY"]
    assert any("BAD" in note for note in read.notes)
