"""What a receiver sends of several protocols on one line: UBX among NMEA 0183, with RTCM 3 between."""

from __future__ import annotations

from typing import Literal

from vsense_ros.driver.gnss import GnssSettings, LinkStatistics
from vsense_ros.driver.nmea import NmeaDecoder
from vsense_ros.driver.ubx import UbxDecoder, fletcher
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample

_UBX, _RTCM = b"\xb5\x62", b"\xd3"
_LONGEST = 4096  # [byte] of a frame of UBX that is waited for; one of RTCM has at most 1029
_CRC_24Q = 0x1864CFB  # polynomial of RTCM 3 (RTCM 10403)


def _remainder(byte: int) -> int:
    crc = byte << 16
    for _ in range(8):
        crc <<= 1
        if crc & 0x1000000:
            crc ^= _CRC_24Q
    return crc


_REMAINDERS = tuple(_remainder(byte) for byte in range(256))


def crc_24q(data: bytes) -> int:
    """The checksum of RTCM 3 frames."""
    crc = 0
    for byte in data:
        crc = (crc << 8 & 0xFFFFFF) ^ _REMAINDERS[crc >> 16 ^ byte]
    return crc


def frame_end(data: bytes, start: int) -> int | None:
    """Where the intact frame of UBX or RTCM that begins at `start` ends; `start` if none does, None if that cannot be
    said before more bytes come."""
    head = data[start : start + 6]
    if head.startswith(_RTCM):
        if len(head) < 3:
            return None
        if head[1] & 0xFC:
            return start
        end = start + 3 + int.from_bytes(head[1:3], "big") + 3
        if end > len(data):
            return None
        return end if crc_24q(data[start : end - 3]) == int.from_bytes(data[end - 3 : end], "big") else start
    if not _UBX.startswith(head[:2]):
        return start
    if len(head) < 6:
        return None
    end = start + 6 + int.from_bytes(head[4:6], "little") + 2
    if end - start > _LONGEST:
        return start
    if end > len(data):
        return None
    return end if fletcher(data[start + 2 : end - 2]) == data[end - 2 : end] else start


class FrameFilter:
    """Takes the intact frames of UBX and RTCM out of a stream: what is left is text and noise."""

    def __init__(self) -> None:
        self._buffer = b""
        self.frames = 0  # that were taken out

    @property
    def unfinished(self) -> int:
        """Bytes of a frame that has not ended."""
        return len(self._buffer)

    def feed(self, data: bytes) -> bytes:
        """The bytes that belong to no frame, of those that are complete."""
        self._buffer += data
        left = bytearray()
        position = 0
        while position < len(self._buffer):
            begins = [at for sync in (_UBX[:1], _RTCM) if (at := self._buffer.find(sync, position)) >= 0]
            start = min(begins, default=len(self._buffer))
            left += self._buffer[position:start]
            position = start
            if not begins:
                break
            end = frame_end(self._buffer, start)
            if end is None:
                break
            if end == start:
                left += self._buffer[start : start + 1]
                end = start + 1
            else:
                self.frames += 1
            position = end
        self._buffer = self._buffer[position:]
        return bytes(left)


class ReceiverDecoder:
    """Decodes UBX and NMEA in one stream of bytes, whichever comes first.

    Both have the same position and velocity: as soon as UBX does, which is more precise and complete, NMEA adds
    headings alone. With `expected` ubx, it never adds anything else.
    """

    def __init__(self, settings: GnssSettings | None = None, expected: Literal["nmea", "ubx"] = "nmea") -> None:
        self.settings = settings or GnssSettings()
        self.ubx, self.nmea = UbxDecoder(self.settings), NmeaDecoder(self.settings)
        self._filter = FrameFilter()
        self._expected = expected

    @property
    def speaks_ubx(self) -> bool:
        """True as soon as UBX gave a position or a velocity."""
        channels = self.ubx.channels
        return bool(channels.fix_monitor.accepted or channels.velocity_monitor.accepted)

    def feed_each(self, data: bytes, received: int) -> tuple[list[Sample], list[Sample]]:
        """Samples of UBX, and all those of NMEA."""
        return self.ubx.feed(data, received), self.nmea.feed(self._filter.feed(data), received)

    def feed(self, data: bytes, received: int) -> list[Sample]:
        """Samples of all that these bytes complete; `received` [ns] is their time of arrival."""
        ubx, nmea = self.feed_each(data, received)
        return [*ubx, *(self.additional(nmea) if self._expected == "ubx" or self.speaks_ubx else nmea)]

    def additional(self, samples: list[Sample]) -> list[Sample]:
        """Those samples of NMEA that UBX does not give: headings, where UBX has none."""
        if self.ubx.channels.attitude_monitor.accepted:
            return []
        return [sample for sample in samples if sample.topic == self.settings.attitude_topic]

    @property
    def _leading(self) -> UbxDecoder | NmeaDecoder:
        """The decoder that gives position and velocity, or is expected to."""
        if self._expected == "ubx" or self.speaks_ubx:
            return self.ubx
        of_nmea, of_ubx = self.nmea.link.counts["frames"], self.ubx.link.counts["frames"] + self._filter.frames
        return self.ubx if of_ubx and not of_nmea else self.nmea

    @property
    def foreign_bytes(self) -> int:
        """Bytes that belong to no frame of UBX or RTCM and to no sentence, with those of one that has not ended."""
        return self.nmea.link.counts["other bytes"] + self.nmea.unfinished + self._filter.unfinished

    @property
    def link(self) -> LinkStatistics:
        """Bytes and frames of the protocol that gives position and velocity."""
        return self._leading.link

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health of the link and of each topic at `now` [ns], of the protocol that gives position and velocity."""
        return self._leading.diagnostics(now)
