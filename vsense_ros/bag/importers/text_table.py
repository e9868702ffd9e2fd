"""Columns of a table of text, in the dialects that loggers write.

The rows are parsed by pyarrow. What it refuses is read again line by line, so that the error names line and column.
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.csv

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.cut_text import Beginning, is_cut
from vsense_ros.bag.importers.mapping import CLOCKS, Column, ColumnMapping, Ref, unit_in_name
from vsense_ros.bag.importers.text_clocks import CLOCK, ISO, clock_cell, times_of
from vsense_ros.errors import InputError
from vsense_ros.messages import units
from vsense_ros.messages.memory import give_back

_MISSING = ("", "-", "--", "---", "n/a", "N/A", "NA", "#N/A", "nan", "NaN", "NAN", "null", "NULL", "None", "*")


@dataclass(frozen=True)
class TextTableSettings:
    """How much of a text file is read at once and shown: decisions of this project."""

    longest_line: int = 1 << 20  # [byte]
    longest_shown: int = 60  # characters of a cell in an error
    footer: int = 20  # lines at the end of a file that may be something else than rows
    tail: int = 1 << 16  # [byte] at the end of a file, by which it is seen if its last line was cut
    block: int = 1 << 20  # [byte] that are parsed at once: larger ones leave more of the memory in pieces


SETTINGS = TextTableSettings()

_DAY = 86_400.0  # [s]


@dataclass
class TextTable:
    """The columns of a table that a mapping uses. Times are seconds after `base` [ns]."""

    path: Path
    header: list[str]
    units: list[str]
    columns: dict[int, Array]
    time: Array
    base: int | None
    notes: list[str] = field(default_factory=list)

    def column(self, ref: Ref) -> Column:
        """A column by its name or number."""
        index = index_of(self.path, self.header, ref.name)
        return Column(self.time, self.columns[index], self.units[index])


def index_of(path: Path, header: Sequence[str], name: str | int, delimiter: str = "") -> int:
    """Which column a name or a number (from 1) means. Raises `InputError` if none, or more than one."""
    if isinstance(name, int):
        if not 1 <= name <= len(header):
            raise InputError(f"{path}: no column {name}: it has {len(header)}")
        return name - 1
    indices = [index for index, heading in enumerate(header) if heading == name]
    if not indices:
        near = f" (delimiter {delimiter!r})" if delimiter else ""
        raise InputError(f"{path}: no column {name!r}; found: {', '.join(header)}{near}")
    if len(indices) > 1:
        which = ", ".join(str(index + 1) for index in indices)
        raise InputError(
            f"{path}: column {name!r} stands {len(indices)} times, as columns {which}; say which by its number, "
            f"column: {indices[0] + 1}"
        )
    return indices[0]


def read_header(path: Path, wanted: ColumnMapping) -> tuple[list[str], list[str]]:
    """Names of the columns of a table and their units, empty where none is stated."""
    lines = _Lines(path, wanted)
    return lines.header, lines.units


def read_table(path: Path, wanted: ColumnMapping, also: Sequence[str | int] = ()) -> TextTable:
    """The columns that a mapping uses, and those that are named `also`. Raises `InputError` naming line and column of
    what is wrong."""
    return _table(_Lines(path, wanted), also)


def read_pieces(path: Path, wanted: ColumnMapping, size: int) -> Iterator[TextTable]:
    """The rows of a table in pieces of about `size` bytes, one after the other; the whole where rows have no times or
    characters more than a byte. Times go on over midnight and the end of a GPS week."""
    lines = _Lines(path, wanted)
    if wanted.time.rate is not None or lines.is_wide:
        yield _table(lines)
        return
    turn = {"hms": _DAY, "hhmmss": _DAY, "gps": float(build.WEEK)}.get(wanted.time.unit)
    turned, latest = 0.0, -math.inf
    for piece in lines.pieces(size):
        table = _table(piece)
        begin = (0 if table.base is None else table.base) * 1e-9
        if turn is not None and begin + table.time[0] + turned < latest - turn / 2:
            turned += turn
        table.time += turned
        latest = begin + float(table.time[-1])
        yield table


def _table(lines: _Lines, also: Sequence[str | int] = ()) -> TextTable:
    path, wanted = lines.path, lines.wanted
    if wanted.time.rate is not None:
        return _by_rate(lines, wanted.time.rate)
    column = _time_column(path, wanted)
    unit = wanted.time.unit
    if unit not in CLOCKS and units.quantity_of(unit) != "time":
        known = ", ".join((*units.QUANTITIES["time"], *CLOCKS))
        raise InputError(f"mapping: time: unit {unit!r} is no unit of time; known: {known}")
    names: list[str | int] = [column, *(ref.name for ref in wanted.columns()), *also]
    if isinstance(wanted.time.week, str):
        names.append(wanted.time.week)
    indices = list(dict.fromkeys(index_of(path, lines.header, name, wanted.delimiter) for name in names))
    stated = lines.units[indices[0]]
    if unit not in CLOCKS and units.quantity_of(stated) == "time" and units.contradiction(stated, unit):
        raise InputError(
            f"mapping: time: the source gives {names[0]!r} in {stated!r}, the mapping says {unit!r}; correct the unit"
        )
    as_text = unit in ("iso", "hms")
    raw = _fast(lines, indices, as_text)
    if raw is None:
        raw = _slow(lines, indices, as_text)
    give_back()
    if not len(raw[indices[0]]):
        raise InputError(f"{path}: no rows below the header")
    seconds, base = times_of(lines, indices[0], raw, wanted, indices[-1] if isinstance(wanted.time.week, str) else None)
    columns = {index: values for index, values in raw.items() if not (as_text and index == indices[0])}
    columns.setdefault(indices[0], seconds)
    return TextTable(path, lines.header, lines.units, columns, seconds, base, lines.notes)


def _time_column(path: Path, wanted: ColumnMapping) -> str | int:
    if wanted.time.column is None:
        key = "expected time: {column: …, unit: s}, or {rate: …} where there is none"
        raise InputError(f"{path}: the mapping names no time column; {key}")
    return wanted.time.column


def _by_rate(lines: _Lines, rate: float) -> TextTable:
    """The columns of a table without times, whose rows follow each other at a rate [Hz]."""
    wanted, missing = lines.wanted, set(lines.missing)
    indices = (index_of(lines.path, lines.header, ref.name, wanted.delimiter) for ref in wanted.columns())
    columns: dict[int, list[float]] = {index: [] for index in indices}
    for number, row in _rows(lines):
        for index, values in columns.items():
            values.append(_number(lines, number, index, row[index].strip() if index < len(row) else "", missing))
    seconds = np.arange(max(map(len, columns.values()), default=0)) / rate
    if not len(seconds):
        raise InputError(f"{lines.path}: no rows below the header")
    arrays = {index: np.array(values) for index, values in columns.items()}
    return TextTable(lines.path, lines.header, lines.units, arrays, seconds, None, lines.notes)


@dataclass
class TextColumns:
    """Columns of a table as texts, with their times: seconds after `base` [ns]."""

    texts: list[list[str]]
    time: Array
    base: int | None
    notes: list[str]


def read_texts(path: Path, wanted: ColumnMapping, names: Sequence[str]) -> TextColumns:
    """Some columns of a table as texts. Raises `InputError` as `read_table` does."""
    lines = _Lines(path, wanted)
    wanted_names = (_time_column(path, wanted), *names)
    time, *others = (index_of(path, lines.header, name, wanted.delimiter) for name in wanted_names)
    as_text = wanted.time.unit in ("iso", "hms")
    clocks: list[Any] = []
    texts: list[list[str]] = [[] for _ in others]
    for number, row in _rows(lines):
        cell = row[time].strip() if time < len(row) else ""
        clock = clock_cell(cell, as_text, wanted)
        if clock is None:
            raise InputError(f"{path}, line {number}: expected a time, found {cell!r}")
        clocks.append(clock)
        for index, column in zip(others, texts, strict=True):
            column.append(row[index].strip() if index < len(row) else "")
    if not clocks:
        raise InputError(f"{path}: no rows below the header")
    raw = {time: pa.chunked_array([pa.array(clocks, pa.string())]) if as_text else np.array(clocks)}
    seconds, base = times_of(lines, time, raw, wanted, None)
    return TextColumns(texts, seconds, base, lines.notes)


class _Lines:
    """The beginning of a table: its encoding, header, units, and where the rows begin and end."""

    def __init__(self, path: Path, wanted: ColumnMapping) -> None:
        self.path, self.wanted = path, wanted
        self.notes: list[str] = []
        self.encoding = wanted.encoding or self._encoding()
        try:
            codecs.lookup(self.encoding)
        except LookupError:
            raise InputError(f"mapping: encoding {self.encoding!r} is not known; examples: utf-8, cp1252") from None
        self.header: list[str] = []
        self.line = 0  # number of lines before the rows
        self.end: int | None = None  # where a last line begins that was cut
        with self.open() as file:
            for _ in range(wanted.skip_lines):
                self._next(file)
            text = self._next(file)
            while text is not None and (not text.strip() or self.is_comment(text)):
                text = self._next(file)
            self.header = [] if text is None else [name.strip() for name in self.split(text)]
            if not any(self.header):
                raise InputError(f"{path}: the file is empty; expected a header line with column names")
            self.units = [unit_in_name(name) for name in self.header]
            self.start, before = file.tell(), self.line
            text = self._next(file)
            if text is not None and self._is_units(self.split(text)):
                cells = [cell.strip() for cell in self.split(text)]
                own = [cell if units.canonical(cell) else "" for cell in cells]
                self.units = [*own, *[""] * len(self.header)][: len(self.header)]
                self.start = file.tell()
                # RaceChrono has another line below, which says where each column comes from, HP Tuners a heading.
                before = self.line
                text = self._next(file)
                while text is not None and not self._has_number(text) and self.line - before < 3:
                    self.start, before = file.tell(), self.line
                    text = self._next(file)
                self.line = before
            else:
                self.line = before
            self._leave_out_cut_line(file)

    def _leave_out_cut_line(self, file: BinaryIO) -> None:
        """End the rows before a last line of which a part is missing: its last number would be another one."""
        size = file.seek(0, io.SEEK_END)
        begin = max(self.start, size - SETTINGS.tail)
        file.seek(begin)
        tail = file.read(SETTINGS.tail)
        if tail.endswith((b"\n", b"\r")):
            return
        *before, last = tail.split(b"\n")
        whole = [self.text(line).rstrip("\r") for line in before[1 if begin > self.start else 0 :] if line.strip()]
        if whole and is_cut(self.text(last), whole, self.wanted.delimiter, self.wanted.decimal):
            self.end = size - len(last)
            shown = self.text(last)[: SETTINGS.longest_shown]
            self.notes.append(f"{self.path.name}: the last line is cut and left out: {shown!r}")

    @property
    def is_wide(self) -> bool:
        """True if a character has several bytes."""
        return self.encoding.lower().startswith(("utf-16", "utf-32"))

    def pieces(self, size: int) -> Iterator[_Lines]:
        """Tables with parts of the rows of this one, each of about `size` bytes; notes are those of the first."""
        begin, line = self.start, self.line
        with self.open() as file:
            last = file.seek(0, io.SEEK_END) if self.end is None else self.end
            while begin < last:
                file.seek(min(begin + size, last))
                file.readline(SETTINGS.longest_line)
                end = min(file.tell(), last)
                piece = copy(self)
                piece.start, piece.line = begin, line
                piece.end = last if last - end < size // 2 else end  # what follows the last row is no piece of its own
                piece.notes = self.notes if begin == self.start else []
                yield piece
                file.seek(begin)
                line += sum(block.count(b"\n") for block in _blocks(file, piece.end - begin))
                begin = piece.end

    def _encoding(self) -> str:
        with self.path.open("rb") as file:
            head = file.read(4)
            if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
                return "utf-16"
            file.seek(0)
            decoder = codecs.getincrementaldecoder("utf-8")()
            try:
                while block := file.read(1 << 20):
                    decoder.decode(block)
                decoder.decode(b"", final=True)
            except UnicodeDecodeError as error:
                if b"\0" in head or b"\0" in error.object[max(error.start - 32, 0) : error.start + 32]:
                    raise InputError(f"{self.path}: not a text table: {error}") from None
                self.notes.append(f"{self.path.name}: not UTF-8; read as cp1252 (key encoding)")
                return "cp1252"
        return "utf-8-sig"

    def open(self) -> BinaryIO:
        """The file in an encoding of which each ASCII character is one byte."""
        if self.is_wide:
            try:
                return io.BytesIO(self.path.read_text(encoding=self.encoding).encode()[: self.end])
            except UnicodeError as error:
                raise InputError(f"{self.path}: not a text in {self.encoding}: {error}") from None
        file = self.path.open("rb")
        return file if self.end is None else io.BufferedReader(Beginning(file, self.end))

    def text(self, line: bytes) -> str:
        return line.decode("utf-8" if self.is_wide else self.encoding, errors="replace").removeprefix("\ufeff")

    def _next(self, file: BinaryIO) -> str | None:
        line = file.readline(SETTINGS.longest_line)
        if not line:
            return None
        if len(line) >= SETTINGS.longest_line:
            raise InputError(
                f"{self.path}, line {self.line + 1}: longer than {SETTINGS.longest_line} bytes, which is no table"
            )
        self.line += 1
        return self.text(line).rstrip("\r\n")

    def is_comment(self, text: str) -> bool:
        """True for a line that the mapping's `comment` begins."""
        return self.wanted.comment is not None and text.lstrip().startswith(self.wanted.comment)

    def split(self, text: str) -> list[str]:
        try:
            return next(csv.reader([text], delimiter=self.wanted.delimiter, skipinitialspace=True), [])
        except csv.Error as error:
            raise InputError(f"{self.path}, line {self.line}: not a table of text: {error}") from None

    def _has_number(self, text: str) -> bool:
        cells = [cell.strip() for cell in self.split(text)]
        return any(
            _is_number(cell, self.wanted.decimal) or ISO.fullmatch(cell) or re.match(CLOCK, cell) for cell in cells
        )

    def _is_units(self, cells: list[str]) -> bool:
        """True if the line below the header has units: no number in it, and a unit that is known."""
        if self.wanted.units_line is not None:
            return self.wanted.units_line
        filled = [cell.strip() for cell in cells if cell.strip() not in _MISSING]
        if not filled or any(_is_number(cell, self.wanted.decimal) or ISO.fullmatch(cell) for cell in filled):
            return False
        return any(units.canonical(cell) not in (None, "1") for cell in filled)

    @property
    def missing(self) -> list[str]:
        return list(dict.fromkeys((*_MISSING, *self.wanted.missing)))


def _blocks(file: BinaryIO, size: int) -> Iterator[bytes]:
    """The next `size` bytes of a file."""
    while size > 0 and (block := file.read(min(SETTINGS.block, size))):
        size -= len(block)
        yield block


def _is_number(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(decimal, "."))
    except ValueError:
        return False
    return True


def _fast(lines: _Lines, indices: list[int], as_text: bool) -> dict[int, Any] | None:
    """The columns by pyarrow; None where something in the file needs a closer look."""
    wanted = lines.wanted
    if wanted.comment is not None or wanted.decimal == wanted.delimiter:
        return None
    names = [str(index) for index in range(len(lines.header))]
    used = [str(index) for index in indices]
    types = {name: pa.string() if as_text and name == used[0] else pa.float64() for name in used}
    with lines.open() as file:
        file.seek(lines.start)
        most = 1 + sum(block.count(b"\n") for block in iter(partial(file.read, SETTINGS.block), b""))
        file.seek(lines.start)
        try:
            reader = pyarrow.csv.open_csv(
                pa.PythonFile(file, mode="r"),
                read_options=pyarrow.csv.ReadOptions(column_names=names, use_threads=False, block_size=SETTINGS.block),
                parse_options=pyarrow.csv.ParseOptions(delimiter=wanted.delimiter),
                convert_options=pyarrow.csv.ConvertOptions(
                    include_columns=used,
                    column_types=types,
                    null_values=lines.missing,
                    strings_can_be_null=True,
                    decimal_point=wanted.decimal,
                    check_utf8=False,
                ),
                memory_pool=pa.system_memory_pool(),  # which gives back what the rest of the program needs
            )
            columns = _filled(reader, types, most)
        except (pa.ArrowInvalid, pa.ArrowTypeError, pa.ArrowNotImplementedError, ValueError):
            return None
    times = columns[used[0]]
    if times.null_count if as_text else not np.isfinite(times).all():
        return None
    return {index: columns[name] for name, index in zip(used, indices, strict=True)}


def _filled(reader: Iterable[Any], types: Mapping[str, Any], most: int) -> dict[str, Any]:
    """The columns of a table by name: arrays of numbers (n,), and texts as pyarrow has them.

    Numbers go into arrays of as many rows as there can be (`most`), which take memory as they are filled: parts that
    were put together at the end would take twice as much.
    """
    numbers = {name: np.empty(most) for name, kind in types.items() if kind != pa.string()}
    texts: dict[str, list[Any]] = {name: [] for name in types if name not in numbers}
    count = 0
    for batch in reader:
        for name, column in numbers.items():
            column[count : count + len(batch)] = batch.column(name).to_numpy(zero_copy_only=False)
        for name, parts in texts.items():
            parts.append(batch.column(name))
        count += len(batch)
    whole = {name: pa.chunked_array(parts, pa.string()) for name, parts in texts.items()}
    return {**whole, **{name: column[:count] for name, column in numbers.items()}}


def _rows(lines: _Lines) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of each row."""
    with lines.open() as file:
        file.seek(lines.start)

        def texts() -> Iterator[str]:
            while line := file.readline(SETTINGS.longest_line):
                yield lines.text(line).replace("\0", "\ufffd")

        rows = csv.reader(texts(), delimiter=lines.wanted.delimiter, skipinitialspace=True)
        try:
            for row in rows:
                # Torque repeats the header after each pause.
                if any(row) and not lines.is_comment(row[0]) and [cell.strip() for cell in row] != lines.header:
                    yield lines.line + rows.line_num, row
        except csv.Error as error:
            raise InputError(f"{lines.path}, line {lines.line + rows.line_num}: not a table of text: {error}") from None


def _slow(lines: _Lines, indices: list[int], as_text: bool) -> dict[int, Any]:
    """The columns row by row; lines at the end that are no rows are left out."""
    time_index, missing = indices[0], set(lines.missing)
    values: dict[int, Any] = {index: [] for index in indices}
    waiting: list[tuple[int, str]] = []  # lines that are no row, if nothing but such follow
    for number, row in _rows(lines):
        cells = [row[index].strip() if index < len(row) else "" for index in indices]
        clock = clock_cell(cells[0], as_text, lines.wanted)
        if clock is None:
            message = (
                f"{lines.path}, line {number}: the time column {lines.header[time_index]!r} is empty; every row needs "
                "a time"
                if cells[0] in missing
                else f"{lines.path}, line {number}, column {lines.header[time_index]!r}: expected a "
                f"{'time' if as_text else 'number'}, found {cells[0]!r}"
            )
            waiting.append((number, message))
            if len(waiting) > SETTINGS.footer or not values[time_index]:
                raise InputError(waiting[0][1])
            continue
        if waiting:
            raise InputError(waiting[0][1])
        values[time_index].append(clock)
        for index, cell in zip(indices[1:], cells[1:], strict=True):
            values[index].append(_number(lines, number, index, cell, missing))
    if waiting:
        lines.notes.append(
            f"{lines.path.name}: {len(waiting)} lines at the end are no rows, from line {waiting[0][0]} on"
        )
    return {
        index: pa.chunked_array([pa.array(column, pa.string())])
        if as_text and index == time_index
        else np.array(column, np.float64)
        for index, column in values.items()
    }


def _number(lines: _Lines, number: int, index: int, cell: str, missing: set[str]) -> float:
    if cell in missing:
        return math.nan
    try:
        return float(cell.replace(lines.wanted.decimal, "."))
    except ValueError:
        shown = cell if len(cell) <= SETTINGS.longest_shown else f"{cell[: SETTINGS.longest_shown]}…"
        raise InputError(
            f"{lines.path}, line {number}, column {lines.header[index]!r}: expected a number, found {shown!r} (cells "
            "without a value: key missing)"
        ) from None
