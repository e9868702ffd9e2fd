"""What further bug reports show, whose files are one step off the path; see `cases`."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np

from recordings.cases import NOON, SECOND, decoder, frame, nmea, pvt
from vsense_ros.bag import write_bag
from vsense_ros.bag.importers import build, import_recording
from vsense_ros.checks.inspect import inspect
from vsense_ros.driver.ubx import fletcher
from vsense_ros.messages.recording import Recording

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: X\n'


def imu_output(message: str, **axes: str) -> dict:
    """An output of axes of imu/data [rad/s]."""
    told = {axis: {"signals": signal, "unit": "rad/s", "standard_deviation": 0.01} for axis, signal in axes.items()}
    return {"kind": "imu", "topic": "imu/data", "frame_id": "imu_link", "message": message, "axes": told}


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
    (told,) = [d for d in subject.diagnostics(NOON * SECOND) if "TURN" in d.name]
    assert told.values["angular_velocity_z is not valid by QF"] == "1"


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


FURTHER_CASES = {
    "21_ubx_among_nmea": ubx_among_nmea,
    "22_clock_wraps_or_is_set": clock_wraps_or_is_set,
    "24_sign_in_a_bit_of_its_own": sign_in_a_bit_of_its_own,
    "25_quality_flag": quality_flag,
    "26_one_signal_drops_the_frame": one_signal_drops_the_frame,
}
