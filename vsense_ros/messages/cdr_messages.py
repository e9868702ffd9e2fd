"""Messages that are no measurement as CDR bytes: transforms, CAN frames, NMEA sentences, texts and diagnostics."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from vsense_ros.errors import InputError
from vsense_ros.messages.cdr_layout import HEADER
from vsense_ros.messages.diagnostic import Diagnostic


@dataclass(frozen=True, slots=True)
class Transform:
    """Where the frame `child` is in the frame `parent`: (3,) [m] and a quaternion x, y, z, w (4,)."""

    parent: str
    child: str
    position: Sequence[float]
    orientation: Sequence[float]


class _Writer:
    """CDR bytes that grow field by field, each aligned to its size."""

    def __init__(self, stamp: int | None = None) -> None:
        """Begin with a time stamp [ns], if there is one."""
        self.data = bytearray(HEADER)
        if stamp is not None:
            self.pack("iI", *divmod(stamp, 1_000_000_000))

    def pack(self, numbers: str, *values: float) -> None:
        """Append numbers of these types, as `struct` calls them, of which the first is the widest."""
        alignment = struct.calcsize(numbers[0])
        self.data.extend(b"\0" * (-(len(self.data) - len(HEADER)) % alignment))
        self.data.extend(struct.pack(f"<{numbers}", *values))

    def text(self, text: str) -> None:
        """Append a text with its length."""
        encoded = text.encode() + b"\0"
        self.pack("I", len(encoded))
        self.data.extend(encoded)


def encode_transforms(stamp: int, transforms: Sequence[Transform]) -> bytes:
    """A tf2_msgs/TFMessage as CDR bytes; `stamp` [ns]."""
    message = _Writer()
    message.pack("I", len(transforms))
    for transform in transforms:
        message.pack("iI", *divmod(stamp, 1_000_000_000))
        message.text(transform.parent)
        message.text(transform.child)
        message.pack("ddddddd", *transform.position, *transform.orientation)
    return bytes(message.data)


@dataclass(frozen=True, slots=True)
class CanFrame:
    """A can_msgs/Frame: identifier, what kind of frame it is, up to eight bytes; `stamp` [ns]."""

    stamp: int
    identifier: int
    data: bytes
    is_remote: bool = False
    is_extended: bool = False
    is_error: bool = False
    length: int = 0  # as stated, which of a remote frame is that of the answer


def encode_can_frame(frame: CanFrame, frame_id: str = "") -> bytes:
    """A can_msgs/Frame as CDR bytes."""
    message = _Writer(frame.stamp)
    message.text(frame_id)
    flags = (frame.is_remote, frame.is_extended, frame.is_error)
    message.pack("I???B", frame.identifier, *flags, frame.length)
    return bytes(message.data + frame.data[:8].ljust(8, b"\0"))


def decode_can_frame(data: bytes) -> CanFrame:
    """A can_msgs/Frame from its CDR bytes. Raises `InputError` for others."""
    (_, offset), (seconds, nanoseconds) = _text_behind_stamp(data, "can_msgs/msg/Frame")
    offset += -offset % 4
    if len(data) < offset + 16:
        raise InputError(f"a can_msgs/msg/Frame needs {offset + 16} bytes, found {len(data)}")
    identifier, remote, extended, error, length = struct.unpack_from("<I3?B", data, offset)
    if length > 8:
        raise InputError(f"a can_msgs/msg/Frame has up to 8 bytes, dlc says {length}")
    content = b"" if remote else data[offset + 8 : offset + 8 + length]
    stamp = seconds * 1_000_000_000 + nanoseconds
    return CanFrame(stamp, identifier, content, remote, extended, error, length)


def decode_sentence(data: bytes) -> bytes:
    """The sentence of a nmea_msgs/Sentence from its CDR bytes. Raises `InputError` for others."""
    (_, offset), _ = _text_behind_stamp(data, "nmea_msgs/msg/Sentence")
    text, _ = _text_at(data, offset + -offset % 4, "nmea_msgs/msg/Sentence")
    return text


def _text_behind_stamp(data: bytes, kind: str) -> tuple[tuple[bytes, int], tuple[int, int]]:
    if len(data) < 12 or data[:2] != HEADER[:2]:
        raise InputError(f"not a {kind} message: expected little-endian CDR, found {data[:2].hex(' ') or 'nothing'}")
    return _text_at(data, 12, kind), struct.unpack_from("<iI", data, 4)


def _text_at(data: bytes, offset: int, kind: str) -> tuple[bytes, int]:
    """A text without its final NUL, and the position behind it."""
    length = int.from_bytes(data[offset : offset + 4], "little") if offset + 4 <= len(data) else 0
    end = offset + 4 + length
    if length == 0 or end > len(data):
        raise InputError(f"not a {kind} message: a text of {length} bytes at byte {offset} of {len(data)}")
    return data[offset + 4 : end - 1], end


def encode_text(text: str) -> bytes:
    """A std_msgs/String as CDR bytes."""
    message = _Writer()
    message.text(text)
    return bytes(message.data)


def encode_diagnostics(stamp: int, diagnostics: Iterable[Diagnostic], hardware_id: str = "") -> bytes:
    """A diagnostic_msgs/DiagnosticArray as CDR bytes; `stamp` [ns]."""
    message, statuses = _Writer(stamp), list(diagnostics)
    message.text("")
    message.pack("I", len(statuses))
    for status in statuses:
        message.pack("B", status.level)
        for text in (status.name, status.message, hardware_id):
            message.text(text)
        message.pack("I", len(status.values))
        for key_and_value in status.values.items():
            for text in key_and_value:
                message.text(text)
    return bytes(message.data)
