"""Racelogic VBOX binary files (.vbb).

A file is a header and a row of records, big or little endian: names and settings, definitions of channels and of the
groups in which they are sampled, and the samples, each with a GNSS time of day in units of 0.1 ms. Latitude and
longitude are in minutes of arc. The older text format counts longitude positive to the west; which way a file counts
is seen from its own heading, so that both are read right. Heights are ellipsoidal.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pymap3d

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "racelogic_vbb"
DESCRIPTION = "Racelogic VBOX binary (.vbb)"

_GROUP, _ITEM, _CHANNEL, _CHANNEL_GROUP, _SAMPLES, _DUMP = 5, 6, 7, 8, 9, 13
_NUMBERS = {1: "u1", 2: "u2", 3: "i2", 4: "u4", 5: "i4", 6: "u8", 7: "i8", 8: "f4", 9: "f8"}
_DATETIME, _TEXT, _BYTES = 11, 12, 13
_TICK = 1e-4  # of the sample times [s]
_DAY = 86_400  # [s]
_UNIX_TICKS = 621_355_968_000_000_000  # 1970 in 100 ns since the year 1
_KMH = 1.0 / 3.6

_USED = ("latitude", "longitude", "velocity", "heading", "height")


@dataclass
class _Group:
    """A set of channels that are sampled together."""

    names: tuple[str, ...]
    dtype: np.dtype
    scale: tuple[float, ...]
    offset: tuple[float, ...]
    positions: list[int] = field(default_factory=list)  # of the samples in the file


@dataclass
class _File:
    created: int = 0  # Unix time [s]
    items: dict[str, object] = field(default_factory=dict)
    groups: dict[int, _Group] = field(default_factory=dict)
    damaged: str = ""


def matches(path: Path) -> bool:
    """True if `path` begins like a VBB file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(3) == b"VBB"


def read(path: Path) -> Recording:
    """GNSS position and velocity of a VBB file, with their covariances if the file has them."""
    data = path.read_bytes()
    if data[:3] != b"VBB" or len(data) < 24:
        raise InputError(f"{path}: not a VBB file: begins with {data[:3].hex(' ') or 'nothing'}, expected 56 42 42")
    if data[3] != 2:
        raise InputError(f"{path}: VBB format {data[3]}, only format 2 is known; save it again with VBOX Test Suite")
    file = _Parser(path, data).run()
    notes = [file.damaged] if file.damaged else []

    main = next((g for g in file.groups.values() if set(_USED) <= set(g.names) and g.positions), None)
    if main is None:
        raise InputError(f"{path}: no samples of {', '.join(_USED)}, which every VBOX recording with GNSS has")
    values, seconds = _samples(data, main, file)
    stamp = build.nanoseconds(seconds, _midnight(file, seconds) * 1_000_000_000)

    speed, course = values["velocity"] * _KMH, np.radians(values["heading"])
    vertical = values["vert. velocity"] * _KMH if "vert. velocity" in values else None
    latitude, longitude = values["latitude"] / 60.0, values["longitude"] / 60.0
    if _counts_west(latitude, longitude, speed * np.sin(course), seconds):
        longitude = -longitude
        notes.append("gps/fix: longitude counts positive to the west in this file; turned")
    here = (float(latitude[0]), float(longitude[0]))
    position_covariance, velocity_covariance = _covariances(data, file, seconds, here)
    channels = {
        "gps/fix": build.fix(
            stamp,
            latitude,
            longitude,
            values["height"],
            covariance=None if position_covariance is None else position_covariance.reshape(-1, 9),
        ),
        "gps/velocity": build.velocity(
            stamp, build.course_velocity(speed, course, vertical), covariance=velocity_covariance
        ),
    }
    rest = [name for g in file.groups.values() if g.positions for name in g.names if name not in (*_USED, "time")]
    notes.append(f"signals of the file that have no topic: {', '.join(rest)}")
    metadata = {"source": NAME} | {
        f"vbox_{name.lower().replace(' ', '_')}": str(value)
        for name, value in file.items.items()
        if name in ("SerialNumber", "GNSS Version", "KF Version")
    }
    return Recording(channels, path.stem, tuple(notes), 0, metadata)


def _covariances(
    data: bytes, file: _File, seconds: Array, here: tuple[float, float]
) -> tuple[Array | None, Array | None]:
    """Covariances (n, 3, 3) in ENU axes of position [m²] and velocity [m²/s²] at given times, if the file has them."""
    quality = next((g for g in file.groups.values() if "POSCov_xx" in g.names and g.positions), None)
    if quality is None or len(quality.positions) != len(seconds):
        return None, None
    values, at = _samples(data, quality, file)
    if not np.array_equal(at, seconds):
        return None, None
    return _enu_covariance(values, "POSCov", here), _enu_covariance(values, "VELCov", here)


def _samples(data: bytes, group: _Group, file: _File) -> tuple[dict[str, Array], Array]:
    """Scaled values of a group by channel name, and their UTC seconds of the day (beyond midnight going on)."""
    packed = b"".join(data[at : at + group.dtype.itemsize] for at in group.positions)
    rows = np.frombuffer(packed, group.dtype)
    gnss = rows["_ticks"].astype(np.float64) * _TICK
    gnss += _DAY * np.concatenate([[0], np.cumsum(np.diff(gnss) < -_DAY / 2)])
    offset = file.items.get("GNSS Offset", 0)
    values = {
        name: rows[f"{index}"].astype(np.float64) * scale + shift
        for index, (name, scale, shift) in enumerate(zip(group.names, group.scale, group.offset, strict=True))
    }
    return values, gnss + (float(offset) if isinstance(offset, int) else 0.0)


def _midnight(file: _File, seconds: Array) -> int:
    """Unix time of the midnight from which the seconds count; the file is created at the start of the recording."""
    date = file.items.get("Date")
    begun = date if isinstance(date, int) else file.created
    days = round((begun - float(seconds[0])) / _DAY)
    return days * _DAY


def _counts_west(latitude: Array, longitude: Array, east_speed: Array, seconds: Array) -> bool:
    """True if longitude falls while the heading says east."""
    east = np.gradient(longitude, seconds) * np.cos(np.radians(latitude))
    return float(np.dot(east, east_speed)) < 0.0


def _enu_covariance(values: dict[str, Array], prefix: str, here: tuple[float, float]) -> Array | None:
    """ENU covariance (n, 3, 3) from the earth-centred one that the file has."""
    names = [[f"{prefix}_{''.join(sorted((a, b)))}" for a in "xyz"] for b in "xyz"]
    if any(name not in values for row in names for name in row):
        return None
    earth = np.array([[values[name] for name in row] for row in names]).transpose(2, 0, 1)
    turn = np.column_stack([pymap3d.ecef2enuv(*axis, *here) for axis in np.eye(3)])
    return turn @ earth @ turn.T


class _Parser:
    """Walks through the records of a file."""

    def __init__(self, path: Path, data: bytes) -> None:
        self._path, self._data, self._at = path, data, 24
        self._order = ">" if data[7] & 1 else "<"
        self._file = _File(created=_unix_seconds(self._unpack_at("Q", 8)))
        self._channels: dict[int, tuple[str, str, float, float]] = {}

    def run(self) -> _File:
        handlers = {
            _GROUP: self._group,
            _ITEM: self._item,
            _CHANNEL: self._channel,
            _CHANNEL_GROUP: self._channel_group,
            _SAMPLES: self._sample,
            _DUMP: self._dump,
        }
        while self._at < len(self._data):
            start = self._at
            handler = handlers.get(self._data[start])
            try:
                if handler is None:
                    raise InputError(f"{self._data[start]} is no record of a VBB file")
                self._at += 1
                handler()
            except (InputError, struct.error, IndexError) as error:
                self._file.damaged = (
                    f"{self._path.name}: damaged or cut off at byte {start} of {len(self._data)} ({error}); "
                    "what stands behind it is lost"
                )
                break
        return self._file

    def _unpack_at(self, code: str, at: int) -> int:
        return struct.unpack_from(self._order + code, self._data, at)[0]

    def _take(self, codes: str) -> tuple:
        layout = struct.Struct(self._order + codes)
        values = layout.unpack_from(self._data, self._at)
        self._at += layout.size
        return values

    def _take_bytes(self) -> bytes:
        length, shift = 0, 0
        while True:
            (part,) = self._take("B")
            length = (length << 7) | (part & 0x7F) if self._order == ">" else length | ((part & 0x7F) << shift)
            shift += 7
            if not part & 0x80:
                break
        if self._at + length > len(self._data):
            raise InputError(f"a text of {length} bytes does not fit")
        self._at += length
        return self._data[self._at - length : self._at]

    def _take_text(self) -> str:
        return self._take_bytes().decode(errors="replace")

    def _take_value(self) -> object:
        (kind,) = self._take("B")
        if kind == _TEXT:
            return self._take_text()
        if kind == _BYTES:
            return self._take_bytes()
        if kind == _DATETIME:
            return _unix_seconds(self._take("Q")[0])
        if kind not in _NUMBERS:
            raise InputError(f"{kind} is no type of value of a VBB file")
        dtype = np.dtype(self._order + _NUMBERS[kind])
        self._at += dtype.itemsize
        return np.frombuffer(self._data, dtype, 1, self._at - dtype.itemsize)[0].item()

    def _group(self) -> None:
        self._take("B")
        self._take_text()

    def _item(self) -> None:
        self._take("B")
        name = self._take_text()
        self._file.items[name] = self._take_value()

    def _channel(self) -> None:
        number, _ = self._take("HB")
        name, _, _ = self._take_text(), self._take_text(), self._take_text()
        kind, scale, offset = self._take("Bdd")
        self._take_text()
        if kind not in _NUMBERS:
            raise InputError(f"channel {name} has a value type {kind} that is no number")
        # Decimal scales are stored as single precision: 3.6 as 3.5999999046.
        self._channels[number] = (name, self._order + _NUMBERS[kind], float(f"{scale:.7g}"), offset)

    def _channel_group(self) -> None:
        number, count = self._take("BH")
        channels = [self._channels.get(channel) for channel in self._take(f"{count}H")]
        known = [channel for channel in channels if channel is not None]
        if len(known) != count:
            raise InputError(f"group {number} has a channel that is not defined")
        self._file.groups[number] = _Group(
            tuple(name for name, *_ in known),
            np.dtype(
                [("_ticks", f"{self._order}u4"), ("_number", "u1"), *((f"{i}", c[1]) for i, c in enumerate(known))]
            ),
            tuple(scale for _, _, scale, _ in known),
            tuple(offset for *_, offset in known),
        )

    def _sample(self) -> None:
        group = self._file.groups.get(self._data[self._at + 4])
        if group is None:
            raise InputError(f"samples of group {self._data[self._at + 4]}, which is not defined")
        if self._at + group.dtype.itemsize > len(self._data):
            raise InputError("the last sample is cut off")
        group.positions.append(self._at)
        self._at += group.dtype.itemsize

    def _dump(self) -> None:
        self._take("H")
        self._take_text()
        self._take_value()


def _unix_seconds(ticks: int) -> int:
    """Unix time of a time stamp in 100 ns since the year 1, whose two upper bits are the time zone."""
    return ((ticks & 0x3FFF_FFFF_FFFF_FFFF) - _UNIX_TICKS) // 10_000_000
