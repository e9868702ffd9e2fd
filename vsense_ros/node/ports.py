"""The far end of a driver's port: pseudo-terminals and TCP servers that a replay writes to."""

from __future__ import annotations

import contextlib
import os
import pty
import select
import socket
import time
import tty
from pathlib import Path
from typing import Protocol

import can

from vsense_ros.driver.slcan import TICK, WRAP
from vsense_ros.errors import InputError

_PATIENCE = 2.0  # [s] for which a reader may stall before bytes are given up
_LOOK_EVERY = 0.005  # [s] whether a reader has taken everything


class Port(Protocol):
    """Where bytes go."""

    def ready(self) -> bool:
        """True if somebody reads."""

    def write(self, data: bytes) -> int:
        """Bytes that nobody took."""

    def close(self) -> None:
        """Close it once the reader has taken everything, and remove what it left in the file system."""


class PtyPort:
    """A pseudo-terminal whose other end is `path`, a symbolic link for a driver to open."""

    def __init__(self, path: str) -> None:
        self.path = Path(path)
        if self.path.exists() and not self.path.is_symlink():
            raise InputError(f"{path}: exists and is no link to a pseudo-terminal; choose another name")
        self.master, slave = pty.openpty()
        tty.setraw(slave)
        os.set_blocking(self.master, False)
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        self._reader = os.ttyname(slave)
        try:
            self.path.symlink_to(self._reader)
        except OSError as error:
            os.close(self.master)
            raise InputError(f"{path}: cannot make a link to a pseudo-terminal there: {error}") from None
        finally:
            os.close(slave)  # from now on the terminal is hung up until a driver opens it
        self._poll = select.poll()
        self._poll.register(self.master, select.POLLIN)

    def ready(self) -> bool:
        return not any(event & select.POLLHUP for _, event in self._poll.poll(0))

    def write(self, data: bytes) -> int:
        while data:
            if not self.ready() or not select.select([], [self.master], [], _PATIENCE)[1]:
                return len(data)
            try:
                data = data[os.write(self.master, data) :]
            except OSError:
                return len(data)
        return 0

    def close(self) -> None:
        self._wait_for_reader()
        os.close(self.master)
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()

    def _wait_for_reader(self) -> None:
        """The system throws away what waits in a terminal when its other end is closed."""
        if not self.ready():
            return
        try:
            terminal = os.open(self._reader, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError:
            return
        waiting = select.poll()
        waiting.register(terminal, select.POLLIN)
        deadline = time.monotonic() + _PATIENCE
        while waiting.poll(0) and time.monotonic() < deadline:
            time.sleep(_LOOK_EVERY)
        os.close(terminal)


class TcpPort:
    """A TCP server for one reader at a time, at `host:port`; without a host, for readers on this machine alone."""

    def __init__(self, address: str) -> None:
        host, _, port = address.rpartition(":")
        try:
            self._server = socket.create_server((host or "127.0.0.1", int(port)))
        except (OSError, ValueError) as error:
            raise InputError(f"cannot listen at socket://{address}: {error}; expected socket://host:port") from None
        self._server.setblocking(False)
        self._client: socket.socket | None = None

    def ready(self) -> bool:
        with contextlib.suppress(BlockingIOError):
            client, _ = self._server.accept()
            client.settimeout(_PATIENCE)
            if self._client is not None:
                self._client.close()
            self._client = client
        return self._client is not None

    def write(self, data: bytes) -> int:
        if not self.ready() or self._client is None:
            return len(data)
        try:
            self._client.sendall(data)
        except OSError:
            self._client.close()
            self._client = None
            return len(data)
        return 0

    def close(self) -> None:
        if self._client is not None:
            self._client.close()
        self._server.close()


def open_port(port: str) -> Port:
    """`socket://host:port` becomes a server there, anything else the name of a pseudo-terminal."""
    return TcpPort(port.removeprefix("socket://")) if port.startswith("socket://") else PtyPort(port)


class SlcanAdapter:
    """A CAN adapter of the kind that python-can's `slcan` interface talks to, at a pseudo-terminal. To a driver that
    asks for it (`Z1`), it sends with each frame the milliseconds of its clock, which is that of the frames."""

    def __init__(self, path: str) -> None:
        self._port = PtyPort(path)
        self._open = self._dates = False
        self._command = b""

    def ready(self) -> bool:
        """True if a driver has opened the channel."""
        self._answer()
        return self._open and self._port.ready()

    def send(self, frame: can.Message) -> int:
        """Send a frame to the driver; 1 if nobody took it."""
        if frame.is_fd or frame.is_error_frame:
            return 1
        identifier = f"{frame.arbitration_id:08X}" if frame.is_extended_id else f"{frame.arbitration_id:03X}"
        letter = ("R" if frame.is_remote_frame else "T") if frame.is_extended_id else "t"
        letter = "r" if frame.is_remote_frame and not frame.is_extended_id else letter
        data = "" if frame.is_remote_frame else frame.data.hex().upper()
        self._answer()
        time = f"{int(frame.timestamp * 1e9) // TICK % WRAP:04X}" if self._dates else ""
        return 1 if self._port.write(f"{letter}{identifier}{frame.dlc:X}{data}{time}\r".encode()) else 0

    def close(self) -> None:
        """Close the terminal."""
        self._port.close()

    def _answer(self) -> None:
        """Take the commands of the driver: `O` and `L` open the channel, `C` closes it, `Z1` and `Z0` have frames dated
        or not; other settings change nothing."""
        with contextlib.suppress(OSError):
            self._command += os.read(self._port.master, 4096)
        *commands, self._command = self._command.split(b"\r")
        for command in commands:
            if command[:1] in (b"O", b"L"):
                self._open = True
            elif command[:1] == b"C":
                self._open = False
            elif command[:1] == b"Z":
                self._dates = command[1:] == b"1"
