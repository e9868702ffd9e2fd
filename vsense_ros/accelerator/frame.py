"""Requests and responses as bytes: what observer and accelerator exchange, in the payload of a topic or over a link.

Little endian. A header of 48 bytes, the payload in 32-bit words, and a CRC-32 (IEEE 802.3, as zlib) over both:

| bytes | field |
|---|---|
| 0–3 | magic, `VSAC` read as a big-endian number |
| 4–5, 6–7 | version, kernel |
| 8–11 | sequence: number of the sender in the first 8 bits, of the request in the rest |
| 12–13, 14–15 | flags (1: a response, 2: coefficients), status |
| 16–23 | stamp [ns] |
| 24–31 | deadline [ns] since the request; 0: none |
| 32–33, 34–35 | rows of the matrix, right-hand sides (0 and 0 where there is none) |
| 36–39 | words of the payload |
| 40–43, 44–47 | clocks of the computation and of the link, of a response |
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

MAGIC = 0x56534143
VERSION = 1
LABEL = "vsense.accelerator.v1"
RESPONSE, TABLE = 1, 2  # flags
REQUESTS = 1 << 24
LARGEST = 1 << 16  # words of a payload

_HEADER = struct.Struct("<IHHIHHQQHHIII")
Words = NDArray[np.uint32]


class Status(IntEnum):
    """What the accelerator says of a request."""

    OK = 0
    PIVOT = 1  # not a positive normal number
    BAD_FRAME = 2
    UNKNOWN_KERNEL = 3
    DEADLINE = 4
    BUSY = 5
    FAULT = 6
    WRONG_SIZE = 7


@dataclass(frozen=True)
class Frame:
    """One request or response; the names are those of the table above."""

    kernel: int
    sequence: int
    payload: Words
    flags: int = 0
    status: int = Status.OK
    stamp: int = 0
    deadline: int = 0
    rows: int = 0
    right_sides: int = 0
    compute_cycles: int = 0
    link_cycles: int = 0
    version: int = field(default=VERSION)

    @property
    def is_response(self) -> bool:
        return bool(self.flags & RESPONSE)

    @property
    def sender(self) -> int:
        return self.sequence >> 24

    def to_bytes(self) -> bytes:
        header = _HEADER.pack(
            MAGIC, self.version, self.kernel, self.sequence, self.flags, self.status, self.stamp, self.deadline,
            self.rows, self.right_sides, self.payload.size, self.compute_cycles, self.link_cycles,
        )  # fmt: skip
        content = header + np.ascontiguousarray(self.payload, "<u4").tobytes()
        return content + struct.pack("<I", zlib.crc32(content))


class FrameError(ValueError):
    """Bytes that are no frame. `kind` names what is wrong: magic, version, length or crc; `sequence` is what stands
    where the sequence would, 0 where nothing does."""

    def __init__(self, kind: str, text: str, sequence: int = 0, kernel: int = 0) -> None:
        super().__init__(text)
        self.kind, self.sequence, self.kernel = kind, sequence, kernel


def parse(data: bytes) -> Frame:
    """The frame that `data` holds. Raises `FrameError`, whatever the bytes are."""
    if len(data) < _HEADER.size + 4:
        raise FrameError("length", f"a frame has at least {_HEADER.size + 4} bytes, found {len(data)}")
    (
        magic, version, kernel, sequence, flags, status, stamp, deadline, rows, right_sides, words, compute, link,
    ) = _HEADER.unpack_from(data)  # fmt: skip
    if magic != MAGIC:
        raise FrameError("magic", f"a frame begins with {MAGIC:08x}, found {magic:08x}")
    if version != VERSION:
        raise FrameError("version", f"version {VERSION} of the frame is known, found {version}", sequence, kernel)
    if words > LARGEST or len(data) != _HEADER.size + 4 * words + 4:
        text = f"{words} words are announced, in {len(data)} bytes"
        raise FrameError("length", text, sequence, kernel)
    (crc,) = struct.unpack_from("<I", data, len(data) - 4)
    if crc != zlib.crc32(data[:-4]):
        raise FrameError("crc", "the checksum does not fit", sequence, kernel)
    payload = np.frombuffer(data, "<u4", words, _HEADER.size).astype(np.uint32)
    return Frame(
        kernel, sequence, payload, flags, status, stamp, deadline, rows, right_sides, compute, link, version
    )  # fmt: skip
