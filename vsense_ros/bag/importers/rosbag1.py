"""ROS 1 bags (`.bag`), by rosbags; messages of the types that ROS 2 has as well."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from vsense_ros.bag.decoding import TopicMessages, channels_of
from vsense_ros.bag.importers.topic_mapping import mapped
from vsense_ros.errors import InputError
from vsense_ros.messages.foreign import READABLE
from vsense_ros.messages.recording import Recording

NAME = "rosbag1"
DESCRIPTION = "ROS 1 bag (.bag)"

_MAGIC = b"#ROSBAG"


def matches(path: Path) -> bool:
    """True if `path` begins like a ROS 1 bag, or is named like one."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(7) == _MAGIC or path.suffix == ".bag"


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """All messages of types that become numbers (`messages.foreign.READABLE`), topics without their leading slash;
    `mapping` says which topics are those of this project (see `topic_mapping`)."""
    return mapped(_whole(path), mapping)


def _whole(path: Path) -> Recording:
    """All topics under their own names."""
    from rosbags.convert.converter import generate_message_converter
    from rosbags.rosbag1 import Reader, ReaderError
    from rosbags.typesys import Stores, get_typestore

    with path.open("rb") as file:
        head = file.read(13)
    if not head.startswith(_MAGIC + b" V2.0"):
        what = "the file is empty" if not head else f"it begins with {head!r}"
        raise InputError(f"{path}: not a ROS 1 bag of version 2.0: {what}")
    ros1, ros2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
    converters: dict[str, Callable[[bytes | memoryview], memoryview]] = {}
    merged: dict[str, TopicMessages] = {}
    skipped: dict[tuple[str, str], int] = {}
    damage: list[str] = []
    count = 0
    try:
        with Reader(path) as bag:
            # One topic after the other: between chunks that overlap in time, each would be unpacked for each message.
            rows = (row for connection in bag.connections for row in bag.messages(connections=[connection]))
            for connection, time, data in rows:
                topic, kind = connection.topic.lstrip("/"), connection.msgtype
                if kind not in READABLE or (topic in merged and merged[topic].kind != kind):
                    skipped[topic, kind] = skipped.get((topic, kind), 0) + 1
                    continue
                if kind not in converters:
                    converters[kind] = generate_message_converter(
                        ros1, ros2, kind, kind, {}, src_is2=False, dst_is2=True
                    )
                messages = merged.setdefault(topic, TopicMessages(kind))
                count += 1
                try:
                    payload = bytes(converters[kind](data))
                except (struct.error, ValueError, IndexError, AssertionError):
                    payload = b""  # counted as damaged with those that cannot be decoded
                messages.append(payload, time)
    except MemoryError:
        raise
    except (
        ReaderError,
        OSError,
        EOFError,
        ValueError,
        LookupError,
        struct.error,
        AssertionError,
        RuntimeError,
    ) as error:
        if not count:
            hint = "; 'rosbag reindex' may mend a bag that was not closed" if "index" in str(error).lower() else ""
            raise InputError(f"{path}: cannot be read as a ROS 1 bag: {error}{hint}") from None
        damage.append(f"{path.name}: damaged after message {count}: {error}")
    except Exception as error:
        if type(error).__module__.partition(".")[0] not in ("rosbags", "lz4", "bz2", "_bz2"):
            raise
        raise InputError(f"{path}: cannot be read as a ROS 1 bag: {error}") from None
    if not merged and not skipped:
        raise InputError(f"{path}: the bag holds no message")
    notes = [f"{topic}: {count} messages of type {kind} skipped" for (topic, kind), count in skipped.items()]
    channels, bad = channels_of(merged.items(), notes)
    return Recording(channels, path.stem, (*notes, *damage), bad, {"source": NAME}, tuple(damage))
