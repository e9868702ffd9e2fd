"""Racelogic VBOX text files (`.vbo`): GNSS, and by a mapping any other of their columns.

Latitude and longitude are in minutes of arc, longitude positive to the west; the time is UTC of the day, packed as
HHMMSS.ss; the date stands in the first line.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.columns import recording_from
from vsense_ros.bag.importers.cut_text import is_cut
from vsense_ros.bag.importers.mapping import Column, Ref
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording

NAME = "racelogic_vbo"
DESCRIPTION = "Racelogic VBOX text (.vbo)"

_CREATED = re.compile(r"File created on (\d{1,2})/(\d{1,2})/(\d{4})(?:\s*@?\s*(\d{1,2}):(\d{2}))?", re.IGNORECASE)
_KMH, _KNOT = 1.0 / 3.6, 1852.0 / 3600.0
_DAY = 86_400.0  # [s]
_USED = ("time", "lat", "long")
_GNSS = (*_USED, "sats", "velocity", "heading", "height", "vert-vel")
_NOT_ASCII = bytes(range(128, 256))
_LONGEST_HEAD = 1 << 20  # [byte]
_TAIL = 1 << 14  # [byte] at the end, by which it is seen if the last line was cut


def matches(path: Path) -> bool:
    """True if `path` has the sections of a VBO file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(4096).lower()
    return (b"[header]" in head and b"file created on" in head) or (path.suffix.lower() == ".vbo")


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """GNSS position and velocity, and with a mapping the topics that it makes of the columns, by their names."""
    notes: list[str] = []
    head, names, table = _content(path, notes)
    seconds, base = _times(path, head, table["time"], notes)
    stamp = build.nanoseconds(seconds, base)
    channels = _gnss(path, table, stamp)
    if mapping is not None:
        wanted = mapping_file.load(mapping, path)

        def column(ref: Ref) -> Column:
            if ref.name not in table:
                raise InputError(f"{path}: no column {ref.name!r}; found: {', '.join(names)}")
            return Column(seconds, table[str(ref.name)])

        more = recording_from(wanted, column, path.stem, NAME, base)
        channels |= more.channels
        notes += more.notes
    rest = [name for name in names if name not in _GNSS]
    if rest and mapping is None:
        notes.append(f"columns that have no topic without a mapping: {', '.join(rest)}")
    return Recording(channels, path.stem, tuple(notes), 0, {"source": NAME})


def other_columns(path: Path) -> tuple[dict[str, Array], dict[str, str]]:
    """The columns that have no topic without a mapping, by name, and their units where the file states them."""
    head, names, table = _content(path, [])
    stated = _section(head, "channel units").split()  # of the channels that are no GNSS, which stand last
    units = dict(zip(names[-len(stated) :], stated, strict=True)) if 0 < len(stated) <= len(names) else {}
    return {name: table[name] for name in names if name not in _GNSS}, units


def _content(path: Path, notes: list[str]) -> tuple[str, list[str], dict[str, Array]]:
    """What stands above the data, the names of the columns, and the columns by name."""
    data = path.read_bytes()
    at = data.lower().find(b"[data]", 0, _LONGEST_HEAD)
    if at < 0:
        what = "the file is empty" if not data else "it has no section [data]"
        raise InputError(f"{path}: not a VBO file: {what}")
    head = data[:at].decode("cp1252", errors="replace")
    names = ["long" if name == "lng" else name for name in _section(head, "column names").split()]  # as RaceBox has it
    missing = [name for name in _USED if name not in names]
    if missing:
        raise InputError(
            f"{path}: no column {missing[0]!r}; its section [column names] has: {', '.join(names) or 'nothing'}"
        )
    rows = _whole_lines(path, data[data.find(b"\n", at) + 1 :], notes)
    return head, names, _table(path, rows, names, notes)


def _whole_lines(path: Path, rows: bytes, notes: list[str]) -> bytes:
    """The rows without a last one that was cut."""
    *before, last = rows[-_TAIL:].split(b"\n")
    whole = [line.decode("cp1252", errors="replace").strip() for line in before[1:] if line.strip()]
    if last.strip() and whole and is_cut(last.decode("cp1252", errors="replace").strip(), whole, " "):
        notes.append(f"{path.name}: the last line is cut and left out: {last[:60]!r}")
        return rows[: len(rows) - len(last)]
    return rows


def _section(head: str, name: str) -> str:
    match = re.search(rf"\[{name}\]\s*\n(.*?)(?=\n\s*\[|\Z)", head, re.IGNORECASE | re.DOTALL)
    return match[1] if match else ""


def _table(path: Path, rows: bytes, names: list[str], notes: list[str]) -> dict[str, Array]:
    """Columns by name; rows with another number of values are left out."""
    odd = 0

    def skip(row: Any) -> str:
        nonlocal odd
        odd += 1
        return "skip"

    places = [str(index) for index in range(len(names))]
    plain = (
        b"\n".join(line.strip() for line in rows.replace(b"+", b"").replace(b"\t", b" ").split(b"\n"))
        if b"  " in rows[:4096] or b"\r" in rows[:4096] or b" \n" in rows[:4096]
        else rows.replace(b"+", b"")
    )
    while b"  " in plain:
        plain = plain.replace(b"  ", b" ")
    plain = plain.translate(None, _NOT_ASCII)
    try:
        table = pyarrow.csv.read_csv(
            BytesIO(plain),
            read_options=pyarrow.csv.ReadOptions(column_names=places, use_threads=False),
            parse_options=pyarrow.csv.ParseOptions(delimiter=" ", invalid_row_handler=skip),
            convert_options=pyarrow.csv.ConvertOptions(
                column_types=dict.fromkeys(places, pa.float64()), null_values=["", "-", "nan", "NaN"]
            ),
        )
    except (pa.ArrowInvalid, ValueError) as error:
        raise InputError(f"{path}: the section [data] holds something else than numbers: {error}") from None
    columns: dict[str, Array] = {}
    for place, name in zip(places, names, strict=True):
        columns.setdefault(name, table.column(place).to_numpy())
    if not len(columns["time"]):
        raise InputError(f"{path}: no rows in the section [data]")
    if odd:
        notes.append(f"{path.name}: {odd} rows with another number of values than {len(names)} left out")
    return columns


def _times(path: Path, head: str, packed: Array, notes: list[str]) -> tuple[Array, int]:
    """Seconds after the returned midnight [ns] of packed times of day."""
    if not np.isfinite(packed).all():
        raise InputError(f"{path}: {int((~np.isfinite(packed)).sum())} rows have no time")
    hours, rest = np.divmod(packed, 10_000.0)
    minutes, parts = np.divmod(rest, 100.0)
    if not ((hours < 24) & (minutes < 60) & (parts < 61) & (packed >= 0)).all():
        raise InputError(f"{path}: the column time is not packed as HHMMSS.ss")
    seconds = np.round((hours * 60 + minutes) * 60 + parts, 6)
    seconds += _DAY * np.concatenate([[0], np.cumsum(np.diff(seconds) < -_DAY / 2)])
    created = _CREATED.search(head)
    if created is None:
        notes.append(f"{path.name}: no date in it; its times count from 1970")
        return seconds, 0
    day, month, year = (int(part) for part in created.groups()[:3])
    try:
        midnight = datetime(year, month, day, tzinfo=UTC)
    except ValueError:
        notes.append(f"{path.name}: {created[0]!r} is no date; its times count from 1970")
        return seconds, 0
    return seconds, round(midnight.timestamp()) * 1_000_000_000


def _gnss(path: Path, table: Mapping[str, Array], stamp: build.Stamps) -> dict[str, Channel]:
    rows = len(stamp)
    absent = np.full(rows, np.nan)
    sats = table.get("sats")
    # The lower six bits are the number of satellites; without any the receiver repeats its last fix.
    good = np.ones(rows, bool) if sats is None else (np.nan_to_num(sats).astype(np.int64) & 63) > 0
    latitude = np.where(good, table["lat"] / 60.0, np.nan)
    longitude = np.where(good, -table["long"] / 60.0, np.nan)
    channels = {"gps/fix": build.fix(stamp, latitude, longitude, table.get("height", absent))}
    if "velocity" in table and "heading" in table:
        speed = np.where(good, table["velocity"] * _KMH, np.nan)
        up = table["vert-vel"] * _KMH if "vert-vel" in table else None
        channels["gps/velocity"] = build.velocity(stamp, build.course_velocity(speed, np.radians(table["heading"]), up))
    return channels
