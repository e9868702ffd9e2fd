"""Tables of text (CSV) with one header line, by a column mapping (see `mapping.py`)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers import text_table
from vsense_ros.bag.importers.columns import recording_from
from vsense_ros.bag.importers.long_table import LongTable
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "csv"
DESCRIPTION = "text table with a column mapping (.csv, .tsv, .txt)"
LAST = True  # a text of a known format is known better by its own importer


def matches(path: Path) -> bool:
    """True if `path` is named like a table of text."""
    return path.is_file() and path.suffix.lower() in (".csv", ".tsv", ".txt")


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """The topics that the mapping makes of the table.

    `mapping` is a YAML file or its content; by default the file of the same name with `.yaml`. Cells without a value
    are absent; rows without any value of a topic are no message of it.
    """
    wanted = mapping_file.load(mapping_file.default_mapping(path, mapping), path)
    table = text_table.read_table(path, wanted) if wanted.rows is None else LongTable(path, wanted)
    recording = recording_from(wanted, table.column, path.stem, NAME, table.base)
    return replace(recording, notes=(*table.notes, *recording.notes))


def pieces(path: Path, size: int, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Iterator[Recording]:
    """The topics of the table in pieces of about `size` bytes of it, which follow each other in time."""
    wanted = mapping_file.load(mapping_file.default_mapping(path, mapping), path)
    if wanted.rows is not None:
        yield read(path, mapping=mapping)
        return
    lacking = {topic for topic, fields in wanted.topics.items() if fields}
    for table in text_table.read_pieces(path, wanted, size):
        recording = recording_from(wanted, table.column, path.stem, NAME, table.base, is_piece=True)
        lacking -= recording.channels.keys()
        yield replace(recording, notes=(*table.notes, *recording.notes))
    if lacking:
        raise InputError(f"{path}: no column of {', '.join(sorted(lacking))} holds a number")
