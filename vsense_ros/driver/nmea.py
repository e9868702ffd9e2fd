"""NMEA 0183 sentences to samples: GGA, GNS, RMC, VTG, ZDA, GST, HDT, THS."""

from __future__ import annotations

import datetime
import math
import re
from functools import reduce
from operator import xor
from typing import Any

from vsense_ros.driver import gnss
from vsense_ros.driver.gnss import GnssChannels, GnssSettings, LinkStatistics
from vsense_ros.driver.monitor import NANO
from vsense_ros.driver.nmea_fields import SENTENCES, fields_of
from vsense_ros.driver.samples import UNMEASURED_VARIANCE
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample

KNOT = 1852.0 / 3600.0  # [m/s]

# Longer than the 82 characters of the standard, which receivers with many satellites exceed.
_SENTENCE = re.compile(rb"\$([ -#%-)+-~]{1,200})\*([0-9A-Fa-f]{2})")
_BEGINNING = re.compile(rb"\$[ -#%-)+-~]{0,200}(\*[0-9A-Fa-f]?)?")

# GGA quality -> (NavSatStatus, factor on `range_error`).
_QUALITY = {
    1: (gnss.STATUS_FIX, 1.0),
    2: (gnss.STATUS_SBAS, 0.4),
    3: (gnss.STATUS_FIX, 1.0),
    4: (gnss.STATUS_GBAS, 0.01),
    5: (gnss.STATUS_GBAS, 0.1),
    9: (gnss.STATUS_SBAS, 0.4),
}
# The same for the mode letters of GNS.
_MODES = {"A": 1, "D": 2, "P": 3, "R": 4, "F": 5}
_NOT_MEASURED = ("N", "E", "M", "S", "V")  # not valid, estimated, entered by hand, simulated
_SERVICES = {
    "GP": gnss.SERVICE_GPS,
    "GL": gnss.SERVICE_GLONASS,
    "GB": gnss.SERVICE_COMPASS,
    "BD": gnss.SERVICE_COMPASS,
    "GA": gnss.SERVICE_GALILEO,
}
_MOST_WAITING = 1000  # sentences that are kept until the date is known
VERTICAL_FACTOR = 1.5  # vertical over horizontal standard deviation, where the receiver does not state it


class NmeaDecoder:
    """Decodes a stream of bytes; everything in it that is no intact sentence is passed over and counted.

    Most sentences carry the time of day alone. The date comes from RMC or ZDA; sentences before the first of those
    wait for it, up to `DATE_PATIENCE`, then the date of arrival is taken. VTG and the headings carry no time: they
    belong to the latest sentence that does if they came in one burst with it, else they are as much later as their
    burst began later. Velocities come from RMC, or from VTG while there is no RMC.
    """

    DATE_PATIENCE = 2 * NANO
    GST_AGE = 2 * NANO
    PAUSE = (
        20_000_000  # [ns] between bursts; within one, bytes come at most as far apart as a USB adapter holds them back
    )

    def __init__(self, settings: GnssSettings | None = None) -> None:
        self.settings = settings or GnssSettings()
        self.channels = GnssChannels(self.settings)
        self.link = LinkStatistics("gnss: NMEA link", self.settings.timeout)
        self._buffer = b""
        self._reference: int | None = None  # a recent UTC time whose date is known [ns]
        self._waiting: list[tuple[str, str, dict[str, Any], int]] = []
        self._heard = self._burst = 0  # arrival of the latest bytes, and of the first ones of their burst [ns]
        self._epoch: tuple[int, int] | None = None  # stamp of the latest sentence with a time, its burst [ns]
        self._fix_sentence: str | None = None
        self._velocity_from_rmc = False
        self._deviations: tuple[int, tuple[float, float, float]] | None = None  # time of day, east, north, up

    def feed(self, data: bytes, received: int) -> list[Sample]:
        """Samples of all sentences that these bytes complete; `received` [ns] is their time of arrival."""
        self.link.heard(len(data), received)
        if abs(received - self._heard) > self.PAUSE:
            self._burst = received
        self._heard = received
        self._buffer += data
        made: list[Sample] = []
        position = 0
        while True:
            start = self._buffer.find(b"$", position)
            end = len(self._buffer) if start < 0 else start
            self.link.other(len(self._buffer[position:end].translate(None, b"\r\n")))
            position = end
            if start < 0:
                break
            if match := _SENTENCE.match(self._buffer, start):
                made += self._sentence(match[1], int(match[2], 16), received)
                position = match.end()
            elif _BEGINNING.fullmatch(self._buffer, start):
                break
            else:
                if self._buffer[start + 1 : start + 2].isalpha():
                    self.link.broken(received)
                self.link.other(1)
                position = start + 1
        self._buffer = self._buffer[position:]
        return made

    @property
    def unfinished(self) -> int:
        """Bytes of a sentence that has not ended."""
        return len(self._buffer)

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health of the link and of each topic at `now` [ns]."""
        sent = self.link.not_decoded
        wanted = f"the receiver sends {sent}; turn on " if sent else ""
        self.channels.fix_monitor.absence = f"{wanted}GGA or GNS" if wanted else ""
        self.channels.velocity_monitor.absence = f"{wanted}RMC or VTG" if wanted else ""
        return [self.link.diagnostic(now), *self.channels.diagnostics(now)]

    def _sentence(self, content: bytes, checksum: int, received: int) -> list[Sample]:
        if reduce(xor, content) != checksum:
            self.link.broken(received)
            return []
        self.link.frame(received)
        address, *fields = content.decode("ascii").split(",")
        talker, kind = address[:-3], address[-3:]
        if kind not in SENTENCES or len(talker) != 2:
            self.link.passed(address[:8])
            return []
        message = fields_of(kind, fields)
        if message is None:
            self.link.broken(received)
            return []
        return self._dated(talker, kind, message, received)

    def _dated(self, talker: str, kind: str, message: dict[str, Any], received: int) -> list[Sample]:
        if not self._learn_date(kind, message) and self._reference is None:
            self._waiting.append((talker, kind, message, received))
            if abs(received - self._waiting[0][3]) < self.DATE_PATIENCE and len(self._waiting) < _MOST_WAITING:
                return []
            time_of_day = next((t for m in self._waiting if (t := m[2].get("time"))), None)
            if time_of_day is None:
                self._waiting.clear()
                return []
            self._reference = gnss.stamp_of_day(time_of_day, self._waiting[0][3])
            ready, self._waiting = self._waiting, []
        else:
            ready, self._waiting = [*self._waiting, (talker, kind, message, received)], []
        return [sample for entry in ready for sample in self._decode(*entry)]

    def _learn_date(self, kind: str, message: dict[str, Any]) -> bool:
        time_of_day, date = message.get("time"), None
        if kind == "RMC" and message["status"] == "A":
            date = message["date"]
        elif kind == "ZDA" and None not in (message["year"], message["month"], message["day"]):
            try:
                date = datetime.date(message["year"], message["month"], message["day"])
            except (ValueError, OverflowError):
                return False
        if date is None or time_of_day is None:
            return False
        self._reference = gnss.utc_stamp(datetime.datetime.combine(date, datetime.time())) + time_of_day
        return True

    def _decode(self, talker: str, kind: str, message: dict[str, Any], received: int) -> list[Sample]:
        if kind in ("HDT", "THS"):
            return self._heading(kind, message, received)
        if kind == "VTG":
            return self._course(message, received)
        time_of_day = message["time"]
        if time_of_day is None or self._reference is None:
            monitor = self.channels.velocity_monitor if kind == "RMC" else self.channels.fix_monitor
            monitor.fault("no time of measurement", received)
            return []
        stamp = gnss.stamp_of_day(time_of_day, self._reference)
        if kind == "GST":
            east, north, up = message["east"], message["north"], message["up"]
            if east and north and up:
                self._deviations = (time_of_day, (east, north, up))
            return []
        if kind == "RMC":
            return self._recommended_minimum(message, stamp, received)
        if kind in ("GGA", "GNS"):
            return self._position(talker, kind, message, stamp, time_of_day, received)
        return []

    def _position(
        self, talker: str, kind: str, message: dict[str, Any], stamp: int, time_of_day: int, received: int
    ) -> list[Sample]:
        if self._fix_sentence is None:
            self._fix_sentence = kind
        if kind != self._fix_sentence:  # the same position in other words
            return []
        if kind == "GGA":
            quality = message["quality"] or 0
        else:
            quality = max((_MODES.get(mode, 0) for mode in message["mode"]), default=0)
        latitude, longitude, height = message["latitude"], message["longitude"], message["altitude"]
        if quality not in _QUALITY or latitude is None or longitude is None or height is None:
            self.channels.fix_monitor.fault("no fix", received)
            return []
        self._epoch = stamp, self._burst
        self._follow(stamp)
        status, factor = _QUALITY[quality]
        stated = self._deviations
        if stated is not None and abs(stated[0] - time_of_day) <= self.GST_AGE:
            deviations, covariance_type = stated[1], gnss.COVARIANCE_DIAGONAL_KNOWN
        else:
            horizontal = self.settings.range_error * factor * (message["hdop"] or 1.0)
            deviations = (horizontal, horizontal, VERTICAL_FACTOR * horizontal)
            covariance_type = gnss.COVARIANCE_APPROXIMATED
        east, north, up = (deviation**2 for deviation in deviations)
        altitude = height + (message["separation"] or 0.0)
        service = _SERVICES.get(talker, gnss.SERVICE_ALL)
        return self.channels.fix(
            stamp, received, latitude, longitude, altitude, (east, north, up), status, service, covariance_type
        )

    def _stamp_by_arrival(self) -> int | None:
        """Stamp of a sentence without a time [ns]: receivers begin each burst equally long after its measurements."""
        if self._epoch is None:
            return None
        stamp, burst = self._epoch
        return stamp + self._burst - burst

    def _follow(self, stamp: int) -> None:
        """Carry the date over midnight where nothing but GGA or GNS has the time."""
        if self._reference is not None and 0 < stamp - self._reference < gnss.DAY // 2:
            self._reference = stamp

    def _recommended_minimum(self, message: dict[str, Any], stamp: int, received: int) -> list[Sample]:
        if message["status"] != "A" or self._is_no_fix(message):
            self.channels.velocity_monitor.fault("no fix", received)
            return []
        self._epoch = stamp, self._burst
        self._velocity_from_rmc = True
        return self._horizontal_velocity(message["knots"], message["course"], stamp, received)

    def _course(self, message: dict[str, Any], received: int) -> list[Sample]:
        stamp = self._stamp_by_arrival()
        if self._velocity_from_rmc or stamp is None:
            return []
        if self._is_no_fix(message):
            self.channels.velocity_monitor.fault("no fix", received)
            return []
        return self._horizontal_velocity(message["knots"], message["course"], stamp, received)

    @staticmethod
    def _is_no_fix(message: dict[str, Any]) -> bool:
        """True if the mode indicator, which sentences have since NMEA 2.3, says that nothing was measured."""
        return message["mode"] in _NOT_MEASURED

    def _horizontal_velocity(
        self, knots: float | None, course: float | None, stamp: int, received: int
    ) -> list[Sample]:
        if knots is None or (course is None and knots > 1.0):
            self.channels.velocity_monitor.fault("no speed or course", received)
            return []
        # Receivers leave the course empty at standstill, where it has no meaning.
        speed, direction = (knots * KNOT, math.radians(course)) if course is not None else (0.0, 0.0)
        variance = self.settings.speed_deviation**2
        variances = (variance, variance, UNMEASURED_VARIANCE)
        east, north = speed * math.sin(direction), speed * math.cos(direction)
        return self.channels.velocity(stamp, received, east, north, None, variances)

    def _heading(self, kind: str, message: dict[str, Any], received: int) -> list[Sample]:
        if kind == "THS" and message["mode"] not in ("A", "E"):
            self.channels.attitude_monitor.fault("heading not valid", received)
            return []
        heading = message["heading"]
        if heading is None:
            self.channels.attitude_monitor.fault("no heading", received)
            return []
        stamp = self._stamp_by_arrival()
        if stamp is None:
            return []
        variance = self.settings.heading_deviation**2
        return self.channels.attitude(stamp, received, math.radians(heading), variance)
