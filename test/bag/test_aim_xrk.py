"""Logs of AiM, written message by message, with fixes as u-blox documents NAV-SOL (u-blox 6 Receiver Description)."""

from __future__ import annotations

import struct
import zlib
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.bag.importers import find_importer, import_recording
from vsense_ros.bag.importers.guess import guess
from vsense_ros.errors import InputError

PLACE = (45.62, 9.28, 190.0)
ENU = (12.0, 5.0, 0.0)  # [m/s]
START = round(datetime(2025, 4, 11, 15, 50, 7, tzinfo=UTC).timestamp() * 1e9)
G, DEG_S = 3, 5  # units of channels
FLOAT = 6  # decoder of channels


def message(token: str, data: bytes) -> bytes:
    name = token.encode().ljust(4, b"\0")
    end = b"<" + name + struct.pack("<H", sum(data) & 0xFFFF) + b">"
    return b"<h" + name + struct.pack("<iB", len(data), 1) + b">" + data + end


def channel(index: int, name: str, unit: int) -> bytes:
    data = bytearray(112)
    struct.pack_into("<H", data, 0, index)
    data[12], data[20], data[72] = unit, FLOAT, 4
    data[24:31], data[32 : 32 + len(name)] = name[:7].encode().ljust(7, b"\0"), name.encode()
    struct.pack_into("<I", data, 64, 10_000)
    return message("CHS", bytes(data))


def fix(time: int, kind: int) -> bytes:
    position, velocity = pymap3d.geodetic2ecef(*PLACE), pymap3d.enu2ecefv(*ENU, PLACE[0], PLACE[1])
    x, y, z = (round(value * 100) for value in position)
    vx, vy, vz = (round(value * 100) for value in velocity)
    solution = (0, 0, 2361, kind, 0xDF, x, y, z, 150, vx, vy, vz, 20, 120, 0, 12, 0)
    return message("GPS", struct.pack("<iIihBBiiiIiiiIHBBI", time, *solution))


def log(with_date: bool = True, seconds: float = 10.0, spare: int = 2) -> bytes:
    parts = [
        message("CNF", b"".join((channel(0, "Master", 18), channel(1, "YawRate", DEG_S), channel(2, "LateralAcc", G))))
    ]
    for time in range(0, round(seconds * 1000), 10):
        for index, value in ((1, 5.0 + time / 1e3), (2, 0.3 + time / 1e5)):
            parts.append(b"(S" + struct.pack("<iHf", time, index, value) + b")")
        if time % 100 == 0:
            parts.append(fix(time, 0 if time < 100 * spare else 3))
    track = b"Monza".ljust(32, b"\0") + struct.pack("<Iii", 0, 456_000_000, 92_000_000) + bytes(52)
    parts.append(message("TRK", track))
    if with_date:
        parts += [message("TMD", b"11/04/2025\0"), message("TMT", b"15:50:07\0")]
    return b"".join(parts)


def test_position_and_speed_are_read_without_a_mapping_where_there_is_a_fix(tmp_path: Path) -> None:
    (tmp_path / "lap.xrk").write_bytes(log())
    assert find_importer(tmp_path / "lap.xrk").name == "aim_xrk"
    recording = import_recording(tmp_path / "lap.xrk")
    place = recording["gps/fix"]
    assert len(place) == 98
    assert place.stamp[0] == START + 200_000_000
    assert place.columns["latitude"] == pytest.approx(PLACE[0], abs=1e-6)
    assert place.columns["longitude"] == pytest.approx(PLACE[1], abs=1e-6)
    assert place.columns["altitude"] == pytest.approx(PLACE[2], abs=0.02)
    assert recording["vehicle/velocity"].columns["linear"][:, 0] == pytest.approx(13.0, abs=0.02)


def test_channels_are_read_by_a_mapping_in_the_units_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "lap.xrk").write_bytes(log())
    imu = {
        "angular_velocity": [None, None, {"column": "YawRate"}],
        "linear_acceleration": [None, {"column": "LateralAcc"}, None],
    }
    channel = import_recording(tmp_path / "lap.xrk", mapping={"topics": {"imu/data": imu}})["imu/data"]
    seconds = (channel.stamp - START) / 1e9
    assert len(channel) == 1000
    assert channel.columns["angular_velocity"][:, 2] == pytest.approx(np.radians(5.0 + seconds), abs=1e-5)
    assert channel.columns["linear_acceleration"][:, 1] == pytest.approx(9.80665 * (0.3 + seconds / 100), abs=1e-5)
    wrong = {"topics": {"imu/data": {"angular_velocity": [None, None, {"column": "Yaw"}]}}}
    with pytest.raises(InputError, match=r"no channel 'Yaw'; found: .*YawRate"):
        import_recording(tmp_path / "lap.xrk", mapping=wrong)


def test_a_mapping_is_proposed_by_the_names_of_channels(tmp_path: Path) -> None:
    (tmp_path / "lap.xrk").write_bytes(log())
    proposal = tmp_path / "lap.yaml"
    proposal.write_text(guess(tmp_path / "lap.xrk").text, encoding="utf-8")
    recording = import_recording(tmp_path / "lap.xrk")
    assert {"imu/data", "gps/fix", "vehicle/velocity"} <= set(recording.channels)


def test_a_compressed_log_is_the_same_and_one_that_was_cut_says_so(tmp_path: Path) -> None:
    (tmp_path / "lap.xrz").write_bytes(zlib.compress(log()))
    assert len(import_recording(tmp_path / "lap.xrz")["gps/fix"]) == 98
    (tmp_path / "cut.xrk").write_bytes(log(with_date=False)[:-3])
    with pytest.raises(InputError, match="Race Studio 3"):  # the line of the track is in what was cut
        import_recording(tmp_path / "cut.xrk")
    (tmp_path / "end.xrk").write_bytes(log() + log()[:-3])
    notes = " ".join(import_recording(tmp_path / "end.xrk").notes)
    assert "it was cut" in notes


def test_without_a_date_times_count_from_1970_and_a_note_says_so(tmp_path: Path) -> None:
    (tmp_path / "lap.xrk").write_bytes(log(with_date=False))
    recording = import_recording(tmp_path / "lap.xrk")
    assert recording["gps/fix"].stamp[0] == 200_000_000
    assert any("1970" in note for note in recording.notes)


@settings(deadline=None, max_examples=40)
@given(data=st.data())
def test_damage_gives_a_recording_or_an_error_for_users(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray(log(seconds=1.0))
    content = content[: data.draw(st.integers(0, len(content)))]
    for _ in range(data.draw(st.integers(0, 4)) if content else 0):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("xrk") / "lap.xrk"
    path.write_bytes(content)
    try:
        recording = import_recording(path)
    except InputError:
        return
    assert recording.channels
