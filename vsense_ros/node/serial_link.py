"""Bytes from a serial port, a pseudo-terminal or a TCP server, again and again after every loss."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import serial

from vsense_ros.diagnostic import Diagnostic, Level
from vsense_ros.errors import InputError

_FIRST_WAIT, _LONGEST_WAIT = 0.1, 1.0  # [s] between attempts to open
_PATIENCE = 0.1  # [s] for which a read waits


class SerialLink:
    """Reads `port` in a thread and hands what arrives to `receive(data, wall_time_ns)`.

    `port` is a device (`/dev/ttyUSB0`, `/dev/pts/3`) or `socket://host:port`. A port that cannot be opened, or that
    disappears, is tried again with growing waits.
    """

    def __init__(
        self,
        name: str,
        port: str,
        baud_rate: int,
        receive: Callable[[bytes, int], None],
        warn: Callable[[str], object],
    ) -> None:
        if not port:
            raise InputError("parameter port is empty: expected a device such as /dev/ttyUSB0, or socket://host:port")
        if "://" in port and not port.startswith("socket://"):
            raise InputError(f"parameter port is {port!r}: of the URLs only socket://host:port is understood")
        self.name = name
        self.port = port
        self.baud_rate = baud_rate
        self.losses = 0
        self.problem = "not opened yet"
        self._receive = receive
        self._warn = warn
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
        wait = _FIRST_WAIT
        while not self._end.is_set():
            try:
                with serial.serial_for_url(self.port, baudrate=self.baud_rate, timeout=_PATIENCE) as link:
                    self.problem = ""
                    wait = _FIRST_WAIT
                    self._read(link)
            except (serial.SerialException, OSError, ValueError) as error:
                if str(error) != self.problem:
                    self._warn(f"trying again: {error}")
                self.losses += not self.problem
                self.problem = str(error)
            self._end.wait(wait)
            wait = min(2.0 * wait, _LONGEST_WAIT)

    def _read(self, link: serial.SerialBase) -> None:
        while not self._end.is_set():
            data = link.read(1)  # wakes at the first byte; with more the arrival of the first would be late
            if data:
                arrived = time.time_ns()
                self._receive(data + link.read(link.in_waiting), arrived)

    def diagnostic(self) -> Diagnostic:
        """Whether the port is open."""
        values = {"port": self.port, "baud rate": str(self.baud_rate), "losses": str(self.losses)}
        if self.problem:
            return Diagnostic(f"{self.name}: port", Level.ERROR, f"trying again: {self.problem}", values)
        return Diagnostic(f"{self.name}: port", Level.OK, "open", values)
