"""CAN logs as text that other programs write: BUSMASTER, CRTD of OVMS, Vehicle Spy, Microchip's CAN bus analyser.

Each is read line by line, so that a damaged line costs itself alone: `lost` is called with what had to be left out.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import can

Lost = Callable[[str], None]
_DAY = 86_400.0  # [s]
_SHOWN = 60  # characters of a line in a message

_CRTD = re.compile(r"(\d+\.\d+) (\d?)(R|T|C|E)(11|29|XX|EV|VB|ER)\b(?: (.*))?")
_BUSMASTER_DATE = re.compile(r"START DATE AND TIME (\d+):(\d+):(\d+) (\d+):(\d+):(\d+):(\d+)")
_BUSMASTER = re.compile(
    r"(?P<hour>\d+):(?P<minute>\d+):(?P<second>\d+):(?P<part>\d{1,4})\s+[RT]x\s+(?P<channel>\d+)\s+(?P<id>\S+)\s+"
    r"(?P<type>[sx]r?)\s+(?P<length>\d+)\s*(?P<data>.*)",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class TextLog:
    """A format: its name, whether the first lines of a file are of it, and its frames."""

    name: str
    begins: Callable[[Sequence[str]], bool]
    frames: Callable[[Path, Lost], Iterator[can.Message]]


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """The lines of a text with their numbers from 1."""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        yield from enumerate(file, 1)


def shown(line: str) -> str:
    """The beginning of a line, in quotes."""
    text = line.strip()
    return repr(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…")


def _frame(
    time: float, identifier: int, extended: bool, channel: str | int | None, data: bytes, *, remote: bool = False
) -> can.Message:
    return can.Message(
        timestamp=time,
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote,
        is_fd=len(data) > 8,
        channel=channel,
        data=data,
    )


def _crtd(path: Path, lost: Lost) -> Iterator[can.Message]:
    """CRTD: `1320745424.002 1R11 402 FA 01 …`, Unix time, bus, identifier of 11 or 29 bits, data, all hexadecimal."""
    for number, line in numbered_lines(path):
        fields = _CRTD.fullmatch(line.strip())
        if fields is None:
            if line.strip():
                lost(f"line {number} is not a CRTD record: {shown(line)}")
            continue
        time, bus, direction, kind, rest = fields.groups()
        if direction in "CE" or kind not in ("11", "29"):
            continue  # comments and events
        try:
            identifier, *data = (rest or "").split()
            content = bytes(int(byte, 16) for byte in data)
            yield _frame(float(time), int(identifier, 16), kind == "29", bus or "1", content)
        except ValueError:
            lost(f"line {number} is not a CRTD record: {shown(line)}")


def _busmaster(path: Path, lost: Lost) -> Iterator[can.Message]:
    """BUSMASTER: times of day to 0.1 ms after the date of the head, or times since the start, absolute or relative."""
    base, total, last, days, numbers = 0.0, 0.0, 0.0, 0, 16
    mode = "SYSTEM"
    for number, line in numbered_lines(path):
        if line.lstrip("-").startswith("***"):
            started = _BUSMASTER_DATE.search(line)
            if started is not None:
                base = _busmaster_start(started, lost)
            mode = next((name for name in ("SYSTEM", "ABSOLUTE", "RELATIVE") if f"***{name} MODE" in line), mode)
            numbers = 10 if line.startswith("***DEC***") else 16 if line.startswith("***HEX***") else numbers
            continue
        fields = _BUSMASTER.fullmatch(line.strip())
        if fields is None:
            if line.strip():
                lost(f"line {number} is not a frame of BUSMASTER: {shown(line)}")
            continue
        hour, minute, second, part = (int(fields[name]) for name in ("hour", "minute", "second", "part"))
        time = (hour * 60 + minute) * 60 + second + part * 1e-4
        if mode == "RELATIVE":
            total = time = total + time
        elif mode == "SYSTEM":
            days += time < last - _DAY / 2
            last = time
            time += days * _DAY
        midnight = base - base % _DAY if mode == "SYSTEM" else base
        remote = fields["type"].lower().endswith("r")
        try:
            content = b"" if remote else bytes(int(byte, numbers) for byte in fields["data"].split())
            if not remote and len(content) != int(fields["length"]):
                raise ValueError("length")
            extended = fields["type"].lower().startswith("x")
            identifier = int(fields["id"], 0 if fields["id"].lower().startswith("0x") else numbers)
            yield _frame(midnight + time, identifier, extended, fields["channel"], content, remote=remote)
        except ValueError:
            lost(f"line {number} is not a frame of BUSMASTER: {shown(line)}")


def _busmaster_start(fields: re.Match[str], lost: Lost) -> float:
    """Unix time of the start of a log, which has no time zone and is taken for UTC; 0 where it is no date."""
    day, month, year, hour, minute, second, millisecond = map(int, fields.groups())
    try:
        start = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        lost(f"{fields[0]!r} is no date; the times count from 1970")
        return 0.0
    return start.timestamp() + millisecond * 1e-3


def _vehicle_spy(path: Path, lost: Lost) -> Iterator[can.Message]:
    """Vehicle Spy's CSV: columns by their names, `Abs Time(Sec)` from the start of the log."""
    place: dict[str, int] = {}
    for number, line in numbered_lines(path):
        cells = [cell.strip() for cell in next(csv.reader([line]), [])]
        names = [cell.lower() for cell in cells]
        if "arb id" in names and names[0] == "line":
            place = {name: index for index, name in enumerate(names)}
            continue
        if not place or not cells or not cells[0].isdigit():
            continue
        try:
            time = float(cells[next(place[name] for name in place if name.startswith("abs time"))])
            bytes_ = [cells[place[f"b{i}"]] for i in range(1, 65) if place.get(f"b{i}", len(cells)) < len(cells)]
            content = bytes(int(byte, 16) for byte in bytes_ if byte)
            extended, remote = (cells[place[name]].upper().startswith("T") for name in ("xtd", "remote"))
            network = cells[place["network"]] if "network" in place else None
            yield _frame(time, int(cells[place["arb id"]], 16), extended, network, content, remote=remote)
        except (ValueError, IndexError, KeyError, StopIteration):
            lost(f"line {number} is not a frame of Vehicle Spy: {shown(line)}")


def _microchip(path: Path, lost: Lost) -> Iterator[can.Message]:
    """Microchip's CAN bus analyser: `1247;RX;0xC2;8;0x5C;…`, milliseconds from the start of the log.

    Eight bytes are written whatever the length.
    """
    in_head = False
    for number, line in numbered_lines(path):
        if line.startswith("//"):
            in_head = not in_head
            continue
        if in_head or not line.strip():
            continue
        try:
            time, _, identifier, length, *data = line.strip().rstrip(";").split(";")
            content = bytes(int(byte, 0) for byte in data[: int(length)])
            if len(content) != int(length):
                raise ValueError("length")
            address = int(identifier, 0)
            yield _frame(float(time) * 1e-3, address, address > 0x7FF, None, content)
        except ValueError:
            lost(f"line {number} is not a frame of Microchip's analyser: {shown(line)}")


TEXT_LOGS: tuple[TextLog, ...] = (
    TextLog("busmaster", lambda lines: any("***BUSMASTER" in line.upper() for line in lines[:3]), _busmaster),
    TextLog("crtd", lambda lines: sum(_CRTD.fullmatch(line.strip()) is not None for line in lines[:5]) > 1, _crtd),
    TextLog(
        "vehicle_spy",
        lambda lines: any(line.lower().startswith("line,") and "arb id" in line.lower() for line in lines),
        _vehicle_spy,
    ),
    TextLog(
        "microchip",
        lambda lines: any(re.match(r"\d+;[RT]X;0x[0-9A-Fa-f]+;\d;", line) is not None for line in lines[:20]),
        _microchip,
    ),
)
