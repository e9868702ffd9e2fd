"""How a table of text is written: its encoding, delimiter, decimal sign, where its header stands, and its times.

Found from the cells themselves: the header is the first line above rows that have as many cells as it, most of them
numbers or times.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from vsense_ros.bag.importers.build import Array
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.errors import InputError
from vsense_ros.messages import units


@dataclass(frozen=True)
class DialectSettings:
    """By which the form of a table is recognised."""

    head: int = setting(1 << 18, "byte", "of a file that are looked at", JUDGEMENT)
    most_above: int = setting(200, "-", "lines above a header", JUDGEMENT)
    rows: int = setting(40, "-", "rows below a header that are looked at", JUDGEMENT)
    share: float = setting(0.6, "-", "of the rows that have as many cells as the header", JUDGEMENT)
    names: int = setting(64, "-", "different texts at most in a column that names the values of others", JUDGEMENT)


SETTINGS = DialectSettings()

_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?")
_ISO = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}(:\d{2}([.,]\d+)?)?\s*(Z|[+-]\d{2}:?\d{2})?")
_CLOCK = re.compile(r"(\d{1,2}:)?\d{1,2}:\d{1,2}([.,]\d+)?")
_ABSENT = ("", "-", "--", "n/a", "na", "nan", "null", "none", "*")
_DATES = ("%d-%b-%Y", "%d.%m.%Y", "%d/%m/%Y", "%m/%d/%Y", "%Y/%m/%d", "%Y-%m-%d", "%b %d, %Y", "%d %b %Y")
_HOURS = ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M:%S:%f", "%I:%M:%S.%f %p", "%I:%M:%S %p", "%H:%M")
# Forms of dates and times, as `datetime.strptime` has them, in the order in which they are tried.
FORMATS = (
    *(f"{date} {hour}" for date in _DATES for hour in _HOURS),
    "%a %b %d %H:%M:%S GMT%z %Y",
    "%a %b %d %H:%M:%S %Z %Y",
    "%a %b %d %H:%M:%S %Y",
)
_EXCEL_EPOCH = "1899-12-30T00:00:00Z"  # day 0 of a spreadsheet
_EXCEL_DAYS = (20_000.0, 80_000.0)  # of the years 1954 to 2119


@dataclass(frozen=True)
class Dialect:
    """The form of a table: its header, the cells of the first rows, and the keys of a mapping that read it."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    keys: dict[str, Any]

    def cells(self, index: int) -> list[str]:
        """The cells of a column that have a value."""
        column = (row[index].strip() for row in self.rows if index < len(row))
        return [cell for cell in column if cell.lower() not in _ABSENT]

    def is_number(self, cell: str) -> bool:
        """True for a number with the decimal sign of the table."""
        return bool(_NUMBER.fullmatch(cell)) and (self.keys.get("decimal", ".") == "," or "," not in cell)

    def numbers(self, index: int) -> Array | None:
        """The first values of a column; None where it is no column of numbers."""
        cells = self.cells(index)
        if not cells or not all(map(self.is_number, cells)):
            return None
        return np.array([float(cell.replace(",", ".")) for cell in cells])


def dialect_of(path: Path) -> Dialect:
    """The form of a table of text. Raises `InputError` where nothing in it looks like a header above rows."""
    lines = _lines(path)
    best: tuple[int, Dialect] | None = None
    for delimiter in ",;\t|":
        counted = _with(delimiter, lines)
        if counted is not None and (best is None or counted[0] > best[0]):
            best = counted
    if best is None:
        raise InputError(
            f"{path}: no header above rows of numbers in its first {min(len(lines), SETTINGS.most_above)} lines; "
            "expected names of columns in one line, and rows with as many cells below it"
        )
    return best[1]


def _lines(path: Path) -> list[str]:
    with path.open("rb") as file:
        head = file.read(SETTINGS.head)
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        text = head[: len(head) // 2 * 2].decode("utf-16", errors="replace")
    else:
        text = head.decode("utf-8-sig", errors="replace")
        if "\ufffd" in text:
            text = head.decode("cp1252", errors="replace")
    lines = text.splitlines()
    return lines[:-1] if len(head) == SETTINGS.head else lines


def _split(line: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    except csv.Error:
        return []


def _with(delimiter: str, lines: Sequence[str]) -> tuple[int, Dialect] | None:
    """The form of a table with a delimiter, and how many values there are below its header; None without any.

    The header is the first line whose names are as many as the rows are wide, or else the one above most values.
    """
    best: tuple[int, Dialect] | None = None
    for number in range(min(len(lines), SETTINGS.most_above)):
        dialect = _below(delimiter, lines, number)
        if dialect is not None and (best is None or _rank(dialect) > _rank(best)):
            best = dialect
    return best


def _rank(counted: tuple[int, Dialect]) -> tuple[bool, int]:
    """What makes one reading of a table better than another: a header with as many names as the rows have cells, then,
    where the header is too short, more values below it."""
    count, table = counted
    widths = [max((i + 1 for i, cell in enumerate(row) if cell), default=0) for row in table.rows]
    wide = len(table.header) >= max(set(widths), key=widths.count)
    return wide, 0 if wide else count


def _below(delimiter: str, lines: Sequence[str], number: int) -> tuple[int, Dialect] | None:
    """The dialect with a line as the header, and the number of values below it; None where it cannot be one."""
    header = _header(delimiter, lines[number])
    if header is None:
        return None
    below = [text for text in lines[number + 1 :] if text.strip() and not text.lstrip().startswith("#")]
    rows = [_split(text, delimiter) for text in below[: SETTINGS.rows]]
    own = [row for row in rows if len(row) >= len(header) - 1 and any(map(_is_value, row)) and row != header]
    fitting = [row for row in own if len(row) <= len(header) + 1 or not any(row[len(header) :])]
    values = [cell for row in fitting for cell in row if cell.lower() not in _ABSENT]
    count = sum(map(_is_value, values))
    if not fitting or len(fitting) < SETTINGS.share * (len(rows) - 2) or count < (len(header) > 2) + len(fitting):
        return None
    return count, Dialect(tuple(header), tuple(map(tuple, fitting)), _keys(delimiter, lines, number, values))


def _header(delimiter: str, line: str) -> list[str] | None:
    """The names in a line, without the empty ones at its end; None for a comment, values, or a line of units."""
    names = _split(line, delimiter)
    while names and not names[-1]:
        names.pop()
    if len(names) < 2 or line.lstrip().startswith("#") or any(map(_is_value, names)):
        return None
    return None if all(units.canonical(name) for name in names) else names


def _keys(delimiter: str, lines: Sequence[str], number: int, values: Sequence[str]) -> dict[str, Any]:
    """What a mapping says of the form of a table whose header is the line `number`, where it is not the usual one."""
    keys: dict[str, Any] = {} if delimiter == "," else {"delimiter": delimiter}
    with_comma = sum(bool(re.fullmatch(r"[+-]?\d+,\d+", cell)) for cell in values)
    with_point = sum(bool(re.fullmatch(r"[+-]?\d+\.\d+", cell)) for cell in values)
    if delimiter != "," and with_comma > with_point:
        keys["decimal"] = ","
    if any(text.strip() for text in lines[:number]):
        keys["skip_lines"] = number
    if any(text.lstrip().startswith("#") for text in lines[: number + 1 + SETTINGS.rows]):
        keys["comment"] = "#"
    return keys


def _is_value(cell: str) -> bool:
    """True for a number, a date or a time of day."""
    return (
        bool(_NUMBER.fullmatch(cell) or _ISO.fullmatch(cell) or _CLOCK.fullmatch(cell)) or _format([cell]) is not None
    )


def _format(cells: Sequence[str]) -> str | None:
    """The form of dates that all cells have; None where there is none."""
    if not cells or not re.search(r"\d.*:\d\d", cells[0]):
        return None
    for form in FORMATS:
        try:
            for cell in cells:
                datetime.strptime(cell, form)  # only whether it has this form
        except ValueError:
            continue
        return form
    return None


def seconds_of(cells: Sequence[str], form: str) -> Array:
    """Unix times [s] of dates in a form of `datetime.strptime`; without a zone they are UTC. Raises `ValueError` for a
    cell of another form."""
    times = (datetime.strptime(cell.strip(), form) for cell in cells)  # the zone is added below
    return np.array([(t if t.tzinfo else t.replace(tzinfo=UTC)).timestamp() for t in times])


def time_keys(table: Dialect, index: int, stated: str) -> dict[str, Any] | None:
    """What a mapping says of a column of times beside its name: unit, form, start. None where it holds no times that
    go on.

    `stated` is the unit that the table gives. A number without a unit is judged by its size and its steps.
    """
    cells = table.cells(index)
    if len(cells) < 2:
        return None
    if all(map(_ISO.fullmatch, cells)):
        return {"unit": "iso"}
    if all(map(_CLOCK.fullmatch, cells)):
        return {"unit": "hms"}
    if (form := _format(cells)) is not None:
        return {"unit": "iso", "format": form}
    values = table.numbers(index)
    if values is None or (np.diff(values) < 0).sum() > 1 or np.ptp(values) == 0:
        return None
    if units.quantity_of(stated) == "time":
        return {"unit": units.canonical(stated)}
    return _unit_by_size(values)


def _unit_by_size(values: Array) -> dict[str, Any]:
    """Unit and start of times that are numbers, by their size, or else by their steps."""
    largest, step = float(np.abs(values).max()), float(np.median(np.diff(values)))
    for limit, unit in ((1e17, "ns"), (1e14, "us"), (1e11, "ms"), (1e8, "s")):
        if largest > limit:
            return {"unit": unit}
    low, high = _EXCEL_DAYS
    if low < values.min() and largest < high and step < 1e-3:
        return {"unit": "d", "start": _EXCEL_EPOCH}
    minutes, seconds = values // 100 % 100, values % 100
    if largest >= 1e4 and largest < 240_000 and (minutes < 60).all() and (seconds < 60).all():
        jumps = np.diff(values)
        if (np.abs(jumps - 40 - step) < 0.5).any() or (values % 1 != 0).any():
            return {"unit": "hhmmss"}
    whole = bool((values == np.round(values)).all())
    if whole and step >= 5:
        return {"unit": "ms" if step < 1000 else "us"}
    return {"unit": "s"}


def rows_by_name(table: Dialect) -> dict[str, str] | None:
    """The columns that name and hold the values where each row has one value; None in other tables."""
    texts = [i for i in range(len(table.header)) if table.cells(i) and table.numbers(i) is None]
    for index in texts:
        names = table.cells(index)
        if not re.fullmatch(r"(?i)(pid|name|parameter|signal|channel|sensor)s?", table.header[index].strip()):
            continue
        values = [i for i, name in enumerate(table.header) if re.fullmatch(r"(?i)(value|val|wert)s?", name.strip())]
        if values and len(set(names)) <= SETTINGS.names:
            columns = {"name": table.header[index], "value": table.header[values[0]]}
            unit = next((name for name in table.header if re.fullmatch(r"(?i)units?", name.strip())), None)
            return columns | ({"unit": unit} if unit else {})
    return None
