"""Bags into recordings: a folder with MCAP files and `metadata.yaml`, or one such file."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import zstandard
from numpy.typing import NDArray

from vsense_ros.bag.decoding import LONGEST_RECORDING, TopicMessages, channels_of, skipped
from vsense_ros.bag.mcap import McapFile, Pieces, Rows, Times, read_file, read_part, read_pieces, unpacked_zstd
from vsense_ros.bag.metadata import RELIABLE_QOS, TopicDescription, custom_data, information_in, parsed
from vsense_ros.errors import InputError
from vsense_ros.messages.foreign import READABLE
from vsense_ros.messages.memory import give_back
from vsense_ros.messages.recording import FIELDS, Recording

_ZSTD = b"\x28\xb5\x2f\xfd"  # the first bytes of what zstd has packed


@dataclass(frozen=True)
class BagLimits:
    """Bounds on what a bag may make its reader allocate: decisions of this project."""

    largest_message: int = 1 << 20  # [byte] of those that rosbag2 has compressed one by one
    most_files: int = 100_000  # of one bag
    glance: int = 32 << 20  # [byte] that a first look unpacks


LIMITS = BagLimits()


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


@dataclass
class _Topic:
    """The messages of one topic from all files of a bag."""

    kind: str
    is_cdr: bool = True
    pieces: Pieces = field(default_factory=list)

    @property
    def count(self) -> int:
        return sum(len(times) for _, times in self.pieces)

    def joined(self) -> TopicMessages:
        """All pieces as one. Each is let go once it is copied, so that a long bag is not in memory twice."""
        times = np.concatenate([times for _, times in self.pieces])
        blocks = [payloads for payloads, _ in self.pieces]
        self.pieces.clear()
        if len({len(block.first) if isinstance(block, Rows) else None for block in blocks}) > 1 or isinstance(
            blocks[0], list
        ):
            lists = (block.as_list() if isinstance(block, Rows) else block for block in blocks)
            return TopicMessages(self.kind, [payload for one in lists for payload in one], times)
        rows = np.empty((len(times), len(blocks[0].first)), np.uint8)
        end = len(rows)
        while blocks:
            block = blocks.pop()
            assert isinstance(block, Rows)
            block.write(rows[end - len(block) : end])
            end -= len(block)
        del block
        give_back()
        return TopicMessages(self.kind, rows, times)

    def raw(self) -> RawChannel:
        """Messages in order of arrival, without those whose time is impossible."""
        messages = self.joined()
        arrived = np.asarray(messages.times).astype(np.int64)
        possible = np.flatnonzero((arrived >= 0) & (np.abs(arrived - np.median(arrived)) <= LONGEST_RECORDING))
        order = possible[np.argsort(arrived[possible], kind="stable")]
        return RawChannel(arrived[order], [bytes(messages.payloads[i]) for i in order.tolist()])


@dataclass
class _Bag:
    """What has been gathered from the files of a bag."""

    topics: dict[str, _Topic] = field(default_factory=dict)
    descriptions: dict[str, TopicDescription] = field(default_factory=dict)
    contradictions: dict[tuple[str, str], int] = field(default_factory=dict)  # topic and its second type → messages
    notes: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    lost: int = 0  # messages known to be lost
    custom: dict[str, str] = field(default_factory=dict)
    informed: bool = False  # metadata.yaml is read

    def add(self, file: McapFile) -> None:
        """Take the messages and the descriptions of one file."""
        self.notes += file.notes
        self.damage += file.damage
        self.lost += file.lost
        if not self.informed:  # metadata.yaml says the same
            self.custom |= custom_data(parsed(file.metadata.get("rosbag2", {}).get("serialized_metadata", "")))
        for channel in file.channels.values():
            schema = file.schemas.get(channel.schema_id)
            definition = schema.data.decode(errors="replace") if schema and schema.encoding == "ros2msg" else ""
            self.descriptions[channel.topic.lstrip("/")] = TopicDescription(
                schema.name if schema else "(unknown)",
                definition,
                channel.metadata.get("topic_type_hash", ""),
                channel.metadata.get("offered_qos_profiles") or RELIABLE_QOS,
            )
        for number, pieces in file.messages.items():
            known = file.channels.get(number)
            name = known.topic.lstrip("/") if known else f"(channel {number})"
            kind = self.descriptions[name].kind if known else "(unknown type)"
            topic = self.topics.setdefault(name, _Topic(kind))
            topic.is_cdr &= known is not None and known.message_encoding == "cdr"
            if topic.kind == kind:
                topic.pieces += map(_without_compression, pieces)
            else:
                messages = sum(len(times) for _, times in pieces)
                self.contradictions[name, kind] = self.contradictions.get((name, kind), 0) + messages


def _without_compression(piece: tuple[list[bytes] | Rows, Times]) -> tuple[list[bytes] | Rows, Times]:
    """Messages that rosbag2 may have compressed one by one; a damaged one becomes empty, which is no message."""
    payloads, times = piece
    first = payloads.first.tobytes() if isinstance(payloads, Rows) else payloads[0]
    if first[:4] != _ZSTD:
        return piece
    unpacked = []
    for payload in payloads.as_list() if isinstance(payloads, Rows) else payloads:
        try:
            unpacked.append(unpacked_zstd(payload, LIMITS.largest_message))
        except zstandard.ZstdError:
            unpacked.append(b"")
    return unpacked, times


def read_bag(path: str | Path) -> Recording:
    """Read a bag folder or a single `.mcap` file.

    All intact messages of types that become numbers (`messages.foreign.READABLE`) are returned, topics without their
    leading slash; what was lost or skipped, and where, stands in `notes`, the known number of lost messages in
    `messages_lost`.

    Raises `InputError` if there is no such bag, if it is none, or if it holds no message.
    """
    return _read(path, READABLE).recording


def read_whole_bag(path: str | Path) -> WholeBag:
    """Read a bag with the messages of types that have no numeric form of their own, too. Raises as `read_bag`."""
    return _read(path, FIELDS)


def glance_at_bag(path: str | Path, most: int = LIMITS.glance) -> Recording | None:
    """A first look at a large bag in a small part of the time of reading it: stretches that lie evenly over it, and
    unpack to about `most` bytes.

    None for a bag that is small, that has no index, or that is none; `read_bag` says why.
    """
    path = Path(path)
    files = [path] if path.is_file() else sorted(path.glob("*.mcap"))
    bag = _Bag()
    for one in files:
        try:
            part = read_part(one, max(1, most // len(files)))
        except OSError:
            return None
        if part is None:
            return None
        bag.add(part)
    numeric = [name for name, topic in bag.topics.items() if topic.is_cdr and topic.kind in READABLE]
    channels, _ = channels_of(((name, bag.topics.pop(name).joined()) for name in numeric), [])
    return Recording(channels, path.stem) if channels else None


def bag_pieces(path: str | Path, size: int) -> Iterator[Recording]:
    """What `read_bag` gives in pieces of about `size` bytes of messages, in the order in which they were written.

    Raises as `read_bag`; that a bag holds no message is said at its end.
    """
    path = Path(path)
    about = _Bag()
    files, _ = _files(path, about)
    left_out: list[str] = []
    any_messages = False
    for one in files:
        try:
            for part in read_pieces(one, size):
                bag = _Bag(notes=about.notes, custom=dict(about.custom), informed=about.informed)
                bag.add(part)
                about.notes = []
                any_messages |= part.count > 0
                yield _whole(path, bag, READABLE).recording
        except InputError as error:
            if len(files) == 1:
                raise
            left_out.append(f"left out: {error}")
    if not any_messages:
        raise _no_message(path, [*about.notes, *left_out])
    if left_out:
        yield Recording({}, _name(path), tuple(left_out), 0, {}, tuple(left_out))


def _read(path: str | Path, kinds: Container[str]) -> WholeBag:
    """Read a bag, of which messages of these types become numbers."""
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: neither a folder nor a regular file; expected a bag folder or a .mcap file")
    return _whole(path, _gathered(path), kinds)


def _whole(path: Path, bag: _Bag, kinds: Container[str]) -> WholeBag:
    """What a bag or a piece of it holds, from the messages that were gathered."""
    numeric = [name for name, topic in bag.topics.items() if topic.is_cdr and topic.kind in kinds]
    others = {name: topic for name, topic in bag.topics.items() if name not in numeric}
    notes = [
        *bag.notes,
        *bag.damage,
        *(skipped(topic, kind, count) for (topic, kind), count in bag.contradictions.items()),
        *(skipped(name, topic.kind, topic.count) for name, topic in others.items()),
    ]
    # One topic after the other is taken out, so that only one is in memory twice.
    channels, bad = channels_of(((name, bag.topics.pop(name).joined()) for name in numeric), notes)
    give_back()
    stored = bag.custom.pop("notes", "")
    recording = Recording(
        channels, _name(path), (*stored.splitlines(), *notes), bag.lost + bad, bag.custom, tuple(bag.damage)
    )
    return WholeBag(recording, {name: topic.raw() for name, topic in others.items()}, bag.descriptions)


def _name(path: Path) -> str:
    return path.stem if path.is_file() else path.resolve().name


def _no_message(path: Path, reasons: list[str]) -> InputError:
    reason = f" ({'; '.join(reasons)})" if reasons else ""
    return InputError(f"{path}: the bag holds no intact message{reason}; record it again or choose another")


def _gathered(path: Path) -> _Bag:
    """All intact messages of a bag."""
    bag = _Bag()
    files, promised = _files(path, bag)
    read = 0
    for path_of_file in files:
        try:
            file = read_file(path_of_file)
        except InputError as error:
            if len(files) == 1:
                raise
            bag.damage.append(f"left out: {error}")
            continue
        read += file.count
        bag.add(file)
    if promised is not None:
        bag.lost = max(bag.lost, promised - read)
    if not read:
        raise _no_message(path, [*bag.notes, *bag.damage])
    return bag


def _files(path: Path, bag: _Bag) -> tuple[list[Path], int | None]:
    """The MCAP files of a bag in their order, and the number of messages that `metadata.yaml` promises."""
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; expected a bag folder or a .mcap file")
    if path.is_file():
        return [path], None
    present = [file for file in sorted(path.glob("*.mcap")) if file.is_file()]
    metadata = path / "metadata.yaml"
    if not metadata.exists():
        if not present:
            raise InputError(f"{path}: no bag: the folder holds neither metadata.yaml nor a .mcap file")
        bag.notes.append("metadata.yaml is missing: the recording was not finished properly")
        return present, None
    information = information_in(metadata)
    if information is None:
        if not present:
            raise InputError(f"{metadata}: not the metadata of a bag: no rosbag2_bagfile_information in it")
        bag.notes.append("metadata.yaml is damaged; all .mcap files of the folder were read")
        return present, None
    storage = information.get("storage_identifier") or ("mcap" if present else "sqlite3")
    if storage != "mcap":
        raise InputError(
            f"{path}: its storage is {storage!r}, expected 'mcap'; convert it with 'ros2 bag convert' or record with "
            "'ros2 bag record --storage mcap'"
        )
    bag.custom = custom_data(information)
    bag.informed = True
    promised = information.get("message_count")
    return _named_files(path, information, bag, present), promised if isinstance(promised, int) else None


def _named_files(path: Path, information: Mapping[str, object], bag: _Bag, present: list[Path]) -> list[Path]:
    """The files that `metadata.yaml` names, else those that are `present`; raises `InputError` if there is none."""
    named = information.get("relative_file_paths")
    files, missing = [], []
    for name in map(str, named[: LIMITS.most_files] if isinstance(named, list) else []):
        file = path / name
        if not file.resolve().is_relative_to(path.resolve()):
            bag.notes.append(f"metadata.yaml names {name!r}, which is outside of the bag: left out")
        elif not file.exists():
            missing.append(file.name)
        elif file.is_file():
            files.append(file)
        else:
            bag.notes.append(f"metadata.yaml names {name!r}, which is no regular file: left out")
    if missing:
        bag.notes.append(f"files that metadata.yaml names are missing: {', '.join(missing)}")
    if not (files or present):
        raise InputError(f"{path}: none of its files is there ({', '.join(missing) or 'metadata.yaml names none'})")
    return files or present
