"""MCAP bags as rosbag2 writes and plays them: profile `ros2`, CDR messages, `ros2msg` schemas, chunked, indexed.

Reader and writer work on the records of the format (https://mcap.dev/spec) directly. A general library spends some
ten microseconds on a message; here a message costs a few struct operations, and its numbers are decoded with all
others of its topic at once (`cdr.decode_channel`).

A damaged bag gives all that is intact: the file is scanned from the front, a chunk whose checksum or compression is
broken is left out and counted by its message index, a chunk cut off by the end of the file is read up to the cut.
"""

from __future__ import annotations

import re
import shutil
import struct
import zlib
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.messages import cdr, definitions, yaml_text
from vsense_ros.messages.memory import give_back
from vsense_ros.messages.recording import FIELDS, Channel, Recording, Sample

_MAGIC = b"\x89MCAP0\r\n"
_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(0x01, 0x09)
_STATISTICS, _METADATA, _METADATA_INDEX, _SUMMARY_OFFSET, _DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_READ = struct.Struct("<xQH4xQ8x")  # of it, length, channel and log time
_HEAD_ROWS = np.dtype(  # the same, of many
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("time", "<u8"), ("publish", "<u8")]
)
_FOOTER_LENGTH = _RECORD.size + 20 + len(_MAGIC)

_ZSTD = b"\x28\xb5\x2f\xfd"
_ENCODED_AT_ONCE = 8192  # messages
_LARGEST_METADATA = 1 << 22  # [byte]
_MOST_FILES = 100_000
_LARGEST_CHUNK = 1 << 28  # [byte] uncompressed
_ORDINARY_CHUNK = 1 << 26  # [byte] that a chunk may have however small it is in the file
_MOST_INFLATED = 100  # times its size in the file, beyond that
_ORDINARY_BAG = 1 << 30  # [byte] uncompressed, likewise for a whole file
_LARGEST_WINDOW = 1 << 27  # [byte] that a decompressor may look back
_LARGEST_MESSAGE = 1 << 20  # [byte] of those with a numeric form
_DAY = 86_400_000_000_000  # [ns]

CHUNK_SIZE = 256 * 1024  # [byte] before compression: what one damaged spot can cost at most

RELIABLE_QOS = """\
- history: keep_last
  depth: 10
  reliability: reliable
  durability: volatile
  deadline:
    sec: 9223372036
    nsec: 854775807
  lifespan:
    sec: 9223372036
    nsec: 854775807
  liveliness: automatic
  liveliness_lease_duration:
    sec: 9223372036
    nsec: 854775807
  avoid_ros_namespace_conventions: false
"""


def _text(value: str) -> bytes:
    encoded = value.encode()
    return struct.pack("<I", len(encoded)) + encoded


def _map(values: Mapping[str, str]) -> bytes:
    body = b"".join(_text(key) + _text(value) for key, value in values.items())
    return struct.pack("<I", len(body)) + body


def _record(opcode: int, body: bytes) -> bytes:
    return _RECORD.pack(opcode, len(body)) + body


_COMPRESSORS: Mapping[str, Callable[[bytes], bytes]] = {
    "": lambda data: data,
    "lz4": lambda data: lz4.frame.compress(data, store_size=True),
    "zstd": lambda data: zstandard.ZstdCompressor(level=3, write_checksum=False).compress(data),
}


@dataclass(frozen=True)
class TopicDescription:
    """What a bag says of a topic beside its messages: how its type is defined and hashed, how it was offered.

    `schema` is the text of the message definition (`ros2msg`), empty where nobody knows it; `qos` the offered qualities
    of service as rosbag2 writes them, in YAML.
    """

    kind: str
    schema: str
    type_hash: str
    qos: str = RELIABLE_QOS

    @classmethod
    def of(cls, topic: str, kind: str) -> TopicDescription:
        """Of a type that the project defines; `InputError` for others."""
        if kind not in definitions.TYPE_HASHES:
            known = ", ".join(sorted(definitions.TYPE_HASHES))
            raise InputError(f"{topic}: message type {kind!r} cannot be written; known: {known}")
        return cls(kind, definitions.schema_text(kind), definitions.TYPE_HASHES[kind])


class _File:
    """One MCAP file, from its head to its summary."""

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path
        self.begun = False  # whether a message is in it
        self.first, self.last = 2**63 - 1, 0  # times of its messages [ns]
        self._compress = _COMPRESSORS[compression]
        self._compression = compression
        self._file: BinaryIO = path.open("wb")
        self._at = 0
        self._schemas: dict[str, tuple[int, bytes]] = {}  # by type: number, record
        self._channels: dict[str, tuple[int, bytes]] = {}  # by topic
        self._counts: dict[int, int] = {}
        self._chunk = bytearray()
        self._index: dict[int, list[tuple[int, int]]] = {}
        self._chunk_indexes: list[bytes] = []
        self._put(_MAGIC + _record(_HEADER, _text("ros2") + _text("vsense_ros")))

    @property
    def size(self) -> int:
        """Bytes so far, those of the pending chunk before compression."""
        return self._at + len(self._chunk)

    @property
    def counts(self) -> dict[str, int]:
        """Messages by topic."""
        return {topic: self._counts[number] for topic, (number, _) in self._channels.items()}

    @property
    def span(self) -> tuple[int, int]:
        """Times of the first and the last message [ns], zeros without any."""
        return (self.first, self.last) if self.begun else (0, 0)

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._at += len(data)

    def write(self, topic: str, description: TopicDescription, log_time: int, data: bytes) -> None:
        channel, _ = self._channels.get(topic) or self._add(topic, description)
        self._index.setdefault(channel, []).append((log_time, len(self._chunk)))
        sequence = self._counts[channel]
        self._counts[channel] += 1
        self._chunk += _MESSAGE_HEAD.pack(_MESSAGE, 22 + len(data), channel, sequence & 0xFFFFFFFF, log_time, log_time)
        self._chunk += data
        self.begun = True
        if log_time < self.first:
            self.first = log_time
        if log_time > self.last:
            self.last = log_time
        if len(self._chunk) >= CHUNK_SIZE:
            self.flush()

    def _add(self, topic: str, description: TopicDescription) -> tuple[int, bytes]:
        kind = description.kind
        if kind not in self._schemas:
            number = len(self._schemas) + 1
            encoding = "ros2msg" if description.schema else ""
            body = struct.pack("<H", number) + _text(kind) + _text(encoding) + _text(description.schema)
            self._schemas[kind] = (number, _record(_SCHEMA, body))
            self._chunk += self._schemas[kind][1]
        number = len(self._channels) + 1
        metadata = {"offered_qos_profiles": description.qos, "topic_type_hash": description.type_hash}
        head = struct.pack("<HH", number, self._schemas[kind][0])
        record = _record(_CHANNEL, head + _text(_absolute(topic)) + _text("cdr") + _map(metadata))
        self._channels[topic] = (number, record)
        self._counts[number] = 0
        self._chunk += record
        return self._channels[topic]

    def flush(self) -> None:
        """Write the pending messages as one chunk with its message index."""
        if not self._chunk:
            return
        raw = bytes(self._chunk)
        packed = self._compress(raw)
        times = [time for entries in self._index.values() for time, _ in entries]
        first, last = (min(times), max(times)) if times else (0, 0)
        start = self._at
        body = struct.pack("<QQQI", first, last, len(raw), zlib.crc32(raw)) + _text(self._compression)
        self._put(_record(_CHUNK, body + struct.pack("<Q", len(packed)) + packed))
        length = self._at - start
        offsets = b""
        for channel in sorted(self._index):
            offsets += struct.pack("<HQ", channel, self._at)
            entries = b"".join(struct.pack("<QQ", *entry) for entry in sorted(self._index[channel]))
            self._put(_record(_MESSAGE_INDEX, struct.pack("<HI", channel, len(entries)) + entries))
        self._chunk_indexes.append(
            struct.pack("<QQQQI", first, last, start, length, len(offsets))
            + offsets
            + struct.pack("<Q", self._at - start - length)
            + _text(self._compression)
            + struct.pack("<QQ", len(packed), len(raw))
        )
        self._file.flush()
        self._chunk.clear()
        self._index.clear()

    def finish(self, information: str) -> None:
        """The end of the file, which the text of `metadata.yaml` so far belongs to."""
        self.flush()
        metadata_at = self._at
        inside = {"serialized_metadata": "".join(line[2:] for line in information.splitlines(True)[1:])}
        self._put(_record(_METADATA, _text("rosbag2") + _map(inside)))
        metadata_length = self._at - metadata_at
        self._put(_record(_DATA_END, struct.pack("<I", 0)))
        self._put_summary(metadata_at, metadata_length)
        self._file.close()

    def abandon(self) -> None:
        with suppress(OSError):
            self._file.close()

    def _put_summary(self, metadata_at: int, metadata_length: int) -> None:
        total = sum(self._counts.values())
        first, last = self.span
        counts = b"".join(struct.pack("<HQ", *item) for item in sorted(self._counts.items()))
        statistics = struct.pack(
            "<QHIIIIQQI",
            total,
            len(self._schemas),
            len(self._channels),
            0,
            1,
            len(self._chunk_indexes),
            first,
            last,
            len(counts),
        )
        groups = {
            _SCHEMA: b"".join(record for _, record in self._schemas.values()),
            _CHANNEL: b"".join(record for _, record in self._channels.values()),
            _CHUNK_INDEX: b"".join(_record(_CHUNK_INDEX, body) for body in self._chunk_indexes),
            _METADATA_INDEX: _record(
                _METADATA_INDEX, struct.pack("<QQ", metadata_at, metadata_length) + _text("rosbag2")
            ),
            _STATISTICS: _record(_STATISTICS, statistics + counts),
        }
        at, summary, offsets = self._at, b"", b""
        for opcode, group in groups.items():
            if group:
                offsets += _record(_SUMMARY_OFFSET, struct.pack("<BQQ", opcode, at + len(summary), len(group)))
                summary += group
        footer_start = _RECORD.pack(_FOOTER, 20) + struct.pack("<QQ", at, at + len(summary))
        crc = zlib.crc32(summary + offsets + footer_start)
        self._put(summary + offsets + footer_start + struct.pack("<I", crc) + _MAGIC)


class BagWriter:
    """Writes a bag folder `<name>/<name>_0.mcap` with `metadata.yaml`, as a context manager.

    The same calls write the same bytes: nothing in the file depends on clock, host or version of this package
    (with compression, on the version of the compression library). What has been written stands readable in the file
    chunk by chunk, also if the process dies before `close`.

    A file that has reached `split_size` [byte] or spans `split_duration` [s] is finished, and `<name>_1.mcap` begun;
    0: never. Raises `InputError` if the folder holds something already (`overwrite=True` replaces a bag).
    """

    def __init__(
        self,
        path: str | Path,
        *,
        compression: str = "zstd",
        overwrite: bool = False,
        metadata: Mapping[str, str] | None = None,
        split_size: int = 0,
        split_duration: float = 0.0,
    ) -> None:
        if compression not in _COMPRESSORS:
            raise InputError(f"compression {compression!r} is unknown; expected one of 'zstd', 'lz4', ''")
        self.path = Path(path)
        self._compression = compression
        self._metadata = dict(metadata or {})
        self._split_size, self._split_duration = split_size, round(split_duration * 1e9)
        self._clear(overwrite)
        self.path.mkdir(parents=True, exist_ok=True)
        self._topics: dict[str, TopicDescription] = {}
        self._files: list[_File] = []
        self._closed = False
        self._begin_file()

    def _begin_file(self) -> None:
        name = f"{self.path.resolve().name}_{len(self._files)}.mcap"
        self._file = _File(self.path / name, self._compression)
        self._files.append(self._file)

    def _clear(self, overwrite: bool) -> None:
        """Remove an old bag in the way; anything that is not a bag stays, and is an error."""
        if not self.path.exists():
            return
        if not self.path.is_dir():
            raise InputError(f"{self.path}: a bag is a folder, but a file of this name exists; choose another name")
        old = list(self.path.iterdir())
        if old and not overwrite:
            raise InputError(f"{self.path}: holds something already; choose another name or allow overwriting")
        if any(not (f.name == "metadata.yaml" or f.suffix == ".mcap") for f in old):
            raise InputError(f"{self.path}: holds files that are no bag, so it is not overwritten")
        for f in old:
            f.unlink()

    def write(self, sample: Sample) -> None:
        """Write a sample at its time of arrival, or of measurement if that is unknown."""
        time = sample.stamp if sample.received is None else sample.received
        self.write_raw(sample.topic, sample.kind, time, cdr.encode(sample))

    def describe(self, topic: str, description: TopicDescription) -> None:
        """Say before its first message what a topic is; those of the project's own types need not be described."""
        self._topics.setdefault(topic, description)

    def write_raw(self, topic: str, kind: str, log_time: int, data: bytes) -> None:
        """Write a message that is CDR bytes already; `log_time` [ns]."""
        description = self._topics.get(topic)
        if description is None:
            description = self._topics[topic] = TopicDescription.of(topic, kind)
        if kind != description.kind:
            raise InputError(f"{topic}: was {description.kind} so far, now {kind}; a topic has one type")
        if log_time < 0:
            raise InputError(f"{topic}: time {log_time} ns is before 1970")
        file = self._file
        if file.begun and (0 < self._split_size <= file.size or 0 < self._split_duration <= log_time - file.first):
            self.split()
        self._file.write(topic, description, log_time, data)

    def split(self) -> None:
        """Finish the file, and begin the next."""
        if self._file.begun:
            self._file.finish(self._metadata_yaml())
            self._begin_file()

    def flush(self) -> None:
        """Write what is pending: whatever happens to the process, it is in the file."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file and write `metadata.yaml`."""
        if self._closed:
            return
        self._closed = True
        information = self._metadata_yaml()
        self._file.finish(information)
        (self.path / "metadata.yaml").write_text(information, encoding="utf-8")

    def abandon(self) -> None:
        """Leave the file as far as it came, without an end, when it cannot be written any more."""
        self._closed = True
        self._file.abandon()

    def _metadata_yaml(self) -> str:
        counts: dict[str, int] = {}
        for file in self._files:
            for topic, count in file.counts.items():
                counts[topic] = counts.get(topic, 0) + count
        begun = [file for file in self._files if file.begun]
        first, last = min((f.first for f in begun), default=0), max((f.last for f in begun), default=0)
        topics = "".join(
            f"""\
- topic_metadata:
    name: {_quoted(_absolute(topic))}
    type: {self._topics[topic].kind}
    serialization_format: cdr
    offered_qos_profiles:
{_indent(self._topics[topic].qos, 6)}    type_description_hash: {self._topics[topic].type_hash}
  message_count: {count}
"""
            for topic, count in counts.items()
        )
        custom = "".join(f"  {_quoted(key)}: {_quoted(value)}\n" for key, value in self._metadata.items())
        names = [_quoted(file.path.name) for file in self._files]
        files = "".join(
            f"  - path: {name}\n{_indent(_span(*file.span, sum(file.counts.values())), 4)}"
            for name, file in zip(names, self._files, strict=True)
        )
        information = (
            "version: 9\nstorage_identifier: mcap\n"
            + _span(first, last, sum(counts.values()))
            + (f"topics_with_message_count:\n{_indent(topics, 2)}" if topics else "topics_with_message_count: []\n")
            + 'compression_format: ""\ncompression_mode: ""\nrelative_file_paths:\n'
            + "".join(f"  - {name}\n" for name in names)
            + f"files:\n{files}"
            + (f"custom_data:\n{custom}" if custom else "custom_data: ~\n")
            + "ros_distro: jazzy\n"
        )
        return "rosbag2_bagfile_information:\n" + _indent(information, 2)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _span(first: int, last: int, count: int) -> str:
    return f"""\
duration:
  nanoseconds: {last - first}
starting_time:
  nanoseconds_since_epoch: {first}
message_count: {count}
"""


def _absolute(topic: str) -> str:
    """Name of a topic in a bag: rosbag2 knows fully qualified names only."""
    return topic if topic.startswith("/") else f"/{topic}"


def _indent(text: str, width: int) -> str:
    return "".join(" " * width + line for line in text.splitlines(True))


def _quoted(text: str) -> str:
    """A YAML double-quoted scalar on one line."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\t", "\\t")
    return f'"{escaped}"'


def write_bag(path: str | Path, recording: Recording, *, compression: str = "zstd", overwrite: bool = False) -> None:
    """Write a recording as a bag, in order of arrival. Its name, metadata and notes go into `custom_data`.

    Nothing half-written is left behind if that fails.
    """
    metadata = dict(recording.metadata)
    if recording.notes:
        metadata["notes"] = "\n".join(recording.notes)
    channels = [channel.in_order() for channel in recording.channels.values() if len(channel)]
    with BagWriter(path, compression=compression, overwrite=overwrite, metadata=metadata) as writer:
        if not channels:
            return
        received = np.concatenate([channel.received for channel in channels])
        source = np.repeat(np.arange(len(channels)), [len(channel) for channel in channels])
        order = np.argsort(received, kind="stable")
        streams = [(channel.topic, channel.kind, _encoded(channel).__next__) for channel in channels]
        try:
            for number, time in zip(source[order].tolist(), received[order].tolist(), strict=True):
                topic, kind, following = streams[number]
                writer.write_raw(topic, kind, time, following())
        except BaseException:
            writer.abandon()
            shutil.rmtree(writer.path, ignore_errors=True)
            raise


def _encoded(channel: Channel) -> Iterator[bytes]:
    """The messages of a channel one after the other, encoded some thousands at a time."""
    for begin in range(0, len(channel), _ENCODED_AT_ONCE):
        rows = cdr.encode_channel(channel.select(slice(begin, begin + _ENCODED_AT_ONCE)))
        data, length = rows.tobytes(), rows.shape[1]
        for at in range(0, len(data), length):
            yield data[at : at + length]


_MUCH = 128 << 20  # [byte] after which freed memory is given back
Times = list[int] | NDArray[np.uint64]  # [ns]
Payloads = list[bytes] | NDArray[np.uint8]  # messages, as rows where all have one length


@dataclass
class _Contents:
    """What has been gathered from the files of a bag."""

    schemas: dict[int, tuple[str, str]] = field(default_factory=dict)  # number → type name, definition
    described: dict[str, TopicDescription] = field(default_factory=dict)  # by topic
    channels: dict[int, tuple[str, str, str]] = field(default_factory=dict)  # number → topic, type, encoding
    payloads: dict[int, list[bytes]] = field(default_factory=dict)
    times: dict[int, list[int]] = field(default_factory=dict)
    # Of chunks with an index that holds: messages of one length as rows of bytes, and their times.
    blocks: dict[int, list[tuple[NDArray[np.uint8], NDArray[np.uint64]]]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    lost: int = 0  # messages known to be lost
    expected: int | None = None  # messages that the file says it holds
    informed: bool = False  # metadata.yaml is read
    custom: dict[str, str] = field(default_factory=dict)
    foreign: set[str] = field(default_factory=set)  # topics whose messages are no CDR
    contradictions: dict[tuple[str, str], int] = field(default_factory=dict)  # topic, its second type → messages

    def is_numeric(self, topic: str, kind: str) -> bool:
        """Whether the messages of a topic become numbers."""
        return kind in FIELDS and topic not in self.foreign

    def count(self) -> int:
        return sum(map(len, self.payloads.values())) + sum(len(t) for b in self.blocks.values() for _, t in b)

    def forget(self) -> None:
        """Make room for the next file."""
        self.schemas, self.channels, self.payloads, self.times, self.blocks = {}, {}, {}, {}, {}

    def take(self, number: int) -> tuple[Payloads, NDArray[np.uint64]]:
        """All messages of a channel, and their times; they are not here any more then."""
        blocks = self.blocks.pop(number, [])
        payloads = self.payloads.get(number, [])
        times = [np.array(self.times.get(number, []), np.uint64), *(times for _, times in blocks)]
        if not payloads and len({rows.shape[1] for rows, _ in blocks}) == 1:
            # Each block is let go once it is copied, so that a long bag is not in memory twice.
            every = np.empty((sum(len(rows) for rows, _ in blocks), blocks[0][0].shape[1]), np.uint8)
            end, moved = len(every), 0
            while blocks:
                rows, _ = blocks.pop()
                every[end - len(rows) : end] = rows
                end, moved = end - len(rows), moved + rows.nbytes
                if moved > _MUCH or not blocks:
                    del rows
                    give_back()
                    moved = 0
            return every, np.concatenate(times)
        return [*payloads, *(row.tobytes() for rows, _ in blocks for row in rows)], np.concatenate(times)


class _Damaged(Exception):
    """A record is not what the format says."""


def _take_text(data: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", data, at)
    end = at + 4 + length
    if end > len(data):
        raise _Damaged(f"a text of {length} bytes does not fit")
    return data[at + 4 : end].decode(errors="replace"), end


def _take_map(data: bytes, at: int) -> dict[str, str]:
    (length,) = struct.unpack_from("<I", data, at)
    at, end, values = at + 4, at + 4 + length, {}
    while at < end:
        key, at = _take_text(data, at)
        values[key], at = _take_text(data, at)
    return values


def _take_definition(contents: _Contents, opcode: int, body: bytes) -> None:
    """Schema, channel, statistics or metadata record."""
    try:
        if opcode == _SCHEMA:
            (number,) = struct.unpack_from("<H", body)
            name, at = _take_text(body, 2)
            encoding, at = _take_text(body, at)
            definition, _ = _take_text(body, at) if encoding == "ros2msg" else ("", at)
            contents.schemas[number] = (name, definition)
        elif opcode == _CHANNEL:
            number, schema = struct.unpack_from("<HH", body)
            topic, at = _take_text(body, 4)
            encoding, at = _take_text(body, at)
            kind, definition = contents.schemas.get(schema, ("(unknown)", ""))
            topic = topic.lstrip("/")
            contents.channels[number] = (topic, kind, encoding)
            metadata = _take_map(body, at)
            qos, type_hash = metadata.get("offered_qos_profiles", ""), metadata.get("topic_type_hash", "")
            contents.described[topic] = TopicDescription(kind, definition, type_hash, qos or RELIABLE_QOS)
        elif opcode == _STATISTICS:
            (contents.expected,) = struct.unpack_from("<Q", body)
        elif opcode == _METADATA:
            name, at = _take_text(body, 0)
            if name == "rosbag2" and not contents.informed:  # the same stands in metadata.yaml
                _take_information(contents, _yaml(_take_map(body, at).get("serialized_metadata", "")))
    except (struct.error, _Damaged) as error:
        raise _Damaged(f"record {opcode:#04x}: {error}") from None


_TOPICS_BLOCK = re.compile(r"^( *)topics_with_message_count:[^\n]*\n(?:(?:\1[ -][^\n]*| *)\n)*", re.MULTILINE)


def _yaml(text: str) -> object:
    """A YAML document; of the metadata of a bag, without the qualities of service of its topics, which are its most."""
    if len(text) > _LARGEST_METADATA:
        return None
    text = _TOPICS_BLOCK.sub("", text, count=1)
    try:
        return yaml_text.load(text, "metadata")
    except InputError:
        return None


def _take_information(contents: _Contents, information: object) -> None:
    custom = information.get("custom_data") if isinstance(information, dict) else None
    if isinstance(custom, dict):
        contents.custom.update({str(key): str(value) for key, value in custom.items()})


def _take_records(contents: _Contents, data: bytes) -> int:
    """Gather the records of a chunk; returns the position behind the last whole one."""
    at, end = 0, len(data)
    unpack, head = _MESSAGE_READ.unpack_from, _MESSAGE_HEAD.size
    payloads, times = contents.payloads, contents.times
    sinks = {channel: (payloads[channel].append, times[channel].append) for channel in payloads}
    last = end - head
    while at + 9 <= end:
        if at <= last and data[at] == _MESSAGE:
            length, channel, log_time = unpack(data, at)
            after = at + 9 + length
            if after > end or length < 22:
                break
            sink = sinks.get(channel)
            if sink is None:
                payloads[channel], times[channel] = [], []
                sink = sinks[channel] = (payloads[channel].append, times[channel].append)
            sink[0](data[at + head : after])
            sink[1](log_time)
        else:
            opcode, length = _RECORD.unpack_from(data, at)
            after = at + 9 + length
            if after > end:
                break
            _take_definition(contents, opcode, data[at + 9 : after])
        at = after
    return at


def _take_indexed(contents: _Contents, data: bytes, index: Mapping[int, list[bytes]]) -> bool:
    """Gather the records of a chunk at once by its message index; False, and nothing gathered, if it does not hold."""
    if not index or any(len(part) % 16 for parts in index.values() for part in parts):
        return False
    whole = np.frombuffer(data, np.uint8)
    head = _MESSAGE_HEAD.size
    found: list[tuple[int, NDArray[np.int64], NDArray[np.int64], NDArray[np.uint64]]] = []
    for channel, parts in index.items():
        offsets = np.sort(np.frombuffer(b"".join(parts), "<u8").reshape(-1, 2)[:, 1])
        if not len(offsets) or offsets[-1] > len(data) - head or (np.diff(offsets) < head).any():
            return False
        at = offsets.astype(np.int64)
        heads = np.ascontiguousarray(sliding_window_view(whole, head)[at]).view(_HEAD_ROWS)[:, 0]
        length = heads["length"]
        if (heads["opcode"] != _MESSAGE).any() or (heads["channel"] != channel).any() or (length > len(data)).any():
            return False
        if (length < head - _RECORD.size).any():
            return False
        found.append((channel, at, length.astype(np.int64) - (head - _RECORD.size), heads["time"]))
    begin = np.concatenate([at for _, at, _, _ in found])
    end = np.concatenate([at + head + size for _, at, size, _ in found])
    order = np.argsort(begin)
    begin, end = begin[order], np.concatenate([[0], end[order]])
    begin = np.concatenate([begin, [len(data)]])
    between = begin - end
    if (between < 0).any():
        return False
    # What lies between the messages are definitions, or messages that the index has not.
    for place in np.flatnonzero(between).tolist():
        part = data[end[place] : begin[place]]
        if _take_records(contents, part) < len(part):
            raise _Damaged(f"it ends after {int(end[place])} of {len(data)} bytes")
    for channel, at, size, times in found:
        for one in np.unique(size).tolist():
            rows = at[size == one] + head
            block = sliding_window_view(whole, one)[rows] if one else np.zeros((len(rows), 0), np.uint8)
            contents.blocks.setdefault(channel, []).append((block, times[size == one]))
    return True


@dataclass(frozen=True)
class _Chunk:
    first: int  # time of the first message [ns]
    last: int
    size: int  # uncompressed [byte]
    crc: int
    compression: str
    packed: bytes
    whole: bool  # False: cut off by the end of the file

    @staticmethod
    def parse(body: bytes, whole: bool) -> _Chunk:
        try:
            first, last, size, crc = struct.unpack_from("<QQQI", body)
            compression, at = _take_text(body, 28)
            (length,) = struct.unpack_from("<Q", body, at)
        except struct.error:
            raise _Damaged("the head of a chunk is cut off") from None
        packed = body[at + 8 : at + 8 + length]
        return _Chunk(first, last, size, crc, compression, packed, whole and len(packed) == length)

    def records(self) -> bytes:
        """Uncompressed records; of a chunk that is cut off, those before the cut."""
        bound = min(_LARGEST_CHUNK, max(_ORDINARY_CHUNK, _MOST_INFLATED * len(self.packed)))
        if self.size > bound:
            raise _Damaged(f"it is said to have {self.size} bytes, of {len(self.packed)} in the file")
        try:
            if self.compression == "":
                data = self.packed
            elif self.compression == "zstd":
                data = _zstd(self.packed, self.size)
            elif self.compression == "lz4":
                data = lz4.frame.LZ4FrameDecompressor().decompress(self.packed, max_length=self.size + 1)
            else:
                raise _Damaged(f"its compression {self.compression!r} is unknown (known: zstd, lz4)")
        except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
            raise _Damaged(f"it cannot be decompressed ({error})") from None
        if self.whole and len(data) != self.size:
            raise _Damaged(f"it has {len(data)} bytes instead of {self.size}")
        if self.whole and self.crc and zlib.crc32(data) != self.crc:
            raise _Damaged("its checksum is wrong")
        return data


def _zstd(packed: bytes, size: int) -> bytes:
    """What is packed, at most `size` + 1 bytes of it; of what is cut off, that before the cut."""
    unpack = zstandard.ZstdDecompressor(max_window_size=_LARGEST_WINDOW)
    if len(packed) >= 18 and zstandard.get_frame_parameters(packed).content_size == size:
        with suppress(zstandard.ZstdError):
            return unpack.decompress(packed)
    found = bytearray()
    with unpack.stream_reader(packed) as reader, suppress(zstandard.ZstdError):
        while len(found) <= size and (block := reader.read(min(size + 1 - len(found), 1 << 20))):
            found += block
    return bytes(found)


def _summary(contents: _Contents, data: bytes) -> list[int]:
    """Definitions from the end of a file, if that is intact; returns the positions of the chunks it names."""
    end = len(data) - _FOOTER_LENGTH
    if end < 0 or not data.endswith(_MAGIC) or data[end] != _FOOTER:
        return []
    (start,) = struct.unpack_from("<Q", data, end + _RECORD.size)
    chunks = []
    try:
        for opcode, body, _, _ in _records(data, start if start else end, end):
            if opcode == _CHUNK_INDEX:
                chunks.append(struct.unpack_from("<Q", body, 16)[0])
            else:
                _take_definition(contents, opcode, body)
    except (_Damaged, struct.error):
        contents.notes.append("the summary at the end of the file is damaged; the file was scanned from the front")
    return sorted(chunks)


def _records(data: bytes, at: int, end: int) -> Iterator[tuple[int, bytes, int, bool]]:
    """Opcode, body, position and wholeness of each record; only the last may be cut off."""
    while at < end:
        if at + _RECORD.size > end:
            raise _Damaged("a record is cut off")
        opcode, length = _RECORD.unpack_from(data, at)
        if opcode == 0 or 0x10 <= opcode < 0x80:
            raise _Damaged(f"{opcode:#04x} is no record of MCAP")
        body = at + _RECORD.size
        yield opcode, data[body : min(body + length, end)], at, body + length <= end
        at = body + length


@dataclass
class _Scan:
    """One pass through a file, from the front to its end."""

    path: Path
    data: bytes
    contents: _Contents
    at: int = len(_MAGIC)  # position of the record that is being read
    lost: int = 0
    start: int | None = None  # time of the first chunk [ns]
    broken: tuple[int, _Chunk, str] | None = None  # chunk that was left out: position, chunk, reason
    waiting: tuple[int, _Chunk] | None = None  # chunk whose message index is still to come, and its position
    chunks: tuple[int, ...] = ()  # positions of chunks that are known from the end of the file
    inflated: int = 0  # [byte]
    index: dict[int, list[bytes]] = field(default_factory=dict)  # of it: entries by channel
    indexed: int = 0  # messages in it, as its message index says

    def run(self, end: int) -> None:
        """Gather records up to the footer. Raises `_Damaged` at a record that cannot be passed."""
        try:
            for opcode, body, position, whole in _records(self.data, self.at, end):
                self.at = position
                following = bisect_right(self.chunks, position)
                if following < len(self.chunks) and self.chunks[following] < position + _RECORD.size + len(body):
                    self.settle()
                    raise _Damaged(f"its length reaches into the chunk at byte {self.chunks[following]}")
                if opcode == _MESSAGE_INDEX:
                    self.indexed += max(len(body) - 6, 0) // 16
                    if self.waiting is not None and len(body) > 6:
                        self.index.setdefault(int.from_bytes(body[:2], "little"), []).append(body[6:])
                    continue
                self.settle()
                if opcode == _FOOTER:
                    break
                if opcode == _CHUNK:
                    self.waiting, self.index, self.indexed = (self.at, _Chunk.parse(body, whole)), {}, 0
                elif not whole:
                    raise _Damaged("a record is cut off")
                elif opcode == _MESSAGE:
                    _take_records(self.contents, self.data[self.at : self.at + _RECORD.size + len(body)])
                else:
                    _take_definition(self.contents, opcode, body)
        finally:
            self.settle()

    def chunk(self, position: int, chunk: _Chunk) -> None:
        self.start = chunk.first if self.start is None else self.start
        try:
            self.inflated += min(chunk.size, _LARGEST_CHUNK)
            if self.inflated > max(_ORDINARY_BAG, _MOST_INFLATED * len(self.data)):
                raise _Damaged(f"the file unpacks to more than {_MOST_INFLATED} times its size, which no bag does")
            records = chunk.records()
            if chunk.whole and _take_indexed(self.contents, records, self.index):
                return
            done = _take_records(self.contents, records)
            if done < chunk.size:
                raise _Damaged(f"it ends after {done} of {chunk.size} bytes")
        except _Damaged as error:
            self.broken = (position, chunk, str(error))

    def settle(self) -> None:
        """Read the chunk that waits, now that its message index has been passed, and note what it cost if broken."""
        if self.waiting is not None:
            waiting, self.waiting = self.waiting, None
            self.chunk(*waiting)
        if self.broken is None:
            return
        position, chunk, reason = self.broken
        since = self.start or 0
        span = f"{(chunk.first - since) * 1e-9:.3f} to {(chunk.last - since) * 1e-9:.3f} s from the start"
        count = str(self.indexed) if self.indexed else "an unknown number of"
        self.contents.notes.append(
            f"{self.path.name}: chunk at byte {position} ({span}) is damaged: {reason}; {count} messages lost"
        )
        self.lost += self.indexed
        self.broken = None


def _scan(path: Path, contents: _Contents) -> None:
    """Gather all intact messages of one file."""
    data = path.read_bytes()
    if not data:
        raise InputError(f"{path}: the file is empty; expected an MCAP bag")
    if not data.startswith(_MAGIC):
        raise InputError(
            f"{path}: not an MCAP file: it begins with {data[:8].hex(' ')}, expected {_MAGIC.hex(' ')}. "
            "Give a bag folder or a .mcap file, or import other formats with 'vsense import'"
        )
    before, contents.expected = contents.count(), None
    chunk_positions = _summary(contents, data)
    finished = data.endswith(_MAGIC) and len(data) > _FOOTER_LENGTH
    scan = _Scan(path, data, contents, chunks=tuple(chunk_positions))
    while True:
        try:
            scan.run(len(data) - (len(_MAGIC) if finished else 0))
            break
        except _Damaged as error:
            following = [position for position in chunk_positions if position > scan.at]
            onward = f"reading went on at byte {following[0]}" if following else "nothing behind it could be read"
            contents.damage.append(f"{path.name}: damaged at byte {scan.at} of {len(data)}: {error}; {onward}")
            if not following:
                break
            scan.at = following[0]
    if not finished:
        contents.damage.append(f"{path.name}: the file is not finished (cut off at byte {len(data)})")
    got = contents.count() - before
    contents.lost += scan.lost if contents.expected is None else max(scan.lost, contents.expected - got)


def read_bag(path: str | Path) -> Recording:
    """Read a bag folder or a single `.mcap` file.

    All intact messages of the types in `messages.recording.FIELDS` are returned, topics without their leading slash;
    what was lost or skipped, and where, stands in `notes`, the known number of lost messages in `messages_lost`.

    Raises `InputError` if there is no such bag, if it is none, or if it holds no message.
    """
    return read_whole_bag(path).recording


@dataclass(frozen=True)
class RawChannel:
    """All messages of one topic of any type, as the bytes in the bag, in order of arrival."""

    times: NDArray[np.int64]  # (n,) of arrival [ns]
    payloads: list[bytes]


@dataclass(frozen=True)
class WholeBag:
    """All that a bag holds: what becomes numbers, the bytes of all else, and what it says of each topic."""

    recording: Recording
    others: Mapping[str, RawChannel]
    descriptions: Mapping[str, TopicDescription]


def read_whole_bag(path: str | Path) -> WholeBag:
    """A bag with the messages of types that have no numeric form, too. Raises as `read_bag`."""
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: neither a folder nor a regular file; expected a bag folder or a .mcap file")
    contents, merged = _gathered(path)
    others = {topic: entry for topic, entry in merged.items() if not contents.is_numeric(topic, entry[0])}
    notes = [
        *contents.notes,
        *contents.damage,
        *(f"{t}: {n} messages of type {k} skipped" for (t, k), n in contents.contradictions.items()),
        *(f"{t}: {len(payloads)} messages of type {k} skipped" for t, (k, payloads, _) in others.items()),
    ]
    # One after the other is taken out, so that only one is there twice.
    result, bad = channels_of(((topic, merged.pop(topic)) for topic in [*merged] if topic not in others), notes)
    give_back()
    stored = contents.custom.pop("notes", "")
    recording = Recording(
        result,
        path.stem if path.is_file() else path.resolve().name,
        (*stored.splitlines(), *notes),
        contents.lost + bad,
        contents.custom,
        tuple(contents.damage),
    )
    raw = {topic: _raw(payloads, times) for topic, (_, payloads, times) in others.items()}
    return WholeBag(recording, raw, contents.described)


def _raw(payloads: Payloads, times: Times) -> RawChannel:
    """Messages in order of arrival, without those whose time is impossible."""
    arrived = np.asarray(times, np.uint64).astype(np.int64)
    possible = np.flatnonzero((arrived >= 0) & (np.abs(arrived - np.median(arrived)) <= _DAY))
    order = possible[np.argsort(arrived[possible], kind="stable")]
    return RawChannel(arrived[order], [bytes(payloads[i]) for i in order.tolist()])


def _gathered(path: Path) -> tuple[_Contents, dict[str, tuple[str, Payloads, Times]]]:
    """All intact messages of a bag by topic: type, messages, times of arrival."""
    contents = _Contents()
    files, promised = _files(path, contents)
    merged: dict[str, tuple[str, Payloads, Times]] = {}
    read = 0
    for file in files:
        contents.forget()
        try:
            _scan(file, contents)
        except InputError as error:
            if len(files) == 1:
                raise
            contents.damage.append(f"left out: {error}")
            continue
        read += contents.count()
        for number in dict.fromkeys((*contents.payloads, *contents.blocks)):
            payloads, times = contents.take(number)
            if bytes(payloads[0][:4]) == _ZSTD:  # by rosbag2, each of them
                payloads = _unpacked(payloads)
            topic, kind, encoding = contents.channels.get(number, (f"(channel {number})", "(unknown type)", ""))
            if encoding != "cdr":
                contents.foreign.add(topic)
            if topic not in merged:
                merged[topic] = (kind, payloads, times)
            elif merged[topic][0] == kind:
                _, before, earlier = merged[topic]
                merged[topic] = (kind, _together(before, payloads), np.concatenate([earlier, times]))
            else:
                known = contents.contradictions
                known[topic, kind] = known.get((topic, kind), 0) + len(payloads)
    if promised is not None:
        contents.lost = max(contents.lost, promised - read)
    if not read:
        told = [*contents.notes, *contents.damage]
        reason = f" ({'; '.join(told)})" if told else ""
        raise InputError(f"{path}: the bag holds no intact message{reason}; record it again or choose another")
    return contents, merged


def _together(one: Payloads, other: Payloads) -> Payloads:
    """The messages of two files."""
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray) and one.shape[1] == other.shape[1]:
        return np.concatenate([one, other])
    return [*map(bytes, one), *map(bytes, other)]


def _unpacked(payloads: Payloads) -> list[bytes]:
    """Messages that rosbag2 has compressed one by one; empty, which is no message, where they are damaged."""
    found = []
    for payload in payloads:
        try:
            found.append(_zstd(bytes(payload), _LARGEST_MESSAGE))
        except zstandard.ZstdError:
            found.append(b"")
    return found


def channels_of(
    gathered: Iterable[tuple[str, tuple[str, Payloads, Times]]], notes: list[str]
) -> tuple[dict[str, Channel], int]:
    """Decode the messages of each topic: of its type, its messages, times. Returns the channels and the number of
    messages that are none."""
    result: dict[str, Channel] = {}
    lost = 0
    for topic, (kind, payloads, times) in gathered:
        received = np.array(times, np.uint64).astype(np.int64)  # from 2⁶³ on negative
        if (np.diff(received) < 0).any():
            order = np.argsort(received, kind="stable")
            received = received[order]
            payloads = payloads[order] if isinstance(payloads, np.ndarray) else [payloads[i] for i in order]
        decoded = cdr.decode_channel(kind, topic, payloads, received)
        if decoded.channel is not None:
            decoded = replace(decoded, channel=_possible_times(decoded.channel, notes))
        if decoded.channel is not None:
            result[topic] = decoded.channel
        if decoded.bad:
            notes.append(f"{topic}: {decoded.bad} messages are damaged and left out; the first: {decoded.first_error}")
            lost += decoded.bad
        for frame, count in decoded.foreign.items():
            notes.append(
                f"{topic}: {count} messages with frame id {frame!r} left out; the others have "
                f"{decoded.channel.frame_id if decoded.channel else ''!r}"
            )
    return result, lost


def _possible_times(channel: Channel, notes: list[str]) -> Channel:
    """The channel with each impossible time of arrival replaced by the time of measurement, and the other way round."""
    if len(channel) < 2:
        return channel
    stamp, received = channel.stamp.copy(), channel.received.copy()
    usual_stamp, usual = float(np.median(stamp)), float(np.median(received))
    strange = (received < 0) | (np.abs(received - usual) > _DAY)
    strange &= (np.abs(stamp - usual_stamp) <= _DAY) & (abs(usual_stamp - usual) <= _DAY)
    if strange.any():
        notes.append(
            f"{channel.topic}: {int(strange.sum())} messages with impossible arrival times; stamps used instead"
        )
        received[strange] = stamp[strange]
    unset = (stamp == 0) & (received > _DAY)
    if unset.any():
        notes.append(f"{channel.topic}: {int(unset.sum())} messages without a time stamp; arrival times used instead")
        stamp[unset] = received[unset]
    if not (strange.any() or unset.any()):
        return channel
    return replace(channel, stamp=stamp, received=received).in_order()


def _read(path: Path, largest: int) -> bytes:
    """The beginning of a regular file; nothing of what is none."""
    if not path.is_file():
        return b""
    with path.open("rb") as file:
        return file.read(largest)


def _files(path: Path, contents: _Contents) -> tuple[list[Path], int | None]:
    """The MCAP files of a bag in their order, and the number of messages that `metadata.yaml` promises."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; expected a bag folder or a .mcap file")
    if path.is_file():
        return [path], None
    found = [file for file in sorted(path.glob("*.mcap")) if file.is_file()]
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        if not found:
            raise InputError(f"{path}: no bag: the folder holds neither metadata.yaml nor a .mcap file")
        contents.notes.append("metadata.yaml is missing: the recording was not finished properly")
        return found, None
    document = _yaml(_read(metadata, _LARGEST_METADATA).decode("utf-8", errors="replace"))
    information = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    if not isinstance(information, dict):
        if not found:
            raise InputError(f"{metadata}: not the metadata of a bag: no rosbag2_bagfile_information in it")
        contents.notes.append("metadata.yaml is damaged; all .mcap files of the folder were read")
        return found, None
    storage = information.get("storage_identifier") or ("mcap" if found else "sqlite3")
    if storage != "mcap":
        raise InputError(
            f"{path}: its storage is {storage!r}, expected 'mcap'; convert it with 'ros2 bag convert' or record with "
            "'ros2 bag record --storage mcap'"
        )
    _take_information(contents, information)
    contents.informed = True
    named = information.get("relative_file_paths")
    names = [str(name) for name in named] if isinstance(named, list) else []
    files, missing = [], []
    for name in names[:_MOST_FILES]:
        file = path / name
        if not file.resolve().is_relative_to(path.resolve()):
            contents.notes.append(f"metadata.yaml names {name!r}, which is outside of the bag: left out")
        elif not file.exists():
            missing.append(file.name)
        elif file.is_file():
            files.append(file)
        else:
            contents.notes.append(f"metadata.yaml names {name!r}, which is no regular file: left out")
    if missing:
        contents.notes.append(f"files that metadata.yaml names are missing: {', '.join(missing)}")
    present = files or found
    if not present:
        raise InputError(f"{path}: none of its files is there ({', '.join(missing) or 'metadata.yaml names none'})")
    promised = information.get("message_count")
    return present, promised if isinstance(promised, int) else None
