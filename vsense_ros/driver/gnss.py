"""What receivers of all protocols have in common: the three topics, their checks, and UTC."""

from __future__ import annotations

import datetime
import math
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.watch import PlausibilityWatch
from vsense_ros.driver import samples
from vsense_ros.driver.monitor import NANO, StreamLimits, StreamMonitor
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample

DAY = 86400 * NANO
_EPOCH = datetime.date(1970, 1, 1).toordinal()
_FIX, _VELOCITY = "sensor_msgs/msg/NavSatFix", "geometry_msgs/msg/TwistWithCovarianceStamped"
_OF_VELOCITY = samples.diagonal([samples.UNMEASURED_VARIANCE] * 6)
_NO_TURNING = np.zeros(3)
_NO_TURNING.setflags(write=False)
_MOST_KINDS = 64  # of frames that are counted by name

# sensor_msgs/NavSatStatus and NavSatFix
STATUS_FIX, STATUS_SBAS, STATUS_GBAS = 0, 1, 2
SERVICE_GPS, SERVICE_GLONASS, SERVICE_COMPASS, SERVICE_GALILEO = 1, 2, 4, 8
SERVICE_ALL = SERVICE_GPS | SERVICE_GLONASS | SERVICE_COMPASS | SERVICE_GALILEO
COVARIANCE_APPROXIMATED, COVARIANCE_DIAGONAL_KNOWN = 1, 2


@dataclass(frozen=True, slots=True)
class GnssSettings:
    """Topics, frames and accuracies of a receiver.

    `range_error`, `speed_deviation` and `heading_deviation` are used where the receiver does not state its own.
    `baseline_yaw` is the direction from the first to the second antenna of a dual-antenna receiver, from the
    vehicle's x axis to the left.
    """

    fix_topic: str = "gps/fix"
    velocity_topic: str = "gps/velocity"
    attitude_topic: str = "gps/attitude"
    frame_id: str = "gnss_link"
    map_frame_id: str = "map"
    nominal_rate: float | None = None  # [Hz]
    timeout: float = 2.0  # [s]
    range_error: float = 3.0  # [m], times HDOP
    speed_deviation: float = 0.1  # [m/s], each horizontal axis
    heading_deviation: float = math.radians(0.3)  # [rad]
    baseline_yaw: float = 0.0  # [rad]
    jump_limit: float = 10.0  # [m] between a fix and where the velocity leads

    def __post_init__(self) -> None:
        for name in ("timeout", "range_error", "speed_deviation", "heading_deviation", "jump_limit"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"GNSS setting {name} is {value}, expected a number above 0")


def utc_stamp(moment: datetime.datetime, nanoseconds: int = 0) -> int:
    """Unix time [ns] of a UTC date and time."""
    seconds = ((moment.toordinal() - _EPOCH) * 24 + moment.hour) * 3600 + moment.minute * 60 + moment.second
    return seconds * NANO + moment.microsecond * 1000 + nanoseconds


def stamp_of_day(time_of_day: int, reference: int) -> int:
    """The moment nearest to `reference` at which the UTC clock shows `time_of_day`; all in [ns].

    Sentences without a date get theirs so, on both sides of midnight.
    """
    day = reference - reference % DAY
    stamp = day + time_of_day
    if stamp - reference > DAY // 2:
        return stamp - DAY
    if reference - stamp > DAY // 2:
        return stamp + DAY
    return stamp


def metres_between(latitude: float, longitude: float, to_latitude: float, to_longitude: float) -> tuple[float, float]:
    """Way to the east and to the north [m] between near points [deg], on the radii of curvature of WGS 84."""
    major, eccentricity_squared = 6378137.0, 6.69437999014e-3
    sine = math.sin(math.radians(latitude))
    root = math.sqrt(1.0 - eccentricity_squared * sine * sine)
    normal, meridian = major / root, major * (1.0 - eccentricity_squared) / root**3
    turn = (to_longitude - longitude + 180.0) % 360.0 - 180.0
    east = math.radians(turn) * normal * math.cos(math.radians(latitude))
    return east, math.radians(to_latitude - latitude) * meridian


@cache
def _one(number: int) -> NDArray[np.float64]:
    """A column of one of the few numbers that name a state, a service or a type; it cannot be written to."""
    column = np.array([float(number)])
    column.setflags(write=False)
    return column


class GnssChannels:
    """Makes the samples of `gps/fix`, `gps/velocity` and `gps/attitude`, and watches over each of them.

    Stamps are UTC times of measurement, `received` is the time of arrival, both in Unix nanoseconds.
    """

    MAX_VELOCITY_AGE = 5 * NANO
    SOONEST, SLOWEST = -NANO // 10, NANO  # [ns] from stamp to arrival, where the clocks agree

    def __init__(self, settings: GnssSettings) -> None:
        self.settings = settings
        limits = StreamLimits(timeout=settings.timeout, nominal_rate=settings.nominal_rate)
        self.fix_monitor = StreamMonitor(f"gnss: {settings.fix_topic}", limits)
        self.velocity_monitor = StreamMonitor(f"gnss: {settings.velocity_topic}", limits)
        self.attitude_monitor = StreamMonitor(f"gnss: {settings.attitude_topic}", limits)
        self.watch = PlausibilityWatch("gnss")
        self._delay = 0  # arrival of the latest measurement after its stamp [ns]
        self._last_fix: tuple[int, float, float] | None = None
        self._last_velocity: tuple[int, float, float] | None = None

    def _accept(self, monitor: StreamMonitor, stamp: int, received: int) -> bool:
        accepted = monitor.accept(stamp, received)
        if accepted:
            self._delay = received - stamp
        return accepted

    def fix(
        self,
        stamp: int,
        received: int,
        latitude: float,
        longitude: float,
        altitude: float,
        variances: tuple[float, float, float],
        status: int,
        service: int,
        covariance_type: int,
    ) -> list[Sample]:
        """A position [deg, deg, m above the ellipsoid] with variances east, north, up [m²]."""
        if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0 and math.isfinite(altitude)):
            self.fix_monitor.fault("position out of range", received)
            return []
        if not self._accept(self.fix_monitor, stamp, received):
            return []
        self._look_for_a_jump(stamp, received, latitude, longitude)
        place = np.array((latitude, longitude, altitude), float)
        covariance = np.zeros(9)
        covariance[0], covariance[4], covariance[8] = variances
        values = {
            "status": _one(status),
            "service": _one(service),
            "latitude": place[:1],
            "longitude": place[1:2],
            "altitude": place[2:],
            "position_covariance": covariance,
            "position_covariance_type": _one(covariance_type),
        }
        settings = self.settings
        made = Sample(settings.fix_topic, _FIX, stamp, values, settings.frame_id, (), "", received)
        self._watch(made, "gps/fix")
        return [made]

    def _watch(self, made: Sample, topic: str) -> None:
        """Show a sample to the checks, which know it by its usual topic."""
        self.watch.add(made if made.topic == topic else replace(made, topic=topic))

    def _look_for_a_jump(self, stamp: int, received: int, latitude: float, longitude: float) -> None:
        last, self._last_fix = self._last_fix, (stamp, latitude, longitude)
        velocity = self._last_velocity
        if last is None or velocity is None or abs(stamp - velocity[0]) > self.MAX_VELOCITY_AGE:
            return
        seconds = (stamp - last[0]) / NANO
        if not 0 < seconds <= self.MAX_VELOCITY_AGE / NANO:
            return
        east, north = metres_between(last[1], last[2], latitude, longitude)
        if math.hypot(east - velocity[1] * seconds, north - velocity[2] * seconds) > self.settings.jump_limit:
            self.fix_monitor.note("position jump against the velocity", received)

    def velocity(
        self,
        stamp: int,
        received: int,
        east: float,
        north: float,
        up: float | None,
        variances: tuple[float, float, float],
    ) -> list[Sample]:
        """A velocity [m/s] with variances east, north, up [m²/s²]. `up` is None where it is not measured: then it is 0,
        with a variance that says so, as NaN would spread over all axes of who turns the vector."""
        if not self._accept(self.velocity_monitor, stamp, received):
            return []
        self._last_velocity = (stamp, east, north)
        vertical = variances[2] if up is not None else samples.UNMEASURED_VARIANCE
        covariance = _OF_VELOCITY.copy()
        covariance[0], covariance[7], covariance[14] = variances[0], variances[1], vertical
        values = {
            "linear": np.array((east, north, 0.0 if up is None else up)),
            "angular": _NO_TURNING,
            "covariance": covariance,
        }
        settings = self.settings
        made = Sample(settings.velocity_topic, _VELOCITY, stamp, values, settings.map_frame_id, (), "", received)
        self._watch(made, "gps/velocity")
        return [made]

    def attitude(
        self,
        stamp: int,
        received: int,
        heading: float,
        heading_variance: float,
        elevation: float | None = None,
        elevation_variance: float = samples.UNMEASURED_VARIANCE,
    ) -> list[Sample]:
        """The direction of the antenna baseline: heading from north to east, elevation above the horizon [rad].

        The elevation is the vehicle's pitch where the antennas stand one behind the other, and its roll where they
        stand side by side; between the two it is left out.
        """
        if not math.isfinite(heading):
            self.attitude_monitor.fault("heading is not a number", received)
            return []
        if not self._accept(self.attitude_monitor, stamp, received):
            return []
        baseline = self.settings.baseline_yaw
        along, across = math.cos(baseline), math.sin(baseline)
        roll = pitch = 0.0
        roll_variance = pitch_variance = samples.UNMEASURED_VARIANCE
        if elevation is not None and abs(across) < 0.05:
            pitch, pitch_variance = -math.copysign(elevation, elevation * along), elevation_variance
        elif elevation is not None and abs(along) < 0.05:
            roll, roll_variance = math.copysign(elevation, elevation * across), elevation_variance
        yaw = math.remainder(math.pi / 2 - heading - baseline, 2 * math.pi)
        settings = self.settings
        variances = (roll_variance, pitch_variance, heading_variance)
        return [
            samples.heading_and_tilt(
                settings.attitude_topic, stamp, settings.frame_id, yaw, variances, roll, pitch, received
            )
        ]

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health of the topics; of the attitude only if the receiver ever spoke of it, of the clocks if they differ."""
        monitors = [self.fix_monitor, self.velocity_monitor]
        if self.attitude_monitor.accepted or self.attitude_monitor.faults:
            monitors.append(self.attitude_monitor)
        diagnostics = [monitor.diagnostic(now) for monitor in monitors]
        if not self.SOONEST <= self._delay <= self.SLOWEST:
            side = "ahead of" if self._delay > 0 else "behind"
            text = f"the computer's clock is {abs(self._delay) / NANO:.1f} s {side} the receiver's: "
            text += "set it by UTC (chrony, PTP), or look at the receiver's date"
            diagnostics.append(Diagnostic("gnss: clocks", Level.WARN, text))
        return [*diagnostics, *self.watch.diagnostics(now)]


class LinkStatistics:
    """Bytes and frames of a serial link, and what the two say about it."""

    def __init__(self, name: str, timeout: float) -> None:
        self.name = name
        self.timeout = timeout
        self.counts = {"bytes": 0, "frames": 0, "broken frames": 0, "other bytes": 0}
        self._passed: Counter[str] = Counter()
        self._last_bytes: int | None = None
        self._last_frame: int | None = None
        self._last_broken: int | None = None

    def heard(self, count: int, at: int) -> None:
        """Bytes arrived."""
        if count:
            self.counts["bytes"] += count
            self._last_bytes = at

    def frame(self, at: int) -> None:
        """An intact frame was found."""
        self.counts["frames"] += 1
        self._last_frame = at

    def broken(self, at: int) -> None:
        """A frame began that is incomplete or whose checksum is wrong."""
        self.counts["broken frames"] += 1
        self._last_broken = at

    def other(self, count: int) -> None:
        """Bytes that belong to no frame of this protocol."""
        self.counts["other bytes"] += count

    def passed(self, name: str) -> None:
        """An intact frame of a kind that is not decoded."""
        if name in self._passed or len(self._passed) < _MOST_KINDS:
            self._passed[name] += 1

    @property
    def not_decoded(self) -> str:
        """The kinds of intact frames that came and are not decoded, the most frequent first; empty if none."""
        return ", ".join(f"{name} × {count}" for name, count in self._passed.most_common(12))

    def diagnostic(self, now: int) -> Diagnostic:
        """Health of the link at `now` [ns]."""
        values = {name: str(count) for name, count in self.counts.items()}
        if self._passed:
            values["not decoded"] = self.not_decoded
        silence = self.timeout * NANO
        level, text = Level.OK, "ok"
        if self._last_bytes is None:
            level, text = Level.STALE, "no bytes received: is the port right, and the sensor on?"
        elif now - self._last_bytes > silence:
            level, text = Level.STALE, f"silent for {(now - self._last_bytes) / NANO:.2f} s"
        elif self._last_frame is None or now - self._last_frame > silence:
            level, text = Level.ERROR, "bytes arrive but no intact frame: are baud rate and protocol right?"
            if self._passed:
                text = f"none of the frames that arrive is decoded: {self.not_decoded}"
        elif self._last_broken is not None and abs(now - self._last_broken) <= 2 * NANO:
            level, text = Level.WARN, "broken frames (incomplete or wrong checksum)"
        return Diagnostic(self.name, level, text, values)
