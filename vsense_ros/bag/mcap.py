"""One MCAP file: the messages of each channel as rows of bytes, and all that is intact of a damaged file.

The records of the format are those of the `mcap` library (https://mcap.dev/spec). Its readers make one Python object of
each message, trust what a file says about its sizes, and stop at the first damage. Here the messages of a chunk are
gathered by a few numpy operations, and nothing is unpacked beyond `ReadingLimits`. A chunk whose checksum or
compression is broken is left out and counted by its message index; one that the end of the file cuts off is read up to
the cut.
"""

from __future__ import annotations

import mmap
import struct
import sys
import zlib
from bisect import bisect_right
from collections.abc import Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC as MAGIC
from numpy.typing import NDArray

from vsense_ros.errors import InputError

Payloads = list[bytes] | NDArray[np.uint8]  # messages, as rows of bytes where all have one length
Times = NDArray[np.uint64]  # of arrival [ns]

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length
MESSAGE_HEAD = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("time", "<u8"), ("publish", "<u8")]
)
_MESSAGE_FIELDS = MESSAGE_HEAD.itemsize - RECORD_HEAD.size  # bytes of a message record that are not its data
_FOOTER_SIZE = RECORD_HEAD.size + 20
_DEFINITIONS = {
    Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel, Opcode.STATISTICS: Statistics, Opcode.METADATA: Metadata,
}  # fmt: skip
_INDEX_ENTRY = 16  # bytes: time and offset of a message


@dataclass(frozen=True)
class ReadingLimits:
    """Bounds on what a damaged or hostile file can make its reader allocate.

    A recording compresses to a tenth of its size at best; zeros compress a thousandfold.
    """

    chunk: int = 1 << 28  # [byte] of one chunk, uncompressed
    ordinary_chunk: int = 1 << 26  # [byte] that any chunk may have, however small it is in the file
    ordinary_file: int = 1 << 30  # [byte] that the chunks of any file may have together
    inflation: int = 100  # times its size in the file that a larger chunk, or file, may have
    window: int = 1 << 27  # [byte] that a zstd decompressor may look back


LIMITS = ReadingLimits()


class Damaged(Exception):
    """A record is not what the format says."""


@dataclass(frozen=True)
class Rows:
    """Messages of one length in which most bytes stay, as covariances and names do: `first` (m,) is the first of them,
    `spans` are where others differ from it, from a byte up to another, and `values` (n, k) is what stands in all of
    these. A recording of an hour takes a sixth of the memory so."""

    first: NDArray[np.uint8]
    spans: tuple[tuple[int, int], ...]
    values: NDArray[np.uint8]

    @classmethod
    def of(cls, rows: NDArray[np.uint8]) -> Rows:
        """Messages given as rows of bytes (n, m). Spans that are less than a number apart are one: many short ones take
        longer to copy."""
        places = np.flatnonzero(np.bitwise_or.reduce(rows ^ rows[0], axis=0))
        runs = np.split(places, np.flatnonzero(np.diff(places) > 8) + 1)
        spans = tuple((int(run[0]), int(run[-1]) + 1) for run in runs if len(run))
        values = [rows[:, begin:end] for begin, end in spans] or [rows[:, :0]]
        return cls(rows[0].copy(), spans, np.concatenate(values, axis=1))

    def __len__(self) -> int:
        return len(self.values)

    def write(self, target: NDArray[np.uint8]) -> None:
        """Write the messages to rows of bytes (n, m)."""
        written = taken = 0
        for begin, end in self.spans:
            target[:, written:begin] = self.first[written:begin]
            target[:, begin:end] = self.values[:, taken : taken + end - begin]
            written, taken = end, taken + end - begin
        target[:, written:] = self.first[written:]

    def as_list(self) -> list[bytes]:
        """The messages one by one."""
        rows = np.empty((len(self), len(self.first)), np.uint8)
        self.write(rows)
        return [row.tobytes() for row in rows]


Pieces = list[tuple[list[bytes] | Rows, Times]]  # messages of one channel with their times, by chunk


@dataclass
class McapFile:
    """What is intact in one MCAP file."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    messages: dict[int, Pieces] = field(default_factory=dict)  # by channel
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)  # by name
    expected: int | None = None  # number of messages that the file says it holds
    lost: int = 0  # number of messages known to be lost
    notes: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Number of intact messages."""
        return sum(len(times) for pieces in self.messages.values() for _, times in pieces)


def read_file(path: Path) -> McapFile:
    """Read all that is intact in one MCAP file. Raises `InputError` for a file that is none."""
    data = path.read_bytes()
    _expect_mcap(path, data[:8])
    return _Scan(path.name, data).run()


def read_pieces(path: Path, size: int) -> Iterator[McapFile]:
    """What `read_file` gives in pieces of about `size` bytes of messages. Raises `InputError` as that does."""
    with path.open("rb") as file:
        _expect_mcap(path, file.read(8))
        yield from _Scan(path.name, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)).pieces(size)


def _expect_mcap(path: Path, head: bytes) -> None:
    if not head:
        raise InputError(f"{path}: the file is empty; expected an MCAP bag")
    if head != MAGIC:
        raise InputError(
            f"{path}: not an MCAP file: it begins with {head.hex(' ')}, expected {MAGIC.hex(' ')}. "
            "Give a bag folder or a .mcap file, or import other formats with 'vsense import'"
        )


def read_part(path: Path, most: int) -> McapFile | None:
    """Read chunks that lie evenly over one MCAP file, and unpack to about `most` bytes together.

    None if that would be the whole file, or if the file has no index of its chunks.
    """
    with path.open("rb") as file:
        size = path.stat().st_size
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size > _FOOTER_SIZE + 2 * len(MAGIC) else b""
        footer = size - len(MAGIC) - _FOOTER_SIZE
        if data[:8] != MAGIC or data[-8:] != MAGIC or data[footer] != Opcode.FOOTER:
            return None
        (start,) = struct.unpack_from("<Q", data, footer + RECORD_HEAD.size)
        definitions, chunks = [], []
        try:
            for opcode, body, at, _ in _records(data, start or footer, footer):
                if opcode == Opcode.CHUNK_INDEX:
                    chunks.append(_parsed(ChunkIndex, body))
                elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                    definitions.append(data[at : at + RECORD_HEAD.size + len(body)])
        except Damaged:
            return None
        every = sum(chunk.uncompressed_size for chunk in chunks) // most
        if every < 2:
            return None
        begins = ((one.chunk_start_offset, one.chunk_length + one.message_index_length) for one in chunks[::every])
        return _Scan(path.name, b"".join([MAGIC, *definitions, *(data[a : a + length] for a, length in begins)])).run()


class _Scan:
    """A pass through a file from the front, which goes on at the next known chunk where a record has no end."""

    def __init__(self, name: str, data: bytes | mmap.mmap) -> None:
        self.name, self.data = name, data
        self.file = McapFile()
        self.known_chunks: list[int] = []  # positions according to the summary
        self.pending: tuple[int, Chunk, bool] | None = None  # chunk whose message index follows: position, chunk, whole
        self.index: list[bytes] = []  # entries of that index
        self.unchunked: list[int] = []  # positions of messages outside of chunks
        self.inflated = 0  # [byte]
        self.gathered = 0  # [byte] of messages since the last piece
        self.before = 0  # messages of all pieces so far, and those that are lost
        self.start: int | None = None  # time of the first chunk [ns]

    def run(self) -> McapFile:
        """Gather what is intact."""
        (file,) = self.pieces(sys.maxsize)
        return file

    def pieces(self, most: int) -> Iterator[McapFile]:
        """Gather what is intact, in pieces of about `most` bytes; the last one knows what is lost."""
        size, file = len(self.data), self.file
        finished = self.data[-len(MAGIC) :] == MAGIC and size > _FOOTER_SIZE + len(MAGIC)
        end = size - len(MAGIC) if finished else size
        if finished:
            self._read_summary(end - _FOOTER_SIZE)
        at: int | None = len(MAGIC)
        while at is not None:
            at = yield from self._read_records(at, end, most)
        if not finished:
            file.damage.append(f"{self.name}: the file is not finished (cut off at byte {size})")
        last = self._so_far()
        if file.expected is not None:
            last.lost += max(file.expected - self.before, 0)
        yield last

    def _so_far(self) -> McapFile:
        """What has been gathered since the last piece, with all definitions."""
        if self.unchunked:
            self._gather(self.data, np.array(self.unchunked))
        file = self.file
        file_so_far = replace(file)
        self.before += file.count + file.lost
        file.messages, file.notes, file.damage, file.lost = {}, [], [], 0
        self.unchunked, self.gathered = [], 0
        if isinstance(self.data, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
            self.data.madvise(mmap.MADV_DONTNEED)  # what has been read need not stay in memory
        return file_so_far

    def _read_summary(self, footer: int) -> None:
        """Read the definitions and the positions of the chunks at the end of a finished file."""
        if self.data[footer] != Opcode.FOOTER:
            return
        (start,) = struct.unpack_from("<Q", self.data, footer + RECORD_HEAD.size)
        try:
            for opcode, body, _, _ in _records(self.data, start or footer, footer):
                if opcode == Opcode.CHUNK_INDEX:
                    self.known_chunks.append(_parsed(ChunkIndex, body).chunk_start_offset)
                else:
                    self._define(opcode, body)
        except Damaged:
            self.file.notes.append("the summary at the end of the file is damaged; the file was scanned from the front")
        self.known_chunks.sort()

    def _read_records(self, at: int, end: int, most: int) -> Generator[McapFile, None, int | None]:
        """Gather records up to the footer, or to one whose end is unknown; returns where to go on after the latter."""
        try:
            for opcode, body, position, whole in _records(self.data, at, end):
                at = position
                after = at + RECORD_HEAD.size + len(body)
                following = self._chunk_after(at)
                if following is not None and following < after:
                    raise Damaged(f"its length reaches into the chunk at byte {following}")
                if opcode == Opcode.FOOTER:
                    break
                self._take(opcode, body, at, whole)
                at = after
                if self.gathered >= most:
                    yield self._so_far()
        except Damaged as error:
            following = self._chunk_after(at)
            onward = f"reading went on at byte {following}" if following else "nothing behind it could be read"
            self._finish_chunk()
            self.file.damage.append(f"{self.name}: damaged at byte {at} of {len(self.data)}: {error}; {onward}")
            return following
        self._finish_chunk()
        return None

    def _chunk_after(self, position: int) -> int | None:
        following = bisect_right(self.known_chunks, position)
        return self.known_chunks[following] if following < len(self.known_chunks) else None

    def _take(self, opcode: int, body: bytes, position: int, whole: bool) -> None:
        """Take one record. Raises `Damaged` for one that is cut off."""
        if opcode == Opcode.MESSAGE_INDEX:
            self.index.append(body[6 : 6 + (len(body) - 6) // _INDEX_ENTRY * _INDEX_ENTRY])
            return
        self._finish_chunk()
        if not whole and opcode != Opcode.CHUNK:
            raise Damaged("a record is cut off")
        if opcode == Opcode.CHUNK:
            self.pending, self.index = (position, _parsed(Chunk, body), whole), []
        elif opcode != Opcode.MESSAGE:
            self._define(opcode, body)
        elif len(body) >= _MESSAGE_FIELDS:
            self.unchunked.append(position)
            self.gathered += len(body)

    def _define(self, opcode: int, body: bytes) -> None:
        """Keep a schema, a channel, the number of messages, or metadata; one that cannot be read is noted."""
        try:
            record = _parsed(_DEFINITIONS[Opcode(opcode)], body) if opcode in _DEFINITIONS else None
        except Damaged as error:
            note = f"{self.name}: {error}; it is left out"
            if note not in self.file.damage[-1:]:
                self.file.damage.append(note)
            return
        if isinstance(record, Schema):
            self.file.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.file.channels[record.id] = record
        elif isinstance(record, Statistics):
            self.file.expected = record.message_count
        elif isinstance(record, Metadata):
            self.file.metadata[record.name] = record.metadata

    def _finish_chunk(self) -> None:
        """Gather the messages of the chunk whose message index has been passed; if broken, note what that costs."""
        if self.pending is None:
            return
        (position, chunk, whole), self.pending = self.pending, None
        index = b"".join(self.index)
        if self.start is None:
            self.start = chunk.message_start_time
        try:
            self.inflated += min(chunk.uncompressed_size, LIMITS.chunk)
            if self.inflated > max(LIMITS.ordinary_file, LIMITS.inflation * len(self.data)):
                raise Damaged(f"the file unpacks to more than {LIMITS.inflation} times its size, which no bag does")
            records = _unpacked(chunk, whole)
            positions, done = self._message_positions(records, index)
            self._gather(records, positions)
            self.gathered += len(records)
            if done < chunk.uncompressed_size:
                raise Damaged(f"it ends after {done} of {chunk.uncompressed_size} bytes")
        except Damaged as error:
            lost = len(index) // _INDEX_ENTRY
            times = (chunk.message_start_time - self.start, chunk.message_end_time - self.start)
            span = f"{times[0] * 1e-9:.3f} to {times[1] * 1e-9:.3f} s from the start"
            count = str(lost) if lost else "an unknown number of"
            self.file.notes.append(
                f"{self.name}: chunk at byte {position} ({span}) is damaged: {error}; {count} messages lost"
            )
            self.file.lost += lost

    def _message_positions(self, records: bytes, index: bytes) -> tuple[NDArray[np.int64], int]:
        """Positions of the messages in the records of a chunk, and of the end of the last whole record.

        Where the index holds, it gives the messages, and only what lies between them is searched.
        """
        indexed = _ascending(np.frombuffer(index, "<u8")[1::2])
        ends = _ends(records, indexed)
        if ends is None:
            return self._walk(records, 0, len(records))
        begins = np.concatenate([indexed.astype(np.int64), [len(records)]])
        ends = np.concatenate([[0], ends])
        positions = [begins[:-1]]
        done = int(ends[-1])
        for gap in np.flatnonzero(begins > ends).tolist():
            others, done_here = self._walk(records, int(ends[gap]), int(begins[gap]))
            if gap == len(indexed):
                done = done_here
            elif done_here < begins[gap]:
                return self._walk(records, 0, len(records))
            positions.append(others)
        return np.sort(np.concatenate(positions)), done

    def _walk(self, records: bytes, at: int, end: int) -> tuple[NDArray[np.int64], int]:
        """Find messages by the lengths of the records, one after the other, and keep the definitions between them."""
        positions = []
        while at + RECORD_HEAD.size <= end:
            opcode, length = RECORD_HEAD.unpack_from(records, at)
            after = at + RECORD_HEAD.size + length
            if after > end or (opcode == Opcode.MESSAGE and length < _MESSAGE_FIELDS):
                break
            if opcode == Opcode.MESSAGE:
                positions.append(at)
            else:
                self._define(opcode, records[at + RECORD_HEAD.size : after])
            at = after
        return np.array(positions, np.int64), at

    def _gather(self, records: bytes | mmap.mmap, positions: NDArray[np.int64]) -> None:
        """Keep the messages at these positions, by channel."""
        heads = _heads(records, positions)
        for channel in _ascending(heads["channel"]).tolist():
            rows = np.flatnonzero(heads["channel"] == channel)
            begins = positions[rows] + MESSAGE_HEAD.itemsize
            sizes = heads["length"][rows].astype(np.int64) - _MESSAGE_FIELDS
            size = int(sizes[0])
            payloads: list[bytes] | Rows
            if (sizes != size).any():
                payloads = [
                    records[begin : begin + n] for begin, n in zip(begins.tolist(), sizes.tolist(), strict=True)
                ]
            elif size:
                payloads = Rows.of(_at(records, begins, np.dtype(f"V{size}")).view(np.uint8).reshape(-1, size))
            else:
                payloads = Rows.of(np.zeros((len(rows), 0), np.uint8))
            self.file.messages.setdefault(channel, []).append((payloads, heads["time"][rows]))


def _heads(records: bytes | mmap.mmap, positions: NDArray[np.int64]) -> NDArray[np.void]:
    """The fixed fields of the messages at these positions."""
    return _at(records, positions, MESSAGE_HEAD) if len(positions) else np.zeros(0, MESSAGE_HEAD)


def _at(data: bytes | mmap.mmap, positions: NDArray[np.int64], kind: np.dtype[np.void]) -> NDArray[np.void]:
    """Copies of what stands at these positions of some bytes."""
    everywhere = np.ndarray(len(data) - kind.itemsize + 1, kind, data, strides=(1,))  # from each byte on, overlapping
    return np.asarray(everywhere[positions])


def _ascending(numbers: NDArray[Any]) -> NDArray[Any]:
    """The numbers in ascending order, each once: mostly they are so already, or are all the same."""
    if len(numbers) and (numbers == numbers[0]).all():
        return numbers[:1]
    return numbers if (numbers[1:] > numbers[:-1]).all() else np.unique(numbers)


def _ends(records: bytes, positions: NDArray[np.uint64]) -> NDArray[np.int64] | None:
    """The ends of the messages at these ascending positions; None if there are no such messages one after another."""
    if not len(positions) or positions[-1] > max(len(records) - MESSAGE_HEAD.itemsize, 0):
        return None
    begins = positions.astype(np.int64)
    heads = _heads(records, begins)
    lengths = heads["length"]
    if (heads["opcode"] != Opcode.MESSAGE).any() or (lengths < _MESSAGE_FIELDS).any() or (lengths > len(records)).any():
        return None
    ends = begins + RECORD_HEAD.size + lengths.astype(np.int64)
    return ends if (ends[:-1] <= begins[1:]).all() and ends[-1] <= len(records) else None


def _records(data: bytes | mmap.mmap, at: int, end: int) -> Iterator[tuple[int, bytes, int, bool]]:
    """Opcode, body, position and wholeness of each record; only the last may be cut off."""
    while at < end:
        if at + RECORD_HEAD.size > end:
            raise Damaged("a record is cut off")
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        if opcode == 0 or Opcode.DATA_END < opcode < 0x80:
            raise Damaged(f"{opcode:#04x} is no record of MCAP")
        body = at + RECORD_HEAD.size
        yield opcode, data[body : min(body + length, end)], at, body + length <= end
        at = body + length


class _Bytes(ReadDataStream):
    """Bytes of a record, whose texts are read even where single characters are damaged."""

    def __init__(self, body: bytes) -> None:
        super().__init__(BytesIO(body))

    def read_prefixed_string(self) -> str:
        return self.read(self.read4()).decode(errors="replace")


def _parsed(kind: Any, body: bytes) -> Any:
    """A record of the library. Raises `Damaged` where the bytes are no such record."""
    try:
        return kind.read(_Bytes(body))
    except (struct.error, EndOfFile, UnicodeDecodeError, OverflowError) as error:
        raise Damaged(f"a record {kind.__name__} cannot be read ({str(error) or 'it is cut off'})") from None


def _unpacked(chunk: Chunk, whole: bool) -> bytes:
    """The records of a chunk; of one that is cut off, those before the cut. Raises `Damaged`."""
    size, packed = chunk.uncompressed_size, chunk.data
    if size > min(LIMITS.chunk, max(LIMITS.ordinary_chunk, LIMITS.inflation * len(packed))):
        raise Damaged(f"it is said to have {size} bytes, of {len(packed)} in the file")
    try:
        if chunk.compression == "":
            data = packed
        elif chunk.compression == "zstd":
            data = unpacked_zstd(packed, size)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        else:
            raise Damaged(f"its compression {chunk.compression!r} is unknown (known: zstd, lz4)")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        raise Damaged(f"it cannot be decompressed ({error})") from None
    if whole and len(data) != size:
        raise Damaged(f"it has {len(data)} bytes instead of {size}")
    if whole and chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise Damaged("its checksum is wrong")
    return data


def unpacked_zstd(packed: bytes, size: int) -> bytes:
    """What zstd has packed, at most `size` + 1 bytes of it; of what is cut off, the part before the cut."""
    unpack = zstandard.ZstdDecompressor(max_window_size=LIMITS.window)
    if len(packed) >= 18 and zstandard.get_frame_parameters(packed).content_size == size:
        with suppress(zstandard.ZstdError):
            return unpack.decompress(packed)
    data = bytearray()
    with unpack.stream_reader(packed) as reader, suppress(zstandard.ZstdError):
        while len(data) <= size and (block := reader.read(min(size + 1 - len(data), 1 << 20))):
            data += block
    return bytes(data)
