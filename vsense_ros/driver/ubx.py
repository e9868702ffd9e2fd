"""u-blox UBX frames to samples: NAV-PVT and NAV-RELPOSNED."""

from __future__ import annotations

import datetime
import math
import struct
from typing import Any

from pyubx2 import UBX_MSGIDS, UBXReader, exceptions

from vsense_ros.driver import gnss
from vsense_ros.driver.gnss import GnssChannels, GnssSettings, LinkStatistics
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
_SYNC = b"\xb5\x62"
_LONGEST = 1024  # [byte] of a frame whose name is looked for
_NAMES = {identifier: name for identifier, name in UBX_MSGIDS.items() if len(identifier) == 2}


def fletcher(data: bytes) -> bytes:
    """The 8-bit Fletcher checksum of UBX, of class to payload."""
    a = b = 0
    for byte in data:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return bytes((a, b))


class UbxDecoder:
    """Decodes a stream of bytes; everything in it that is no intact frame of interest is passed over.

    NAV-PVT gives position and velocity with the receiver's own accuracies, NAV-RELPOSNED the attitude of the antenna
    baseline. The latter has only the time of week, whose date the latest NAV-PVT tells.
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
        self._buffer += data
        made: list[Sample] = []
        position = 0
        while True:
            start = self._buffer.find(_SYNC[:1], position)
            end = len(self._buffer) if start < 0 else start
            self.link.other(end - position)
            position = end
            if start < 0:
                break
            header = self._buffer[start : start + 6]
            size = _SIZES.get(header)
            if size is None:
                if any(known.startswith(header) for known in _SIZES):
                    break
                self._count_other(start)
                self.link.other(1)
                position = start + 1
                continue
            frame = self._buffer[start : start + size]
            if len(frame) < size:
                break
            if fletcher(frame[2:-2]) == frame[-2:]:
                made += self._frame(frame, received)
                position = start + size
            else:
                self.link.broken(received)
                self.link.other(1)
                position = start + 1
        self._buffer = self._buffer[position:]
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
        if frame.startswith(_SHORT_PVT):
            content = _PVT[2:] + frame[6:-2] + bytes(8)
            frame = _SYNC + content + fletcher(content)
        try:
            message = UBXReader.parse(frame)
        except (exceptions.UBXParseError, exceptions.UBXMessageError, exceptions.UBXTypeError, ValueError):
            self.link.broken(received)
            return []
        if frame.startswith(_PVT):
            (time_of_week,) = struct.unpack_from("<I", frame, 6)
            return self._position_velocity_time(message, time_of_week, received)
        (time_of_week,) = struct.unpack_from("<I", frame, 6 + 4)
        return self._relative_position(message, time_of_week, received)

    def _position_velocity_time(self, message: Any, time_of_week: int, received: int) -> list[Sample]:
        channels = self.channels
        objection = None
        if not (message.validDate and message.validTime):
            objection = "time not known"
        elif not message.fullyResolved:
            objection = "time not resolved: the leap seconds are not known yet"
        elif not message.gnssFixOk or message.fixType not in (2, 3, 4):
            objection = "no fix"
        else:
            try:
                moment = datetime.datetime(
                    message.year, message.month, message.day, message.hour, message.min, min(message.second, 59)
                )
            except ValueError:
                objection = "time out of range"
        if objection is not None:
            channels.fix_monitor.fault(objection, received)
            channels.velocity_monitor.fault(objection, received)
            return []
        # A leap second has the number 60; Unix time has no place for it and repeats the one before.
        stamp = gnss.utc_stamp(moment, message.nano)
        self._week = (time_of_week, stamp)
        made: list[Sample] = []
        if message.invalidLlh:
            channels.fix_monitor.fault("no fix", received)
        else:
            status = gnss.STATUS_FIX
            if message.carrSoln:
                status = gnss.STATUS_GBAS
            elif message.diffSoln:
                status = gnss.STATUS_SBAS
            # hAcc is the radial deviation of two axes.
            horizontal, vertical = (message.hAcc * 1e-3) ** 2 / 2, (message.vAcc * 1e-3) ** 2
            made += channels.fix(
                stamp,
                received,
                message.lat,
                message.lon,
                message.height * 1e-3,
                (horizontal, horizontal, vertical),
                status,
                gnss.SERVICE_ALL,
                gnss.COVARIANCE_DIAGONAL_KNOWN,
            )
        axis = (message.sAcc * 1e-3) ** 2 / 3  # sAcc is the deviation of three axes together
        east, north, up = message.velE * 1e-3, message.velN * 1e-3, -message.velD * 1e-3
        return made + channels.velocity(stamp, received, east, north, up, (axis, axis, axis))

    def _relative_position(self, message: Any, time_of_week: int, received: int) -> list[Sample]:
        if not (message.relPosHeadingValid and message.gnssFixOK):
            self.channels.attitude_monitor.fault("heading not valid", received)
            return []
        if self._week is None:
            return []
        reference, stamp = self._week
        milliseconds = (time_of_week - reference + WEEK // 2) % WEEK - WEEK // 2
        heading_variance = math.radians(max(message.accHeading, 1e-3)) ** 2
        elevation = None
        elevation_variance = 0.0
        length = message.relPosLength * 1e-2
        if length > 0 and abs(message.relPosD) * 1e-2 <= length:
            elevation = math.asin(-message.relPosD * 1e-2 / length)
            elevation_variance = max((message.accD * 1e-2 / length) ** 2, 1e-8)
        return self.channels.attitude(
            stamp + milliseconds * MILLISECOND,
            received,
            math.radians(message.relPosHeading),
            heading_variance,
            elevation,
            elevation_variance,
        )
