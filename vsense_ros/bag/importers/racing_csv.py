"""CSV files of AiM Race Studio and of RaceChrono: what stands above the header, units below it, known names.

Without a mapping the GNSS columns become topics; with one (see `mapping.py`) whatever it names. The header is found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers import text_table
from vsense_ros.bag.importers.columns import recording_from
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "racing_csv"
DESCRIPTION = "CSV of AiM Race Studio or RaceChrono (.csv)"

_MOST_LINES = 200  # above the header
_TIMES = ("Time", "timestamp", "Timestamp")
_DATES = ("%A, %B %d, %Y", "%a, %b %d, %Y", "%d/%m/%Y", "%Y-%m-%d", "%d.%m.%Y")


def matches(path: Path) -> bool:
    """True if `path` begins like a CSV of one of these."""
    return path.is_file() and _kind(path) is not None


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """The topics that the mapping makes of the table; by default GNSS position and velocity."""
    kind = _kind(path)
    skipped, start = _above(path)
    beside = [f for ending in (".yaml", ".yml") if (f := path.with_suffix(ending)).exists()]
    if mapping is None and beside:
        mapping = beside[0]
    first = mapping_file.load({"topics": {}, "skip_lines": skipped}, path)
    header, _ = text_table.read_header(path, first)
    wanted = mapping_file.load(_usual(path, kind or "", header) if mapping is None else mapping, path)
    time = wanted.time
    if kind == "aim" and time.start is None and start is not None:
        time = time.model_copy(update={"start": start})
    if "skip_lines" in wanted.model_fields_set:  # what a mapping says goes before what is found
        skipped = wanted.skip_lines
    wanted = wanted.model_copy(update={"skip_lines": skipped, "time": time})
    table = text_table.read_table(path, wanted)
    recording = recording_from(wanted, table.column, path.stem, NAME, table.base)
    return replace(recording, notes=(*table.notes, *recording.notes))


def _kind(path: Path) -> str | None:
    if path.suffix.lower() not in (".csv", ".txt"):
        return None
    with path.open("rb") as file:
        head = file.read(2048)
    text = head.decode("utf-8-sig", errors="replace").lower()
    if "aim csv file" in text.partition("\n")[0]:
        return "aim"
    return "racechrono" if "racechrono" in text.partition("\n")[0] else None


def _above(path: Path) -> tuple[int, datetime | None]:
    """Number of lines above the header, and the date and time that stand there."""
    day, clock = None, None
    with path.open("rb") as file:
        for number in range(_MOST_LINES):
            cells = [cell.strip().strip('"') for cell in file.readline(1 << 16).decode("cp1252").strip().split('","')]
            cells = cells if len(cells) > 1 else [cell.strip().strip('"') for cell in cells[0].split(",")]
            while len(cells) > 1 and not cells[-1]:
                cells.pop()  # a spreadsheet fills all lines up to the width of the table
            if cells[0] in _TIMES and len(cells) > 2:
                return number, None if day is None else _moment(day, clock)
            if cells[0] == "Date" and len(cells) > 1:
                day = ", ".join(cells[1:]).strip(", ")
            if cells[0] == "Time" and len(cells) > 1:
                clock = cells[1]
    raise InputError(
        f"{path}: no header in its first {_MOST_LINES} lines: expected a line that begins with Time or timestamp"
    )


def _moment(day: str, clock: str | None) -> datetime | None:
    date = next((d for form in _DATES if (d := _parsed(day, form)) is not None), None)
    if date is None:
        return None
    hour = next(
        (h for form in ("%I:%M:%S %p", "%I:%M %p", "%H:%M:%S", "%H:%M") if (h := _parsed(clock or "", form))), None
    )
    if hour is not None:
        date = date.replace(hour=hour.hour, minute=hour.minute, second=hour.second)
    return date.replace(tzinfo=UTC)


def _parsed(text: str, form: str) -> datetime | None:
    try:
        return datetime.strptime(text.strip(), form)
    except ValueError:
        return None


def _usual(path: Path, kind: str, header: list[str]) -> dict[str, Any]:
    """The mapping of the names that these programs give."""
    names = {
        "aim": ("Time", "GPS Speed", "GPS Heading", "GPS Latitude", "GPS Longitude", "GPS Altitude"),
        "racechrono": ("timestamp", "speed", "bearing", "latitude", "longitude", "altitude"),
    }[kind]
    units = {"aim": (None, "km/h"), "racechrono": ("s", "m/s")}[kind]
    time, *rest = [header.index(name) + 1 if name in header else None for name in names]
    speed, course, latitude, longitude, altitude = rest
    topics: dict[str, Any] = {}
    if latitude and longitude:
        height = {"column": altitude, "unit": "m"} if altitude else None
        topics["gps/fix"] = {
            "latitude": {"column": latitude, "unit": "deg"},
            "longitude": {"column": longitude, "unit": "deg"},
            "altitude": height,
        }
    if speed and course:
        # The unit of a speed is the one that stands below the header; RaceChrono's files without one have m/s.
        unit = {} if kind == "aim" else {"unit": units[1]}
        topics["gps/velocity"] = {
            "speed": {"column": speed, **unit},
            "course": {"column": course, "unit": "deg"},
        }
    if time is None or not topics:
        raise InputError(f"{path}: none of the columns {', '.join(names[1:])} is in it; which is what needs a mapping")
    return {"time": {"column": time, "unit": "s"}, "topics": topics}
