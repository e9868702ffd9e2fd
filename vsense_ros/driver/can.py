"""CAN frames to samples: a DBC says where the signals are, a mapping says what they mean."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import can
import cantools
import numpy as np
from cantools.database import Database, Message
from cantools.database import Signal as DbcSignal

from vsense_ros.driver import samples
from vsense_ros.driver.can_checksum import CHECKSUMS
from vsense_ros.driver.can_mapping import (
    UNITS,
    CanMapping,
    CounterCheck,
    ImuOutput,
    JointStateOutput,
    MessageCheck,
    Signal,
    load_mapping,
    suggestion,
)
from vsense_ros.driver.monitor import LATEST, NANO, StreamLimits, StreamMonitor
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample


def load_database(path: str | Path) -> Database:
    """Read a DBC (or another format that cantools knows); overlapping signals are allowed.

    `InputError` if the file is missing or cannot be understood.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a CAN database (.dbc, .arxml, .kcd, .sym)")
    try:
        database = cantools.database.load_file(path, strict=False)
    except (cantools.Error, cantools.database.UnsupportedDatabaseFormatError, ValueError, OSError) as error:
        raise InputError(f"{path}: not a CAN database that can be read: {error}") from None
    if not isinstance(database, Database):
        raise InputError(f"{path}: expected a CAN database, found diagnostic descriptions (CDD)")
    return database


@dataclass(frozen=True, slots=True)
class _Conversion:
    """A `Signal` bound to the DBC: the physical values that it sums, and one affine map to SI."""

    name: str
    signals: tuple[str, ...]
    gain: float
    offset: float  # [SI]
    lowest: float  # [SI], before a rolling radius is applied
    highest: float
    divisor: float  # rolling radius [m] or 1
    unit: str

    def convert(self, physical: dict[str, float]) -> tuple[float, bool]:
        """Value in SI and whether it is in the plausible range."""
        value = self.gain * sum(physical[name] for name in self.signals) + self.offset
        return value / self.divisor, self.lowest <= value <= self.highest


def _bind(name: str, signal: Signal, message: Message, where: str) -> tuple[_Conversion, list[DbcSignal]]:
    known = {s.name: s for s in message.signals}
    bound = []
    for wanted in signal.signals:
        if wanted not in known:
            raise InputError(
                f"{where}, {name}: message {message.name} has no signal {wanted!r}{suggestion(wanted, known)}; "
                f"it has {', '.join(known)}"
            )
        bound.append(known[wanted])
        stated = known[wanted].unit
        if stated in UNITS and signal.factor == 1.0 and stated != signal.unit:
            raise InputError(
                f"{where}, {name}: the database gives {message.name}.{wanted} in {stated!r}, the mapping says "
                f"{signal.unit!r}; correct the unit, or state the factor between the two"
            )
    to_si = UNITS[signal.unit][1]
    lowest, highest = (bound_ * to_si for bound_ in signal.range) if signal.range else (-math.inf, math.inf)
    conversion = _Conversion(
        name,
        signal.signals,
        signal.factor * to_si,
        signal.offset * to_si,
        lowest,
        highest,
        signal.rolling_radius or 1.0,
        signal.output_unit,
    )
    return conversion, [] if signal.range else bound


def _has_range(signal: DbcSignal) -> bool:
    return signal.minimum is not None and signal.maximum is not None and signal.minimum < signal.maximum


class _CounterState:
    """The last counter value and the verdict on the next."""

    def __init__(self, check: CounterCheck, message: Message, where: str) -> None:
        known = {s.name: s for s in message.signals}
        if check.signal not in known:
            raise InputError(
                f"{where}: message {message.name} has no counter signal {check.signal!r}"
                f"{suggestion(check.signal, known)}; it has {', '.join(known)}"
            )
        self.check = check
        self.modulus = 1 << known[check.signal].length
        self.last: int | None = None
        self.lost = 0

    def objection(self, value: int) -> str | None:
        """Why a frame with this counter is not believed; None if it is. Every counter becomes the reference."""
        previous, self.last = self.last, value
        if previous is None:
            return None
        step = (value - previous) % self.modulus
        if step == 0:
            return "counter frozen"
        if step > self.check.max_delta:
            return "counter jumping"
        self.lost += step - 1
        return None


class _Receiver:
    """One message of the bus: its checks and the outputs made from it."""

    def __init__(
        self, message: Message, check: MessageCheck, outputs: list[JointStateOutput | ImuOutput], where: str
    ) -> None:
        self.message = message
        self.outputs: list[tuple[JointStateOutput | ImuOutput, list[_Conversion]]] = []
        self.ranges: dict[str, DbcSignal] = {}
        for output in outputs:
            conversions = []
            for name, signal in output.named_signals().items():
                conversion, checked = _bind(name, signal, message, f"{where}, {output.topic}")
                conversions.append(conversion)
                self.ranges |= {s.name: s for s in checked if _has_range(s)}
            self.outputs.append((output, conversions))
        self.length = message.length if check.length is None else check.length
        self.needed = {name for _, conversions in self.outputs for c in conversions for name in c.signals}
        if check.counter is not None:
            self.needed.add(check.counter.signal)
        if not message.is_multiplexed():
            missing = self.needed - message.decode(bytes(self.length), allow_truncated=True).keys()
            if missing and self.needed <= {s.name for s in message.signals}:
                raise InputError(
                    f"{where}: {message.name} with {self.length} data bytes has no room for {', '.join(missing)}"
                )
        self.latency = round(check.latency * NANO)
        self.checksum = check.checksum
        if self.checksum is not None and not -1 <= self.checksum.byte < self.length:
            raise InputError(
                f"{where}: checksum byte {self.checksum.byte} of {message.name} is outside its {self.length} bytes"
            )
        self.counter = _CounterState(check.counter, message, where) if check.counter else None
        topics = ", ".join(output.topic for output in outputs)
        limits = StreamLimits(timeout=check.timeout, nominal_rate=check.rate)
        self.monitor = StreamMonitor(f"can: {topics} ({message.name}, 0x{message.frame_id:X})", limits)

    def objection(self, data: bytes) -> str | None:
        """Why the data is not believed before its signals are looked at."""
        if len(data) != self.length:
            return f"data length {len(data)}, expected {self.length}"
        if self.checksum is not None:
            at = self.checksum.byte % self.length
            expected = CHECKSUMS[self.checksum.algorithm](
                self.message.frame_id, data[:at] + data[at + 1 :], self.length
            )
            if data[at] != expected:
                return "bad checksum"
        return None

    def feed(self, message: can.Message, received: int | None) -> list[Sample]:
        arrival = round(message.timestamp * NANO)
        at = arrival if received is None else received
        monitor = self.monitor
        data = bytes(message.data)
        reason = self.objection(data)
        physical: dict[str, float] = {}
        if reason is None:
            try:
                physical = self.message.decode(data, decode_choices=False, allow_truncated=True)
            except (cantools.Error, ValueError) as error:
                reason = f"cannot be decoded: {error}"
            else:
                if not self.needed <= physical.keys():  # another page of a multiplexed message
                    return []
        if reason is None and self.counter is not None:
            reason = self.counter.objection(int(physical[self.counter.check.signal]))
        if reason is None:
            reason = self._out_of_range(physical)
        made: list[tuple[JointStateOutput | ImuOutput, dict[str, float]]] = []
        if reason is None:
            for output, conversions in self.outputs:
                values = {}
                for conversion in conversions:
                    values[conversion.name], plausible = conversion.convert(physical)
                    if not plausible:
                        reason = f"{conversion.name} out of range"
                made.append((output, values))
        if reason is not None:
            monitor.fault(reason, at)
            return []
        if not monitor.accept(arrival, received):
            return []
        stamp = arrival - self.latency
        return [_sample(output, values, stamp, at) for output, values in made]

    def _out_of_range(self, physical: dict[str, float]) -> str | None:
        for name, signal in self.ranges.items():
            slack = 0.5 * abs(float(signal.scale))
            if not float(signal.minimum or 0) - slack <= physical[name] <= float(signal.maximum or 0) + slack:
                return f"{name} out of range [{signal.minimum}, {signal.maximum}]"
        return None

    def diagnostic(self, now: int) -> Diagnostic:
        values = {} if self.counter is None else {"lost by the counter": str(self.counter.lost)}
        return self.monitor.diagnostic(now, values)


def _sample(output: JointStateOutput | ImuOutput, values: dict[str, float], stamp: int, received: int) -> Sample:
    if isinstance(output, JointStateOutput):
        return samples.joint_state(output.topic, stamp, output.field, values, received)
    vectors: dict[str, np.ndarray | None] = {}
    for field in ("angular_velocity", "linear_acceleration"):
        names = [f"{field}_{axis}" for axis in "xyz"]
        if not any(name in values for name in names):
            continue
        vectors[field] = np.array([values.get(name, math.nan) for name in names])
        deviations = {str(axis): signal.standard_deviation for axis, signal in output.axes.items()}
        vectors[f"{field}_covariance"] = samples.diagonal(
            [(deviations.get(name) or 0.0) ** 2 or samples.UNMEASURED_VARIANCE for name in names]
        )
    return samples.imu(output.topic, stamp, output.frame_id, received=received, **vectors)


class CanDecoder:
    """Decodes the frames of one bus.

    `database` and `mapping` are files or what was loaded from them. With `channel`, frames of other channels (as in a
    log of several buses) are passed over.

    Raises `InputError` if the mapping asks for messages or signals that the database does not have.
    """

    def __init__(
        self, database: str | Path | Database, mapping: str | Path | CanMapping, channel: str | int | None = None
    ) -> None:
        self.database = database if isinstance(database, Database) else load_database(database)
        self.mapping = mapping if isinstance(mapping, CanMapping) else load_mapping(mapping)
        self.channel = channel
        where = f"CAN mapping {self.mapping.name}"
        known = {message.name: message for message in self.database.messages}
        self._receivers: dict[tuple[int, bool], _Receiver] = {}
        for name in dict.fromkeys(output.message for output in self.mapping.outputs):
            if name not in known:
                raise InputError(
                    f"{where}: the database has no message {name!r}{suggestion(name, known)}; "
                    f"it has {len(known)} messages"
                )
            message = known[name]
            outputs = [output for output in self.mapping.outputs if output.message == name]
            check = self.mapping.messages.get(name, MessageCheck())
            self._receivers[message.frame_id, message.is_extended_frame] = _Receiver(message, check, outputs, where)
        self._database_ids = {(m.frame_id, m.is_extended_frame) for m in known.values()}
        self._counts = dict.fromkeys(
            ("frames", "not mapped", "not in the database", "error frames", "broken frames", "without time stamp"), 0
        )
        self._last_frame: int | None = None
        self._last_error: int | None = None
        self._last_broken: int | None = None

    def feed(self, message: can.Message, received: int | None = None) -> list[Sample]:
        """Samples of one frame; none if it is of no interest or not believed.

        The frame's time stamp [s] is the clock of the measurements. `received` [ns] is the time of arrival in the
        clock given to `diagnostics`, where that is another one.
        """
        if self.channel is not None and message.channel is not None and message.channel != self.channel:
            return []
        if not 0.0 <= message.timestamp < LATEST / NANO:
            self._counts["without time stamp"] += 1
            return []
        at = round(message.timestamp * NANO) if received is None else received
        if message.is_error_frame:
            self._counts["error frames"] += 1
            self._last_error = at
            return []
        self._counts["frames"] += 1
        self._last_frame = at
        if message.is_remote_frame:
            return []
        key = (message.arbitration_id, message.is_extended_id)
        receiver = self._receivers.get(key)
        if receiver is None:
            self._counts["not mapped" if key in self._database_ids else "not in the database"] += 1
            return []
        return receiver.feed(message, received)

    def broken(self, at: int) -> None:
        """What arrived at `at` [ns] was no frame that the interface could read."""
        self._counts["broken frames"] += 1
        self._last_broken = at

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health of the bus, then of each message that is listened to, at `now` [ns]."""
        return [self._bus(now), *(receiver.diagnostic(now) for receiver in self._receivers.values())]

    def _bus(self, now: int) -> Diagnostic:
        values = {name: str(count) for name, count in self._counts.items()}
        level, text = Level.OK, "ok"
        if self._last_frame is None:
            level, text = Level.STALE, "no frame received: is the bus connected, and the bit rate right?"
        elif now - self._last_frame > self.mapping.bus_timeout * NANO:
            level, text = Level.STALE, f"bus silent for {(now - self._last_frame) / NANO:.2f} s"
        elif self._last_error is not None and abs(now - self._last_error) <= 2 * NANO:
            level, text = Level.WARN, "error frames on the bus"
        elif self._last_broken is not None and now - self._last_broken <= 2 * NANO:
            level, text = Level.WARN, "broken frames: is the line to the adapter disturbed?"
        return Diagnostic(f"can: bus ({self.mapping.name})", level, text, values)
