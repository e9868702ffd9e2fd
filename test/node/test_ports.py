"""The far end of a driver's port, and the log of its bytes."""

from __future__ import annotations

import ctypes
import os
import socket
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path

import can
import pytest
import serial

from vsense_ros.driver.can_bus import open_bus
from vsense_ros.driver.slcan import SlcanBus
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Level
from vsense_ros.node.byte_log import read_byte_log, write_byte_log
from vsense_ros.node.ports import PtyPort, SlcanAdapter, open_port
from vsense_ros.node.serial_link import SerialLink


def soon(condition: Callable[[], bool], timeout: float = 5.0) -> bool:
    """True as soon as a condition holds: bytes need a moment from one end of a terminal to the other."""
    end = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(1e-3)
    return True


def test_bytes_written_to_a_pty_arrive_unchanged(tmp_path: Path) -> None:
    port = PtyPort(str(tmp_path / "gnss"))
    data = bytes(range(256))
    assert not port.ready()
    assert port.write(data) == len(data)  # nobody reads
    with serial.Serial(str(tmp_path / "gnss"), timeout=1.0) as reader:
        assert soon(port.ready)
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
        assert soon(adapter.ready)
        assert adapter.send(frame) == 0
        read = bus.recv(1.0)
    adapter.close()
    assert read is not None
    assert read.equals(frame, timestamp_delta=None, check_channel=False, check_direction=False)


@pytest.mark.parametrize(
    "frame",
    [
        can.Message(arbitration_id=0xAA, data=bytes.fromhex("1a6f1a6f1a6f1a6f"), is_extended_id=False),
        can.Message(arbitration_id=0x18FEF100, data=b"\x00\xff", is_extended_id=True),
        can.Message(arbitration_id=0x7FF, dlc=3, is_remote_frame=True, is_extended_id=False),
        can.Message(arbitration_id=0, data=b"", is_extended_id=False),
    ],
)
def test_frames_of_an_adapter_that_dates_them_have_its_time_however_late_they_are_read(
    tmp_path: Path, frame: can.Message
) -> None:
    adapter = SlcanAdapter(str(tmp_path / "can"))
    with open_bus("slcan", str(tmp_path / "can"), sleep_after_open=0.0) as bus:
        assert isinstance(bus, SlcanBus)
        assert soon(adapter.ready)
        milliseconds = [59_990, 59_999, 60_000, 60_007]
        for time_of_frame in milliseconds:
            frame.timestamp = time_of_frame * 1e-3 + 4e-4
            assert adapter.send(frame) == 0
        time.sleep(0.2)
        read = []
        for _ in milliseconds:
            read.append((bus.recv(1.0), bus.ticks))
        assert bus.recv(0.01) is None
    adapter.close()
    assert [ticks for _, ticks in read] == [59_990, 59_999, 0, 7]
    for one, _ in read:
        assert one is not None
        assert one.equals(frame, timestamp_delta=None, check_channel=False, check_direction=False)


@pytest.mark.parametrize("line", [b"t0AA21A2B\r", b"t0AA21A2B0\r", b"t0AA21A2Bnone\r"])
def test_a_frame_of_an_adapter_without_a_clock_has_no_time_of_its_own(tmp_path: Path, line: bytes) -> None:
    adapter = SlcanAdapter(str(tmp_path / "can"))
    with open_bus("slcan", str(tmp_path / "can"), sleep_after_open=0.0) as bus:
        assert isinstance(bus, SlcanBus)
        assert soon(adapter.ready)
        os.write(adapter._port.master, b"\a\rz\r" + line)
        read = [frame for frame in (bus.recv(0.2) for _ in range(4)) if frame is not None]
        assert [bytes(frame.data) for frame in read] == [b"\x1a\x2b"]
        assert bus.ticks is None
    adapter.close()


def test_a_slcan_driver_that_leaves_is_noticed(tmp_path: Path) -> None:
    adapter = SlcanAdapter(str(tmp_path / "can"))
    with can.Bus(channel=str(tmp_path / "can"), interface="slcan", sleep_after_open=0.0):
        assert soon(adapter.ready)
    assert soon(lambda: not adapter.ready())
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


def test_what_cannot_be_used_is_told_and_the_port_is_read_on(tmp_path: Path) -> None:
    port = PtyPort(str(tmp_path / "gnss"))
    taken, warnings = [], []

    def receive(data: bytes, wall: int) -> None:
        taken.append(1 // (data[0] - ord("x")))

    link = SerialLink("gnss", str(tmp_path / "gnss"), 115200, receive, warnings.append)
    link.start()

    def write_until(condition: Callable[[], object], data: bytes) -> None:
        deadline = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < deadline
            port.write(data)
            time.sleep(0.02)

    write_until(lambda: link.faults, b"x")
    write_until(lambda: taken, b"y")
    told = link.diagnostic()
    link.stop()
    port.close()
    assert (told.level, told.values["losses"]) == (Level.ERROR, "0")
    assert "ZeroDivisionError" in told.message
    assert "b'x" in warnings[-1]


@pytest.mark.exam
def test_a_tcp_sensor_that_lost_its_power_is_missed_and_connected_again() -> None:
    dead: list[socket.socket] = []
    deaf = ctypes.create_string_buffer(struct.pack("HBBI", 6, 0, 0, 0))  # a socket filter that drops what arrives
    taken: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(10.0)
        port = f"socket://127.0.0.1:{server.getsockname()[1]}"
        link = SerialLink("imu", port, 115200, lambda data, _: taken.append(data), lambda _: None)
        link.start()
        for life in range(2):
            peer, _ = server.accept()
            time.sleep(0.3)  # until it is open
            peer.sendall(b"%d" % life)
            time.sleep(0.3)  # until the byte is acknowledged
            peer.setsockopt(socket.SOL_SOCKET, 26, struct.pack("HP", 1, ctypes.addressof(deaf)))  # SO_ATTACH_FILTER
            dead.append(peer)  # neither end nor reset reaches the other side
        link.stop()
    assert b"".join(taken) == b"01"
    assert link.losses == 1


@pytest.mark.slow
@pytest.mark.exam
def test_a_tcp_sensor_that_is_slow_keeps_its_connection() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = f"socket://127.0.0.1:{server.getsockname()[1]}"
        link = SerialLink("gnss", port, 115200, lambda *_: None, lambda _: None)
        link.start()
        peer, _ = server.accept()
        time.sleep(8.0)
        assert (link.losses, link.problem) == (0, "")
        link.stop()
        peer.close()


def test_a_port_is_closed_once_its_reader_has_taken_everything(tmp_path: Path) -> None:
    port = PtyPort(str(tmp_path / "imu"))
    with serial.Serial(str(tmp_path / "imu"), timeout=1.0) as reader:
        assert port.write(b"the last of all") == 0
        held_up = threading.Timer(0.3, lambda: taken.append(reader.read(15)))
        taken: list[bytes] = []
        held_up.start()
        port.close()
        held_up.join()
    assert taken == [b"the last of all"]


def test_a_port_whose_reader_takes_nothing_is_closed_all_the_same(tmp_path: Path) -> None:
    port = PtyPort(str(tmp_path / "imu"))
    with serial.Serial(str(tmp_path / "imu"), timeout=1.0):
        assert port.write(b"never read") == 0
        began = time.monotonic()
        port.close()
    assert time.monotonic() - began < 4.0
