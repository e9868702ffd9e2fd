"""Times in tables of text: the units of time that a mapping names, and how dates and times of day are written."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.dialect import seconds_of
from vsense_ros.bag.importers.mapping import ColumnMapping
from vsense_ros.errors import InputError
from vsense_ros.messages import units

_DAY = 86_400.0  # [s]
CLOCK = r"^\s*(?:(?P<h>[0-9]{1,2}):)?(?P<m>[0-9]{1,2}):(?P<s>[0-9]{1,2}(?:[.,][0-9]+)?)\s*$"
ISO = re.compile(r"\s*\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}(:\d{2}([.,]\d+)?)?\s*(Z|[+-]\d{2}:?\d{2})?\s*")


class Lines(Protocol):
    """What of a table errors and notes are about."""

    path: Path
    header: list[str]
    notes: list[str]


def clock_cell(cell: str, as_text: bool, wanted: ColumnMapping) -> str | float | None:
    """The time in a cell, a text where the unit is one that is written; None if there is none."""
    if as_text and wanted.time.format is not None:
        try:
            seconds_of([cell], wanted.time.format)
        except ValueError:
            return None
        return cell
    if as_text:
        return cell if ISO.fullmatch(cell) or re.match(CLOCK, cell) else None
    try:
        value = float(cell.replace(wanted.decimal, "."))
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def times_of(
    lines: Lines, index: int, raw: dict[int, Any], wanted: ColumnMapping, week_index: int | None
) -> tuple[Array, int | None]:
    """Seconds after the returned base [ns]; a base of None is that of the mapping."""
    unit, column = wanted.time.unit, raw[index]
    if unit == "iso":
        return _iso(lines, column) if wanted.time.format is None else _dates(lines, column, wanted.time.format)
    if unit == "hms":
        seconds = _hms(lines, column)
    elif unit == "hhmmss":
        hours, rest = np.divmod(column, 10_000.0)
        minutes, parts = np.divmod(rest, 100.0)
        if not ((hours < 24) & (minutes < 60) & (parts < 61) & (column >= 0)).all():
            raise InputError(f"{lines.path}: the time column {lines.header[index]!r} is not packed HHMMSS")
        seconds = np.round((hours * 60 + minutes) * 60 + parts, 9)
    elif unit == "gps":
        return _gps(lines, column, wanted, None if week_index is None else raw[week_index])
    else:
        return column * units.to_si(unit), None
    if wanted.time.start is None:
        lines.notes.append(f"{lines.path.name}: the times have no date; counted from 1970 (key start of time)")
    return seconds + _DAY * np.concatenate([[0], np.cumsum(np.diff(seconds) < -_DAY / 2)]), None


def _iso(lines: Lines, column: pa.ChunkedArray) -> tuple[Array, int]:
    column = pc.replace_substring(pc.utf8_trim_whitespace(column), " ", "T", max_replacements=1)
    column = pc.replace_substring(column, ",", ".")
    for kind in (pa.timestamp("ns", "UTC"), pa.timestamp("ns")):
        try:
            stamps = pc.cast(column, kind)
        except pa.ArrowInvalid:
            continue
        nanoseconds = stamps.cast(pa.int64()).to_numpy()
        base = int(nanoseconds[0])
        return (nanoseconds - base) * 1e-9, base
    first = next((text for text in column.to_pylist() if not ISO.fullmatch(text)), column[0].as_py())
    raise InputError(f"{lines.path}: expected times as 2024-05-01T12:00:00.1Z all in one form, found {first!r}")


def _dates(lines: Lines, column: pa.ChunkedArray, form: str) -> tuple[Array, int]:
    """Times in a form of the mapping: seconds after the first, and this [ns]."""
    texts = column.to_pylist()
    try:
        seconds = seconds_of(texts, form)
    except ValueError as error:
        raise InputError(f"{lines.path}: expected times as {form!r} (key format of time): {error}") from None
    base = math.floor(seconds[0])
    return seconds - base, base * 1_000_000_000


def _hms(lines: Lines, column: pa.ChunkedArray) -> Array:
    parts = pc.extract_regex(column, CLOCK)
    if parts.null_count:
        first = column.filter(pc.is_null(parts))[0].as_py()
        raise InputError(f"{lines.path}: expected times of day as 12:00:00.1, found {first!r}")

    def number(name: str) -> Array:
        text = pc.replace_substring(pc.struct_field(parts, name), ",", ".")
        text = pc.if_else(pc.equal(text, ""), "0", text)
        return text.cast(pa.float64()).to_numpy()

    return (number("h") * 60 + number("m")) * 60 + number("s")


def _gps(lines: Lines, column: Array, wanted: ColumnMapping, weeks: Array | None) -> tuple[Array, int]:
    """Seconds of the GPS week; the week goes on where they begin anew."""
    week = wanted.time.week
    if week is None:
        raise InputError("mapping: time: seconds of the GPS week need the key week: its number, or a column")
    first = int(week) if isinstance(week, int) else int(weeks[0]) if weeks is not None else 0
    if not 0 <= first < 5000:
        raise InputError(f"{lines.path}: {first} is no GPS week")
    if first < 1024:  # counted with 10 bits, which begin at 0 again every 1024 weeks: the latest that is over
        first += 1024 * int((time.time() - build.GPS_EPOCH - first * build.WEEK) // (1024 * build.WEEK))
    turns = np.concatenate([[0], np.cumsum(np.diff(column) < -build.WEEK / 2)])
    unix = build.GPS_EPOCH + first * build.WEEK
    base = unix - build.gps_minus_utc(unix + float(column[0]))
    return column + build.WEEK * turns, base * 1_000_000_000
