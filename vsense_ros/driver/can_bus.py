"""CAN buses: opening them, and when the frames of a log are due on one."""

from __future__ import annotations

import math
import socket
from collections.abc import Iterable, Iterator
from typing import Any

import can

from vsense_ros.driver.slcan import SlcanBus
from vsense_ros.errors import InputError

INTERFACES = {
    "socketcan": "a CAN interface of Linux, as in `ip link`, for example can0",
    "slcan": "a serial port, for example /dev/ttyACM0",
    "udp_multicast": "a multicast group, for example 239.74.163.2",
    "virtual": "any name; inside one process",
}


_WAITING = 4_000_000  # [byte] that the kernel is asked to keep of a bus


def keep_more(endpoint: socket.socket) -> int:
    """Have the kernel keep what waits to be read from a socket, as far as net.core.rmem_max allows; how much that is
    now [byte]. By default a few hundred CAN frames fill it, and the next are lost."""
    if endpoint.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) < 2 * _WAITING:  # the kernel doubles what is asked for
        endpoint.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _WAITING)
    return endpoint.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)


def open_bus(interface: str, channel: str, bitrate: int | None = None, **options: Any) -> can.BusABC:
    """Open a bus through python-can; `InputError` says what is missing if that fails.

    `bitrate` [bit/s] is for interfaces that set it themselves (slcan); further options go to python-can as they are.
    """
    if interface not in INTERFACES:
        raise InputError(f"CAN interface {interface!r} is not known; expected one of {', '.join(INTERFACES)}")
    if not channel:
        raise InputError(f"CAN interface {interface} needs a channel: {INTERFACES[interface]}")
    if bitrate is not None:
        options["bitrate"] = bitrate
    try:
        if interface == "slcan":
            return SlcanBus(channel, **options)
        bus = can.Bus(channel=channel, interface=interface, **options)
        if isinstance(endpoint := getattr(bus, "socket", None), socket.socket):
            keep_more(endpoint)
        return bus
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise InputError(
            f"cannot open CAN interface {interface} on channel {channel!r}: {error}; expected {INTERFACES[interface]}"
        ) from None


def schedule(
    messages: Iterable[can.Message],
    rate: float = 1.0,
    begin: float = 0.0,
    end: float = math.inf,
    channel: str | int | None = None,
) -> Iterator[tuple[float, can.Message]]:
    """When each message is due [s] after the start of a replay at `rate` times real time.

    Only messages from `begin` to `end` [s after the first of the log] and, if given, of one channel. `rate` may be
    infinite: everything is due at once. Messages of a log that steps back in time are due at once, too.
    """
    if not rate > 0:
        raise InputError(f"replay rate is {rate}, expected a number above 0")
    first: float | None = None
    due = 0.0
    for message in messages:
        if first is None:
            first = message.timestamp
        if channel is not None and message.channel != channel:
            continue
        elapsed = message.timestamp - first
        if not begin <= elapsed <= end:
            continue
        due = max(due, (elapsed - begin) / rate)
        yield due, message
