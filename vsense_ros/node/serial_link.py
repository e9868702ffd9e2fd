"""Bytes from a serial port, a pseudo-terminal or a TCP server, again and again after every loss."""

from __future__ import annotations

import math
import socket
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass

import serial

from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level


@dataclass(frozen=True)
class SerialLinkSettings:
    """How long a serial port is waited for: decisions of this project."""

    first_wait: float = 0.1  # [s] between attempts to open
    longest_wait: float = 1.0  # [s] between attempts to open
    patience: float = 0.1  # [s] for which a read waits
    fault_hold: float = 2.0  # [s] for which a fault in what was received colours the diagnostic


SETTINGS = SerialLinkSettings()

# A TCP peer that lost its power is silent like one without news: asked after 2 s, it answers within 3 s or is gone.
_KEEP_ALIVE = {socket.TCP_KEEPIDLE: 2, socket.TCP_KEEPINTVL: 1, socket.TCP_KEEPCNT: 3}


class SerialLink:
    """Reads `port` in a thread and hands what arrives to `receive(data, wall_time_ns)`.

    While nothing arrives `quiet(wall_time_ns)` is called, ten times a second, or at each attempt to open.

    `port` is a device (`/dev/ttyUSB0`, `/dev/pts/3`) or `socket://host:port`. A port that cannot be opened, that
    disappears, or whose TCP server no longer answers, is tried again with growing waits. What `receive` or `quiet`
    raises is reported and counted, and reading goes on.
    """

    def __init__(
        self,
        name: str,
        port: str,
        baud_rate: int,
        receive: Callable[[bytes, int], None],
        warn: Callable[[str], object],
        quiet: Callable[[int], object] = lambda wall: None,
    ) -> None:
        if not port:
            raise InputError("parameter port is empty: expected a device such as /dev/ttyUSB0, or socket://host:port")
        if "://" in port and not port.startswith("socket://"):
            raise InputError(f"parameter port is {port!r}: of the URLs only socket://host:port is understood")
        self.name = name
        self.port = port
        self.baud_rate = baud_rate
        self.losses = 0
        self.faults = 0
        self.problem = "not opened yet"
        self._latest_fault = ("", -math.inf)  # what, and when [s] of the monotonic clock
        self._receive = receive
        self._warn = warn
        self._quiet = quiet
        self._end = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin to read."""
        self._end.clear()
        self._thread = threading.Thread(target=self._run, name=f"read {self.port}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop reading and close the port."""
        self._end.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        wait = SETTINGS.first_wait
        while not self._end.is_set():
            try:
                with serial.serial_for_url(self.port, baudrate=self.baud_rate, timeout=SETTINGS.patience) as link:
                    if self.port.startswith("socket://"):
                        _keep_alive(link._socket)
                    self.problem = ""
                    wait = SETTINGS.first_wait
                    self._read(link)
            except Exception as error:  # pyserial lets through more than its own, such as termios.error
                if str(error) != self.problem:
                    self._warn(f"trying again: {error}")
                self.losses += not self.problem
                self.problem = str(error)
                self._hand_on(b"", time.time_ns())
            self._end.wait(wait)
            wait = min(2.0 * wait, SETTINGS.longest_wait)

    def _read(self, link: serial.SerialBase) -> None:
        while not self._end.is_set():
            data = link.read(1)  # wakes at the first byte; with more the arrival of the first would be late
            arrived = time.time_ns()
            try:
                data += link.read(link.in_waiting) if data else b""
            finally:  # the port may be gone now, what it gave is not
                self._hand_on(data, arrived)

    def _hand_on(self, data: bytes, arrived: int) -> None:
        try:
            if data:
                self._receive(data, arrived)
            else:
                self._quiet(arrived)
        except Exception as error:  # of whatever kind: it is no fault of the port, which is read on
            reason = f"{type(error).__name__}: {error}"
            if reason != self._latest_fault[0]:
                self._warn(f"what was received could not be used: {data!r}\n{traceback.format_exc()}")
            self.faults += 1
            self._latest_fault = (reason, time.monotonic())

    def diagnostic(self) -> Diagnostic:
        """Health of the port: open or not, and how many of its bytes could not be used."""
        values = {"port": self.port, "baud rate": str(self.baud_rate), "losses": str(self.losses)}
        values["faults in what was received"] = str(self.faults)
        if self.problem:
            return Diagnostic(f"{self.name}: port", Level.ERROR, f"trying again: {self.problem}", values)
        reason, at = self._latest_fault
        if time.monotonic() - at <= SETTINGS.fault_hold:
            text = f"open, but what was received could not be used: {reason}"
            return Diagnostic(f"{self.name}: port", Level.ERROR, text, values)
        return Diagnostic(f"{self.name}: port", Level.OK, "open", values)


def _keep_alive(connection: socket.socket) -> None:
    """Have the system ask a silent peer whether it is still there; if not, reading fails."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for option, value in _KEEP_ALIVE.items():
        connection.setsockopt(socket.IPPROTO_TCP, option, value)
