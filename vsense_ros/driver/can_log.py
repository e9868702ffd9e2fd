"""CAN logs of any format: candump, Vector ASC and BLF, PEAK TRC, GVRET and python-can CSV, MDF4 bus logging, and the
texts of `can_text_logs`.

The format is known by the beginning of a file. What python-can reads is read by it; candump and GVRET are read here, so
that a damaged line costs itself alone, and because python-can knows neither candump's form for people nor GVRET.

Times are Unix times where the log has a date: a date without a time zone is taken for UTC. Where it has none they
count from the start of the log, which `CanFrames.counts_from_zero` says.
"""

from __future__ import annotations

import csv
import logging
import math
import re
import struct
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import can
import numpy as np
from can.io.asc import ASCReader
from numpy.typing import NDArray

from vsense_ros.driver.can_frames import CanFrames
from vsense_ros.driver.can_frames_fast import asc_frames, blf_frames
from vsense_ros.driver.can_text_logs import TEXT_LOGS, TextLog, numbered_lines, shown
from vsense_ros.driver.mdf import make_asammdf_careful
from vsense_ros.errors import InputError

FORMATS = (
    "candump, Vector ASC and BLF, PEAK TRC, GVRET and python-can CSV, MDF4, BUSMASTER, CRTD, Vehicle Spy CSV, Microchip"
)
_BLF_SIZE = struct.Struct("<16xQ")  # of the file [byte], in its header
_LONGEST_LINE = 4096  # [byte] that the last line of a text log is looked for in
_MOST_LOSSES = 50  # that are reported one by one

# (time) channel id#data, id##flags data (FD), id#R (remote); or for people: (time) channel [RX -] id [length] data
_CANDUMP = re.compile(
    r"\s*\((?P<time>[^)]{1,40})\)\s+(?P<channel>\S{1,16})\s+(?:(?:RX|TX)\s+[-\w ]{1,4}\s+)?(?P<id>[0-9A-Fa-f]{3,8})"
    r"(?:#(?P<fd>#[0-9A-Fa-f])?(?P<data>R?[0-9A-Fa-f]*)(?:\s+[RT])?|\s+\[(?P<length>\d{1,2})\]\s*"
    r"(?P<bytes>remote request|(?:[0-9A-Fa-f]{2}\s*)*)(?:\s*'.*')?)\s*"
)
_VIEW_WITHOUT_TIME = re.compile(r"\s*\S{1,16}\s+[0-9A-Fa-f]{3,8}\s+\[\d{1,2}\]\s+([0-9A-Fa-f]{2}\s*)*\s*")
_NO_TRC = re.compile(r"(?!\s*(?:\d+\)?\s|;|$))")
_NO_ASC = re.compile(r"(?i)(?!\s*(?:-?\d+(?:\.\d+)?\s|//|(?:date|base|begin|end|previous|no|internal)\b|\$|$))")
_GVRET = ("time stamp", "id", "extended")


class CanLog:
    """The messages of a log file, in the order of the file.

    Iterating yields every intact message; what had to be left out is then in `losses`. `InputError` if not one
    message was intact.
    """

    def __init__(self, path: Path, read: Callable[[CanLog], Iterator[can.Message]], format_: str) -> None:
        self.path = path
        self.format = format_
        self.losses: list[str] = []
        self._lost = 0
        self._read = read

    def lost(self, what: str) -> None:
        """Note a loss."""
        self._lost += 1
        if self._lost <= _MOST_LOSSES:
            self.losses.append(what)

    def first_time(self) -> float | None:
        """Time of the first message [s]; None where none is intact."""
        try:
            return next(iter(self)).timestamp
        except (InputError, StopIteration):
            return None

    def __iter__(self) -> Iterator[can.Message]:
        self.losses.clear()
        self._lost = 0
        count = 0
        try:
            for message in self._read(self):
                if math.isfinite(message.timestamp):
                    count += 1
                    yield message
                else:
                    self.lost(f"message {count} has no time")
        # python-can's readers let through whatever their parsing stumbles over.
        except (
            can.CanError,
            ValueError,
            LookupError,
            OSError,
            EOFError,
            struct.error,
            TypeError,
            AttributeError,
        ) as error:
            self.lost(f"unreadable after message {count}: {error}")
        except Exception as error:
            if type(error).__module__.partition(".")[0] not in ("asammdf", "can", "zlib"):
                raise
            self.lost(f"unreadable after message {count}: {error}")
        if self._lost > _MOST_LOSSES:
            self.losses.append(f"and {self._lost - _MOST_LOSSES} more")
        if count == 0:
            why = f": {self.losses[0]}" if self.losses else ""
            raise InputError(f"{self.path}: not one intact CAN message found{why}; is it a {self.format} log?")


def format_of(path: Path) -> str | None:
    """The format of a CAN log by its beginning: `candump`, `asc`, `blf`, `trc`, `gvret`, `csv`, `mf4`, or the name of
    one of `TEXT_LOGS`; None: none."""
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except OSError:
        return None
    binary = _binary_format(head)
    lines = [line for line in head.decode("utf-8-sig", errors="replace").splitlines() if line.strip()]
    if binary is not None or not lines:
        return binary or None
    recognised = (name for name, begins in _TEXT_BEGINNINGS.items() if begins(lines, path.suffix.lower()))
    return next(recognised, None) or next((log.name for log in TEXT_LOGS if log.begins(lines)), None)


def _binary_format(head: bytes) -> str | None:
    """The format of a binary log; an empty name for one of which nothing can be read, None for text."""
    if head.startswith(b"LOGG"):
        return "blf"
    if head.startswith(b"MDF"):
        # asammdf recurses without end when it drops a file whose header it could not read.
        return "mf4" if head[64:68] == b"##HD" else ""
    return None


def _begins_as_asc(lines: Sequence[str], suffix: str) -> bool:
    beginnings = [line.strip().lower() for line in lines[:6]]
    return beginnings[0].startswith("date ") or any(line.startswith(("base hex", "base dec")) for line in beginnings)


def _begins_as_trc(lines: Sequence[str], suffix: str) -> bool:
    first = lines[0].strip().lower()
    return first.startswith((";$fileversion", ";##")) or (first.startswith(";") and suffix == ".trc")


def _begins_as_gvret(lines: Sequence[str], suffix: str) -> bool:
    return tuple(name.strip() for name in lines[0].strip().lower().split(","))[:3] == _GVRET


def _begins_as_csv(lines: Sequence[str], suffix: str) -> bool:
    return lines[0].strip().lower().startswith("timestamp,arbitration_id,")


def _begins_as_candump(lines: Sequence[str], suffix: str) -> bool:
    return any(_CANDUMP.fullmatch(line) or _VIEW_WITHOUT_TIME.fullmatch(line) for line in lines[:20])


# How text logs begin, given their first lines and the ending of the file's name; the first that fits counts.
_TEXT_BEGINNINGS: dict[str, Callable[[Sequence[str], str], bool]] = {
    "asc": _begins_as_asc,
    "trc": _begins_as_trc,
    "gvret": _begins_as_gvret,
    "csv": _begins_as_csv,
    "candump": _begins_as_candump,
}


def read_can_log(path: str | Path) -> CanLog:
    """Open a CAN log. `InputError` if there is no such file, or if it is none."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a CAN log ({FORMATS})")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; expected a CAN log ({FORMATS})")
    form = format_of(path)
    if form is None:
        raise InputError(f"{path}: not a CAN log; expected {FORMATS}")
    readers: dict[str, Callable[[CanLog], Iterator[can.Message]]] = {
        "candump": _candump,
        "asc": _asc,
        "gvret": _gvret,
        "blf": lambda log: _python_can(log, can.BLFReader(log.path)),
        "trc": _trc,
        "csv": lambda log: _python_can(log, can.CSVReader(log.path)),
        "mf4": _mf4,
        **{text_log.name: _of_text(text_log) for text_log in TEXT_LOGS},
    }
    return CanLog(path, readers[form], form)


def read_frames(path: str | Path) -> CanFrames:
    """All data frames of a log as columns: at once where a file is whole and has classic frames alone, else one by
    one."""
    log = read_can_log(path)
    fast = {"blf": blf_frames, "asc": asc_frames}.get(log.format)
    frames = None if fast is None else fast(log.path, log.first_time)
    return _as_it_ends(log, _one_by_one(log) if frames is None else frames)


def _as_it_ends(log: CanLog, frames: CanFrames) -> CanFrames:
    """The frames with a note if the file was cut."""
    if log.format == "blf":
        return replace(frames, losses=(*frames.losses, *_cut_off(log)))
    return _without_cut_line(log, frames) if log.format in ("asc", "trc", "gvret") else frames


def _without_cut_line(log: CanLog, frames: CanFrames) -> CanFrames:
    """The frames of a text log; where its last line has no end, a note, and no frame whose last byte lacks a digit."""
    size = log.path.stat().st_size
    with log.path.open("rb") as file:
        file.seek(max(size - _LONGEST_LINE, 0))
        last = file.read().replace(b"\r", b"\n").rpartition(b"\n")[2].decode(errors="replace")
    if not last.strip():
        return frames
    losses = (*frames.losses, f"the last line has no end, as if the file was cut: {shown(last)}")
    digit_lacks = re.search(r"\b[0-9A-Fa-f]{2}[ ,][0-9A-Fa-f]\Z", last) is not None
    count = len(frames) - (1 if digit_lacks and len(frames) else 0)
    columns = ("time", "identifier", "is_extended", "channel", "length", "begin")
    return replace(frames, losses=losses, **{name: getattr(frames, name)[:count] for name in columns})


def _cut_off(log: CanLog) -> list[str]:
    """A note if the header of a BLF file states more bytes than there are; a logger that died states none."""
    with log.path.open("rb") as file:
        head = file.read(_BLF_SIZE.size)
    size = log.path.stat().st_size
    stated = _BLF_SIZE.unpack(head)[0] if len(head) == _BLF_SIZE.size else 0
    return [f"the file was cut: its header states {stated} bytes, it has {size}"] if stated > size else []


def frames_in_pieces(path: str | Path, count: int) -> Iterator[CanFrames]:
    """The data frames of a log of any size, `count` at a time, read one by one."""
    log = read_can_log(path)
    waiting: CanFrames | None = None
    for piece in _collected(log, count):
        if waiting is not None:
            yield waiting
        waiting = piece
    assert waiting is not None  # a log without frames is refused
    yield _as_it_ends(log, waiting)


def _one_by_one(log: CanLog) -> CanFrames:
    return next(_collected(log))


class _Columns:
    """Data frames that are collected one by one."""

    def __init__(self) -> None:
        self.time, self.begin, self.identifier = array("d"), array("q"), array("I")
        self.length, self.is_extended, self.channel = array("B"), array("B"), array("h")
        self.data = bytearray()

    def add(self, message: can.Message, channel: int) -> None:
        """One more frame, on the channel of a number."""
        self.begin.append(len(self.data))
        self.data += message.data
        self.time.append(message.timestamp)
        self.identifier.append(message.arbitration_id)
        self.length.append(len(message.data))
        self.is_extended.append(message.is_extended_id)
        self.channel.append(channel)

    def frames(self, seconds: NDArray[np.float64], channels: Iterable[Any], losses: Sequence[str]) -> CanFrames:
        """The frames, at times [s] that may be others than those of the log."""
        return CanFrames(
            seconds,
            np.array(self.identifier, np.uint32),
            np.array(self.is_extended, bool),
            np.array(self.channel, np.int16),
            tuple("" if name is None else str(name) for name in channels),
            np.array(self.length, np.int64),
            np.array(self.begin, np.int64),
            np.frombuffer(bytes(self.data), np.uint8),
            tuple(losses),
        )


def _collected(log: CanLog, most: int | None = None) -> Iterator[CanFrames]:
    """The data frames of a log, at most so many at a time."""
    numbers: dict[Any, int] = {}
    columns = _Columns()
    reported, are_steps, passed = 0, None, 0.0

    def piece() -> CanFrames:
        nonlocal reported, are_steps, passed
        seconds = np.array(columns.time, np.float64)
        losses = log.losses[reported:]
        reported = len(log.losses)
        if are_steps is None:
            are_steps = log.format == "candump" and len(seconds) > 10 and np.mean(np.diff(seconds) < 0) > 0.05
            losses += ["the times are steps from frame to frame (candump -td); summed up"] if are_steps else []
        if are_steps:
            seconds = passed + np.cumsum(seconds)
            passed = float(seconds[-1]) if len(seconds) else passed
        return columns.frames(seconds, numbers, losses)

    for message in log:
        if message.is_error_frame or message.is_remote_frame:
            continue
        number = numbers.setdefault(message.channel, len(numbers))
        if most is not None and len(columns.time) == most:
            yield piece()
            columns = _Columns()
        columns.add(message, number)
    yield piece()


def _candump(log: CanLog) -> Iterator[can.Message]:
    """Both forms of candump, line by line, so that a damaged line costs itself alone."""
    timeless = 0
    for number, line in numbered_lines(log.path):
        fields = _CANDUMP.fullmatch(line)
        if fields is None:
            if not line.strip():
                continue
            timeless += bool(_VIEW_WITHOUT_TIME.fullmatch(line))
            if timeless == 20:
                raise InputError(f"{log.path}: candump wrote no times; record it with 'candump -L' or 'candump -ta'")
            log.lost(f"line {number} is not a candump message: {shown(line)}")
            continue
        moment, channel, identifier, fd, data, length, viewed = fields.groups()
        data = viewed if data is None else data
        is_remote = data.startswith(("R", "remote"))
        try:
            stamp = float(moment) if moment.strip()[:1].isdigit() and "-" not in moment else _moment(moment)
            content = b"" if is_remote else bytes.fromhex(data)
            if length is not None and len(content) != int(length) and not is_remote:
                raise ValueError("length")
            yield can.Message(
                timestamp=stamp,
                arbitration_id=int(identifier, 16) & 0x1FFFFFFF,
                is_extended_id=len(identifier) > 3,
                is_remote_frame=is_remote,
                is_error_frame=len(identifier) > 3 and bool(int(identifier, 16) & 0x20000000),
                is_fd=fd is not None or len(content) > 8,
                channel=channel,
                data=content,
            )
        except ValueError:
            log.lost(f"line {number} is not a candump message: {shown(line)}")


def _moment(text: str) -> float:
    """Unix time of a date and time of day; one without a time zone is UTC."""
    moment = datetime.fromisoformat(text.strip())
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _gvret(log: CanLog) -> Iterator[can.Message]:
    """GVRET as SavvyCAN writes it; times in microseconds."""
    with log.path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        rows = csv.reader(line.replace("\0", "") for line in file)
        header = [name.strip().lower() for name in next(rows, [])]
        place = {name: index for index, name in enumerate(header)}
        first = place.get("d1", len(header))
        at_length = place.get("len", first - 1)
        bus = place.get("bus")
        for row in rows:
            if not row:
                continue
            try:
                count = int(row[at_length])
                content = bytes(int(cell, 16) for cell in row[first : first + count])
                if len(content) != count:
                    raise ValueError("length")
                yield can.Message(
                    timestamp=float(row[0]) * 1e-6,
                    arbitration_id=int(row[1], 16),
                    is_extended_id=row[2].strip().lower() in ("true", "1"),
                    is_fd=count > 8,
                    channel=None if bus is None else row[bus].strip(),
                    data=content,
                )
            except (ValueError, IndexError):
                log.lost(f"line {rows.line_num} is not a GVRET row: {shown(','.join(row))}")


class _Asc(ASCReader):
    """python-can's reader of ASC; a frame that it cannot parse is left out, and the date of the header is UTC."""

    def __init__(self, log: CanLog) -> None:
        super().__init__(log.path, relative_timestamp=False)
        self._log = log

    def _process_classic_can_frame(self, line: str, msg_kwargs: dict[str, Any]) -> can.Message:
        try:
            return super()._process_classic_can_frame(line, msg_kwargs)
        except (ValueError, IndexError):
            self._log.lost(f"not a frame: {shown(line)}")
            return None  # type: ignore[return-value]

    def _process_fd_can_frame(self, line: str, msg_kwargs: dict[str, Any]) -> can.Message:
        try:
            return super()._process_fd_can_frame(line, msg_kwargs)
        except (ValueError, IndexError):
            self._log.lost(f"not a frame: {shown(line)}")
            return None  # type: ignore[return-value]

    @staticmethod
    def _datetime_to_timestamp(datetime_string: str) -> float:
        # AM and PM are written in other ways by Windows in some languages.
        try:
            naive = datetime.fromtimestamp(ASCReader._datetime_to_timestamp(datetime_string))
        except ValueError:
            return 0.0
        return naive.replace(tzinfo=UTC).timestamp()


def _asc(log: CanLog) -> Iterator[can.Message]:
    """Vector ASC; python-can passes over lines that are none of its events without a word."""
    with _Asc(log) as reader:
        total = 0.0
        for message in reader:
            if reader.timestamps_format == "relative":  # each from the one before it
                total += message.timestamp - reader.start_time
                message.timestamp = reader.start_time + total
            yield message
    _say_lines(log, _NO_ASC, "event of ASC")


def _trc(log: CanLog) -> Iterator[can.Message]:
    """PEAK TRC; python-can passes over lines that do not begin with the number of a message without a word."""
    yield from _python_can(log, can.TRCReader(log.path))
    _say_lines(log, _NO_TRC, "message of TRC")


def _say_lines(log: CanLog, strange: re.Pattern[str], expected: str) -> None:
    """Note the lines that match a pattern, which are not what is expected."""
    for number, line in numbered_lines(log.path):
        if strange.match(line):
            log.lost(f"line {number} is no {expected}: {shown(line)}")


def _of_text(text_log: TextLog) -> Callable[[CanLog], Iterator[can.Message]]:
    return lambda log: text_log.frames(log.path, log.lost)


def _mf4(log: CanLog) -> Iterator[can.Message]:
    make_asammdf_careful()
    yield from _python_can(log, can.MF4Reader(log.path))


def _python_can(log: CanLog, reader: Any) -> Iterator[can.Message]:
    said = _Said(log)
    logger = logging.getLogger("can")
    logger.addHandler(said)
    try:
        with reader:
            yield from reader
    finally:
        logger.removeHandler(said)


class _Said(logging.Handler):
    """What python-can says of lines that it leaves out becomes a loss of the log."""

    def __init__(self, log: CanLog) -> None:
        super().__init__(logging.WARNING)
        self._log = log

    def emit(self, record: logging.LogRecord) -> None:
        self._log.lost(record.getMessage())
