"""BLF and ASC files are read at once as python-can reads them one by one; what is not whole goes to it."""

from __future__ import annotations

import struct
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.driver.can_frames import CanFrames
from vsense_ros.driver.can_frames_fast import _objects, asc_frames, blf_frames
from vsense_ros.driver.can_log import CanLog, _one_by_one, read_can_log, read_frames
from vsense_ros.errors import InputError

START = 1_714_564_800.0  # [s]
FAST = {".blf": blf_frames, ".asc": asc_frames}


def messages(count: int = 500, *, fd: bool = False) -> list[can.Message]:
    return [
        can.Message(
            timestamp=START + i * 0.001,
            arbitration_id=0x18FEF100 + i % 3 if i % 2 else 0x123,
            is_extended_id=bool(i % 2),
            data=struct.pack("<Q", i)[: i % 9],
            channel=i % 3,
            is_fd=fd and i == count // 2,
        )
        for i in range(count)
    ]


def written(path: Path, frames: list[can.Message]) -> Path:
    with can.Logger(path) as logger:
        for message in frames:
            logger(message)
    return path


def at_once(path: Path) -> CanFrames | None:
    return FAST[path.suffix](path, read_can_log(path).first_time)


def assert_same(one: CanFrames, other: CanFrames) -> None:
    assert one.time == pytest.approx(other.time, abs=2e-6)
    assert one.identifier.tolist() == other.identifier.tolist()
    assert one.is_extended.tolist() == other.is_extended.tolist()
    assert [one.channels[i] for i in one.channel] == [other.channels[i] for i in other.channel]
    assert one.channels == other.channels
    assert one.length.tolist() == other.length.tolist()
    rows = np.arange(len(one))
    assert np.array_equal(one.rows(rows), other.rows(rows))


@pytest.mark.parametrize("ending", FAST)
def test_what_is_read_at_once_is_what_python_can_reads(ending: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"drive{ending}", messages())
    found = at_once(path)
    assert found is not None
    assert_same(found, _one_by_one(read_can_log(path)))
    assert len(found) == 500


@pytest.mark.parametrize("ending", FAST)
def test_remote_and_error_frames_are_no_data(ending: str, tmp_path: Path) -> None:
    frames = messages(50)
    frames.insert(20, can.Message(timestamp=frames[20].timestamp, arbitration_id=5, is_remote_frame=True, channel=0))
    frames.insert(30, can.Message(timestamp=frames[29].timestamp, is_error_frame=True, channel=0))
    path = written(tmp_path / f"drive{ending}", frames)
    assert_same(read_frames(path), _one_by_one(read_can_log(path)))
    assert len(read_frames(path)) == 50


@pytest.mark.parametrize("ending", FAST)
def test_frames_of_can_fd_are_left_to_python_can(ending: str, tmp_path: Path) -> None:
    path = written(tmp_path / f"drive{ending}", messages(fd=True))
    assert at_once(path) is None
    assert len(read_frames(path)) == 500


@pytest.mark.parametrize("ending", FAST)
@settings(deadline=None, max_examples=40)
@given(share=st.floats(0.0, 1.0), flip=st.integers(0, 255))
def test_a_damaged_file_is_never_read_otherwise_than_frame_by_frame(
    ending: str, tmp_path_factory: pytest.TempPathFactory, share: float, flip: int
) -> None:
    path = written(tmp_path_factory.mktemp("bus") / f"drive{ending}", messages(60))
    content = bytearray(path.read_bytes())
    at = int(share * (len(content) - 1))
    if flip:
        content[at] ^= flip
    else:
        del content[at:]
    path.write_bytes(bytes(content))
    if read_can_log_or_none(path) is None:
        return
    found = at_once(path)
    if found is not None:
        assert_same(found, _one_by_one(read_can_log(path)))


@pytest.mark.parametrize(
    ("whole", "damaged"),
    [
        (b"   Rx   d 8 2C", b" \r Rx   d 8 2C"),
        (b" 0.044000 3  ", b" 0 044000 3  "),
        (b" 0.044000 3  ", b" 0804400 3  "),
        (b" 0.044000 3  ", b" 0.04400\x00 3  "),
        (b" 0.044000 3  123 ", b" 0.044000 3  38FEF102x "),
        (b" 0.044000 3  123 ", b" 0.044000 3  80000123 "),
    ],
    ids=["line return", "space in a time", "time without a point", "no text", "30 bits", "32 bits"],
)
def test_a_text_that_is_no_frame_for_python_can_is_none_here(whole: bytes, damaged: bytes, tmp_path: Path) -> None:
    path = written(tmp_path / "drive.asc", messages(60))
    content = path.read_bytes()
    assert content.count(whole) == 1
    path.write_bytes(content.replace(whole, damaged))
    assert at_once(path) is None


def read_can_log_or_none(path: Path) -> CanLog | None:
    try:
        log = read_can_log(path)
    except InputError:
        return None
    return log if log.format == path.suffix[1:] else None


def test_lines_of_another_format_in_an_asc_file_are_told(tmp_path: Path) -> None:
    path = written(tmp_path / "drive.asc", messages(60))
    assert read_frames(path).losses == ()
    path.write_text(path.read_text() + 'Time,Speed\n"0.010","72.0"\n')
    found = read_frames(path)
    assert len(found) == 60
    assert [loss.partition(": ")[2] for loss in found.losses] == ["'Time,Speed'", '\'"0.010","72.0"\'']


def test_a_block_without_an_object_is_left_to_python_can_and_an_empty_one_has_no_frames() -> None:
    assert _objects(b"no object here") is None
    none = _objects(b"")
    assert none is not None
    assert [len(part) for part in none] == [0] * 5
