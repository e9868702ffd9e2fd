"""CAN buses and logs: opening, reading, and replaying one onto the other."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import can
from can.io.canutils import CanutilsLogReader

from vsense_ros.errors import InputError

INTERFACES = {
    "socketcan": "a CAN interface of Linux, as in `ip link`, for example can0",
    "slcan": "a serial port, for example /dev/ttyACM0",
    "udp_multicast": "a multicast group, for example 239.74.163.2",
    "virtual": "any name; inside one process",
}
LOG_SUFFIXES = (".log", ".asc", ".blf", ".mf4")


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
        return can.Bus(channel=channel, interface=interface, **options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise InputError(
            f"cannot open CAN interface {interface} on channel {channel!r}: {error}; expected {INTERFACES[interface]}"
        ) from None


class CanLog:
    """The messages of a log file, in the order of the file.

    Iterating yields every intact message; what had to be left out is then told by `losses`. `InputError` if not one
    message was intact.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.losses: list[str] = []

    def __iter__(self) -> Iterator[can.Message]:
        self.losses.clear()
        count = 0
        for message in self._candump() if self.path.suffix.lower() == ".log" else self._other():
            count += 1
            yield message
        if count == 0:
            why = f": {self.losses[0]}" if self.losses else ""
            raise InputError(f"{self.path}: not one intact CAN message found{why}; is it a {self._format} log?")

    @property
    def _format(self) -> str:
        return "candump" if self.path.suffix.lower() == ".log" else self.path.suffix.lower()

    def _candump(self) -> Iterator[can.Message]:
        """Line by line, so that a damaged line costs itself alone."""
        with self.path.open(encoding="ascii", errors="replace") as file:
            current: list[str] = []
            for number, line in enumerate(file, 1):
                if not line.strip():
                    continue
                current[:] = [line]
                try:
                    message = next(iter(_LineReader(current)))
                    if not math.isfinite(message.timestamp):
                        raise ValueError("no time stamp")
                    yield message
                except (ValueError, IndexError):
                    text = line.strip()
                    text = text if len(text) <= 60 else f"{text[:60]}…"
                    self.losses.append(f"line {number} is not a candump message: {text!r}")

    def _other(self) -> Iterator[can.Message]:
        count = 0
        try:
            with can.LogReader(self.path) as reader:
                for message in reader:
                    count += 1
                    yield message
        # python-can's readers let through whatever their parsing stumbles over.
        except (can.CanError, ValueError, IndexError, KeyError, OSError, EOFError, struct.error, TypeError) as error:
            self.losses.append(f"unreadable after message {count}: {error}")
        except Exception as error:
            if type(error).__module__.partition(".")[0] not in ("asammdf", "zlib"):
                raise
            self.losses.append(f"unreadable after message {count}: {error}")


class _LineReader(CanutilsLogReader):
    """python-can's candump parser on lines instead of a file."""

    def __init__(self, lines: list[str]) -> None:
        self.file = lines

    def stop(self) -> None:
        return


def read_can_log(path: str | Path) -> CanLog:
    """Open a CAN log: candump `.log`, Vector `.asc` and `.blf`, MDF4 `.mf4`."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a CAN log ({', '.join(LOG_SUFFIXES)})")
    if path.suffix.lower() not in LOG_SUFFIXES:
        raise InputError(f"{path}: CAN log of unknown format {path.suffix!r}; expected {', '.join(LOG_SUFFIXES)}")
    return CanLog(path)


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


def paced(
    scheduled: Iterable[tuple[float, can.Message]],
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[can.Message]:
    """The messages of a `schedule`, each when it is due by `clock` [s]."""
    start: float | None = None
    for due, message in scheduled:
        if start is None:
            start = clock() - due
        wait = start + due - clock()
        if wait > 0:
            sleep(wait)
        yield message
