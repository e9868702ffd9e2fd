"""CAN over a serial line (slcan), read in one go, with the times at which the adapter took each frame.

python-can reads such a line byte by byte and dates a frame when it is read. A process that gets no processor for a
second then dates a second of frames at one time. Adapters that know the command `Z1` (Lawicel, CAN232 Manual, 2.4)
append to each frame the milliseconds of their own clock, which does not depend on who reads when.
"""

from __future__ import annotations

from typing import Any

import can
import serial
from can.interfaces.slcan import slcanBus

TICK = 1_000_000  # [ns] of the adapter's clock
WRAP = 60_000  # ticks after which it begins anew

_DIGITS = 4  # hexadecimal, of a time
_LENGTH_AT = {"t": 4, "r": 4, "T": 9, "R": 9}  # where the number of data bytes stands in a line, by its first letter


class SlcanBus(slcanBus):
    """A bus behind an slcan adapter; `ticks` is the adapter's time of the frame that was received last, in ticks of
    `TICK` that begin anew after `WRAP`, or None where the adapter sends none."""

    def __init__(self, channel: str, **options: Any) -> None:
        self.ticks: int | None = None
        self._lines: list[str] = []  # whole ones that were read and not yet used, the newest first
        super().__init__(channel, **options)

    def open(self) -> None:
        """Open the channel, with times of frames. Who does not know them answers so, which is passed over."""
        self._write("Z1")
        super().open()

    def _read(self, timeout: float | None) -> str | None:
        """The next line with its end, within a time [s]; None if there is none."""
        if not self._lines:
            self._fill(timeout)
        line = self._lines.pop() if self._lines else None
        self.ticks = _ticks(line) if line else None
        return line

    def _fill(self, timeout: float | None) -> None:
        port, remaining = self.serialPortOrig, serial.Timeout(timeout)
        if port.timeout != timeout:
            port.timeout = timeout
        while not self._lines:
            try:
                self._buffer += port.read(max(port.in_waiting, 1))
            except (serial.SerialException, OSError) as error:
                raise can.CanOperationError(f"Could not read from serial device: {error}") from error
            *whole, rest = bytes(self._buffer.replace(self._ERROR, self._ERROR + self._OK)).split(self._OK)
            self._buffer[:] = rest
            self._lines = [line.decode("ascii", "replace") + "\r" for line in reversed(whole)]
            if remaining.expired():
                return

    def flush(self) -> None:
        """Forget what has been read and what waits to be."""
        self._lines.clear()
        super().flush()


def _ticks(line: str) -> int | None:
    """The adapter's time at the end of the line of a frame; None if it has none."""
    at = _LENGTH_AT.get(line[0])
    if at is None or not line[at : at + 1].isdigit():
        return None
    begin = at + 1 + (0 if line[0] in "rR" else 2 * int(line[at]))
    digits = line[begin:-1]
    try:
        return int(digits, 16) % WRAP if len(digits) == _DIGITS else None
    except ValueError:
        return None
