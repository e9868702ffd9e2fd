"""What further bug reports show, whose files are one step off the path; see `cases`."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np

from recordings.cases import NOON, SECOND, decoder, frame

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


FURTHER_CASES = {
    "24_sign_in_a_bit_of_its_own": sign_in_a_bit_of_its_own,
    "25_quality_flag": quality_flag,
    "26_one_signal_drops_the_frame": one_signal_drops_the_frame,
}
