"""What further bug reports show, whose files are one step off the path; see `cases`."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import can
import numpy as np
import pytest
from cantools.database import Database, Message, Signal
from cantools.database.conversion import LinearConversion

from recordings import conventions, guessing, planted
from recordings.cases import NOON, SECOND, decoder, frame, nmea, pvt
from recordings.known_buses import BUSES
from recordings.known_logs import LOGS
from vsense_ros.bag import write_bag
from vsense_ros.bag.importers import build, import_recording
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.inspect import inspect
from vsense_ros.checks.mending import mends
from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_mapping import CanMapping
from vsense_ros.driver.ubx import fletcher
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: X\n'


def imu_output(message: str, **axes: str) -> dict:
    """An output of axes of imu/data [rad/s]."""
    of_axes = {axis: {"signals": signal, "unit": "rad/s", "standard_deviation": 0.01} for axis, signal in axes.items()}
    return {"kind": "imu", "topic": "imu/data", "frame_id": "imu_link", "message": message, "axes": of_axes}


def steering_output(message: str, signal: str, **more: object) -> dict:
    """An output of the steering wheel's angle [deg]."""
    joints = {"steering_wheel": {"signals": signal, "unit": "deg", **more}}
    topic = "vehicle/steering"
    return {"kind": "joint_state", "topic": topic, "message": message, "field": "position", "joints": joints}


def sign_in_a_bit_of_its_own(folder: Path) -> None:
    dbc = HEAD + (
        'BO_ 96 LWS: 8 X\n SG_ SIZE : 8|12@1+ (0.1,0) [0|0] "deg" X\n SG_ SIDE : 20|1@1+ (1,0) [0|1] "" X\n'
        'VAL_ 96 SIDE 0 "left" 1 "right" ;\n'
    )
    subject = decoder(folder, steering_output("LWS", "SIZE", sign={"signal": "SIDE", "negative": "right"}), dbc=dbc)
    got = [
        subject.feed(frame(i, 96, (250 << 8 | side << 20).to_bytes(8, "little")))[0] for i, side in enumerate((0, 1))
    ]
    np.testing.assert_allclose([math.degrees(s.values["position"][0]) for s in got], [25.0, -25.0])


def quality_flag(folder: Path) -> None:
    dbc = HEAD + (
        'BO_ 64 TURN: 8 X\n SG_ RATE : 0|16@1- (0.001,0) [0|0] "rad/s" X\n SG_ QF : 16|2@1+ (1,0) [0|3] "" X\n'
    )
    output = imu_output("TURN", angular_velocity_z="RATE")
    output["axes"]["angular_velocity_z"]["valid"] = {"signal": "QF", "values": [3]}
    subject = decoder(folder, output, dbc=dbc)
    got = [len(subject.feed(frame(i, 64, struct.pack("<hB5x", 700, quality)))) for i, quality in enumerate((3, 0, 3))]
    assert got == [1, 0, 1]
    (reported,) = [d for d in subject.diagnostics(NOON * SECOND) if "TURN" in d.name]
    assert reported.values["angular_velocity_z is not valid by QF"] == "1"


def one_signal_drops_the_frame(folder: Path) -> None:
    dbc = HEAD + (
        'BO_ 65 DYN: 8 X\n SG_ ANGLE : 0|16@1- (0.1,0) [-450|450] "deg" X\n'
        ' SG_ YAW : 16|16@1- (0.0002,0) [-6|6] "rad/s" X\n SG_ ROLL : 32|16@1+ (0.0002,-6) [-6|6] "rad/s" X\n'
    )
    imu = imu_output("DYN", angular_velocity_z="YAW", angular_velocity_x="ROLL")
    subject = decoder(folder, steering_output("DYN", "ANGLE"), imu, dbc=dbc)
    for i, degrees in enumerate((448, 452, 459)):
        steering, turning = subject.feed(frame(i, 65, struct.pack("<hhH2x", degrees * 10, 1500, 65535)))
        np.testing.assert_allclose(np.degrees(steering.values["position"]), degrees)
        np.testing.assert_allclose(turning.values["angular_velocity"], [np.nan, np.nan, 0.3])


def ubx_among_nmea(folder: Path) -> None:
    sent = b""
    for second in range(10):
        gga = nmea(f"GNGGA,1200{second:02d}.00,4800.0000,N,01100.0000,E,1,12,0.6,453.0,M,47.0,M,,")
        sent += gga + b"".join(later_pvt(second, tenths) for tenths in range(10))
    (folder / "mixed.ubx").write_bytes(sent)
    found = import_recording(folder / "mixed.ubx")
    for topic in ("gps/fix", "gps/velocity"):
        assert len(found[topic]) == 100
        np.testing.assert_array_equal(found[topic].stamp, NOON * SECOND + np.arange(100) * SECOND // 10)


def later_pvt(second: int, tenths: int) -> bytes:
    """A NAV-PVT frame of some time after noon."""
    frame = bytearray(pvt())
    frame[6 + 10] = second
    struct.pack_into("<i", frame, 6 + 16, tenths * 100_000_000)
    return bytes(frame[:-2]) + fletcher(bytes(frame[2:-2]))


def clock_wraps_or_is_set(folder: Path) -> None:
    rate = {"column": "r", "unit": "rad/s"}
    mapping = {"time": {"column": "t", "unit": "us"}, "topics": {"imu/data": {"angular_velocity": [None, None, rate]}}}
    rows = [f"{(2**32 - 3_000_000 + i * 10_000) % 2**32},{math.sin(i)}" for i in range(600)]
    (folder / "wrap.csv").write_text("t,r\n" + "\n".join(rows) + "\n")
    found = import_recording(folder / "wrap.csv", mapping=mapping)
    np.testing.assert_allclose(found["imu/data"].seconds, np.arange(600) * 0.01, atol=1e-6)
    assert not inspect(found).problems
    mapping["time"]["unit"] = "iso"
    rows = [f"2024-10-27 02:59:{57 + i / 100:09.6f}" for i in range(300)]
    rows += [f"2024-10-27 02:00:{i / 100:09.6f}" for i in range(300)]
    (folder / "dst.csv").write_text("t,r\n" + "\n".join(f"{t},{math.sin(i)}" for i, t in enumerate(rows)) + "\n")
    found = import_recording(folder / "dst.csv", mapping=mapping)
    np.testing.assert_allclose(found["imu/data"].seconds, np.arange(600) * 0.01, atol=1e-6)
    stamp = NOON * SECOND + np.arange(600) * SECOND // 100
    stamp[:200] -= (NOON - 30) * SECOND
    write_bag(folder / "late", Recording({"imu/data": build.imu(stamp, np.ones((600, 3)), np.ones((600, 3)))}))
    found = import_recording(folder / "late")
    assert len(found["imu/data"]) == 400
    assert any("the clock was set" in note for note in found.notes)


def two_databases_two_buses(folder: Path) -> None:
    wheel = 'SG_ A : 0|16@1+ (0.01,0) [0|0] "m/s" X\n'
    (folder / "a.dbc").write_text(HEAD + f"BO_ 100 SPIN: 8 X\n {wheel}BO_ 101 ALSO: 8 X\n {wheel}")
    (folder / "b.dbc").write_text(HEAD + 'BO_ 100 HAND: 8 X\n SG_ A : 0|16@1- (0.1,0) [0|0] "deg" X\n')
    (folder / "a.yaml").write_text(
        "name: a\noutputs:\n  - {kind: speed, message: SPIN, speed: {signals: A, unit: m/s}}\n"
        "  - {kind: body_velocity, message: ALSO, speed: {signals: A, unit: m/s}}\n"
    )
    (folder / "b.yaml").write_text(
        "name: b\noutputs:\n  - {kind: joint_state, topic: vehicle/steering, message: HAND, field: position, "
        "joints: {steering_wheel: {signals: A, unit: deg}}}\n"
    )
    with can.Logger(folder / "two.log") as logger:
        for i in range(20):
            for channel, identifier, value in (("can0", 100, 1000), ("can0", 101, 1000), ("can1", 100, -450)):
                data = struct.pack("<h6x", value)
                logger(can.Message(NOON + i / 50, identifier, is_extended_id=False, data=data, channel=channel))
    mappings = [folder / "a.yaml", folder / "b.yaml"]
    for dbc in (["a.dbc", "b.dbc"], ["can0=a.dbc", "can1=b.dbc"]):
        files = [f"{bus}{'=' if bus else ''}{folder / name}" for bus, _, name in (d.rpartition("=") for d in dbc)]
        found = import_recording(folder / "two.log", dbc=files, mapping=mappings)
        np.testing.assert_allclose(found["vehicle/speed"].columns["linear"][:, 0], 10.0)
        np.testing.assert_allclose(np.degrees(found["vehicle/steering"].columns["position"]), -45.0)


def vbo_of_racebox(folder: Path) -> None:
    (folder / "lap.vbo").write_text(
        "File created on 01/05/2024 @ 12:00\n\n[header]\nsatellites\ntime\nlatitude\nlongitude\n\n[column names]\n"
        "sats time lat lng velocity heading height\n\n[data]\n"
        + "".join(f"012 1200{i / 10:05.2f} +2880.00000 -660.00000 36.0 90.0 500.0\n" for i in range(20))
    )
    found = import_recording(folder / "lap.vbo")
    np.testing.assert_allclose(found["gps/fix"].columns["longitude"], 11.0)
    np.testing.assert_allclose(found["gps/velocity"].columns["linear"][:, 0], 10.0)


def container_pdu(folder: Path) -> None:
    rate = Signal("YAW", 0, 16, is_signed=True, conversion=LinearConversion(0.001, 0, False), unit="rad/s")
    inside = Message(1, "TURN", 2, [rate], header_id=0x0A0B0C)
    box = Message(102, "BOX", 64, [], contained_messages=[inside], is_fd=True)
    output = imu_output("TURN", angular_velocity_z="YAW")
    subject = CanDecoder(Database([box]), CanMapping.model_validate({"name": "car", "outputs": [output]}))
    data = bytes.fromhex("777777 01 05 0a0b0c 02") + struct.pack("<h", 700)
    (sample,) = subject.feed(frame(0, 102, data.ljust(64, b"\0"), is_fd=True))
    assert abs(sample.values["angular_velocity"][2] - 0.7) < 1e-12


def speed_and_gnss_on_can(folder: Path) -> None:
    dbc = HEAD + (
        'BO_ 110 SPD: 8 X\n SG_ V : 0|16@1+ (0.01,0) [0|300] "km/h" X\n'
        'BO_ 111 NAV: 8 X\n SG_ COG : 0|16@1+ (0.01,0) [0|360] "deg" X\n SG_ SOG : 16|16@1+ (0.01,0) [0|300] "km/h" X\n'
    )
    over_ground = {"speed": {"signals": "SOG", "unit": "km/h"}, "course": {"signals": "COG", "unit": "deg"}}
    outputs = (
        {"kind": "speed", "message": "SPD", "speed": {"signals": "V", "unit": "km/h"}},
        {"kind": "gnss_velocity", "topic": "gps/velocity", "message": "NAV", **over_ground},
    )
    subject = decoder(folder, *outputs, dbc=dbc)
    (speed,) = subject.feed(frame(0, 110, struct.pack("<H6x", 7200)))
    (velocity,) = subject.feed(frame(1, 111, struct.pack("<HH4x", 9000, 3600)))
    np.testing.assert_allclose(speed.values["linear"][0], 20.0)
    np.testing.assert_allclose(velocity.values["linear"], [10.0, 0.0, 0.0], atol=1e-12)


def hostile_input(folder: Path) -> None:
    (folder / "bomb.dbc").write_text(
        HEAD + 'BO_ 5 GOOD: 8 X\n SG_ A : 0|8@1+ (1,0) [0|1] "" X\n SG_ B : -2147483649|8@1+ (1,0) [0|1] "" X\n'
    )
    read = read_database(folder / "bomb.dbc")
    assert [s.name for s in read.database.get_message_by_name("GOOD").signals] == ["A"]
    import h5py

    (folder / "secret").write_bytes(np.arange(64, dtype=float).tobytes())
    with h5py.File(folder / "outside.mat", "w") as file:
        file["t"] = np.arange(64, dtype=float)
        file.create_dataset("x", (64,), "f8", external=[(str(folder / "secret"), 0, 512)])
    rate = {"column": "x", "unit": "rad/s"}
    mapping = {"time": {"column": "t"}, "topics": {"imu/data": {"angular_velocity": [None, None, rate]}}}
    with pytest.raises(InputError, match="'x' is in another file, which is not read"):
        import_recording(folder / "outside.mat", mapping=mapping)


def mend_twice_undoes_itself(folder: Path) -> None:
    recording = conventions.without_gnss(planted.drive("double_lane_change", "prototype_real", 0))
    reversed_ = planted.changed(recording, planted.STEERING, planted.scaled("position", -1.0))
    (todo,) = mends(reversed_)
    assert todo.topic == planted.STEERING
    after = mended(reversed_, [todo])
    assert conventions.same(after, recording)
    assert inspect(after).problems == ()


def bag_with_usual_names(folder: Path) -> None:
    verdict = guessing.judged("bag", BUSES["ROS 2 bag of drivers"], folder)
    assert verdict.right, verdict.why


def dialects_of_tables(folder: Path) -> None:
    for name in (
        "Torque",
        "Car Scanner",
        "TrackAddict",
        "12-hour clock",
        "days of a spreadsheet",
        "MoTeC i2",
        "RomRaider",
    ):
        verdict = guessing.judged(name, LOGS[name], folder)
        assert verdict.right, verdict.why


FURTHER_CASES = {
    "21_ubx_among_nmea": ubx_among_nmea,
    "22_clock_wraps_or_is_set": clock_wraps_or_is_set,
    "23_mend_twice_undoes_itself": mend_twice_undoes_itself,
    "24_sign_in_a_bit_of_its_own": sign_in_a_bit_of_its_own,
    "25_quality_flag": quality_flag,
    "26_one_signal_drops_the_frame": one_signal_drops_the_frame,
    "27_two_databases_two_buses": two_databases_two_buses,
    "28_vbo_of_racebox": vbo_of_racebox,
    "29_bag_with_usual_names": bag_with_usual_names,
    "30_container_pdu": container_pdu,
    "31_dialects_of_tables": dialects_of_tables,
    "32_speed_and_gnss_on_can": speed_and_gnss_on_can,
    "33_hostile_input": hostile_input,
}
