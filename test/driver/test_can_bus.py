from __future__ import annotations

import math
import socket
from itertools import pairwise
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.driver.can_bus import keep_more, open_bus, schedule
from vsense_ros.driver.can_log import read_can_log
from vsense_ros.errors import InputError


def messages(count: int = 20) -> list[can.Message]:
    return [
        can.Message(
            timestamp=1_700_000_000.0 + 0.01 * i,
            arbitration_id=0x100 + i,
            is_extended_id=False,
            data=bytes([i] * (i % 9)),
            channel=i % 2,
        )
        for i in range(count)
    ]


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".mf4"])
def test_a_log_of_each_format_reads_as_python_can_wrote_it(tmp_path, suffix):
    path = tmp_path / f"drive{suffix}"
    with can.Logger(path) as logger:
        for message in messages():
            logger(message)
    log = read_can_log(path)
    read = list(log)
    assert log.losses == []
    assert [(m.arbitration_id, bytes(m.data)) for m in read] == [(m.arbitration_id, bytes(m.data)) for m in messages()]
    steps = [b.timestamp - a.timestamp for a, b in pairwise(read)]
    assert steps == pytest.approx([0.01] * 19, abs=1.1e-3)  # ASC has milliseconds for some of its stamps


def test_a_damaged_line_of_a_candump_log_costs_itself_alone(tmp_path):
    path = tmp_path / "drive.log"
    lines = ["(1.0) can0 123#0102", "(1.1) can0 123#01", "", "(1.2) can0 12", "rubbish", "(1.3) can1 7FF#"]
    path.write_text("\n".join(lines) + "\n(1.4) can0 123#0")
    log = read_can_log(path)
    assert [m.timestamp for m in log] == [1.0, 1.1, 1.3]
    assert [loss.partition(" is")[0] for loss in log.losses] == ["line 4", "line 5", "line 7"]


def test_a_truncated_binary_log_gives_its_intact_messages_and_says_what_is_lost(tmp_path):
    path = tmp_path / "drive.blf"
    with can.Logger(path, max_container_size=200) as logger:
        for message in messages(200):
            logger(message)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    log = read_can_log(path)
    assert 50 < len(list(log)) < 200


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("drive.log", None, "no such file"),
        ("drive.txt", b"x", "not a CAN log; expected candump"),
        ("drive.log", b"", "the file is empty"),
        ("drive.log", b"\x00\xff\xfe garbage", "not a CAN log"),
        ("drive.asc", b"garbage\n", "not a CAN log"),
        ("drive.asc", b"date Mon May 1 02:00:00 pm 2023\ngarbage\n", "not one intact CAN message"),
        ("drive.blf", b"garbage", "not a CAN log"),
        ("drive.blf", b"LOGGarbage", "not one intact CAN message"),
        ("drive.mf4", b"garbage", "not a CAN log"),
        ("drive.mf4", b"MDF     ".ljust(64) + b"##HD garbage", "not one intact CAN message"),
    ],
)
def test_a_file_that_is_no_can_log_is_refused_in_words(tmp_path, name, content, expected):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=expected):
        list(read_can_log(path))


def test_a_log_is_due_at_its_own_pace_divided_by_the_rate():
    due = [d for d, _ in schedule(messages(5), rate=2.0)]
    assert due == pytest.approx([0, 0.005, 0.01, 0.015, 0.02], abs=1e-6)
    assert {d for d, _ in schedule(messages(5), rate=math.inf)} == {0.0}


def test_part_of_a_log_and_one_channel_of_it_can_be_replayed():
    chosen = list(schedule(messages(20), begin=0.045, end=0.105, channel=1))
    assert [m.arbitration_id for _, m in chosen] == [0x105, 0x107, 0x109]
    assert chosen[0][0] == pytest.approx(0.005, abs=1e-6)


@given(st.lists(st.floats(0, 1e6), min_size=1), st.floats(0.01, 100))
def test_nothing_is_due_before_what_stands_before_it_in_the_log(stamps, rate):
    log = [can.Message(timestamp=t) for t in stamps]
    due = [d for d, _ in schedule(log, rate)]
    assert due == sorted(due)


@pytest.mark.parametrize("rate", [0.0, -1.0, math.nan])
def test_a_rate_that_is_no_rate_is_refused(rate):
    with pytest.raises(InputError, match="replay rate"):
        list(schedule(messages(2), rate))


def test_what_is_sent_on_a_bus_arrives_on_it():
    with open_bus("virtual", "here") as sender, open_bus("virtual", "here") as receiver:
        sender.send(messages(8)[7])
        received = receiver.recv(1.0)
    assert received is not None
    assert bytes(received.data) == bytes([7] * 7)


@pytest.mark.parametrize(
    ("interface", "channel", "expected"),
    [
        ("canbus", "can0", "not known; expected one of socketcan, slcan, udp_multicast, virtual"),
        ("socketcan", "", "needs a channel"),
        ("socketcan", "nosuchcan0", "cannot open CAN interface socketcan on channel 'nosuchcan0'"),
        ("slcan", "/dev/nosuchtty", "cannot open CAN interface slcan"),
        ("udp_multicast", "not-an-address", "cannot open CAN interface udp_multicast"),
    ],
)
def test_a_bus_that_cannot_be_opened_is_refused_in_words(interface, channel, expected):
    with pytest.raises(InputError, match=expected):
        open_bus(interface, channel)


def test_the_kernel_is_asked_to_keep_what_a_driver_without_processor_does_not_read() -> None:
    """With a datagram socket, as that of a CAN interface is one; as many as the machine allows."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as there, socket.socket(type=socket.SOCK_DGRAM) as here:
        allowed = int(Path("/proc/sys/net/core/rmem_max").read_text())
        there.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        before = there.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        assert keep_more(there) >= min(2 * allowed, 8_000_000) > before
        there.bind(("127.0.0.1", 0))
        for _ in range(150):
            here.sendto(bytes(16), there.getsockname())
        there.setblocking(False)
        assert sum(len(there.recv(64)) for _ in range(150)) == 150 * 16
        larger = there.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        assert keep_more(there) == larger
