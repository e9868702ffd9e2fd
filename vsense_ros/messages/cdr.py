"""Measurements as CDR bytes, and back, for the message types of `vsense_ros.messages.recording.FIELDS`.

A whole channel is decoded with one structured numpy view of its byte layout instead of field by field, which is what
makes reading a bag cheaper than the filter that follows.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.messages.cdr_layout import HEADER, Layout, Strings, layout_of, read_strings
from vsense_ros.messages.recording import FIELDS, Channel, Sample

_STAMP = struct.Struct("<iI")
_HALF = 2**31  # of the range of seconds, beyond which they begin again at the other end
_MANY = 1000  # messages, of which a field that stays is kept once


def _strings_of(item: Sample | Channel, values: Mapping[str, NDArray[np.float64]]) -> Strings:
    lengths = {name: value.shape[-1] for name, value in values.items()}
    if item.kind == "sensor_msgs/msg/JointState":
        for name, length in lengths.items():
            if length not in (0, len(item.names)):
                raise ValueError(f"{item.topic}: {name} has {length} values for {len(item.names)} names")
        counts = (lengths.get("position", 0), lengths.get("velocity", 0), lengths.get("effort", 0))
        return Strings(item.kind, item.frame_id, names=item.names, counts=counts)
    for name, length in lengths.items():
        if length != FIELDS[item.kind][name]:
            raise ValueError(f"{item.topic}: {name} has {length} values, {item.kind} has {FIELDS[item.kind][name]}")
    return Strings(item.kind, item.frame_id, item.child_frame_id)


def _filled(
    item: Sample | Channel, stamps: NDArray[np.int64], values: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.uint8]:
    """The messages as rows of bytes."""
    layout = layout_of(_strings_of(item, values))
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
_of_samples: dict[object, Layout] = {}
_of_messages: dict[tuple[str, int], Layout] = {}
_MOST_LAYOUTS = 1024


def _remember(layouts: dict[Any, Layout], key: object, layout: Layout) -> None:
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
        layout = layout_of(_strings_of(sample, values))
        if not layout.other_fields:
            _remember(_of_samples, key, layout)
        return message
    data = bytearray(layout.template)
    seconds, nanoseconds = divmod(sample.stamp, 1_000_000_000)
    _STAMP.pack_into(data, len(HEADER), (seconds + _HALF) % (2 * _HALF) - _HALF, nanoseconds)
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
    if layout.other_fields:
        row = np.frombuffer(data, layout.dtype, 1)[0]
        values |= {name: np.array(row[name], dtype=np.float64) for name in layout.other_fields}
    for name in layout.empty:
        values[name] = np.zeros(0)
    strings = layout.strings
    seconds, nanoseconds = _STAMP.unpack_from(data, len(HEADER))
    stamp = seconds * 1_000_000_000 + nanoseconds
    return Sample(topic, kind, stamp, values, strings.frame_id, strings.names, strings.child_frame_id, received)


def _checked_layout(kind: str, data: bytes, topic: str) -> Layout:
    if kind not in FIELDS:
        raise InputError(f"{topic}: message type {kind!r} has no numeric form; known: {', '.join(sorted(FIELDS))}")
    try:
        layout = layout_of(read_strings(kind, data))
    except ValueError as error:  # includes bad UTF-8
        raise InputError(f"{topic}: not a {kind} message: {error}") from None
    if len(data) < len(layout.template):
        raise InputError(f"{topic}: a {kind} message needs {len(layout.template)} bytes, found {len(data)}")
    return layout


@dataclass(frozen=True)
class Decoded:
    """The messages of one topic as a channel, and those that are no part of it."""

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
    frames: Counter[tuple[str, str]] = Counter()
    for layout, rows in groups:
        frames[layout.strings.frame_id, layout.strings.child_frame_id] += len(rows)
    ((frame, _),) = frames.most_common(1)
    foreign = {" / ".join(filter(None, key)) or "(empty)": n for key, n in frames.items() if key != frame}
    chosen = [(g, r) for g, r in groups if (g.strings.frame_id, g.strings.child_frame_id) == frame]
    make = _uniform_channel if len(chosen) == 1 else _joined_channel
    return Decoded(make(topic, payloads, received, chosen), bad, first_error, foreign)


_Groups = list[tuple[Layout, NDArray[np.intp]]]  # layouts with the row numbers of their messages


def _stamps(messages: NDArray[np.void]) -> NDArray[np.int64]:
    """Time stamps [ns] of messages (n,)."""
    seconds = messages["sec"][:, 0].astype(np.int64)
    return np.asarray(seconds * 1_000_000_000 + messages["nanosec"][:, 0], np.int64)


def _uniform_channel(topic: str, payloads: Payloads, received: NDArray[np.int64], groups: _Groups) -> Channel:
    """The channel of messages of one layout, whose numbers are copied once."""
    ((layout, rows),) = groups
    messages, strings = _rows_of(layout, _chosen(payloads, rows)), layout.strings
    columns = {
        field: _numbers(messages[field]) if field in layout.offsets else np.zeros((len(rows), 0))
        for field in FIELDS[strings.kind]
    }
    return Channel(
        topic, strings.kind, _stamps(messages), received[rows], columns, strings.frame_id, strings.names,
        strings.child_frame_id,
    )  # fmt: skip


def _joined_channel(topic: str, payloads: Payloads, received: NDArray[np.int64], groups: _Groups) -> Channel:
    """The channel of messages of several layouts, as they come where some lack joints; NaN for what they lack."""
    first = groups[0][0].strings
    names = tuple(dict.fromkeys(name for layout, _ in groups for name in layout.strings.names))
    widths = {field: width or len(names) for field, width in FIELDS[first.kind].items()}
    if first.kind == "sensor_msgs/msg/JointState":
        present = {field for layout, _ in groups for field in layout.offsets}
        widths = {field: width if field in present else 0 for field, width in widths.items()}
    order = np.concatenate([rows for _, rows in groups])
    stamp = np.empty(len(order), np.int64)
    columns = {field: np.full((len(order), width), np.nan) for field, width in widths.items()}
    done = 0
    for layout, rows in groups:
        messages = _rows_of(layout, _chosen(payloads, rows))
        part = slice(done, done + len(rows))
        stamp[part] = _stamps(messages)
        places = [names.index(name) for name in layout.strings.names]
        for field in layout.offsets.keys() & widths.keys():
            columns[field][part, places or slice(None)] = _numbers(messages[field])
        done += len(rows)
    channel = Channel(topic, first.kind, stamp, received[order], columns, first.frame_id, names, first.child_frame_id)
    return channel.select(np.argsort(order, kind="stable"))


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


def _rows_of(layout: Layout, payloads: Payloads) -> NDArray[np.void]:
    length = len(payloads[0])
    if isinstance(payloads, np.ndarray):
        return np.ascontiguousarray(payloads).view(layout.dtype_of(length))[:, 0]
    return np.frombuffer(b"".join(payloads), layout.dtype_of(length))


def _by_length(payloads: Payloads) -> list[NDArray[np.intp]]:
    """The row numbers of messages of each length."""
    if isinstance(payloads, np.ndarray):
        return [np.arange(len(payloads))]
    lengths = np.fromiter(map(len, payloads), np.intp, len(payloads))
    return [np.flatnonzero(lengths == length) for length in dict.fromkeys(lengths.tolist())]


def _grouped(kind: str, topic: str, payloads: Payloads) -> tuple[list[tuple[Layout, NDArray[np.intp]]], int, str]:
    """Messages by byte layout and length, with their row numbers; the number of unusable ones, and why the first is."""
    groups: list[tuple[Layout, NDArray[np.intp]]] = []
    bad, first_error = 0, ""
    for rows in _by_length(payloads):
        chosen = _chosen(payloads, rows)
        table = (
            chosen
            if isinstance(chosen, np.ndarray)
            else np.frombuffer(b"".join(chosen), np.uint8).reshape(len(rows), -1)
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
