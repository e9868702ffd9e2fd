"""Septentrio Binary Format (SBF, mosaic-X5 Reference Guide 4.14): what a receiver logs of position, velocity, attitude.

A block begins with `$@`, and has a CRC-16 of CCITT. Times are of GPS; a value of −2·10¹⁰ is none. Covariances stand in
blocks of their own, with the time of the solution that they belong to. A file has no times of arrival: those of
measurement stand for them.
"""

from __future__ import annotations

from binascii import crc_hqx
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pysbf2 import SBF_MSGIDS, VALNONE, SBFReader
from scipy.spatial.transform import Rotation

from vsense_ros.bag.importers import build
from vsense_ros.bag.importers.build import Array, Stamps
from vsense_ros.driver.samples import UNMEASURED_VARIANCE
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording

NAME = "septentrio"
DESCRIPTION = "Septentrio Binary Format (.sbf)"
FIRST = True  # sentences of NMEA between the blocks say the same, less precisely

_SYNC = b"$@"
_HEADER, _LONGEST = 8, 1 << 16  # [byte]
_BEGINNING = 1 << 16  # [byte] in which the first block is looked for
_NUMBER = 0x1FFF  # bits of the block's number; those above are its revision
_NO_VALUE = -2e10
_SOLUTION, _POSITION_ERROR, _VELOCITY_ERROR, _ATTITUDE, _ATTITUDE_ERROR = (
    "PVTGeodetic",
    "PosCovGeodetic",
    "VelCovGeodetic",
    "AttEuler",
    "AttCovEuler",
)
_NUMBERS = {number: name for number, (name, _) in SBF_MSGIDS.items()}
_WANTED = (_SOLUTION, _POSITION_ERROR, _VELOCITY_ERROR, _ATTITUDE, _ATTITUDE_ERROR)
_PLACE = ("Longitude", "Latitude", "Height")
_MOTION = ("Ve", "Vn", "Vu")
# Elements of symmetric matrices, row by row, in the order east, north, up, and roll, pitch, yaw.
_OF_POSITION = ("lonlon", "latlon", "lonhgt", "latlon", "latlat", "lathgt", "lonhgt", "lathgt", "hgthgt")
_OF_VELOCITY = ("VeVe", "VnVe", "VeVu", "VnVe", "VnVn", "VnVu", "VeVu", "VnVu", "VuVu")
_OF_ANGLES = ("RollRoll", "PitchPitch", "HeadHead")

Time = tuple[int, int]  # week, millisecond of the week, both of GPS


def matches(path: Path) -> bool:
    """True if a position or an attitude stands in an intact block near the beginning of a file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(_BEGINNING)
    return any(_name(block) in (_SOLUTION, _ATTITUDE) for block in _blocks(head, Counter()))


def read(path: Path) -> Recording:
    """`gps/fix`, `gps/velocity` and, of receivers with several antennas, `gps/attitude`."""
    counts: Counter[str] = Counter()
    values: dict[str, dict[Time, Any]] = {name: {} for name in _WANTED}
    others: Counter[str] = Counter()
    data = path.read_bytes()
    outside = len(data)
    for block in _blocks(data, counts):
        outside -= len(block)
        name = _name(block)
        if name not in values:
            others[name] += 1
            continue
        content = SBFReader.parse(block, validate=VALNONE)
        if content.WNc < 0xFFFF and content.TOW < build.WEEK * 1000:
            values[name][content.WNc, content.TOW] = content
        else:
            counts["without a time"] += 1
    channels = [*_solutions(values), *_attitudes(values)]
    if not channels:
        held = ", ".join(f"{name} ({number})" for name, number in others.most_common(8)) or "nothing intact"
        raise InputError(
            f"{path}: no position, velocity or attitude: expected blocks {_SOLUTION} or {_ATTITUDE} with a solution; "
            f"found {held}"
        )
    notes = [f"{path.name}: {number} blocks left out: {why}" for why, number in counts.items()]
    if outside:
        notes.append(f"{path.name}: {outside} bytes belong to no whole block and are not read")
    if others:
        notes.append(f"{path.name}: blocks that are not read: {', '.join(sorted(others))}")
    return Recording({c.topic: c for c in channels}, path.stem, tuple(notes), 0, {"source": NAME})


def _blocks(data: bytes, counts: Counter[str]) -> Iterator[bytes]:
    """The intact blocks; damaged ones are counted by what is wrong with them."""
    at = data.find(_SYNC)
    while at >= 0:
        length = int.from_bytes(data[at + 6 : at + _HEADER], "little")
        end = at + length
        if length < _HEADER or length % 4:  # two bytes of something else
            end = at + 1
        elif end > len(data):
            counts["cut at the end of the file"] += 1
            end = at + 1
        elif crc_hqx(data[at + 4 : end], 0) == int.from_bytes(data[at + 2 : at + 4], "little"):
            yield data[at:end]
        else:
            counts["checksum wrong"] += 1
            end = at + 1
        at = data.find(_SYNC, end)


def _name(block: bytes) -> str:
    number = int.from_bytes(block[4:6], "little") & _NUMBER
    return _NUMBERS.get(number, str(number))


def _stamps(times: list[Time]) -> Stamps:
    """Unix times [ns]."""
    seconds = [build.GPS_EPOCH + week * build.WEEK + tow / 1000 for week, tow in times]
    leap = np.array([build.gps_minus_utc(second) for second in seconds], np.int64)
    ticks = np.array([(build.GPS_EPOCH + week * build.WEEK) * 1000 + tow for week, tow in times], np.int64)
    return (ticks - 1000 * leap) * 1_000_000


def _numbers(blocks: list[Any], names: tuple[str, ...]) -> Array:
    """Attributes (n, m) of blocks, NaN where a block or its value is missing."""
    values = np.array([[getattr(block, name, np.nan) for name in names] for block in blocks], float)
    values = values.reshape(len(blocks), len(names))
    return np.where(values == _NO_VALUE, np.nan, values)


def _solutions(values: Mapping[str, Mapping[Time, Any]]) -> list[Channel]:
    """Position and velocity at the times that have a solution."""
    times = sorted(time for time, block in values[_SOLUTION].items() if block.Type and not block.Error)
    blocks = [values[_SOLUTION][time] for time in times]
    stamp, channels = _stamps(times), []
    place = _numbers(blocks, _PLACE)
    if (known := np.isfinite(place[:, :2]).all(axis=1)).any():
        covariance, stated = _covariances(values[_POSITION_ERROR], times, _OF_POSITION)
        longitude, latitude = np.degrees(place[known, 0]), np.degrees(place[known, 1])
        fix = build.fix(stamp[known], latitude, longitude, place[known, 2], covariance=covariance[known])
        fix.columns["position_covariance_type"][~stated[known]] = 0.0  # unknown
        channels.append(fix)
    motion = _numbers(blocks, _MOTION)
    if (known := np.isfinite(motion).all(axis=1)).any():
        covariance, _ = _covariances(values[_VELOCITY_ERROR], times, _OF_VELOCITY)
        channels.append(build.velocity(stamp[known], motion[known], covariance=covariance[known].reshape(-1, 3, 3)))
    return channels


def _covariances(
    blocks: Mapping[Time, Any], times: list[Time], elements: tuple[str, ...]
) -> tuple[Array, NDArray[np.bool_]]:
    """Covariances (n, 9) of the solutions at some times, zeros where none is stated, and where one is (n,)."""
    elements_of_times = _numbers([blocks.get(time) for time in times], tuple(f"Cov_{element}" for element in elements))
    stated = np.asarray(np.isfinite(elements_of_times).all(axis=1))
    return np.where(stated[:, None], elements_of_times, 0.0), stated


def _attitudes(values: Mapping[str, Mapping[Time, Any]]) -> list[Channel]:
    """The attitude of the vehicle, whose axes are forward, right, down for the receiver."""
    times = sorted(time for time, block in values[_ATTITUDE].items() if not block.Error)
    angles = _numbers([values[_ATTITUDE][time] for time in times], ("Roll", "Pitch", "Heading"))
    known = np.isfinite(angles[:, 2])
    if not known.any():
        return []
    names = tuple(f"Cov_{element}" for element in _OF_ANGLES)
    variances = np.radians(np.radians(_numbers([values[_ATTITUDE_ERROR].get(time) for time in times], names)))
    unmeasured = ~np.isfinite(angles) | ~np.isfinite(variances)
    of_heading = ~unmeasured[:, 2:]
    variances = np.where(of_heading, np.where(unmeasured, UNMEASURED_VARIANCE, variances), 0.0)[known]
    roll, pitch, heading = np.radians(np.nan_to_num(angles[known])).T
    absent = np.tile([-1.0] + [0.0] * 8, (int(known.sum()), 1))
    columns = {
        "orientation": Rotation.from_euler("ZYX", np.column_stack([np.pi / 2 - heading, -pitch, roll])).as_quat(),
        "orientation_covariance": (np.eye(3) * variances[:, None, :]).reshape(-1, 9),
        "angular_velocity_covariance": absent,
        "linear_acceleration_covariance": absent,
    }
    return [build.channel("gps/attitude", _stamps(times)[known], columns)]
