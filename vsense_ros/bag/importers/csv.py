"""Tables of text (CSV) with one header line, by a column mapping (see `mapping.py`)."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.build import Array
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "csv"
DESCRIPTION = "text table with a column mapping (.csv, .tsv, .txt)"
LAST = True  # a text of a known format is known better by its own importer


def matches(path: Path) -> bool:
    """Whether `path` is named like a table of text."""
    return path.is_file() and path.suffix.lower() in (".csv", ".tsv", ".txt")


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """The topics that the mapping makes of the table.

    `mapping` is a YAML file or its content; by default the file of the same name with `.yaml`. Empty cells are
    absent values; rows without any value of a topic are no message of it.
    """
    wanted = mapping_file.load(mapping_file.default_mapping(path, mapping), path)
    if wanted.time.column is None:
        raise InputError(f"{path}: the mapping names no time column; expected time: {{column: …, unit: s}}")
    if wanted.time.unit not in mapping_file.UNITS["time"]:
        known = ", ".join(mapping_file.UNITS["time"])
        raise InputError(f"mapping: time: unit {wanted.time.unit!r} is no unit of time; known: {known}")
    table = _table(path, wanted)
    time = _column(path, table, wanted.time.column) * mapping_file.UNITS["time"][wanted.time.unit]
    if not np.isfinite(time).all():
        line = int(np.argmin(np.isfinite(time))) + 2 + wanted.skip_lines
        raise InputError(
            f"{path}, line {line}: the time column {wanted.time.column!r} is empty; every row needs a time"
        )
    return mapping_file.apply(wanted, lambda name: (time, _column(path, table, name)), path.stem, NAME)


def _column(path: Path, table: Mapping[str, Array], name: str) -> Array:
    if name not in table:
        raise InputError(f"{path}: no column {name!r}; found: {', '.join(table)}")
    return table[name]


def _table(path: Path, wanted: mapping_file.ColumnMapping) -> dict[str, Array]:
    """Columns that the mapping uses, by name."""
    used = {wanted.time.column, *wanted.columns()}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            for _ in range(wanted.skip_lines):
                next(file, "")
            rows = csv.reader(file, delimiter=wanted.delimiter, skipinitialspace=True)
            header = [name.strip() for name in next(rows, [])]
            chosen = [(index, name) for index, name in enumerate(header) if name in used]
            values: dict[str, list[float]] = {name: [] for _, name in chosen}
            for row in rows:
                if not row:
                    continue
                for index, name in chosen:
                    cell = row[index].strip() if index < len(row) else ""
                    values[name].append(_number(path, rows.line_num + wanted.skip_lines, name, cell, wanted.decimal))
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text table in UTF-8: {error}") from None
    if not header:
        raise InputError(f"{path}: the file is empty; expected a header line with column names")
    missing = [name for name in used if name not in header]
    if missing:
        raise InputError(
            f"{path}: no column {missing[0]!r}; found: {', '.join(header)} (delimiter {wanted.delimiter!r})"
        )
    if not any(map(len, values.values())):
        raise InputError(f"{path}: no rows below the header")
    return {name: np.array(column) for name, column in values.items()}


def _number(path: Path, line: int, name: str, cell: str, decimal: str) -> float:
    if not cell:
        return float("nan")
    try:
        return float(cell.replace(decimal, "."))
    except ValueError:
        raise InputError(f"{path}, line {line}, column {name!r}: expected a number, found {cell!r}") from None
