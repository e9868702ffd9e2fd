"""ROS 2 bags in SQLite (`.db3`), and bags whose files or messages rosbag2 has compressed with zstd."""

from __future__ import annotations

import sqlite3
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import zstandard

from vsense_ros.bag import decoding
from vsense_ros.bag.decoding import TopicMessages, channels_of
from vsense_ros.bag.importers.topic_mapping import mapped, mapped_pieces
from vsense_ros.bag.reading import read_bag
from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text
from vsense_ros.messages.foreign import READABLE
from vsense_ros.messages.recording import Recording

NAME = "rosbag2"
DESCRIPTION = "ROS 2 bag in SQLite, or compressed by rosbag2 (.db3, .db3.zstd, .mcap.zstd)"
FIRST = True  # a folder with such files is no bag in MCAP

_ENDINGS = (".db3", ".db3.zstd", ".mcap.zstd")
_SQLITE = b"SQLite format 3\0"
_ZSTD = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class RosbagLimits:
    """Bounds on what a compressed bag may unpack to: decisions of this project."""

    inflation: int = 32  # [-] times its size that a compressed file may hold
    ordinary: int = 1 << 28  # [byte] that any file may hold


LIMITS = RosbagLimits()


def matches(path: Path) -> bool:
    """True if `path` is a file of SQLite, or a folder with such bags or compressed ones."""
    if path.is_file():
        if path.name.endswith(_ENDINGS):
            return True
        with path.open("rb") as file:
            return file.read(16) == _SQLITE
    return bool(_parts(path)) and not any(path.glob("*.mcap"))


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """All messages of types that become numbers (`messages.foreign.READABLE`), topics without their leading slash;
    `mapping` says which topics are those of this project (see `topic_mapping`)."""
    return mapped(whole(path), mapping)


def pieces(path: Path, size: int, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Iterator[Recording]:
    """What `read` gives, in pieces of about `size` bytes of messages; a file that is compressed is one piece."""
    yield from mapped_pieces(_pieces(path, size), mapping)


@dataclass
class _Gathered:
    """Messages of files of SQLite: those that become numbers or are of a `further` type, and the number of others."""

    further: str = ""
    topics: dict[str, TopicMessages] = field(default_factory=dict)
    skipped: dict[tuple[str, str], int] = field(default_factory=dict)  # by topic and type
    size: int = 0  # [byte]

    def add(self, topic: str, kind: str, data: bytes, time: int) -> None:
        """Take one message."""
        messages = self.topics.setdefault(topic, TopicMessages(kind))
        if messages.kind != kind:
            self.skip(topic, kind)
            return
        messages.append(data, time)
        self.size += len(data)

    def skip(self, topic: str, kind: str) -> None:
        """Count one message that is not read."""
        self.skipped[topic, kind] = self.skipped.get((topic, kind), 0) + 1

    def recording(self, path: Path, notes: list[str], damage: list[str]) -> Recording:
        """What has been gathered, as numbers."""
        notes = [*notes, *(decoding.skipped(topic, kind, count) for (topic, kind), count in self.skipped.items())]
        channels, bad = channels_of(self.topics.items(), notes)
        name = path.name.partition(".")[0] if path.is_file() else path.resolve().name
        return Recording(channels, name, (*notes, *damage), bad, {}, tuple(damage))


def whole(path: Path, raw: dict[str, TopicMessages] | None = None, kind: str = "") -> Recording:
    """All topics under their own names. Messages of a `kind` that does not become numbers are put into `raw`, as
    bytes."""
    notes: list[str] = []
    damage: list[str] = []
    gathered = _Gathered(kind)
    others = list(_rest(path, sys.maxsize, gathered, notes, damage))
    for topic in [topic for topic, messages in gathered.topics.items() if messages.kind == kind]:
        (raw if raw is not None else {})[topic] = gathered.topics.pop(topic)
    if not gathered.topics and not others and not gathered.skipped and not raw:
        raise _no_message(path, damage)
    recording = gathered.recording(path, notes, damage)
    return _joined([recording, *others] if recording.channels else others, path, notes, damage) if others else recording


def _pieces(path: Path, size: int) -> Iterator[Recording]:
    """All topics under their own names, in pieces."""
    notes: list[str] = []
    damage: list[str] = []
    gathered = _Gathered()
    any_messages = False
    for piece in _rest(path, size, gathered, notes, damage):
        any_messages |= bool(piece.channels)
        yield piece
    if not any_messages and not gathered.topics and not gathered.skipped:
        raise _no_message(path, damage)
    yield gathered.recording(path, notes, damage)


def _rest(path: Path, size: int, gathered: _Gathered, notes: list[str], damage: list[str]) -> Iterator[Recording]:
    """Gather the messages of a bag. Yields what is more than `size` bytes of them, and what is compressed as a whole;
    the rest stays in `gathered`."""
    parts = [path] if path.is_file() else _parts(path)
    per_message = path.is_dir() and _mode(path, notes) == "message"
    for part in parts:
        try:
            if part.name.endswith(".mcap.zstd"):
                yield _compressed_mcap(part)
                continue
            for _ in _take(part, per_message, gathered, damage):
                if gathered.size >= size:
                    yield gathered.recording(path, [], [])
                    gathered.topics, gathered.skipped, gathered.size = {}, {}, 0
        except InputError as error:
            if len(parts) == 1:
                raise
            damage.append(f"left out: {error}")


def _no_message(path: Path, damage: list[str]) -> InputError:
    return InputError(f"{path}: the bag holds no intact message" + (f" ({'; '.join(damage)})" if damage else ""))


def _parts(path: Path) -> list[Path]:
    """The files of a bag in the order in which they were written."""
    files = [f for f in path.iterdir() if f.is_file() and f.name.endswith(_ENDINGS)]

    def number(file: Path) -> tuple[int, str]:
        digits = file.name.partition(".")[0].rpartition("_")[2]
        return (int(digits) if digits.isdigit() and len(digits) < 10 else 0, file.name)

    return sorted(files, key=number)


def _mode(path: Path, notes: list[str]) -> str:
    """How rosbag2 has compressed the bag, as its metadata says."""
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        notes.append("metadata.yaml is missing: the recording was not finished properly")
        return ""
    try:
        document = yaml_text.load_file(metadata)
    except InputError:
        notes.append("metadata.yaml is damaged")
        return ""
    information: Any = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    return str(information.get("compression_mode") or "").lower() if isinstance(information, dict) else ""


def _unpacked(file: Path) -> bytes:
    """What a compressed file holds, up to a bound; of one that is cut off, what comes before the cut."""
    bound = max(LIMITS.inflation * file.stat().st_size, LIMITS.ordinary)
    content = bytearray()
    with file.open("rb") as packed:
        reader = zstandard.ZstdDecompressor().stream_reader(packed)
        try:
            while block := reader.read(1 << 20):
                content += block
                if len(content) > bound:
                    raise InputError(f"{file}: unpacks to more than {bound} bytes, which no bag of its size does")
        except zstandard.ZstdError as error:
            if not content:
                raise InputError(f"{file}: cannot be unpacked: {error}") from None
    return bytes(content)


def _compressed_mcap(part: Path) -> Recording:
    with TemporaryDirectory(prefix="vsense_") as folder:
        plain = Path(folder) / part.name.removesuffix(".zstd")
        plain.write_bytes(_unpacked(part))
        return read_bag(plain)


def _joined(parts: list[Recording], path: Path, notes: list[str], damage: list[str]) -> Recording:
    """One recording of the files of a split bag."""
    from vsense_ros.bag.join import concatenated

    whole = concatenated(parts)
    every = tuple(dict.fromkeys((*notes, *(note for part in parts for note in part.notes), *damage)))
    hurt = tuple(dict.fromkeys((*damage, *(text for part in parts for text in part.damage))))
    return Recording(whole, path.resolve().name, every, sum(part.messages_lost for part in parts), {}, hurt)


def _take(part: Path, per_message: bool, gathered: _Gathered, damage: list[str]) -> Iterator[None]:
    """Gather the messages of one file of SQLite, one with each step."""
    with part.open("rb") as file:
        head = file.read(16)
    if not head:
        raise InputError(f"{part}: the file is empty; expected a bag in SQLite")
    if head != _SQLITE and not head.startswith(_ZSTD):
        raise InputError(f"{part}: not a bag in SQLite: it begins with {head[:8].hex(' ')}")
    if head.startswith(_ZSTD):
        connection = sqlite3.connect(":memory:")
        content = _unpacked(part)
        try:
            connection.deserialize(content)
        except sqlite3.Error as error:
            raise InputError(f"{part}: not a bag in SQLite: {error}") from None
    else:
        connection = sqlite3.connect(f"{part.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    unpack = zstandard.ZstdDecompressor()
    try:
        topics = {
            int(number): (str(name).lstrip("/"), str(kind), str(form))
            for number, name, kind, form in connection.execute(
                "SELECT id, name, type, serialization_format FROM topics"
            )
        }
        for number, time, data in _rows(part, connection, damage):
            topic, kind, form = topics.get(number, (f"(topic {number})", "(unknown type)", ""))
            if (kind not in READABLE and kind != gathered.further) or form != "cdr":
                gathered.skip(topic, kind)
                continue
            if per_message or data.startswith(_ZSTD):
                try:
                    data = unpack.decompress(data, max_output_size=1 << 20)
                except zstandard.ZstdError:
                    data = b""
            gathered.add(topic, kind, data, time % 2**64)
            yield
    except (sqlite3.Error, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{part}: not a bag of rosbag2 that can be read: {error}") from None
    finally:
        connection.close()


def _rows(part: Path, connection: sqlite3.Connection, damage: list[str]) -> Iterator[tuple[int, int, bytes]]:
    """Topic, time and bytes of the messages, up to where the file is damaged."""
    count = 0
    try:
        for number, time, data in connection.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            if isinstance(data, bytes) and isinstance(time, int) and isinstance(number, int):
                count += 1
                yield number, time, data
    except sqlite3.DatabaseError as error:
        if not count:
            raise
        damage.append(f"{part.name}: damaged after message {count}: {error}")
