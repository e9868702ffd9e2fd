"""The fields of NMEA 0183 sentences (version 4.11) that are decoded, by their places."""

from __future__ import annotations

import datetime
import re
from collections.abc import Callable, Sequence
from typing import Any

from vsense_ros.driver.monitor import NANO

_TIME = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d{1,6}))?")
_DATE = re.compile(r"(\d\d)(\d\d)(\d\d)")
_FIRST_YEAR = 69  # of two digits that belongs to 1900, as POSIX has it


def _text(fields: Sequence[str], place: int) -> str:
    return fields[place]


def _text_if_any(fields: Sequence[str], place: int) -> str:
    """A field that sentences of older versions lack."""
    return fields[place] if place < len(fields) else ""


def _number(fields: Sequence[str], place: int) -> float | None:
    """A number; None if the field is empty or beyond what any receiver states."""
    number = float(fields[place]) if fields[place] else None
    return number if number is not None and abs(number) < 1e9 else None


def _whole(fields: Sequence[str], place: int) -> int | None:
    """A whole number; None if the field is empty."""
    return int(fields[place]) if fields[place] else None


def _angle(fields: Sequence[str], place: int) -> float | None:
    """Latitude or longitude [deg] from degrees and minutes, dddmm.mm, with the hemisphere in the next field; None if
    there is none."""
    text, hemisphere = fields[place], fields[place + 1]
    minutes = text.find(".") - 2
    if minutes < 2:
        return None
    try:
        angle = abs(float(text[:minutes])) + float(text[minutes:]) / 60
    except ValueError:
        return None
    return -angle if hemisphere in ("S", "W") else angle


def _time(fields: Sequence[str], place: int) -> int | None:
    """UTC time of day [ns]; None if there is none."""
    match = _TIME.fullmatch(fields[place])
    if match is None:
        return None
    hour, minute, second = int(match[1]), int(match[2]), int(match[3])
    if hour > 23 or minute > 59 or second > 59:
        return None
    microseconds = int(match[4].ljust(6, "0")) if match[4] else 0
    return ((hour * 60 + minute) * 60 + second) * NANO + microseconds * 1000


def _date(fields: Sequence[str], place: int) -> datetime.date | None:
    """A date; None if there is none."""
    match = _DATE.fullmatch(fields[place])
    if match is None:
        return None
    day, month, year = int(match[1]), int(match[2]), int(match[3])
    try:
        return datetime.date(year + (1900 if year >= _FIRST_YEAR else 2000), month, day)
    except ValueError:
        return None


_POSITION = (("time", 0, _time), ("latitude", 1, _angle), ("longitude", 3, _angle))
_HEIGHT = (("hdop", 7, _number), ("altitude", 8, _number))
SENTENCES: dict[str, tuple[tuple[str, int, Callable[[Sequence[str], int], Any]], ...]] = {
    "GGA": (*_POSITION, ("quality", 5, _whole), *_HEIGHT, ("separation", 10, _number)),
    "GNS": (*_POSITION, ("mode", 5, _text), *_HEIGHT, ("separation", 9, _number)),
    "RMC": (
        ("time", 0, _time),
        ("status", 1, _text),
        ("knots", 6, _number),
        ("course", 7, _number),
        ("date", 8, _date),
        ("mode", 11, _text_if_any),
    ),
    "VTG": (("course", 0, _number), ("knots", 4, _number), ("mode", 8, _text_if_any)),
    "ZDA": (("time", 0, _time), ("day", 1, _whole), ("month", 2, _whole), ("year", 3, _whole)),
    "GST": (("time", 0, _time), ("north", 5, _number), ("east", 6, _number), ("up", 7, _number)),
    "HDT": (("heading", 0, _number),),
    "THS": (("heading", 0, _number), ("mode", 1, _text)),
}


def fields_of(kind: str, fields: Sequence[str]) -> dict[str, Any] | None:
    """What a sentence of a kind in `SENTENCES` says, by name; None if it is too short or has no numbers where they
    belong."""
    try:
        return {name: read(fields, place) for name, place, read in SENTENCES[kind]}
    except (IndexError, ValueError):
        return None
