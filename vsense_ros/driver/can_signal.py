"""One signal of a CAN message: taken from the data of one frame, or of all frames of a log at once.

cantools decodes whole messages: it refuses all of a message where one multiplexer page is unknown, and spends tens of
microseconds on it. Here only what is asked for is taken.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
from cantools.database import Message
from cantools.database import Signal as DbcSignal
from numpy.typing import NDArray

Array = NDArray[np.float64]
Frames = NDArray[np.uint8]  # (frames, bytes), data that is too short filled with zeros

_FLOATS: dict[int, str] = {16: "f2", 32: "f4", 64: "f8"}
_UNPACK = {16: struct.Struct("<e"), 32: struct.Struct("<f"), 64: struct.Struct("<d")}


@dataclass(frozen=True, slots=True)
class SignalField:
    """Where a signal's bits stand and what they mean: physical value = raw × scale + offset.

    `first` and `last` are the bytes that it touches; `shift` is the number of bits behind it in them, read as one
    number of the signal's byte order. `pages` are the selectors on which its presence depends, each with its values.
    """

    name: str
    first: int
    last: int
    shift: int
    length: int
    big_endian: bool
    is_signed: bool
    is_float: bool
    scale: float
    offset: float
    pages: tuple[tuple[SignalField, frozenset[int]], ...] = ()

    @staticmethod
    def of(signal: DbcSignal, message: Message) -> SignalField:
        """The field of a signal of a database."""
        if signal.byte_order == "big_endian":
            # The position of the highest bit, counted along the bytes from the highest bit of each.
            high = 8 * (signal.start // 8) + 7 - signal.start % 8
            end = high + signal.length
            first, last, shift = high // 8, (end - 1) // 8, 7 - (end - 1) % 8
        else:
            first, last, shift = signal.start // 8, (signal.start + signal.length - 1) // 8, signal.start % 8
        pages: tuple[tuple[SignalField, frozenset[int]], ...] = ()
        if signal.multiplexer_ids:
            known = {s.name: s for s in message.signals}
            selector = known.get(signal.multiplexer_signal or "")
            if selector is not None:
                own = SignalField.of(selector, message)
                pages = (*own.pages, (own, frozenset(int(page) for page in signal.multiplexer_ids)))
        return SignalField(
            signal.name,
            first,
            last,
            shift,
            signal.length,
            signal.byte_order == "big_endian",
            bool(signal.is_signed),
            bool(signal.is_float),
            float(signal.scale),
            float(signal.offset),
            pages,
        )

    @property
    def representable(self) -> tuple[float, float]:
        """The least and the largest physical value that the bits can say."""
        if self.is_float:
            return -math.inf, math.inf
        ends = [raw * self.scale + self.offset for raw in self.raw_range]
        return min(ends), max(ends)

    @property
    def raw_range(self) -> tuple[int, int]:
        """The least and the largest number that the bits can be."""
        half = 1 << (self.length - 1)
        return (-half, half - 1) if self.is_signed else (0, 2 * half - 1)

    def raw(self, data: bytes) -> int:
        """The bits of one frame as a number; the data must reach to `last`."""
        order = "big" if self.big_endian else "little"
        value = int.from_bytes(data[self.first : self.last + 1], order) >> self.shift  # type: ignore[arg-type]
        value &= (1 << self.length) - 1
        return value - (1 << self.length) if self.is_signed and value >> (self.length - 1) else value

    def has(self, data: bytes) -> bool:
        """True if the frame is of a page that has the signal."""
        return all(selector.raw(data) in values for selector, values in self.pages)

    def physical(self, data: bytes) -> float:
        """The physical value in one frame."""
        value = self.raw(data)
        if self.is_float:
            number = _UNPACK[self.length].unpack((value % (1 << self.length)).to_bytes(self.length // 8, "little"))[0]
            return float(number) * self.scale + self.offset
        return value * self.scale + self.offset

    def raw_of(self, frames: Frames) -> NDArray[np.int64] | NDArray[np.uint64]:
        """The bits in each frame as a number, (frames,)."""
        taken = frames[:, self.first : self.last + 1].astype(np.uint64)
        if self.big_endian:
            taken = taken[:, ::-1]
        value = np.zeros(len(frames), np.uint64)
        for place in range(taken.shape[1]):
            behind = 8 * place - self.shift
            if behind >= 64:
                break
            value |= taken[:, place] << np.uint64(behind) if behind >= 0 else taken[:, place] >> np.uint64(-behind)
        if self.length < 64:
            value &= np.uint64((1 << self.length) - 1)
        if not self.is_signed:
            return value
        up = np.uint64(64 - self.length)
        return (value << up).view(np.int64) >> np.int64(64 - self.length)

    def has_of(self, frames: Frames) -> NDArray[np.bool_]:
        """Which frames are of a page that has the signal, (frames,)."""
        present = np.ones(len(frames), bool)
        for selector, values in self.pages:
            present &= np.isin(selector.raw_of(frames).astype(np.int64), list(values))
        return present

    def physical_of(self, frames: Frames, raw: NDArray[Any] | None = None) -> Array:
        """The physical value in each frame, (frames,); `raw` are its bits, where they are known already."""
        raw = self.raw_of(frames) if raw is None else raw
        if self.is_float:
            bits = raw.view(np.uint64).astype(np.dtype(f"u{self.length // 8}"))
            return np.frombuffer(bits.tobytes(), _FLOATS[self.length]).astype(np.float64) * self.scale + self.offset
        return raw.astype(np.float64) * self.scale + self.offset
