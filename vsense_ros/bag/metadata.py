"""What rosbag2 writes about a bag beside its messages: `metadata.yaml`, and the types and qualities of its topics."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsense_ros.errors import InputError
from vsense_ros.messages import definitions, yaml_text

FILE_NAME = "metadata.yaml"

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

_TOPICS_BLOCK = re.compile(r"^( *)topics_with_message_count:[^\n]*\n(?:(?:\1[ -][^\n]*| *)\n)*", re.MULTILINE)


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
        """Describe a topic of a type that the project defines; raises `InputError` for others."""
        if kind not in definitions.TYPE_HASHES:
            known = ", ".join(sorted(definitions.TYPE_HASHES))
            raise InputError(f"{topic}: message type {kind!r} cannot be written; known: {known}")
        return cls(kind, definitions.schema_text(kind), definitions.TYPE_HASHES[kind])


@dataclass(frozen=True)
class FileSummary:
    """One file of a bag: its name, the times of its first and last message [ns], and its messages by topic."""

    name: str
    first: int
    last: int
    counts: Mapping[str, int]

    @property
    def count(self) -> int:
        """Number of messages of all topics."""
        return sum(self.counts.values())


def absolute(topic: str) -> str:
    """Name of a topic in a bag: rosbag2 knows fully qualified names only."""
    return topic if topic.startswith("/") else f"/{topic}"


def metadata_text(
    files: Sequence[FileSummary], descriptions: Mapping[str, TopicDescription], custom: Mapping[str, str]
) -> str:
    """The text of `metadata.yaml` (version 9, ROS 2 Jazzy)."""
    counts: dict[str, int] = {}
    for file in files:
        for topic, count in file.counts.items():
            counts[topic] = counts.get(topic, 0) + count
    begun = [file for file in files if file.count]
    first, last = min((file.first for file in begun), default=0), max((file.last for file in begun), default=0)
    topics = "".join(
        f"""\
- topic_metadata:
    name: {_quoted(absolute(topic))}
    type: {descriptions[topic].kind}
    serialization_format: cdr
    offered_qos_profiles:
{_indent(descriptions[topic].qos, 6)}    type_description_hash: {descriptions[topic].type_hash}
  message_count: {count}
"""
        for topic, count in counts.items()
    )
    names = [_quoted(file.name) for file in files]
    spans = "".join(
        f"  - path: {name}\n{_indent(_span(file.first, file.last, file.count), 4)}"
        for name, file in zip(names, files, strict=True)
    )
    information = (
        "version: 9\nstorage_identifier: mcap\n"
        + _span(first, last, sum(counts.values()))
        + (f"topics_with_message_count:\n{_indent(topics, 2)}" if topics else "topics_with_message_count: []\n")
        + 'compression_format: ""\ncompression_mode: ""\nrelative_file_paths:\n'
        + "".join(f"  - {name}\n" for name in names)
        + f"files:\n{spans}custom_data:"
        + ("".join(f"\n  {_quoted(key)}: {_quoted(value)}" for key, value in custom.items()) or " ~")
        + "\nros_distro: jazzy\n"
    )
    return "rosbag2_bagfile_information:\n" + _indent(information, 2)


def _span(first: int, last: int, count: int) -> str:
    return f"""\
duration:
  nanoseconds: {last - first}
starting_time:
  nanoseconds_since_epoch: {first}
message_count: {count}
"""


def _indent(text: str, width: int) -> str:
    return "".join(" " * width + line for line in text.splitlines(True))


def _quoted(text: str) -> str:
    """A YAML double-quoted scalar on one line."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n").replace("\t", "\\t")
    return f'"{escaped}"'


def information_in(path: Path) -> dict[str, Any] | None:
    """What the file `metadata.yaml` of a bag says; None where it cannot be read."""
    if not path.is_file():
        return None
    with path.open("rb") as file:
        document = parsed(file.read(yaml_text.LIMITS.largest_text).decode("utf-8", errors="replace"))
    information = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    return information if isinstance(information, dict) else None


def parsed(text: str) -> object:
    """The content of a text of metadata without the qualities of service of its topics, which are most of it; None
    where it is no YAML, or longer than anybody writes."""
    if len(text) > yaml_text.LIMITS.largest_text:
        return None
    try:
        return yaml_text.load(_TOPICS_BLOCK.sub("", text, count=1), FILE_NAME)
    except InputError:
        return None


def custom_data(information: object) -> dict[str, str]:
    """The user's part of the metadata."""
    custom = information.get("custom_data") if isinstance(information, dict) else None
    return {str(key): str(value) for key, value in custom.items()} if isinstance(custom, dict) else {}
