"""Inertial measurements: their plausibility and mounting, and the Xsens XBus protocol (MTData2).

Protocol: Xsens, MT Low Level Communication Protocol Documentation (MT0101P).
"""

from __future__ import annotations

import datetime
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.driver import samples
from vsense_ros.driver.gnss import LinkStatistics, utc_stamp
from vsense_ros.driver.monitor import NANO, StreamLimits, StreamMonitor
from vsense_ros.driver.sensor_clock import SensorClock
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


def mounting_rotation(mounting: str | Sequence[Sequence[float]]) -> NDArray[np.float64]:
    """Rotation (3, 3) from the sensor's axes to those of the vehicle (forward, left, up).

    Either `"x,-y,-z"`: which axis of the sensor points forward, left and up (here for a sensor whose axes are forward,
    right, down), or the matrix itself. `InputError` if that is no rotation.
    """
    if isinstance(mounting, str):
        rows = []
        for part in mounting.replace(" ", "").lower().split(","):
            sign, axis = (-1.0, part[1:]) if part.startswith("-") else (1.0, part.removeprefix("+"))
            if axis not in _AXES:
                raise InputError(f"IMU mounting {mounting!r}: {part!r} is no axis; expected three such as 'x,-y,-z'")
            rows.append([sign * component for component in _AXES[axis]])
        matrix = np.array(rows)
    else:
        try:
            matrix = np.array(mounting, float)
        except (ValueError, TypeError):
            raise InputError(f"IMU mounting {mounting!r}: expected 'x,-y,-z' or a 3 × 3 matrix") from None
    if matrix.shape != (3, 3):
        raise InputError(f"IMU mounting {mounting!r}: expected three axes or a 3 × 3 matrix, found {matrix.shape}")
    determinant = np.linalg.det(matrix)
    if not (np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3) and determinant > 0):
        raise InputError(
            f"IMU mounting {mounting!r} is no rotation (determinant {determinant:.3g}): "
            "each axis once, right-handed; a left-handed sensor cannot be mounted so"
        )
    return matrix


@dataclass(frozen=True, slots=True)
class ImuSettings:
    """Topic, mounting, noise and limits of an IMU.

    A sample is saturated at `rate_range` or `acceleration_range`, and frozen when `frozen_after` samples in a row have
    exactly the same values, which noise keeps a working sensor from.
    """

    topic: str = "imu/data"
    frame_id: str = "imu_link"
    mounting: str | Sequence[Sequence[float]] = "x,y,z"
    nominal_rate: float | None = None  # [Hz]
    timeout: float = 0.2  # [s]
    latency: float = 0.0  # [s] from the measurement to the sensor's time stamp
    rate_range: float = math.radians(2000)  # [rad/s]
    acceleration_range: float = 16 * 9.80665  # [m/s²]
    rate_deviation: float = 0.002  # [rad/s], where the sample states none
    acceleration_deviation: float = 0.03  # [m/s²], where the sample states none
    frozen_after: int = 20

    def __post_init__(self) -> None:
        for name in ("timeout", "rate_range", "acceleration_range", "rate_deviation", "acceleration_deviation"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"IMU setting {name} is {value}, expected a number above 0")
        if self.frozen_after < 2:
            raise InputError(f"IMU setting frozen_after is {self.frozen_after}, expected at least 2")


class ImuChecker:
    """Passes on plausible samples of one IMU in vehicle axes, and reports on the others."""

    def __init__(self, settings: ImuSettings | None = None) -> None:
        self.settings = settings or ImuSettings()
        self.rotation = mounting_rotation(self.settings.mounting)
        self._turned = not np.array_equal(self.rotation, np.eye(3))
        limits = StreamLimits(timeout=self.settings.timeout, nominal_rate=self.settings.nominal_rate)
        self.monitor = StreamMonitor(f"imu: {self.settings.topic}", limits)
        self._last: bytes = b""
        self._repeats = 0

    def check(self, sample: Sample) -> Sample | None:
        """The sample with topic, frame and axes of the vehicle; None if it is not believed.

        A rotated sensor's orientation is not passed on.
        """
        at = sample.received if sample.received is not None else sample.stamp
        objection = self._objection(sample.values)
        if objection is not None:
            reason, level = objection
            self.monitor.fault(reason, at, level)
            return None
        if not self.monitor.accept(sample.stamp, sample.received):
            return None
        settings = self.settings
        values = dict(sample.values)
        for field, deviation in (
            ("angular_velocity", settings.rate_deviation),
            ("linear_acceleration", settings.acceleration_deviation),
        ):
            covariance = values[f"{field}_covariance"]
            if covariance[0] == -1.0:
                continue
            if not covariance.any():
                covariance = samples.diagonal([deviation**2] * 3)
            rotated = self.rotation @ covariance.reshape(3, 3) @ self.rotation.T
            values[f"{field}_covariance"] = rotated.ravel()
            values[field] = self.rotation @ values[field]
        if self._turned:
            values["orientation"] = np.array([0.0, 0.0, 0.0, 1.0])
            values["orientation_covariance"] = samples.ABSENT.copy()
        stamp = sample.stamp - round(settings.latency * NANO)
        return replace(sample, topic=settings.topic, frame_id=settings.frame_id, stamp=stamp, values=values)

    def _objection(self, values: Mapping[str, NDArray[np.float64]]) -> tuple[str, Level] | None:
        present = [
            (values[field], limit)
            for field, limit in (
                ("angular_velocity", self.settings.rate_range),
                ("linear_acceleration", self.settings.acceleration_range),
            )
            if values[f"{field}_covariance"][0] != -1.0
        ]
        if not present:
            return "neither rates nor accelerations", Level.ERROR
        if not all(np.isfinite(vector).all() for vector, _ in present):
            return "not a number", Level.ERROR
        reading = b"".join(vector.tobytes() for vector, _ in present)
        self._repeats = self._repeats + 1 if reading == self._last else 0
        self._last = reading
        if self._repeats >= self.settings.frozen_after - 1:
            return "values frozen", Level.ERROR
        if any((np.abs(vector) >= limit).any() for vector, limit in present):
            return "saturated", Level.WARN
        return None

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health at `now` [ns]."""
        return [self.monitor.diagnostic(now)]


_PREAMBLE = b"\xfa\xff\x36"  # preamble, bus identifier of a master, MTData2
_EXTENDED = 0xFF
_LONGEST = 2048
_UTC_TIME, _PACKET_COUNTER, _SAMPLE_TIME_FINE = 0x1010, 0x1020, 0x1060
_ACCELERATION, _ACCELERATION_HR, _RATE_OF_TURN, _RATE_OF_TURN_HR = 0x4020, 0x4040, 0x8020, 0x8040
_DELTA_V, _DELTA_Q = 0x4010, 0x8030  # over one period: velocity [m/s], quaternion w, x, y, z
_FLOATS = {0: "f", 3: "d"}  # number formats by the lowest two bits of the identifier; 1 is fixed point 12.20
_FIXED_16_32 = 2
_VECTOR = struct.Struct(">3f")
_UTC = struct.Struct(">IHBBBBBB")  # ns, year, month, day, hour, minute, second, flags
_UTC_VALID = 0x03  # date and time of day
_TICK = 100_000  # [ns] of SampleTimeFine
_WRAP = 2**32  # ticks


class XbusDecoder:
    """Decodes a stream of XBus bytes; what is no intact MTData2 message is passed over and counted.

    Time of measurement is the sensor's UTC time where it knows it, else its own clock (SampleTimeFine), tied to the
    time of arrival at the fastest transmission seen, else the time of arrival.
    """

    def __init__(self, settings: ImuSettings | None = None) -> None:
        self.checker = ImuChecker(settings)
        self.link = LinkStatistics("imu: XBus link", self.checker.settings.timeout)
        self._buffer = b""
        self._counter: int | None = None
        self._clock = SensorClock(_TICK, _WRAP, self.checker.monitor.note)
        self._lost = 0
        self._summed_until: int | None = None  # stamp of the latest velocity increment and turn [ns]

    def feed(self, data: bytes, received: int) -> list[Sample]:
        """Samples of all messages that these bytes complete; `received` [ns] is their time of arrival."""
        self.link.heard(len(data), received)
        self._buffer += data
        made: list[Sample] = []
        position = 0
        while True:
            start = self._buffer.find(_PREAMBLE[:1], position)
            end = len(self._buffer) if start < 0 else start
            self.link.other(end - position)
            position = end
            if start < 0:
                break
            head = self._buffer[start : start + 6]
            if not head.startswith(_PREAMBLE) and not _PREAMBLE.startswith(head):
                self.link.other(1)
                position = start + 1
                continue
            extended = len(head) > 3 and head[3] == _EXTENDED
            if len(head) < (6 if extended else 4):
                break
            body = start + (6 if extended else 4)
            length = int.from_bytes(head[4:6], "big") if extended else head[3]
            stop = body + length + 1
            packets: dict[int, bytes] | None = None
            if length <= _LONGEST:
                if stop > len(self._buffer):
                    break
                if sum(self._buffer[start + 1 : stop]) & 0xFF == 0:
                    packets = _packets(self._buffer[body : stop - 1])
            if packets is None:
                self.link.broken(received)
                self.link.other(1)
                position = start + 1
                continue
            self.link.frame(received)
            position = stop
            sample = self._sample(packets, received)
            if sample is not None:
                made.append(sample)
        self._buffer = self._buffer[position:]
        return made

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health of the link and of the IMU at `now` [ns]."""
        sent = self.link.not_decoded
        self.checker.monitor.absence = (
            f"the sensor sends {sent}; set it to Acceleration (0x4020) and Rate of Turn (0x8020)" if sent else ""
        )
        return [
            self.link.diagnostic(now),
            self.checker.monitor.diagnostic(now, {"lost by the packet counter": str(self._lost)}),
        ]

    def _sample(self, packets: dict[int, bytes], received: int) -> Sample | None:
        missing = 0
        counter = packets.get(_PACKET_COUNTER)
        if counter is not None and len(counter) == 2:
            value = int.from_bytes(counter, "big")
            missing = 0 if self._counter is None else (value - self._counter - 1) & 0xFFFF
            missing = missing if missing < 0x8000 else 0
            if missing:
                self._lost += missing
                self.checker.monitor.note("packets missing", received)
            self._counter = value
        rates = _numbers(packets, _RATE_OF_TURN, 3)
        if rates is None:
            rates = _numbers(packets, _RATE_OF_TURN_HR, 3)
        accelerations = _numbers(packets, _ACCELERATION, 3)
        if accelerations is None:
            accelerations = _numbers(packets, _ACCELERATION_HR, 3)
        stamp = self._stamp(packets, received)
        if rates is None and accelerations is None:
            velocity, turn = _numbers(packets, _DELTA_V, 3), _numbers(packets, _DELTA_Q, 4)
            period = self._period_until(stamp, missing)
            if velocity is None and turn is None:
                self.link.passed(", ".join(f"0x{identifier:04X}" for identifier in packets))
                return None
            if period is None:
                self.checker.monitor.passed("first increment, whose period is not known")
                return None
            accelerations = None if velocity is None else velocity / period
            rates = None if turn is None else _rotation_vector(turn) / period
        return self.checker.check(
            samples.imu(
                "",
                stamp,
                "",
                angular_velocity=rates,
                linear_acceleration=accelerations,
                received=received,
            )
        )

    def _period_until(self, stamp: int, missing: int) -> float | None:
        """Period of a measurement that was summed up until `stamp` [s]; None while it is not known."""
        before, self._summed_until = self._summed_until, stamp
        nominal = self.checker.settings.nominal_rate
        if nominal is not None:
            return 1.0 / nominal
        if before is None:
            return None
        period = (stamp - before) / NANO / (missing + 1)
        return period if 0.0 < period < 1.0 else None

    def _stamp(self, packets: dict[int, bytes], received: int) -> int:
        utc = packets.get(_UTC_TIME)
        if utc is not None and len(utc) == _UTC.size:
            nanoseconds, year, month, day, hour, minute, second, flags = _UTC.unpack(utc)
            if flags & _UTC_VALID == _UTC_VALID:
                try:
                    return utc_stamp(datetime.datetime(year, month, day, hour, minute, min(second, 59)), nanoseconds)
                except ValueError:
                    self.checker.monitor.note("UTC time out of range", received)
        ticks = packets.get(_SAMPLE_TIME_FINE)
        if ticks is not None and len(ticks) == 4:
            return self._clock.stamp(int.from_bytes(ticks, "big"), received)
        return received


def _packets(data: bytes) -> dict[int, bytes] | None:
    """Payloads by identifier; None if they do not fill the message exactly."""
    payloads: dict[int, bytes] = {}
    position = 0
    while position + 3 <= len(data):
        identifier, length = struct.unpack_from(">HB", data, position)
        payload = data[position + 3 : position + 3 + length]
        if len(payload) < length:
            return None
        payloads[identifier] = payload
        position += 3 + length
    return payloads if position == len(data) else None


def _numbers(packets: dict[int, bytes], identifier: int, count: int) -> NDArray[np.float64] | None:
    """Numbers (count,) in any of the four formats, in whichever coordinates their identifier names."""
    for kind, payload in packets.items():
        if kind & 0xFFF0 != identifier:
            continue
        form = kind & 0x3
        if form in _FLOATS and len(payload) == count * struct.calcsize(_FLOATS[form]):
            return np.array(struct.unpack(f">{count}{_FLOATS[form]}", payload), float)
        if form == _FIXED_16_32 and len(payload) == 6 * count:  # each: fraction, 32 bits, then the whole part
            parts = [struct.unpack_from(">Ih", payload, 6 * i) for i in range(count)]
            return np.array([whole + fraction / 2**32 for fraction, whole in parts])
        if form not in (*_FLOATS, _FIXED_16_32) and len(payload) == 4 * count:
            return np.array(struct.unpack(f">{count}i", payload)) / 2**20
    return None


def _rotation_vector(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotation (3,) [rad] of a quaternion w, x, y, z."""
    w, axis = float(quaternion[0]), quaternion[1:]
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return 2.0 * axis
    return 2.0 * math.atan2(sine, abs(w)) / sine * axis * math.copysign(1.0, w)


def encode_mtdata2(sample: Sample, packet_counter: int = 0) -> bytes:
    """The MTData2 message that a sensor with the sample's axes would send for it (single precision, valid UTC time)."""
    seconds, nanoseconds = divmod(sample.stamp, NANO)
    moment = datetime.datetime.fromtimestamp(seconds, datetime.UTC)
    utc = _UTC.pack(nanoseconds, moment.year, moment.month, moment.day, moment.hour, moment.minute, moment.second, 0x07)
    content = [
        (_PACKET_COUNTER, struct.pack(">H", packet_counter & 0xFFFF)),
        (_UTC_TIME, utc),
        (_SAMPLE_TIME_FINE, struct.pack(">I", sample.stamp // _TICK % 2**32)),
    ]
    for identifier, field in ((_ACCELERATION, "linear_acceleration"), (_RATE_OF_TURN, "angular_velocity")):
        if sample.values[f"{field}_covariance"][0] != -1.0:
            content.append((identifier, _VECTOR.pack(*sample.values[field])))
    data = b"".join(struct.pack(">HB", identifier, len(payload)) + payload for identifier, payload in content)
    message = _PREAMBLE + bytes([len(data)]) + data
    return message + bytes([-sum(message[1:]) & 0xFF])
