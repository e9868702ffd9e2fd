"""Blocks of a Septentrio receiver, packed as its reference guide says, give the motion that was packed."""

from __future__ import annotations

import struct
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import find_importer, import_recording
from vsense_ros.errors import InputError

WEEK, START = 2325, 302_400_000  # of GPS; Wednesday 12:00:00
UTC_NS = round(datetime(2024, 7, 31, 11, 59, 42, tzinfo=UTC).timestamp() * 1e9)  # 18 leap seconds behind GPS
NONE = -2e10
COUNT = 5


def crc(data: bytes) -> int:
    """CRC-16-CCITT, bit by bit as in the guide."""
    value = 0
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


def block(number: int, layout: str, *values: float, tow: int, week: int = WEEK) -> bytes:
    body = struct.pack("<IH" + layout, tow, week, *values)
    body += bytes(-(8 + len(body)) % 4)
    rest = struct.pack("<HH", number, 8 + len(body)) + body
    return b"$@" + struct.pack("<H", crc(rest)) + rest


def solution(tow: int, mode: int = 4, error: int = 0, latitude: float = 0.85, up: float = 0.1) -> bytes:
    motion = (3.0, 4.0, up, 53.13)  # north, east, up [m/s], course [deg]
    tail = (0.0, 0.0, 0, 0, 20, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
    layout = "BBddd" + "5f" + "dfBBBBHHIBBHHHB"
    return block(4007, layout, mode, error, latitude, 0.2, 500.0, 47.0, *motion, *tail, tow=tow)


def position_error(tow: int) -> bytes:
    return block(5906, "BB10f", 4, 0, 4.0, 9.0, 16.0, 1.0, 0.5, 0.25, 0, 0.125, 0, 0, tow=tow)


def velocity_error(tow: int) -> bytes:
    return block(5908, "BB10f", 4, 0, 0.04, 0.09, 0.16, 1.0, 0.01, 0.02, 0, 0.03, 0, 0, tow=tow)


def attitude(tow: int, roll: float = 2.0) -> bytes:
    return block(5938, "BBHBB6f", 20, 0, 2, 0, 0, 90.0, 3.0, roll, 0, 0, 0, tow=tow)


def attitude_error(tow: int) -> bytes:
    return block(5939, "BB6f", 0, 0, 0.25, 0.5, 1.0, 0, 0, 0, tow=tow)


def log(folder: Path, *parts: bytes) -> Path:
    path = folder / "drive.sbf"
    path.write_bytes(b"".join(parts))
    return path


def drive(covariances: bool = True) -> list[bytes]:
    found = []
    for i in range(COUNT):
        tow = START + 100 * i
        found += [solution(tow), attitude(tow), attitude_error(tow)]
        found += [position_error(tow), velocity_error(tow)] if covariances else []
    return found


def test_position_velocity_and_their_covariances_are_east_north_up_in_utc(tmp_path: Path) -> None:
    path = log(tmp_path, *drive())
    assert find_importer(path).name == "septentrio"
    recording = import_recording(path)
    fix, velocity = recording["gps/fix"], recording["gps/velocity"]
    assert fix.stamp.tolist() == [UTC_NS + 100_000_000 * i for i in range(COUNT)]
    assert fix.columns["latitude"][:, 0] == pytest.approx(np.degrees(0.85))
    assert fix.columns["longitude"][:, 0] == pytest.approx(np.degrees(0.2))
    assert fix.columns["altitude"][:, 0] == pytest.approx(500.0)
    east_first = [9.0, 0.5, 0.125, 0.5, 4.0, 0.25, 0.125, 0.25, 16.0]
    assert fix.columns["position_covariance"][0] == pytest.approx(east_first)
    assert velocity.columns["linear"][0] == pytest.approx([4.0, 3.0, 0.1], abs=1e-6)
    covariance = velocity.columns["covariance"][0].reshape(6, 6)[:3, :3]
    assert covariance == pytest.approx(np.array([[0.09, 0.01, 0.03], [0.01, 0.04, 0.02], [0.03, 0.02, 0.16]]))


def test_a_vehicle_that_looks_east_with_its_nose_up_has_the_yaw_0_and_a_negative_pitch(tmp_path: Path) -> None:
    channel = import_recording(log(tmp_path, *drive()))["gps/attitude"]
    turn = Rotation.from_quat(channel.columns["orientation"][0])
    forward, left = turn.apply([1.0, 0.0, 0.0]), turn.apply([0.0, 1.0, 0.0])
    assert forward == pytest.approx([np.cos(np.radians(3)), 0.0, np.sin(np.radians(3))], abs=1e-6)
    assert left[2] > 0  # the right side is down
    covariance = channel.columns["orientation_covariance"][0]
    assert covariance[[0, 4, 8]] == pytest.approx(np.radians(1.0) ** 2 * np.array([1.0, 0.5, 0.25]))


def test_an_angle_that_two_antennas_cannot_see_is_unmeasured_and_errors_without_a_block_are_unknown(
    tmp_path: Path,
) -> None:
    with_error = import_recording(log(tmp_path, attitude(START, NONE), attitude_error(START)))["gps/attitude"]
    assert with_error.columns["orientation_covariance"][0, 0] == 1e6
    alone = import_recording(log(tmp_path, attitude(START), solution(START)))
    assert not alone["gps/attitude"].columns["orientation_covariance"].any()
    assert not alone["gps/fix"].columns["position_covariance_type"].any()
    second = [solution(START), position_error(START), solution(START + 100)]
    kinds = import_recording(log(tmp_path, *second))["gps/fix"].columns["position_covariance_type"]
    assert kinds[:, 0].tolist() == [3.0, 0.0]


def test_what_has_no_solution_is_no_message(tmp_path: Path) -> None:
    parts = [solution(START), solution(START + 100, mode=0), solution(START + 200, error=1)]
    parts += [solution(START + 300, latitude=NONE), solution(START + 400, up=NONE)]
    recording = import_recording(log(tmp_path, *parts))
    assert len(recording["gps/fix"]) == 2
    assert len(recording["gps/velocity"]) == 2
    with pytest.raises(InputError, match=r"no position, velocity or attitude.* PVTGeodetic"):
        import_recording(log(tmp_path, solution(START, mode=0)))


def test_sentences_and_damage_between_blocks_cost_nothing_else_and_are_counted(tmp_path: Path) -> None:
    damaged = bytearray(solution(START + 50))
    damaged[20] ^= 1
    sentence = b"$GPGGA,120000.00,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
    parts = [sentence, solution(START), bytes(damaged), b"$@junk", solution(START + 100), solution(START + 200)[:-4]]
    path = log(tmp_path, *parts)
    assert find_importer(path).name == "septentrio"
    recording = import_recording(path)
    assert len(recording["gps/fix"]) == 2
    notes = " ".join(recording.notes)
    assert "1 blocks left out: checksum wrong" in notes
    assert "cut at the end of the file" in notes
    left = len(sentence) + len(damaged) + len(b"$@junk") + len(solution(START)) - 4
    assert f"{left} bytes belong to no whole block" in notes


@settings(deadline=None, max_examples=60)
@given(cut=st.integers(0, 400), flips=st.lists(st.tuples(st.integers(0, 400), st.integers(1, 255)), max_size=4))
def test_whatever_is_damaged_no_wrong_value_comes_of_it(
    tmp_path_factory: pytest.TempPathFactory, cut: int, flips: list[tuple[int, int]]
) -> None:
    data = bytearray(b"".join(drive())[: 600 - cut])
    for at, bits in flips:
        if at < len(data):
            data[at] ^= bits
    path = log(tmp_path_factory.mktemp("sbf"), bytes(data))
    try:
        recording = import_recording(path)
    except InputError:
        return
    if "gps/fix" in recording:
        assert recording["gps/fix"].columns["latitude"] == pytest.approx(np.degrees(0.85))
