"""The far end of a driver's port, and the log of its bytes."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import can
import pytest
import serial

from vsense_ros.errors import InputError
from vsense_ros.node.byte_log import read_byte_log, write_byte_log
from vsense_ros.node.ports import PtyPort, SlcanAdapter, open_port


def test_bytes_written_to_a_pty_arrive_unchanged(tmp_path: Path) -> None:
    port = PtyPort(str(tmp_path / "gnss"))
    data = bytes(range(256))
    assert not port.ready()
    assert port.write(data) == len(data)  # nobody reads
    with serial.Serial(str(tmp_path / "gnss"), timeout=1.0) as reader:
        assert port.ready()
        assert port.write(data) == 0
        assert reader.read(256) == data
    port.close()
    assert not (tmp_path / "gnss").exists()


def test_a_file_in_the_way_of_a_pty_stays(tmp_path: Path) -> None:
    (tmp_path / "gnss").write_text("precious")
    with pytest.raises(InputError, match="no link"):
        PtyPort(str(tmp_path / "gnss"))
    assert (tmp_path / "gnss").read_text() == "precious"


def test_bytes_written_to_a_socket_arrive_unchanged() -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        number = probe.getsockname()[1]
    port = open_port(f"socket://127.0.0.1:{number}")
    assert not port.ready()
    with serial.serial_for_url(f"socket://127.0.0.1:{number}", timeout=1.0) as reader:
        assert port.write(b"$GNRMC") == 0
        assert reader.read(6) == b"$GNRMC"
    port.close()


def test_an_address_that_is_none_is_refused() -> None:
    with pytest.raises(InputError, match="host:port"):
        open_port("socket://nowhere")


@pytest.mark.parametrize(
    "frame",
    [
        can.Message(arbitration_id=0xAA, data=bytes.fromhex("1a6f1a6f1a6f1a6f"), is_extended_id=False),
        can.Message(arbitration_id=0x18FEF100, data=b"\x00\xff", is_extended_id=True),
        can.Message(arbitration_id=0x7FF, dlc=3, is_remote_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0x18FEF1FF, dlc=0, is_remote_frame=True, is_extended_id=True),
        can.Message(arbitration_id=0, data=b"", is_extended_id=False),
    ],
)
def test_python_can_reads_the_frames_of_the_slcan_adapter(tmp_path: Path, frame: can.Message) -> None:
    adapter = SlcanAdapter(str(tmp_path / "can"))
    with can.Bus(channel=str(tmp_path / "can"), interface="slcan", sleep_after_open=0.0, timeout=0.1) as bus:
        assert adapter.ready()
        assert adapter.send(frame) == 0
        read = bus.recv(1.0)
    adapter.close()
    assert read is not None
    assert read.equals(frame, timestamp_delta=None, check_channel=False, check_direction=False)


def test_a_slcan_driver_that_leaves_is_noticed(tmp_path: Path) -> None:
    adapter = SlcanAdapter(str(tmp_path / "can"))
    with can.Bus(channel=str(tmp_path / "can"), interface="slcan", sleep_after_open=0.0):
        assert adapter.ready()
    assert not adapter.ready()
    assert adapter.send(can.Message(arbitration_id=1)) == 1
    adapter.close()


def test_a_byte_log_keeps_times_and_bytes(tmp_path: Path) -> None:
    entries = [(1_723_456_789_123_456_789, b"$GN\r\n"), (1_723_456_789_223_456_789, b"\x00\xff"), (5, b"")]
    write_byte_log(tmp_path / "log", entries)
    assert read_byte_log(tmp_path / "log") == entries


@pytest.mark.parametrize("line", ["soon 00ff", "12 0g", "12 0"])
def test_a_line_that_is_no_entry_of_a_byte_log_is_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "log").write_text(f"1 00\n{line}\n")
    with pytest.raises(InputError, match=r"log, line 2"):
        read_byte_log(tmp_path / "log")


def test_a_missing_byte_log_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing_here"):
        read_byte_log(tmp_path / "nothing_here")


def test_descriptors_of_closed_ptys_are_given_back(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        PtyPort(str(tmp_path / "x")).close()
    assert len(os.listdir("/proc/self/fd")) == before
