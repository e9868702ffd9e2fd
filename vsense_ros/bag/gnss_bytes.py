"""GNSS messages as a receiver sends them: NMEA 0183 or UBX bytes made from `gps/fix` and `gps/velocity`.

With these the GNSS driver can be fed over a serial line from any recording. The time is that of measurement, the
bytes are due at the time of arrival. NMEA carries no vertical velocity; UBX carries one, and 0 where it is unknown.
"""

from __future__ import annotations

from datetime import UTC, datetime
from functools import reduce
from operator import xor

import numpy as np
from pyubx2 import GET, UBXMessage

from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

_KNOT = 1852 / 3600  # [m/s]


def gnss_byte_stream(recording: Recording, protocol: str = "nmea") -> list[tuple[int, bytes]]:
    """Time of arrival [ns] and bytes of each fix, in order of arrival.

    `protocol` is `nmea` (RMC and GGA; the height is written as ellipsoidal, with separation 0) or `ubx` (NAV-PVT).
    A fix is paired with the velocity of the same time of measurement; a fix without one is sent without velocity.
    Raises `InputError` if the recording has no `gps/fix` or the protocol is unknown.
    """
    if protocol not in ("nmea", "ubx"):
        raise InputError(f"GNSS protocol {protocol!r} is unknown; expected 'nmea' or 'ubx'")
    if "gps/fix" not in recording:
        raise InputError(f"{recording.name}: no gps/fix, so there is nothing that a GNSS receiver could send")
    fixes = recording["gps/fix"]
    position = np.column_stack([fixes.columns[name][:, 0] for name in ("latitude", "longitude", "altitude")])
    valid = np.isfinite(position[:, :2]).all(axis=1) & (fixes.columns["status"][:, 0] >= 0)
    velocity = np.full((len(fixes), 3), np.nan)
    if "gps/velocity" in recording and len(recording["gps/velocity"]):
        velocities = recording["gps/velocity"]
        order = np.argsort(velocities.stamp, kind="stable")
        row = order[np.minimum(np.searchsorted(velocities.stamp[order], fixes.stamp), len(order) - 1)]
        same = velocities.stamp[row] == fixes.stamp
        velocity[same] = velocities.columns["linear"][row[same]]
    make = _nmea if protocol == "nmea" else _ubx
    stream = [
        (int(received), make(int(stamp), position[i], velocity[i], bool(valid[i])))
        for i, (stamp, received) in enumerate(zip(fixes.stamp, fixes.received, strict=True))
    ]
    return sorted(stream, key=lambda entry: entry[0])


def _speed_and_course(velocity: np.ndarray) -> tuple[float, float]:
    """Speed over ground [m/s] and course [deg, clockwise from north, 0 to 360]; NaN without velocity."""
    return float(np.hypot(velocity[0], velocity[1])), float(np.degrees(np.arctan2(velocity[0], velocity[1])) % 360.0)


def _nmea(stamp: int, position: np.ndarray, velocity: np.ndarray, valid: bool) -> bytes:
    # NMEA resolves hundredths or thousandths of a second; rounding to milliseconds may reach the next second.
    milliseconds = (stamp + 500_000) // 1_000_000
    moment = datetime.fromtimestamp(milliseconds // 1000, UTC)
    time = f"{moment:%H%M%S}.{milliseconds % 1000:03d}"
    place = ",,,"
    if valid:
        north, east = _minutes(position[0], 2), _minutes(position[1], 3)
        place = f"{north},{'N' if position[0] >= 0 else 'S'},{east},{'E' if position[1] >= 0 else 'W'}"
    speed, course = _speed_and_course(velocity)
    motion = f"{speed / _KNOT:.4f},{course:.4f}" if np.isfinite(speed) else ","
    height = f"{position[2]:.3f},M,0.0,M" if valid and np.isfinite(position[2]) else ",M,,M"
    rmc = f"GNRMC,{time},{'A' if valid else 'V'},{place},{motion},{moment:%d%m%y},,,{'A' if valid else 'N'}"
    gga = f"GNGGA,{time},{place},{1 if valid else 0},12,0.8,{height},,"
    return _sentence(rmc) + _sentence(gga)


def _minutes(degrees: float, width: int) -> str:
    """Degrees and minutes run together, minutes with 7 decimals (0.2 mm)."""
    units = round(abs(float(degrees)) * 60e7)
    whole, rest = divmod(units, 600_000_000)
    return f"{whole:0{width}d}{rest // 10_000_000:02d}.{rest % 10_000_000:07d}"


def _sentence(body: str) -> bytes:
    return f"${body}*{reduce(xor, body.encode()):02X}\r\n".encode()


def _ubx(stamp: int, position: np.ndarray, velocity: np.ndarray, valid: bool) -> bytes:
    second = (stamp + 500_000_000) // 1_000_000_000  # nano runs from -0.5 s to 0.5 s around it
    moment = datetime.fromtimestamp(second, UTC)
    east, north, up = (round(1e3 * float(v)) if np.isfinite(v) else 0 for v in velocity)
    speed, course = _speed_and_course(velocity)
    latitude, longitude = (float(v) if valid else 0.0 for v in position[:2])
    height = round(1e3 * float(position[2])) if valid and np.isfinite(position[2]) else 0
    moving = np.isfinite(speed)
    message = UBXMessage(
        "NAV",
        "NAV-PVT",
        GET,
        iTOW=((stamp // 1_000_000) - 315_964_800_000 + 18_000) % 604_800_000,
        year=moment.year,
        month=moment.month,
        day=moment.day,
        hour=moment.hour,
        min=moment.minute,
        second=moment.second,
        validDate=1,
        validTime=1,
        fullyResolved=1,
        tAcc=50,
        nano=stamp - second * 1_000_000_000,
        fixType=3 if valid else 0,
        gnssFixOk=int(valid),
        numSV=12 if valid else 0,
        lon=longitude,
        lat=latitude,
        height=height,
        hMSL=height,
        hAcc=1000,
        vAcc=1500,
        velN=north,
        velE=east,
        velD=-up,
        gSpeed=round(1e3 * speed) if moving else 0,
        headMot=course if moving else 0.0,
        sAcc=50 if moving else 1_000_000,
        headAcc=1.0,
        pDOP=1.2,
    )
    return message.serialize()
