"""ROS messages as bytes: CDR, little endian (XCDR1), for the message types of `vsense_ros.messages.recording.FIELDS`.

Strings stand at the front of all these messages and all else has a fixed size, so two messages of one topic that
carry the same strings have the same byte layout. A layout is worked out once (`_layout`) from the message definition;
a whole channel is then decoded with one structured numpy view instead of field by field, which is what makes reading
a bag cheaper than the filter that follows.

Alignment counts from behind the four bytes of the encapsulation header (OMG DDS-XTypes 1.3, 7.6.2).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.messages import definitions
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import FIELDS, Channel, Sample

_HEADER = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_HALF = 2**31  # of the range of seconds, beyond which they begin again at the other end
_SIZES = {"int8": 1, "uint8": 1, "byte": 1, "uint16": 2, "int32": 4, "uint32": 4, "float64": 8}
_FORMATS = {
    "int8": "i1",
    "uint8": "u1",
    "byte": "u1",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "float64": "<f8",
}
_MAX_JOINTS = 4096
_MANY = 1000  # messages, of which a field that stays is kept once

# Where the number fields of `FIELDS` stand in the message, if not under their own name at the top.
_PATHS: Mapping[str, Mapping[str, str]] = {
    "sensor_msgs/msg/NavSatFix": {"status": "status.status", "service": "status.service"},
    "geometry_msgs/msg/TwistWithCovarianceStamped": {
        "linear": "twist.twist.linear",
        "angular": "twist.twist.angular",
        "covariance": "twist.covariance",
    },
    "geometry_msgs/msg/TwistStamped": {"linear": "twist.linear", "angular": "twist.angular"},
    "geometry_msgs/msg/AccelStamped": {"linear": "accel.linear", "angular": "accel.angular"},
    "geometry_msgs/msg/AccelWithCovarianceStamped": {
        "linear": "accel.accel.linear",
        "angular": "accel.accel.angular",
        "covariance": "accel.covariance",
    },
    "geometry_msgs/msg/WrenchStamped": {"force": "wrench.force", "torque": "wrench.torque"},
    "nav_msgs/msg/Odometry": {
        "position": "pose.pose.position",
        "orientation": "pose.pose.orientation",
        "pose_covariance": "pose.covariance",
        "linear": "twist.twist.linear",
        "angular": "twist.twist.angular",
        "twist_covariance": "twist.covariance",
    },
}


@dataclass(frozen=True)
class _Strings:
    """What decides the byte layout of a message: its strings and the lengths of its arrays."""

    kind: str
    frame_id: str = ""
    child_frame_id: str = ""
    names: tuple[str, ...] = ()
    counts: tuple[int, int, int] = (0, 0, 0)  # of position, velocity, effort of a JointState


@dataclass(frozen=True)
class _Layout:
    """Where everything stands in the bytes of a message."""

    strings: _Strings
    template: bytes  # a message with these strings and all numbers zero
    offsets: Mapping[str, tuple[str, int, int]]  # field → numpy format, count, byte offset
    fixed: NDArray[np.intp]  # positions of the bytes that are the same in every message of this layout

    @cached_property
    def wide(self) -> Mapping[str, tuple[int, int]]:
        """Of fields of 64-bit numbers: first byte, and the one after the last."""
        return {name: (at, at + 8 * n) for name, (format_, n, at) in self.offsets.items() if format_ == "<f8"}

    @cached_property
    def others(self) -> tuple[str, ...]:
        """All other fields that are no part of the stamp."""
        return tuple(name for name in self.offsets if name not in self.wide and name not in ("sec", "nanosec"))

    @cached_property
    def empty(self) -> tuple[str, ...]:
        """Fields of the message type that messages of this layout have no numbers for."""
        return tuple(name for name in FIELDS[self.strings.kind] if name not in self.offsets)

    @cached_property
    def runs(self) -> tuple[tuple[int, int, bytes], ...]:
        """The fixed bytes: first position, the one after the last, and what stands there."""
        parts = np.split(self.fixed, np.flatnonzero(np.diff(self.fixed) > 1) + 1)
        ends = [(int(part[0]), int(part[-1]) + 1) for part in parts]
        return tuple((begin, end, self.template[begin:end]) for begin, end in ends)

    def fits(self, data: bytes) -> bool:
        """Whether a message, not shorter than the template, has this layout."""
        return all(data[begin:end] == text for begin, end, text in self.runs)

    @cached_property
    def dtype(self) -> np.dtype:
        return self.dtype_of(len(self.template))

    def dtype_of(self, length: int) -> np.dtype:
        """Structured type of messages of `length` bytes; some writers pad the end."""
        return np.dtype(
            {
                "names": list(self.offsets),
                "formats": [(f, (n,)) for f, n, _ in self.offsets.values()],
                "offsets": [offset for _, _, offset in self.offsets.values()],
                "itemsize": length,
            }
        )


@cache
def _primitives(kind: str) -> tuple[tuple[str, int, str], ...]:
    """Primitive type, count (0: sequence) and dotted path of each field in the order of the bytes."""

    def walk(name: str, path: str) -> Iterable[tuple[str, int, str]]:
        for field_type, field in definitions.fields(name):
            inner, _, bracket = field_type.partition("[")
            here = f"{path}.{field}" if path else field
            if definitions.is_message(inner):
                yield from walk(inner, here)
            else:
                yield inner, int(bracket[:-1] or 0) if bracket else 1, here

    return tuple(walk(kind, ""))


def _field_at(kind: str, path: str) -> str | None:
    """The field of `FIELDS[kind]` that a primitive belongs to."""
    for field in FIELDS[kind]:
        start = _PATHS.get(kind, {}).get(field, field)
        if path == start or path.startswith(f"{start}."):
            return field
    return None


@lru_cache(maxsize=1024)
def _layout(strings: _Strings) -> _Layout:
    data = bytearray(_HEADER)
    offsets: dict[str, tuple[str, int, int]] = {}
    fixed = [0, 1]

    def align(size: int) -> None:
        data.extend(b"\0" * (-(len(data) - len(_HEADER)) % size))

    def put(value: bytes) -> None:
        fixed.extend(range(len(data), len(data) + len(value)))
        data.extend(value)

    def put_string(text: str) -> None:
        align(4)
        encoded = text.encode() + b"\0"
        put(struct.pack("<I", len(encoded)) + encoded)

    counts = dict(zip(("position", "velocity", "effort"), strings.counts, strict=True))
    for primitive, count, path in _primitives(strings.kind):
        if path == "name":
            align(4)
            put(struct.pack("<I", len(strings.names)))
            for name in strings.names:
                put_string(name)
            continue
        if primitive == "string":
            put_string(strings.frame_id if path == "header.frame_id" else strings.child_frame_id)
            continue
        if count == 0:
            count = counts[path]
            align(4)
            put(struct.pack("<I", count))
            if not count:
                continue
        align(_SIZES[primitive])
        field = path.rpartition(".")[2] if path.startswith("header.") else _field_at(strings.kind, path)
        if field is None:
            raise LookupError(f"{strings.kind}: {path} belongs to no number field")
        before = offsets.get(field)
        offsets[field] = (
            (_FORMATS[primitive], before[1] + count, before[2])
            if before
            else (
                _FORMATS[primitive],
                count,
                len(data),
            )
        )
        data.extend(b"\0" * (_SIZES[primitive] * count))
    return _Layout(strings, bytes(data), offsets, np.array(fixed))


def _read_strings(kind: str, data: bytes) -> _Strings:
    """Strings and array lengths of a message. Raises ValueError if the bytes are no such message."""
    if len(data) < 4 or data[0] != 0 or data[1] != 1:
        raise ValueError(f"expected little-endian CDR (00 01), found {data[:2].hex(' ') or 'nothing'}")
    at = 12

    def number() -> int:
        nonlocal at
        at += -(at - 4) % 4
        if at + 4 > len(data):
            raise ValueError(f"ends at byte {len(data)}, inside its strings")
        (value,) = struct.unpack_from("<I", data, at)
        at += 4
        return value

    def text() -> str:
        nonlocal at
        length = number()
        if length == 0 or at + length > len(data):
            raise ValueError(f"a string of {length} bytes at byte {at} does not fit into {len(data)} bytes")
        at += length
        return data[at - length : at - 1].decode()

    frame_id = text()
    if kind == "nav_msgs/msg/Odometry":
        return _Strings(kind, frame_id, child_frame_id=text())
    if kind != "sensor_msgs/msg/JointState":
        return _Strings(kind, frame_id)
    count = number()
    if count > _MAX_JOINTS:
        raise ValueError(f"{count} joint names; at most {_MAX_JOINTS} are plausible")
    names = tuple(text() for _ in range(count))
    counts = []
    for _ in range(3):
        length = number()
        if length not in (0, count):
            raise ValueError(f"{length} values for {count} joints")
        counts.append(length)
        if length:
            at += -(at - 4) % 8 + 8 * length
    return _Strings(kind, frame_id, names=names, counts=(counts[0], counts[1], counts[2]))


def _strings_of(item: Sample | Channel, values: Mapping[str, NDArray[np.float64]]) -> _Strings:
    lengths = {name: value.shape[-1] for name, value in values.items()}
    if item.kind == "sensor_msgs/msg/JointState":
        for name, length in lengths.items():
            if length not in (0, len(item.names)):
                raise ValueError(f"{item.topic}: {name} has {length} values for {len(item.names)} names")
        counts = (lengths.get("position", 0), lengths.get("velocity", 0), lengths.get("effort", 0))
        return _Strings(item.kind, item.frame_id, names=item.names, counts=counts)
    for name, length in lengths.items():
        if length != FIELDS[item.kind][name]:
            raise ValueError(f"{item.topic}: {name} has {length} values, {item.kind} has {FIELDS[item.kind][name]}")
    return _Strings(item.kind, item.frame_id, item.child_frame_id)


def _filled(
    item: Sample | Channel, stamps: NDArray[np.int64], values: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.uint8]:
    """Messages as rows of bytes."""
    layout = _layout(_strings_of(item, values))
    rows = np.frombuffer(bytearray(layout.template * len(stamps)), layout.dtype)
    seconds, nanoseconds = np.divmod(stamps, 1_000_000_000)
    rows["sec"] = seconds[:, None]
    rows["nanosec"] = nanoseconds[:, None]
    for name, value in values.items():
        if value.shape[-1] == 0:
            continue
        if layout.offsets[name][0] != "<f8" and not np.isfinite(value).all():
            raise ValueError(f"{item.topic}: {name} is an integer in {item.kind}, found NaN or infinity")
        rows[name] = value
    return rows.view(np.uint8).reshape(len(stamps), len(layout.template))


# Layouts of samples and messages of late, by all that decides them and by type and length: an observer says and hears
# the same kinds of message hundreds of times a second.
_of_samples: dict[object, _Layout] = {}
_of_messages: dict[tuple[str, int], _Layout] = {}
_MOST_LAYOUTS = 1024


def _remember(layouts: dict[Any, _Layout], key: object, layout: _Layout) -> None:
    if len(layouts) >= _MOST_LAYOUTS:
        layouts.clear()
    layouts[key] = layout


def encode(sample: Sample) -> bytes:
    """A sample as CDR bytes; fields that `values` lacks are zero (empty for a JointState)."""
    values = sample.values
    sizes = tuple([(name, value.shape) for name, value in values.items()])
    key = sample.kind, sample.frame_id, sample.child_frame_id, sample.names, sizes
    layout = _of_samples.get(key)
    if layout is None:
        values = {name: np.atleast_1d(value) for name, value in values.items()}
        message = _filled(sample, np.array([sample.stamp]), values).tobytes()
        layout = _layout(_strings_of(sample, values))
        if not layout.others:
            _remember(_of_samples, key, layout)
        return message
    data = bytearray(layout.template)
    seconds, nanoseconds = divmod(sample.stamp, 1_000_000_000)
    _STAMP.pack_into(data, len(_HEADER), (seconds + _HALF) % (2 * _HALF) - _HALF, nanoseconds)
    wide = layout.wide
    for name, value in values.items():
        if name in wide:
            begin, end = wide[name]
            data[begin:end] = value.astype(np.float64, copy=False).tobytes()
    return bytes(data)


def encode_channel(channel: Channel) -> NDArray[np.uint8]:
    """All messages of a channel as CDR bytes, one row each."""
    return _filled(channel, channel.stamp, channel.columns)


def decode(kind: str, data: bytes, topic: str = "", received: int | None = None) -> Sample:
    """One message from its CDR bytes.

    Raises `InputError` if the bytes are not a little-endian CDR message of this type.
    """
    layout = _of_messages.get((kind, len(data)))
    if layout is None or not layout.fits(data):
        layout = _checked_layout(kind, data, topic)
        _remember(_of_messages, (kind, len(data)), layout)
    values = {
        name: np.frombuffer(data, np.float64, (end - begin) // 8, begin).copy()
        for name, (begin, end) in layout.wide.items()
    }
    if layout.others:
        row = np.frombuffer(data, layout.dtype, 1)[0]
        values |= {name: np.array(row[name], dtype=np.float64) for name in layout.others}
    for name in layout.empty:
        values[name] = np.zeros(0)
    strings = layout.strings
    seconds, nanoseconds = _STAMP.unpack_from(data, len(_HEADER))
    stamp = seconds * 1_000_000_000 + nanoseconds
    return Sample(topic, kind, stamp, values, strings.frame_id, strings.names, strings.child_frame_id, received)


def _checked_layout(kind: str, data: bytes, topic: str) -> _Layout:
    if kind not in FIELDS:
        raise InputError(f"{topic}: message type {kind!r} has no numeric form; known: {', '.join(sorted(FIELDS))}")
    try:
        layout = _layout(_read_strings(kind, data))
    except ValueError as error:  # includes bad UTF-8
        raise InputError(f"{topic}: not a {kind} message: {error}") from None
    if len(data) < len(layout.template):
        raise InputError(f"{topic}: a {kind} message needs {len(layout.template)} bytes, found {len(data)}")
    return layout


@dataclass(frozen=True)
class Decoded:
    """What became of the messages of one topic."""

    channel: Channel | None  # None: no message was usable
    bad: int  # messages that are not what their type says
    first_error: str  # about the first of them
    foreign: Mapping[str, int]  # frame id that is not the channel's → messages left out for it


Payloads = Sequence[bytes] | NDArray[np.uint8]


def decode_channel(kind: str, topic: str, payloads: Payloads, received: NDArray[np.int64]) -> Decoded:
    """All messages of one topic as a channel, in the given order; those of one length may be rows of bytes (n, length).

    A channel has one frame id: the most frequent; messages with another are left out and counted. Joints that are
    missing in some messages are NaN there.
    """
    groups, bad, first_error = _grouped(kind, topic, payloads)
    if not groups:
        return Decoded(None, bad, first_error, {})
    frames: dict[tuple[str, str], int] = {}
    for layout, rows in groups:
        key = (layout.strings.frame_id, layout.strings.child_frame_id)
        frames[key] = frames.get(key, 0) + len(rows)
    frame = max(frames, key=lambda key: frames[key])
    foreign = {" / ".join(filter(None, key)) or "(empty)": n for key, n in frames.items() if key != frame}
    chosen = [(g, r) for g, r in groups if (g.strings.frame_id, g.strings.child_frame_id) == frame]

    alone = len(chosen) == 1
    names = chosen[0][0].strings.names
    if not alone:
        names = tuple(dict.fromkeys(name for layout, _ in chosen for name in layout.strings.names))
    order = np.concatenate([rows for _, rows in chosen])
    stamp = np.empty(len(order), np.int64)
    widths = {field: width or len(names) for field, width in FIELDS[kind].items()}
    if kind == "sensor_msgs/msg/JointState":
        present = {field for layout, _ in chosen for field in layout.offsets}
        widths = {field: width if field in present else 0 for field, width in widths.items()}
    columns = {field: np.full((len(order), width), np.nan) for field, width in widths.items()} if not alone else {}
    done = 0
    for layout, rows in chosen:
        messages_ = _rows_of(layout, _chosen(payloads, rows))
        part = slice(done, done + len(rows))
        stamp[part] = messages_["sec"][:, 0].astype(np.int64) * 1_000_000_000 + messages_["nanosec"][:, 0]
        for field, width in widths.items():
            values = _numbers(messages_[field]) if field in layout.offsets else None
            if alone:
                columns[field] = np.zeros((len(rows), 0)) if values is None else values
            elif values is not None and layout.strings.names:
                columns[field][part, [names.index(name) for name in layout.strings.names]] = values
            elif values is not None and width:
                columns[field][part] = values
        done += len(rows)
    back = np.argsort(order, kind="stable")
    channel = Channel(topic, kind, stamp, received[order], columns, frame[0], names, frame[1])
    return Decoded(channel if alone else channel.select(back), bad, first_error, foreign)


def _numbers(column: NDArray[Any]) -> NDArray[np.float64]:
    """A field of many messages as numbers; one that is the same in all of them, as most covariances are, is there once
    and cannot be written."""
    first = column[:1]
    if len(column) >= _MANY and all((part == first).all() for part in (column[-1:], column[: _MANY // 8], column)):
        return np.broadcast_to(first[0].astype(np.float64), column.shape)
    return column.astype(np.float64)


def _chosen(payloads: Payloads, rows: NDArray[np.intp]) -> Payloads:
    if len(rows) == len(payloads):
        return payloads
    return payloads[rows] if isinstance(payloads, np.ndarray) else [payloads[i] for i in rows.tolist()]


def _rows_of(layout: _Layout, payloads: Payloads) -> NDArray[np.void]:
    length = len(payloads[0])
    if isinstance(payloads, np.ndarray):
        return np.ascontiguousarray(payloads).view(layout.dtype_of(length))[:, 0]
    return np.frombuffer(b"".join(payloads), layout.dtype_of(length))


def _grouped(kind: str, topic: str, payloads: Payloads) -> tuple[list[tuple[_Layout, NDArray[np.intp]]], int, str]:
    """Messages by byte layout and length, with their row numbers; the number of unusable ones, and why the first is."""
    groups: list[tuple[_Layout, NDArray[np.intp]]] = []
    bad, first_error = 0, ""
    if isinstance(payloads, np.ndarray):
        lengths = np.full(len(payloads), payloads.shape[1], np.intp)
    else:
        lengths = np.fromiter(map(len, payloads), np.intp, len(payloads))
    for length in dict.fromkeys(lengths.tolist()):
        rows = np.flatnonzero(lengths == length)
        chosen = _chosen(payloads, rows)
        table = (
            chosen
            if isinstance(chosen, np.ndarray)
            else np.frombuffer(b"".join(chosen), np.uint8).reshape(len(rows), length)
        )
        open_ = np.ones(len(rows), bool)
        while open_.any():
            first = int(np.argmax(open_))
            try:
                layout = _checked_layout(kind, bytes(payloads[int(rows[first])]), topic)
            except InputError as error:
                bad += 1
                first_error = first_error or str(error)
                open_[first] = False
                continue
            same = open_ & (table[:, layout.fixed] == table[first, layout.fixed]).all(axis=1)
            groups.append((layout, rows[same]))
            open_ &= ~same
    return groups, bad, first_error


@dataclass(frozen=True, slots=True)
class Transform:
    """Where the frame `child` is in the frame `parent`: (3,) [m] and a quaternion x, y, z, w (4,)."""

    parent: str
    child: str
    position: Sequence[float]
    orientation: Sequence[float]


def encode_transforms(stamp: int, transforms: Sequence[Transform]) -> bytes:
    """A tf2_msgs/TFMessage as CDR bytes; `stamp` [ns]."""
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    data = bytearray(_HEADER + struct.pack("<I", len(transforms)))
    for transform in transforms:
        data.extend(b"\0" * (-len(data) % 4) + struct.pack("<iI", seconds, nanoseconds))
        for name in (transform.parent, transform.child):
            encoded = name.encode() + b"\0"
            data.extend(b"\0" * (-len(data) % 4) + struct.pack("<I", len(encoded)) + encoded)
        data.extend(b"\0" * (-(len(data) - len(_HEADER)) % 8))
        data.extend(struct.pack("<7d", *transform.position, *transform.orientation))
    return bytes(data)


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
    name = frame_id.encode() + b"\0"
    data = bytearray(_HEADER + struct.pack("<iI", *divmod(frame.stamp, 1_000_000_000)))
    data.extend(struct.pack("<I", len(name)) + name)
    data.extend(b"\0" * (-len(data) % 4))
    flags = (frame.is_remote, frame.is_extended, frame.is_error)
    return bytes(data + struct.pack("<I3?B8s", frame.identifier, *flags, frame.length, frame.data))


def decode_can_frame(data: bytes) -> CanFrame:
    """A can_msgs/Frame from its CDR bytes. Raises `InputError` for others."""
    (_, at), (seconds, nanoseconds) = _text_behind_stamp(data, "can_msgs/msg/Frame")
    at += -at % 4
    if len(data) < at + 16:
        raise InputError(f"a can_msgs/msg/Frame needs {at + 16} bytes, found {len(data)}")
    identifier, remote, extended, error, length = struct.unpack_from("<I3?B", data, at)
    if length > 8:
        raise InputError(f"a can_msgs/msg/Frame has up to 8 bytes, dlc says {length}")
    content = b"" if remote else data[at + 8 : at + 8 + length]
    stamp = seconds * 1_000_000_000 + nanoseconds
    return CanFrame(stamp, identifier, content, remote, extended, error, length)


def decode_sentence(data: bytes) -> bytes:
    """The sentence of a nmea_msgs/Sentence from its CDR bytes. Raises `InputError` for others."""
    (_, at), _ = _text_behind_stamp(data, "nmea_msgs/msg/Sentence")
    text, _ = _text_at(data, at + -at % 4, "nmea_msgs/msg/Sentence")
    return text


def _text_behind_stamp(data: bytes, kind: str) -> tuple[tuple[bytes, int], tuple[int, int]]:
    if len(data) < 12 or data[:2] != _HEADER[:2]:
        raise InputError(f"not a {kind} message: expected little-endian CDR, found {data[:2].hex(' ') or 'nothing'}")
    return _text_at(data, 12, kind), struct.unpack_from("<iI", data, 4)


def _text_at(data: bytes, at: int, kind: str) -> tuple[bytes, int]:
    """A text without its final NUL, and the position behind it."""
    length = int.from_bytes(data[at : at + 4], "little") if at + 4 <= len(data) else 0
    end = at + 4 + length
    if length == 0 or end > len(data):
        raise InputError(f"not a {kind} message: a text of {length} bytes at byte {at} of {len(data)}")
    return data[at + 4 : end - 1], end


def encode_text(text: str) -> bytes:
    """A std_msgs/String as CDR bytes."""
    encoded = text.encode() + b"\0"
    return _HEADER + struct.pack("<I", len(encoded)) + encoded


def encode_diagnostics(stamp: int, diagnostics: Iterable[Diagnostic], hardware_id: str = "") -> bytes:
    """A diagnostic_msgs/DiagnosticArray as CDR bytes; `stamp` [ns]."""
    data = bytearray(_HEADER + struct.pack("<iI", *divmod(stamp, 1_000_000_000)))

    def number(value: int) -> None:
        data.extend(b"\0" * (-len(data) % 4) + struct.pack("<I", value))

    def text(value: str) -> None:
        encoded = value.encode() + b"\0"
        number(len(encoded))
        data.extend(encoded)

    statuses = list(diagnostics)
    text("")
    number(len(statuses))
    for status in statuses:
        data.append(status.level)
        for value in (status.name, status.message, hardware_id):
            text(value)
        number(len(status.values))
        for key, value in status.values.items():
            text(key)
            text(value)
    return bytes(data)
