"""u-blox UBX frames to samples: NAV-PVT and NAV-RELPOSNED."""

from __future__ import annotations

import datetime
import math
import struct
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyubx2 import UBX_MSGIDS

from vsense_ros.driver import gnss
from vsense_ros.driver.gnss import GnssChannels, GnssSettings, LinkStatistics
from vsense_ros.driver.monitor import NANO
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample

MILLISECOND = 1_000_000  # [ns]
WEEK = 7 * 86400 * 1000  # [ms]

# The frames that are decoded, by all of their header: sync, class, identifier and payload length. Looking for these
# instead of any length keeps a false header in garbage or in another frame from swallowing what follows it.
_PVT = bytes.fromhex("b56201075c00")
_SHORT_PVT = bytes.fromhex("b56201075400")  # of u-blox 7: without flags3 and what stands behind it
_RELPOSNED = bytes.fromhex("b562013c4000")
_SIZES = {_PVT: 6 + 92 + 2, _SHORT_PVT: 6 + 84 + 2, _RELPOSNED: 6 + 64 + 2}
_LONG_PVT = 92  # [byte] of its payload
_PVT_LAYOUT = struct.Struct("<IHBBBBBB4xiBBxxiii4xIIiii8xI6xH12x")
_RELPOSNED_LAYOUT = struct.Struct("<4xI8xiii4xxxbb8xI4xI4xI")
_SYNC = b"\xb5\x62"
_FIRST = _SYNC[:1]
# Flags of the frames: of `valid`, of `flags` of both, of `flags3`.
_TIME_VALID, _TIME_RESOLVED = 0b011, 0b100
_FIX_OK, _DIFFERENTIAL, _CARRIER, _HEADING_VALID = 0b1, 0b10, 0b1100_0000, 0b1_0000_0000
_NO_POSITION = 0b1
_LONGEST = 1024  # [byte] of a frame whose name is looked for
_NAMES = {identifier: name for identifier, name in UBX_MSGIDS.items() if len(identifier) == 2}


def fletcher(data: bytes) -> bytes:
    """The 8-bit Fletcher checksum of UBX, of class to payload: the sum of its bytes, and of all sums up to each."""
    return _weights(len(data)).dot(np.frombuffer(data, np.uint8)).tobytes()


@lru_cache(maxsize=256)
def _weights(count: int) -> NDArray[np.uint8]:
    """How often each of so many bytes is in the sum, and in the sum of all sums, modulo 256 (2, count)."""
    return np.array([np.ones(count, int), np.arange(count, 0, -1)]).astype(np.uint8)


@lru_cache(maxsize=4)  # of measurements that arrive on one day or two
def _day(year: int, month: int, day: int) -> int:
    """Unix time [ns] at which a date begins; `ValueError` if there is no such date."""
    return gnss.utc_stamp(datetime.datetime(year, month, day))


def _stamp(message: PositionVelocityTime) -> int:
    """Unix time [ns] of a message; `ValueError` if there is no such time."""
    _, year, month, day, hour, minute, second, _, nano, *_ = message
    if hour > 23 or minute > 59:
        raise ValueError
    # A leap second has the number 60; Unix time has no place for it and repeats the one before.
    seconds = hour * 3600 + minute * 60 + (second if second < 60 else 59)
    return _day(year, month, day) + seconds * NANO + nano


class PositionVelocityTime(NamedTuple):
    """The payload of NAV-PVT as u-blox's interface description has it: whole numbers, in its units."""

    iTOW: int
    year: int
    month: int
    day: int
    hour: int
    min: int
    second: int
    valid: int
    nano: int
    fixType: int
    flags: int
    lon: int
    lat: int
    height: int
    hAcc: int
    vAcc: int
    velN: int
    velE: int
    velD: int
    sAcc: int
    flags3: int

    @classmethod
    def of(cls, payload: bytes) -> PositionVelocityTime:
        """The numbers in a payload (92 bytes)."""
        return cls._make(_PVT_LAYOUT.unpack(payload))


class RelativePosition(NamedTuple):
    """The payload of NAV-RELPOSNED in its own units (u-blox F9 interface description): lengths in cm, their
    fractions (HP) and the accuracy of the vertical component in 0.1 mm, angles in 1e-5 deg."""

    iTOW: int
    relPosD: int
    relPosLength: int
    relPosHeading: int
    relPosHPD: int
    relPosHPLength: int
    accD: int
    accHeading: int
    flags: int

    @classmethod
    def of(cls, payload: bytes) -> RelativePosition:
        """The numbers in a payload (64 bytes)."""
        return cls._make(_RELPOSNED_LAYOUT.unpack(payload))


class UbxDecoder:
    """Decodes a stream of bytes; everything in it that is no intact frame of interest is passed over.

    NAV-PVT gives position and velocity with the receiver's own accuracies, NAV-RELPOSNED the attitude of the antenna
    baseline. The latter has only the time of week, whose date the latest NAV-PVT has.
    """

    def __init__(self, settings: GnssSettings | None = None) -> None:
        self.settings = settings or GnssSettings()
        self.channels = GnssChannels(self.settings)
        self.link = LinkStatistics("gnss: UBX link", self.settings.timeout)
        self._buffer = b""
        self._week: tuple[int, int] | None = None  # time of week [ms] and stamp [ns] of the latest NAV-PVT

    def feed(self, data: bytes, received: int) -> list[Sample]:
        """Samples of all frames that these bytes complete; `received` [ns] is their time of arrival."""
        self.link.heard(len(data), received)
        self._buffer = buffer = self._buffer + data
        made: list[Sample] = []
        position = other = 0
        while True:
            start = buffer.find(_FIRST, position)
            end = len(buffer) if start < 0 else start
            other += end - position
            position = end
            if start < 0:
                break
            header = buffer[start : start + 6]
            size = _SIZES.get(header)
            if size is None:
                if any(known.startswith(header) for known in _SIZES):
                    break
                self._count_other(start)
                other += 1
                position = start + 1
                continue
            end = start + size
            if len(buffer) < end:
                break
            if fletcher(buffer[start + 2 : end - 2]) == buffer[end - 2 : end]:
                made += self._frame(buffer[start:end], received)
                position = end
            else:
                self.link.broken(received)
                other += 1
                position = start + 1
        if other:
            self.link.other(other)
        self._buffer = buffer[position:]
        return made

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health of the link and of each topic at `now` [ns]."""
        sent = self.link.not_decoded
        for monitor in (self.channels.fix_monitor, self.channels.velocity_monitor):
            monitor.absence = f"the receiver sends {sent}; turn on NAV-PVT (0x01 0x07)" if sent else ""
        return [self.link.diagnostic(now), *self.channels.diagnostics(now)]

    def _count_other(self, start: int) -> None:
        """Name an intact frame that is not decoded. It is not skipped: what looks like one may be part of garbage."""
        head = self._buffer[start : start + 6]
        if len(head) < 6 or not head.startswith(_SYNC):
            return
        end = start + 6 + int.from_bytes(head[4:6], "little")
        check = self._buffer[end : end + 2]
        if end - start <= _LONGEST and len(check) == 2 and fletcher(self._buffer[start + 2 : end]) == check:
            self.link.passed(_NAMES.get(head[2:4], f"0x{head[2]:02X} 0x{head[3]:02X}"))

    def _frame(self, frame: bytes, received: int) -> list[Sample]:
        self.link.frame(received)
        payload = frame[6:-2]
        if frame.startswith(_RELPOSNED):
            return self._relative_position(RelativePosition.of(payload), received)
        return self._position_velocity_time(PositionVelocityTime.of(payload.ljust(_LONG_PVT, b"\0")), received)

    def _position_velocity_time(self, message: PositionVelocityTime, received: int) -> list[Sample]:
        channels = self.channels
        objection = None
        if message.valid & _TIME_VALID != _TIME_VALID:
            objection = "time not known"
        elif not message.valid & _TIME_RESOLVED:
            objection = "time not resolved: the leap seconds are not known yet"
        elif not message.flags & _FIX_OK or message.fixType not in (2, 3, 4):
            objection = "no fix"
        else:
            try:
                stamp = _stamp(message)
            except ValueError:
                objection = "time out of range"
        if objection is not None:
            channels.fix_monitor.fault(objection, received)
            channels.velocity_monitor.fault(objection, received)
            return []
        self._week = (message.iTOW, stamp)
        made: list[Sample] = []
        if message.flags3 & _NO_POSITION:
            channels.fix_monitor.fault("no fix", received)
        else:
            status = gnss.STATUS_FIX
            if message.flags & _CARRIER:
                status = gnss.STATUS_GBAS
            elif message.flags & _DIFFERENTIAL:
                status = gnss.STATUS_SBAS
            # hAcc is the radial deviation of two axes.
            horizontal, vertical = (message.hAcc * 1e-3) ** 2 / 2, (message.vAcc * 1e-3) ** 2
            made += channels.fix(
                stamp,
                received,
                message.lat / 10_000_000,
                message.lon / 10_000_000,
                message.height * 1e-3,
                (horizontal, horizontal, vertical),
                status,
                gnss.SERVICE_ALL,
                gnss.COVARIANCE_DIAGONAL_KNOWN,
            )
        axis = (message.sAcc * 1e-3) ** 2 / 3  # sAcc is the deviation of three axes together
        east, north, up = message.velE * 1e-3, message.velN * 1e-3, -message.velD * 1e-3
        return made + channels.velocity(stamp, received, east, north, up, (axis, axis, axis))

    def _relative_position(self, message: RelativePosition, received: int) -> list[Sample]:
        if not (message.flags & _HEADING_VALID and message.flags & _FIX_OK):
            self.channels.attitude_monitor.fault("heading not valid", received)
            return []
        if self._week is None:
            return []
        reference, stamp = self._week
        milliseconds = (message.iTOW - reference + WEEK // 2) % WEEK - WEEK // 2
        heading_variance = math.radians(max(message.accHeading / 100_000, 1e-3)) ** 2
        elevation = None
        elevation_variance = 0.0
        length = (message.relPosLength + message.relPosHPLength * 1e-2) * 1e-2
        down = (message.relPosD + message.relPosHPD * 1e-2) * 1e-2
        if length > 0 and abs(down) <= length:
            elevation = math.asin(-down / length)
            elevation_variance = max((message.accD * 1e-4 / length) ** 2, 1e-8)
        return self.channels.attitude(
            stamp + milliseconds * MILLISECOND,
            received,
            math.radians(message.relPosHeading / 100_000),
            heading_variance,
            elevation,
            elevation_variance,
        )
