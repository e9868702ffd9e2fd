"""Files of AiM loggers (`.xrk`, compressed `.xrz`), by libxrk. Each channel has its own times.

Without a mapping GNSS position and speed become topics (the library does not keep the direction of travel); with one
(see `mapping.py`) the channels that it names.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import replace
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path
from typing import Any

import libxrk
import numpy as np

from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.columns import recording_from
from vsense_ros.bag.importers.mapping import Column, Ref
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "aim_xrk"
DESCRIPTION = "log of AiM (.xrk, .xrz)"

_BEGINNING = b"<hCNF"  # of the configuration, with which a log begins
_ENDS = b">)"  # of a message
_TIMES = "timecodes"  # [ms]
_FIX = "GPS_Fix"  # 0: none, 2: of two dimensions, 3: of three
_PLACE = ("GPS Latitude", "GPS Longitude", "GPS Altitude")
_SPEED = "GPS Speed"


def matches(path: Path) -> bool:
    """True if `path` begins with the configuration of a logger, or is named like a compressed log."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_BEGINNING)) == _BEGINNING or path.suffix.lower() in (".xrk", ".xrz")


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """GNSS position and speed, and with a mapping the topics that it makes of the channels, by their names.

    `mapping` is a YAML file or its content; by default the file of the same name with `.yaml`. Time counts from the
    date and time of day that the logger wrote down, taken for UTC, unless the mapping gives another.
    """
    log, notes = _log(path)
    beside = [file for ending in (".yaml", ".yml") if (file := path.with_suffix(ending)).exists()]
    given = mapping if mapping is not None else next(iter(beside), None)
    wanted = mapping_file.load(_usual(path, log) if given is None else given, path)
    if wanted.time.start is None and (start := _start(log, notes)) is not None:
        wanted = wanted.model_copy(update={"time": wanted.time.model_copy(update={"start": start})})
    columns = {name: _column(log, name) for name in log.channels}

    def column(ref: Ref) -> Column:
        if ref.name not in columns:
            raise InputError(f"{path}: no channel {str(ref.name)!r}; found: {', '.join(sorted(columns))}")
        return columns[str(ref.name)]

    recording = recording_from(wanted, column, path.stem, NAME)
    return replace(recording, notes=(*notes, *recording.notes))


def channels(path: Path) -> tuple[dict[str, Array], dict[str, str]]:
    """Values (n,) and units of all channels, by name."""
    log, _ = _log(path)
    columns = {name: _column(log, name) for name in sorted(log.channels)}
    return {name: column.values for name, column in columns.items()}, {n: c.unit for n, c in columns.items()}


def _log(path: Path) -> tuple[libxrk.LogFile, list[str]]:
    """The log, and notes. What the library passes over without a word at the end of a file is noted."""
    data = path.read_bytes()
    if not data:
        raise InputError(f"{path}: the file is empty; expected a log of AiM")
    try:
        # The library prints what it does not know, and divides by zero where a car stands at its first line.
        with redirect_stdout(StringIO()), np.errstate(invalid="ignore", divide="ignore"):
            log = libxrk.aim_xrk(data)
    except (ValueError, LookupError, TypeError, ArithmeticError) as error:
        way = "export it from Race Studio 3 as CSV, which is read, too"
        raise InputError(f"{path}: libxrk cannot read it: {type(error).__name__}: {error}; {way}") from None
    if not log.channels:
        raise InputError(f"{path}: no channel with values in it; expected a log of AiM")
    cut = data.startswith(_BEGINNING) and data[-1] not in _ENDS
    return log, [f"{path.name}: the file ends within a message: it was cut"] if cut else []


def _column(log: libxrk.LogFile, name: str) -> Column:
    table = log.channels[name]
    values = np.asarray(table.column(name).to_numpy(), np.float64)
    if name in (*_PLACE, _SPEED) and _FIX in log.channels:
        fixes = log.channels[_FIX].column(_FIX).to_numpy()
        values = np.where(fixes > 0, values, np.nan) if len(fixes) == len(values) else values
    unit = libxrk.ChannelMetadata.from_channel_table(table).units
    return Column(np.asarray(table.column(_TIMES).to_numpy(), np.float64) / 1000, values, unit)


def _start(log: libxrk.LogFile, notes: list[str]) -> datetime | None:
    """When the log begins by the logger's own clock."""
    text = f"{log.metadata.get('Log Date')} {log.metadata.get('Log Time')}"
    try:
        start = datetime.strptime(text, "%d/%m/%Y %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        notes.append(f"no date in it ({text!r}); its times count from 1970 (key start of time)")
        return None
    notes.append(f"begins at {text} (day, month, year) by the logger's clock, which has no zone; taken for UTC")
    return start


def _usual(path: Path, log: libxrk.LogFile) -> dict[str, Any]:
    """The mapping of what each logger with a receiver has."""
    topics: dict[str, Any] = {}
    if all(name in log.channels for name in _PLACE):
        fields = zip(("latitude", "longitude", "altitude"), _PLACE, ("deg", "deg", "m"), strict=True)
        topics["gps/fix"] = {field: {"column": name, "unit": unit} for field, name, unit in fields}
    if _SPEED in log.channels:
        topics["vehicle/velocity"] = {"speed": {"column": _SPEED, "unit": "m/s"}}
    if not topics:
        held = ", ".join(sorted(log.channels))
        raise InputError(f"{path}: no GNSS in it; its channels need a mapping (proposed by --guess): {held}")
    return {"topics": topics}
