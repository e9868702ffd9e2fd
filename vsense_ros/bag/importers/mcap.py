"""A ROS 2 bag in MCAP: what the other importers make, and what this project writes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from vsense_ros.bag.importers.topic_mapping import mapped, mapped_pieces
from vsense_ros.bag.reading import bag_pieces, read_bag
from vsense_ros.messages.recording import Recording

NAME = "mcap"
DESCRIPTION = "ROS 2 bag in MCAP"


def matches(path: Path) -> bool:
    """True if `path` is an MCAP file, or a folder with one or with the metadata of a bag."""
    return path.suffix == ".mcap" or (path / "metadata.yaml").exists() or any(path.glob("*.mcap"))


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """All messages of types that become numbers (`messages.foreign.READABLE`), topics without their leading slash;
    `mapping` says which topics are those of this project (see `topic_mapping`)."""
    return mapped(read_bag(path), mapping)


def pieces(path: Path, size: int, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Iterator[Recording]:
    """What `read` gives, in pieces of about `size` bytes of messages, in the order in which they were written."""
    yield from mapped_pieces(bag_pieces(path, size), mapping)
