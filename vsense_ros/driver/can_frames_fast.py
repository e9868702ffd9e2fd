"""Frames of whole BLF and ASC files with classic frames alone, all at once.

Whatever else there is in a file, or anything that is not as expected, is for the readers that go frame by frame: the
functions give None then. `first_time` gives the time of a file's first message, with the date of its head.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsense_ros.driver.can_frames import CanFrames

FirstTime = Callable[[], float | None]

_PIECE = 1 << 23  # [byte] that are looked at together
_BASE = struct.Struct("<4sHHLL")  # signature, size of the header, its version, size of the object, its type
_SIGNATURE = int.from_bytes(b"LOBJ", "little")
_CONTAINER, _CLASSIC = 10, (1, 86)  # types of objects
_OTHER_FRAMES = (100, 101)  # CAN FD
_ZLIB, _STORED = 2, 0
_EXTENDED, _REMOTE = 0x8000_0000, 0x80
_IDENTIFIER = 0x1FFF_FFFF  # the largest
_MOST = 8  # [byte] of a classic frame

# Lines of an ASC file that hold no data frame.
_ASC_OTHER = re.compile(
    rb"date .*|base hex +timestamps absolute.*|(?:no )?internal events logged.*|//.*|(?:begin|end) triggerblock.*"
    rb"|\d+\.\d+ start of measurement.*|\d+\.\d+ +\d+ +(?:errorframe|[0-9a-f]+x? +[rt]x +r\b).*",
    re.IGNORECASE,
)
_LONE_RETURN = re.compile(rb"\r(?=[^\n])")  # ends a line for readers of text, and is left to them
_MOST_OTHERS = 0.1  # of the lines, above which they are read one by one anyway
_NO_DIGIT = 255
_HEX = np.full(256, _NO_DIGIT, np.uint8)
for _value, _digit in enumerate(b"0123456789abcdef"):
    _HEX[_digit] = _HEX[ord(chr(_digit).upper())] = _value
_GAP = np.zeros(256, bool)
_GAP[list(b" \t\r\n")] = True


def blf_frames(path: Path, first_time: FirstTime) -> CanFrames | None:
    """The frames of a BLF file."""
    parts = []
    for block in _stretches(path):
        part = None if block is None else _objects(block)
        if part is None:
            return None
        parts.append(part)
    first = first_time()
    if first is None or not parts:
        return None
    time, channel, identifier, length, data = (np.concatenate(column) for column in zip(*parts, strict=True))
    if not len(time):
        return None
    return _columns(time - time[0] + first, channel.astype(np.int64) - 1, identifier, length, data)


def _stretches(path: Path) -> Iterator[bytes | None]:
    """Decompressed stretches of whole objects; None where the file is not as expected."""
    tail = b""
    with path.open("rb") as file:
        head = file.read(8)
        file.seek(int.from_bytes(head[4:8], "little"))
        pending, size = [], 0
        while base := file.read(_BASE.size):
            if len(base) < _BASE.size:
                yield None
                return
            signature, _, _, length, kind = _BASE.unpack(base)
            body = file.read(length - _BASE.size) if length >= _BASE.size else b""
            if signature != b"LOBJ" or len(body) != length - _BASE.size:
                yield None
                return
            file.read(length % 4)
            if kind != _CONTAINER:
                continue
            method = int.from_bytes(body[:2], "little")
            try:
                content = zlib.decompress(body[16:]) if method == _ZLIB else body[16:]
            except zlib.error:
                yield None
                return
            if method not in (_ZLIB, _STORED):
                yield None
                return
            pending.append(content)
            size += len(content)
            if size > _PIECE:
                whole, tail = _cut(tail + b"".join(pending))
                pending, size = [], 0
                yield whole
    whole, tail = _cut(tail + b"".join(pending))
    yield whole
    if len(tail) > 3:
        yield None  # an object that was cut


def _cut(block: bytes) -> tuple[bytes, bytes]:
    """The whole objects of a block, and the rest."""
    at = block.rfind(b"LOBJ")
    while at >= 0:
        if len(block) - at >= _BASE.size:
            end = at + _BASE.unpack_from(block, at)[3]
            if end <= len(block):
                return block[:end], block[end:]
        return block[:at], block[at:]
    return b"", block


def _objects(block: bytes) -> tuple[NDArray, ...] | None:
    """Time [s], channel, identifier with its flag, length and data (n, 8) of the classic frames of a block."""
    words = np.frombuffer(block, np.uint32, len(block) // 4)
    starts = np.flatnonzero(words == _SIGNATURE)
    if not len(starts):
        return None if len(block) > 3 else tuple(np.zeros(shape) for shape in (0, 0, 0, 0, (0, _MOST)))
    sizes, kinds = words[np.minimum(starts + 2, len(words) - 1)], words[np.minimum(starts + 3, len(words) - 1)]
    ends = starts + (sizes.astype(np.int64) + 3) // 4
    if starts[0] != 0 or (starts[1:] != ends[:-1]).any() or np.isin(kinds, _OTHER_FRAMES).any():
        return None
    starts = starts[np.isin(kinds, _CLASSIC)] * 4
    if not len(starts):
        return tuple(np.zeros(shape) for shape in (0, 0, 0, 0, (0, _MOST)))
    data = np.frombuffer(block, np.uint8)

    def field(offset: int, kind: str) -> NDArray:
        width = np.dtype(kind).itemsize
        return np.ascontiguousarray(data[(starts + offset)[:, None] + np.arange(width)]).view(kind)[:, 0]

    if (field(6, "<u2") != 1).any() or (starts[-1] + 48 > len(block)):
        return None
    steps = np.where(field(16, "<u4") == 1, 1e-5, 1e-9)
    time = field(24, "<u8").astype(np.float64) * steps
    kept = (field(34, "u1") & _REMOTE) == 0
    content = data[(starts + 40)[:, None] + np.arange(_MOST)]
    columns = (time, field(32, "<u2"), field(36, "<u4"), np.minimum(field(35, "u1"), _MOST), content)
    return tuple(column[kept] for column in columns)


def asc_frames(path: Path, first_time: FirstTime) -> CanFrames | None:
    """The frames of an ASC file with hexadecimal numbers and absolute times."""
    parts = []
    triggers = 0
    with path.open("rb") as file:
        tail = b""
        while block := file.read(_PIECE):
            whole, newline, tail = (tail + block).rpartition(b"\n")
            part = None if _LONE_RETURN.search(whole) else _Words(whole + newline).frames()
            if part is None:
                return None
            parts.append(part)
            triggers += len(re.findall(rb"(?i)\nbegin triggerblock", whole))
        if tail.strip():
            part = None if _LONE_RETURN.search(tail) else _Words(tail + b"\n").frames()
            if part is None:
                return None
            parts.append(part)
    first = first_time() if parts and triggers < 2 else None
    if first is None:
        return None
    time, channel, identifier, length, data = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _columns(time - time[0] + first, channel - 1, identifier, length, data) if len(time) else None


class _Words:
    """The words of a text of whole lines: where each begins and ends, and which is the first of each line."""

    def __init__(self, text: bytes) -> None:
        self._text = text
        self._bytes = np.frombuffer(text, np.uint8)
        gap = _GAP[self._bytes]
        before, behind = np.concatenate([[True], gap[:-1]]), np.concatenate([gap[1:], [True]])
        self._starts, self._ends = np.flatnonzero(~gap & before), np.flatnonzero(~gap & behind) + 1
        self._newlines = np.flatnonzero(self._bytes == ord("\n"))
        lines = np.concatenate([[0], self._newlines[:-1] + 1])
        self._first = np.searchsorted(self._starts, lines)
        self._count = np.diff(np.append(self._first, len(self._starts)))

    def frames(self) -> tuple[NDArray, ...] | None:
        """Time [s], channel, identifier with its flag, length and data (n, 8): words 0, 1, 2, 5, and 6 onward."""
        chosen = np.flatnonzero(self._count >= 6)
        first = self._first[chosen]
        way, kind, length = (self._letters(first + place, 2) for place in (3, 4, 5))
        is_frame = np.isin(way[:, 0], (ord("R"), ord("T"))) & (way[:, 1] == ord("x"))
        is_frame &= (kind[:, 0] == ord("d")) & (kind[:, 1] == 0) & (length[:, 1] == 0)
        size = _HEX[length[:, 0]]
        is_frame &= (size <= _MOST) & (self._count[chosen] >= 6 + size.astype(np.int64))
        is_other = self._count > 0
        is_other[chosen[is_frame]] = False
        others = np.flatnonzero(is_other)
        if len(others) > max(_MOST_OTHERS * len(self._count), 20) or not all(map(self._is_other, others.tolist())):
            return None
        first, size = first[is_frame], size[is_frame]
        time, channel = self._number(first, points=1), self._number(first + 1, points=0)
        identifier = self._identifier(first + 2)
        data = self._data(first + 6, size)
        if time is None or channel is None or identifier is None or data is None:
            return None
        return time, channel.astype(np.int64), identifier, size, data

    def _is_other(self, line: int) -> bool:
        begin = self._starts[self._first[line]]
        return _ASC_OTHER.fullmatch(self._text[begin : self._newlines[line]].rstrip()) is not None

    def _letters(self, words: NDArray, width: int) -> NDArray:
        """The first letters of words (n, width), 0 where a word is shorter."""
        places = self._starts[words][:, None] + np.arange(width)
        inside = places < self._ends[words][:, None]
        return np.where(inside, self._bytes[np.minimum(places, len(self._bytes) - 1)], 0).astype(np.uint8)

    def _number(self, words: NDArray, points: int) -> NDArray | None:
        """Decimal numbers with as many points, before and behind which a digit stands; None where one is none."""
        length = self._ends[words] - self._starts[words]
        width = int(length.max(initial=1))
        letters = self._letters(words, width)
        is_point = letters == ord(".")
        is_digit = (letters >= ord("0")) & (letters <= ord("9"))
        ends_with_digits = is_digit[:, 0] & is_digit[np.arange(len(words)), length - 1]
        if width > 20 or not ends_with_digits.all() or (is_point.sum(axis=1) != points).any():
            return None
        if ((is_digit | is_point).sum(axis=1) != length).any():
            return None
        return np.ascontiguousarray(letters).view(f"S{width}")[:, 0].astype(np.float64)

    def _identifier(self, words: NDArray) -> NDArray | None:
        """Hexadecimal identifiers, with the flag of extended ones, which end with an x; None where one is none."""
        length = self._ends[words] - self._starts[words]
        extended = self._bytes[self._ends[words] - 1] == ord("x")
        length = length - extended
        if not len(words) or length.min() < 1 or length.max() > 8:
            return None if len(words) else np.zeros(0, np.uint32)
        digits = _HEX[self._letters(words, 8)]
        inside = np.arange(8) < length[:, None]
        if (digits[inside] == _NO_DIGIT).any():
            return None
        identifiers = np.zeros(len(words), np.uint32)
        for place in range(8):
            identifiers = np.where(inside[:, place], identifiers << np.uint32(4) | digits[:, place], identifiers)
        if identifiers.max() > _IDENTIFIER:
            return None
        return identifiers.astype(np.uint32) | np.where(extended, np.uint32(_EXTENDED), np.uint32(0))

    def _data(self, words: NDArray, size: NDArray) -> NDArray | None:
        """Bytes (n, 8) of two hexadecimal digits each; None where one is none."""
        inside = np.arange(_MOST) < size[:, None]
        chosen = (words[:, None] + np.arange(_MOST))[inside]
        if (self._ends[chosen] - self._starts[chosen] != 2).any():
            return None
        high, low = (_HEX[self._bytes[self._starts[chosen] + place]] for place in (0, 1))
        if len(chosen) and max(high.max(), low.max()) == _NO_DIGIT:
            return None
        data = np.zeros((len(words), _MOST), np.uint8)
        data[inside] = high << 4 | low
        return data


def _columns(time: NDArray, channel: NDArray, identifier: NDArray, length: NDArray, data: NDArray) -> CanFrames:
    """Columns of frames, with the channels in the order in which they come first."""
    _, first, which = np.unique(channel, return_index=True, return_inverse=True)
    order = np.argsort(first)
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    return CanFrames(
        time,
        (identifier & _IDENTIFIER).astype(np.uint32),
        (identifier & _EXTENDED) != 0,
        place[which].astype(np.int16),
        tuple(str(channel[row]) for row in first[order]),
        length.astype(np.int64),
        np.arange(len(time), dtype=np.int64) * _MOST,
        np.ascontiguousarray(data, np.uint8).ravel(),
    )
