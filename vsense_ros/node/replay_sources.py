"""What a replay sends: messages of a bag, frames of a CAN log, bytes of serial devices, and where each of them goes."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from vsense_ros.bag import TopicDescription, read_whole_bag
from vsense_ros.driver.can_bus import open_bus
from vsense_ros.driver.can_log import read_can_log
from vsense_ros.errors import InputError
from vsense_ros.messages import cdr
from vsense_ros.node.base import SensingNode
from vsense_ros.node.byte_log import read_byte_log
from vsense_ros.node.can_driver import bus_options
from vsense_ros.node.parameters import NodeParameters, parameter, path_parameter
from vsense_ros.node.ports import Port, SlcanAdapter, open_port
from vsense_ros.node.qos import profile_of

NANO = 1_000_000_000
Times = NDArray[np.int64]
Send = Callable[[Any], int]  # sends one item; returns how much of it nobody took


class SourceParameters(NodeParameters):
    """Sources of a replay, and where each of them goes."""

    bag: str = path_parameter("bag to publish")
    topics: tuple[str, ...] = Field((), description="topics of the bag to publish; empty: all")
    can_log: str = path_parameter("CAN log to send (candump, .asc, .blf, .trc, .mf4, GVRET .csv)")
    can_interface: Literal["slcan_adapter", "socketcan", "udp_multicast", "slcan"] = Field(
        "slcan_adapter", description="bus to send it to; slcan_adapter: a pty for can_driver's slcan to open"
    )
    can_channel: str = path_parameter("channel of the interface; for slcan_adapter, name of the pty to create")
    can_port: int = parameter(43113, "", "UDP port of udp_multicast", ge=1, le=65535)
    can_log_channel: str = Field("", description="only the frames of this channel of the log; empty: all")
    can_offset: float = parameter(0.0, "s", "added to the times of the CAN log, to align them with the other sources")
    gnss_bytes: str = path_parameter("byte log of a GNSS receiver")
    gnss_port: str = path_parameter("pty to create, or socket://host:port to listen at, for gps_driver")
    imu_bytes: str = path_parameter("byte log of an IMU")
    imu_port: str = path_parameter("pty to create, or socket://host:port to listen at, for imu_driver")


class ReplaySources:
    """The sources that the parameters name, opened, with their items in no particular order.

    `times` [ns] and `items` have one entry for each item; an item is the number of its sender in `senders` and what to
    send. `waiting_for` says of each port whether somebody reads it; `close` closes what has been opened. Raises
    `InputError` for sources that cannot be read or opened; what was opened until then is in `closers`.
    """

    def __init__(self, node: SensingNode[Any], parameters: SourceParameters, *, own_clock: bool) -> None:
        """With `own_clock` the replay publishes the time itself, and the recorded topic `clock` is left out."""
        self.node, self.parameters, self.own_clock = node, parameters, own_clock
        self.times: Times = np.zeros(0, np.int64)
        self.senders: list[tuple[str, Send]] = []
        self.items: list[tuple[int, Any]] = []
        self.closers: list[Callable[[], None]] = []
        self.waiting_for: list[tuple[str, Callable[[], bool]]] = []
        self.lost_in_bag = 0

    def load(self) -> None:
        """Read and open all sources."""
        p = self.parameters
        if p.bag:
            self._load_bag(p.bag)
        if p.can_log:
            frames = [
                frame
                for frame in read_can_log(p.can_log)
                if not p.can_log_channel or frame.channel in (None, p.can_log_channel)
            ]
            stamps = np.array([frame.timestamp for frame in frames])
            self._add("CAN", self._open_bus(), np.rint((stamps + p.can_offset) * 1e9), frames)
        for name, log, where in (("GNSS", p.gnss_bytes, p.gnss_port), ("IMU", p.imu_bytes, p.imu_port)):
            if log:
                self._load_bytes(name, log, where)

    def close(self) -> None:
        """Close what has been opened."""
        while self.closers:
            self.closers.pop(0)()

    def _add(self, name: str, send: Send, when: Any, what: list[Any]) -> None:
        self.times = np.concatenate((self.times, np.asarray(when, np.int64)))
        self.items.extend((len(self.senders), item) for item in what)
        self.senders.append((name, send))

    def _load_bytes(self, name: str, log: str, where: str) -> None:
        """Read the byte log of a serial device, and open the port at which a driver reads it."""
        if not where:
            raise InputError(f"parameter {name.lower()}_port is empty: expected a name for a pty, or a socket:// URL")
        entries = read_byte_log(log)
        port: Port = open_port(where)
        self.closers.append(port.close)
        self.waiting_for.append((f"a reader of {where}", port.ready))
        self._add(name, port.write, [t for t, _ in entries], [data for _, data in entries])

    def _load_bag(self, path: str) -> None:
        """Announce the topics of a bag, and add their messages."""
        p, node = self.parameters, self.node
        bag = read_whole_bag(path)
        self.lost_in_bag = bag.recording.messages_lost
        known = {**bag.recording.channels, **bag.others}
        if unknown := [topic for topic in p.topics if topic not in known]:
            raise InputError(f"{path}: has no topic {', '.join(unknown)}; it has {', '.join(sorted(known))}")
        for topic in known:
            if topic not in p.topics and (p.topics or (topic == "clock" and self.own_clock)):
                continue
            about = bag.descriptions.get(topic)
            if topic in bag.others:
                about, messages = about or TopicDescription("", "", ""), bag.others[topic].payloads
                times = bag.others[topic].times
            else:
                numbers = bag.recording.channels[topic]
                about = about or TopicDescription.of(topic, numbers.kind)
                messages, times = [row.tobytes() for row in cdr.encode_channel(numbers)], numbers.received
            try:
                node.outputs.create(topic, about.kind, profile_of(about.qos), about.type_hash)
            except InputError as error:
                if p.topics:
                    raise
                node.get_logger().warning(f"{topic} is left out: {error}")
                continue
            self._add(topic, partial(self._publish_row, topic, about.kind), times, messages)

    def _publish_row(self, topic: str, kind: str, data: bytes) -> int:
        self.node.outputs.publish_bytes(topic, kind, data)
        return 0

    def _open_bus(self) -> Send:
        p = self.parameters
        if p.can_interface == "slcan_adapter":
            if not p.can_channel:
                raise InputError("parameter can_channel is empty: slcan_adapter needs a name for its pty")
            adapter = SlcanAdapter(p.can_channel)
            self.closers.append(adapter.close)
            self.waiting_for.append((f"a driver to open {p.can_channel}", adapter.ready))
            return adapter.send
        bus = open_bus(p.can_interface, p.can_channel, **bus_options(p.can_interface, p.can_port))
        self.closers.append(bus.shutdown)

        def send(frame: Any) -> int:
            bus.send(frame, timeout=1.0)
            return 0

        return send


def check_overlap(times: Times, senders: list[tuple[str, Send]], items: list[tuple[int, Any]]) -> None:
    """Raise `InputError` for sources that have no time in common, because their clocks differ."""
    of = np.fromiter((number for number, _ in items), np.intp, len(items))
    spans: dict[str, tuple[int, int]] = {}
    for number, (name, _) in enumerate(senders):
        own = times[of == number]
        if not len(own):
            continue
        name = name if name in ("CAN", "GNSS", "IMU") else "the bag"
        first, last = spans.get(name, (int(own.min()), int(own.max())))
        spans[name] = (min(first, int(own.min())), max(last, int(own.max())))
    ordered = sorted(spans.items(), key=lambda item: item[1])
    for (one, (_, end)), (other, (begin, _)) in pairwise(ordered):
        if begin > end:
            listed = ", ".join(f"{n} from {_moment(a)} to {_moment(b)}" for n, (a, b) in ordered)
            raise InputError(
                f"{one} and {other} have no time in common: {listed}. Their clocks differ, or it is a time zone: "
                "set can_offset, or give logs of one drive"
            )


def _moment(nanoseconds: int) -> str:
    """A Unix time [ns] for people; times that count from the start of a log in seconds."""
    if nanoseconds < 10**16:
        return f"{nanoseconds / NANO:.3f} s"
    return f"{datetime.fromtimestamp(nanoseconds / NANO, UTC):%Y-%m-%d %H:%M:%S} UTC"
