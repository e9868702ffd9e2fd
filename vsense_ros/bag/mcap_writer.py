"""Writes one MCAP file as rosbag2 does: profile `ros2`, CDR messages, `ros2msg` schemas, chunked, indexed.

The records are those of the `mcap` library (https://mcap.dev/spec), but for messages and their index: its writer
spends four times as long on each of them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC as MAGIC

from vsense_ros.bag.metadata import FileSummary, TopicDescription, absolute

CHUNK_SIZE = 256 * 1024  # [byte] before compression: what one damaged spot can cost at most

COMPRESSORS: Mapping[str, Callable[[bytes], bytes]] = {
    "": lambda data: data,
    "lz4": lambda data: lz4.frame.compress(data, store_size=True),
    "zstd": lambda data: zstandard.ZstdCompressor(level=3, write_checksum=False).compress(data),
}
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_INDEX_HEAD = struct.Struct("<BQHI")  # opcode, length, channel, bytes of its entries
_MESSAGE = int(Opcode.MESSAGE)


def _bytes_of(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


class McapWriter:
    """Writes one MCAP file, from its head to its summary; each chunk is in the file as soon as it is full."""

    def __init__(self, path: Path, compression: str) -> None:
        self.path = path
        self.begun = False  # True once a message has been written
        self.first, self.last = 2**63 - 1, 0  # times of its messages [ns]
        self._compression = compression
        self._file: BinaryIO = path.open("wb")
        self._at = 0
        self._schemas: dict[str, Schema] = {}  # by type
        self._channels: dict[str, Channel] = {}  # by topic
        self._counts: dict[int, int] = {}  # by number of the channel
        self._chunk = bytearray()
        self._index: dict[int, list[tuple[int, int]]] = {}  # time and offset of the messages of the chunk, by channel
        self._chunk_indexes = bytearray()  # their records: as objects, those of an hour at 250 Hz would be 50 MB
        self._chunks = 0
        self._put(MAGIC + _bytes_of(Header("ros2", "vsense_ros")))

    @property
    def size(self) -> int:
        """Bytes so far, those of the pending chunk before compression."""
        return self._at + len(self._chunk)

    def summary(self) -> FileSummary:
        """What `metadata.yaml` says of this file."""
        counts = {topic: self._counts[channel.id] for topic, channel in self._channels.items()}
        first, last = (self.first, self.last) if self.begun else (0, 0)
        return FileSummary(self.path.name, first, last, counts)

    def _put(self, data: bytes) -> None:
        self._file.write(data)
        self._at += len(data)

    def write(self, topic: str, description: TopicDescription, log_time: int, data: bytes) -> None:
        """Write one message; `log_time` [ns]."""
        channel = (self._channels.get(topic) or self._add(topic, description)).id
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

    def _add(self, topic: str, description: TopicDescription) -> Channel:
        """Define the channel of a topic, and the schema of its type."""
        kind = description.kind
        if kind not in self._schemas:
            encoding = "ros2msg" if description.schema else ""
            schema = Schema(len(self._schemas) + 1, description.schema.encode(), encoding, kind)
            self._schemas[kind] = schema
            self._chunk += _bytes_of(schema)
        metadata = {"offered_qos_profiles": description.qos, "topic_type_hash": description.type_hash}
        number = len(self._channels) + 1
        channel = Channel(number, absolute(topic), "cdr", metadata, self._schemas[kind].id)
        self._channels[topic] = channel
        self._counts[channel.id] = 0
        self._chunk += _bytes_of(channel)
        return channel

    def flush(self) -> None:
        """Write the pending messages as one chunk with its message index."""
        if not self._chunk:
            return
        raw = bytes(self._chunk)
        packed = COMPRESSORS[self._compression](raw)
        indexes = {channel: np.array(sorted(entries), "<u8") for channel, entries in sorted(self._index.items())}
        first = min((int(entries[0, 0]) for entries in indexes.values()), default=0)
        last = max((int(entries[-1, 0]) for entries in indexes.values()), default=0)
        start = self._at
        self._put(_bytes_of(Chunk(self._compression, packed, last, first, zlib.crc32(raw), len(raw))))
        length = self._at - start
        offsets = {}
        for channel, entries in indexes.items():
            offsets[channel] = self._at
            head = _MESSAGE_INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + entries.nbytes, channel, entries.nbytes)
            self._put(head + entries.tobytes())
        index_length = self._at - start - length
        self._chunk_indexes += _bytes_of(
            ChunkIndex(length, start, self._compression, len(packed), last, index_length, offsets, first, len(raw))
        )
        self._chunks += 1
        self._file.flush()
        self._chunk.clear()
        self._index.clear()

    def finish(self, metadata: str) -> None:
        """End the file with the text of `metadata.yaml` so far, and the summary by which readers find chunks."""
        self.flush()
        metadata_at = self._at
        inside = {"serialized_metadata": "".join(line[2:] for line in metadata.splitlines(True)[1:])}
        self._put(_bytes_of(Metadata("rosbag2", inside)))
        metadata_index = MetadataIndex(metadata_at, self._at - metadata_at, "rosbag2")
        self._put(_bytes_of(DataEnd(0)))
        self._put_summary(metadata_index)
        self._file.close()

    def _put_summary(self, metadata_index: MetadataIndex) -> None:
        first, last = (self.first, self.last) if self.begun else (0, 0)
        statistics = Statistics(
            attachment_count=0,
            channel_count=len(self._channels),
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            message_end_time=last,
            message_start_time=first,
            metadata_count=1,
            schema_count=len(self._schemas),
        )
        groups = {
            Opcode.SCHEMA: _bytes_of(*self._schemas.values()),
            Opcode.CHANNEL: _bytes_of(*self._channels.values()),
            Opcode.CHUNK_INDEX: bytes(self._chunk_indexes),
            Opcode.METADATA_INDEX: _bytes_of(metadata_index),
            Opcode.STATISTICS: _bytes_of(statistics),
        }
        start, summary, offsets = self._at, b"", b""
        for opcode, group in groups.items():
            if group:
                offsets += _bytes_of(SummaryOffset(opcode, start + len(summary), len(group)))
                summary += group
        footer = _bytes_of(Footer(start, start + len(summary), 0))[:-4]
        checksum = struct.pack("<I", zlib.crc32(summary + offsets + footer))
        self._put(summary + offsets + footer + checksum + MAGIC)

    def abandon(self) -> None:
        """Close the file without an end."""
        with suppress(OSError):
            self._file.close()
