"""A ROS 2 bag in MCAP: what the other importers make, and what this project writes."""

from __future__ import annotations

from pathlib import Path

from vsense_ros.bag.reading import read_bag as read

__all__ = ["DESCRIPTION", "NAME", "matches", "read"]

NAME = "mcap"
DESCRIPTION = "ROS 2 bag in MCAP"


def matches(path: Path) -> bool:
    """True if `path` is an MCAP file, or a folder with one or with the metadata of a bag."""
    return path.suffix == ".mcap" or (path / "metadata.yaml").exists() or any(path.glob("*.mcap"))
