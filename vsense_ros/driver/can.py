"""CAN frames to samples: a DBC says where the signals are, a mapping says what they mean."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can
import numpy as np
from cantools.database import Database, Message
from cantools.database import Signal as DbcSignal
from numpy.typing import NDArray

from vsense_ros.checks.watch import PlausibilityWatch
from vsense_ros.driver import samples
from vsense_ros.driver.can_checksum import CHECKSUMS
from vsense_ros.driver.can_database import CanDatabase, read_database
from vsense_ros.driver.can_mapping import (
    CanMapping,
    CounterCheck,
    ImuOutput,
    JointStateOutput,
    MessageCheck,
    Signal,
    load_mapping,
    suggestion,
)
from vsense_ros.driver.can_signal import Array, Frames, SignalField
from vsense_ros.driver.monitor import LATEST, NANO, StreamLimits, StreamMonitor
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample
from vsense_ros.messages.units import contradiction


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

    def convert(self, physical: Mapping[str, Any]) -> tuple[Any, Any]:
        """Value in SI and whether it is in the plausible range, of numbers or arrays."""
        value = self.gain * sum(physical[name] for name in self.signals) + self.offset
        return value / self.divisor, (self.lowest <= value) & (value <= self.highest)


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
        stated = known[wanted].unit or ""
        if abs(signal.factor) == 1.0 and not signal.ignore_stated_unit and contradiction(stated, signal.unit):
            raise InputError(
                f"{where}, {name}: the database gives {message.name}.{wanted} in {stated!r}, the mapping says "
                f"{signal.unit!r}; correct the unit, state the factor between the two, or where the database is wrong, "
                "ignore_stated_unit: true"
            )
    lowest, highest = (bound_ * signal.to_si for bound_ in signal.range) if signal.range else (-math.inf, math.inf)
    conversion = _Conversion(
        name,
        signal.signals,
        signal.factor * signal.to_si,
        signal.offset * signal.to_si,
        lowest,
        highest,
        signal.rolling_radius or 1.0,
    )
    return conversion, [] if signal.range else bound


@dataclass(frozen=True, slots=True)
class _Range:
    """The plausible physical values of a signal, as its database gives them, widened by half a step."""

    lowest: float
    highest: float
    text: str


def _range_of(signal: DbcSignal, field: SignalField) -> tuple[_Range | None, str]:
    """The range that a database gives; None with the reason where it contradicts the signal's own scale and offset."""
    if signal.minimum is None or signal.maximum is None or not signal.minimum < signal.maximum:
        return None, ""
    lowest, highest = float(signal.minimum), float(signal.maximum)
    text = f"[{signal.minimum}, {signal.maximum}]"
    slack = 0.5 * abs(field.scale)
    least, most = field.representable
    if field.is_float:
        return _Range(lowest, highest, text), ""
    counts = (lowest, highest) in (field.raw_range, (0.0, float(field.raw_range[1])))
    if lowest < least - 2 * slack or highest > most + 2 * slack or (counts and (field.scale, field.offset) != (1, 0)):
        return None, (
            f"range {text} of {signal.name} is not used: with its scale {field.scale:g} and offset {field.offset:g} "
            f"it goes from {least:g} to {most:g}"
        )
    if (lowest, highest) == (0.0, 1.0) and field.length > 1 and signal.unit:
        return None, f"range {text} of {signal.name} is not used: it has {field.length} bits and a unit"
    return _Range(lowest - slack, highest + slack, text), ""


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
        self.notes: list[str] = []
        known = {s.name: s for s in message.signals}
        ranges: dict[str, _Range] = {}
        for output in outputs:
            conversions = []
            for name, signal in output.named_signals().items():
                conversion, checked = _bind(name, signal, message, f"{where}, {output.topic}")
                conversions.append(conversion)
                for found in checked:
                    limits, doubt = _range_of(found, SignalField.of(found, message))
                    if limits is not None:
                        ranges[found.name] = limits
                    elif doubt and doubt not in self.notes:
                        self.notes.append(doubt)
            self.outputs.append((output, conversions))
        self.ranges = ranges
        self.exact_length = check.length
        self.length = message.length if check.length is None else check.length
        needed = dict.fromkeys(name for _, conversions in self.outputs for c in conversions for name in c.signals)
        self.counter = _CounterState(check.counter, message, where) if check.counter else None
        if check.counter is not None:
            needed[check.counter.signal] = None
        self.fields = {name: SignalField.of(known[name], message) for name in needed}
        # On which page of a multiplexed message all are present.
        self.paged = [field for field in self.fields.values() if field.pages]
        beyond = [field.name for field in self.fields.values() if field.last >= self.length]
        if beyond:
            raise InputError(
                f"{where}: {message.name} with {self.length} data bytes has no room for {', '.join(beyond)}"
            )
        self.places = [
            (
                name,
                field,
                field.shift + 8 * (self.length - 1 - field.last if field.big_endian else field.first),
                (1 << field.length) - 1,
                1 << (field.length - 1) if field.is_signed else 0,
            )
            for name, field in self.fields.items()
        ]
        self.latency = round(check.latency * NANO)
        self.checksum = check.checksum
        if self.checksum is not None and not -1 <= self.checksum.byte < self.length:
            raise InputError(
                f"{where}: checksum byte {self.checksum.byte} of {message.name} is outside its {self.length} bytes"
            )
        self.by_group = False  # found by the parameter group of J1939, from the unit `source`
        self.source = check.source
        self.told_source = check.source is not None
        topics = ", ".join(output.topic for output in outputs)
        limits_ = StreamLimits(timeout=check.timeout, nominal_rate=check.rate)
        self.monitor = StreamMonitor(f"can: {topics} ({message.name}, 0x{message.frame_id:X})", limits_)

    def objection(self, data: bytes) -> str | None:
        """Why the data is not believed before its signals are looked at. CAN FD knows few lengths and fills up to the
        next one, and senders may send more than the database knows of."""
        if len(data) != self.length and (self.exact_length is not None or len(data) < self.length):
            return f"data length {len(data)}, expected {self.length}"
        if self.checksum is not None:
            at = self.checksum.byte % self.length
            expected = CHECKSUMS[self.checksum.algorithm](
                self.message.frame_id, data[:at] + data[at + 1 : self.length], self.length
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
            if self.paged and not all(field.has(data) for field in self.paged):
                monitor.passed("other multiplexer page")
                return []
            physical = self._physical(data)
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

    def _physical(self, data: bytes) -> dict[str, float]:
        """Physical values of the signals that are asked for, from the whole of the data as one number."""
        big = int.from_bytes(data[: self.length], "big")
        little = int.from_bytes(data, "little")
        found = {}
        for name, field, shift, mask, sign in self.places:
            if field.is_float:
                found[name] = field.physical(data)
                continue
            raw = ((big if field.big_endian else little) >> shift) & mask
            if raw & sign:
                raw -= mask + 1
            found[name] = raw * field.scale + field.offset
        return found

    def _out_of_range(self, physical: dict[str, float]) -> str | None:
        for name, limits in self.ranges.items():
            if not limits.lowest <= physical[name] <= limits.highest:
                return f"{name} out of range {limits.text}"
        return None

    def table(
        self, data: Frames, lengths: NDArray[np.int64], faults: Counter[str]
    ) -> tuple[NDArray[np.intp], list[tuple[JointStateOutput | ImuOutput, dict[str, Array]]]]:
        """The same for all frames of a log at once: data (n, bytes) and lengths (n,), in the order of the log.

        Returns the rows that are believed, and for each output its values in them by name; `faults` counts the others
        by their reason. Time stamps are not judged.
        """
        good = np.ones(len(data), bool)

        def refuse(bad: NDArray[np.bool_], reason: str) -> None:
            count = int((bad & good).sum())
            if count:
                faults[f"{self.message.name}: {reason}"] += count
                good[bad] = False

        short = lengths != self.length if self.exact_length is not None else lengths < self.length
        refuse(short, f"another data length than {self.length}")
        if self.checksum is not None:
            wrong = [
                good[i] and self.objection(row.tobytes()) is not None for i, row in enumerate(data[:, : self.length])
            ]
            refuse(np.array(wrong, bool), "bad checksum")
        for field in self.paged:
            good &= field.has_of(data)
        physical: dict[str, Any] = {name: field.physical_of(data) for name, field in self.fields.items()}
        if self.counter is not None:
            rows = np.flatnonzero(good)
            counted = physical[self.counter.check.signal][rows].astype(np.int64)
            step = np.diff(counted, prepend=counted[:1] - 1) % self.counter.modulus
            for bad, reason in (
                (step == 0, "counter frozen"),
                (step > self.counter.check.max_delta, "counter jumping"),
            ):
                mask = np.zeros(len(data), bool)
                mask[rows[bad]] = True
                refuse(mask, reason)
        for name, limits in self.ranges.items():
            refuse(~((physical[name] >= limits.lowest) & (physical[name] <= limits.highest)), f"{name} out of range")
        made = []
        for output, conversions in self.outputs:
            values = {}
            for conversion in conversions:
                values[conversion.name], plausible = conversion.convert(physical)
                refuse(~plausible, f"{conversion.name} out of range")
            made.append((output, values))
        rows = np.flatnonzero(good)
        return rows, [(output, {name: value[rows] for name, value in values.items()}) for output, values in made]

    def diagnostic(self, now: int) -> Diagnostic:
        values = {} if self.counter is None else {"lost by the counter": str(self.counter.lost)}
        return self.monitor.diagnostic(now, values)


def _pgn(identifier: int) -> int:
    """The parameter group of an identifier of J1939: without priority, source, and where it is one, destination."""
    format_ = identifier >> 16 & 0xFF
    return identifier >> 8 & (0x3FF00 if format_ < 240 else 0x3FFFF)


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
        self,
        database: str | Path | Database | CanDatabase,
        mapping: str | Path | CanMapping,
        channel: str | int | None = None,
    ) -> None:
        if isinstance(database, str | Path):
            read = read_database(database)
        else:
            read = database if isinstance(database, CanDatabase) else CanDatabase(database)
        self.database = read.database
        self.mapping = mapping if isinstance(mapping, CanMapping) else load_mapping(mapping)
        self.channel = channel
        where = f"CAN mapping {self.mapping.name}"
        known: dict[str, Message] = {}
        twice: dict[str, list[Message]] = {}
        for message in self.database.messages:
            twice.setdefault(message.name, []).append(message)
            known[f"{message.name}@0x{message.frame_id:X}"] = message
        known |= {name: messages[0] for name, messages in twice.items() if len(messages) == 1}
        self._receivers: dict[tuple[int, bool], _Receiver] = {}
        self._by_pgn: dict[int, _Receiver] = {}
        notes = list(read.notes)
        for name in dict.fromkeys(output.message for output in self.mapping.outputs):
            if len(alike := twice.get(name, [])) > 1:
                told = ", ".join(f"{name}@0x{message.frame_id:X}" for message in alike)
                raise InputError(f"{where}: the database has {len(alike)} messages {name!r}; say which: {told}")
            if name not in known:
                left_out = next((note for note in read.notes if f" {name} left out" in note), "")
                raise InputError(
                    f"{where}: the database has no message {name!r}{suggestion(name, twice)}; "
                    f"it has {len(self.database.messages)} messages" + (f" ({left_out})" if left_out else "")
                )
            message = known[name]
            outputs = [output for output in self.mapping.outputs if output.message == name]
            check = self.mapping.messages.get(name, MessageCheck())
            receiver = _Receiver(message, check, outputs, where)
            notes += receiver.notes
            self._receivers[message.frame_id, message.is_extended_frame] = receiver
            # The null address, which never sends, stands in databases of J1939 for any.
            of_j1939 = message.protocol == "j1939" or message.frame_id & 0xFF == 0xFE
            if message.is_extended_frame and (of_j1939 if check.j1939 is None else check.j1939):
                receiver.by_group = True
                self._by_pgn[_pgn(message.frame_id)] = receiver
        self.notes: tuple[str, ...] = tuple(notes)
        self._database_ids = {(m.frame_id, m.is_extended_frame) for m in self.database.messages}
        self._ignored: dict[tuple[int, bool], str] = {}  # why, by identifier
        self.watch = PlausibilityWatch("can")
        self._passed: Counter[tuple[int, bool]] = Counter()  # frames that nobody listens to
        self._counts = dict.fromkeys(
            ("frames", "not mapped", "not in the database", "error frames", "broken frames", "without time stamp"), 0
        )
        self._other_channels: set[str] = set()
        self._last_frame: int | None = None
        self._last_error: int | None = None
        self._last_broken: int | None = None

    def feed(self, message: can.Message, received: int | None = None) -> list[Sample]:
        """Samples of one frame; none if it is of no interest or not believed.

        The frame's time stamp [s] is the clock of the measurements. `received` [ns] is the time of arrival in the
        clock given to `diagnostics`, where that is another one.
        """
        if self.channel is not None and message.channel is not None and message.channel != self.channel:
            if len(self._other_channels) < 16:
                self._other_channels.add(str(message.channel))
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
        ignored = self._ignored.get(key)  # most frames are for others
        if ignored is not None:
            self._counts[ignored] += 1
            self._passed[key] += 1
            return []
        receiver = self.receiver(*key)
        if receiver is None:
            reason = "not mapped" if key in self._database_ids else "not in the database"
            self._counts[reason] += 1
            self._passed[key] += 1
            if not self._by_pgn:  # whose sender may change
                self._ignored[key] = reason
            return []
        samples_ = receiver.feed(message, received)
        for sample in samples_:
            self.watch.add(sample)
        return samples_

    def receiver(self, identifier: int, is_extended: bool) -> _Receiver | None:
        """Who listens to an identifier: by itself, or by its parameter group where that is of J1939."""
        key = (identifier, is_extended)
        found = self._receivers.get(key)
        if found is None and is_extended and key not in self._database_ids:
            found = self._by_pgn.get(_pgn(identifier))
        if found is None or not found.by_group:
            return found
        source = identifier & 0xFF
        if found.source is None or (key in self._receivers and not found.told_source):
            found.source = source  # several units may send a group: that of the database, else the first one heard
        return found if found.source == source else None

    def broken(self, at: int) -> None:
        """What arrived at `at` [ns] was no frame that the interface could read."""
        self._counts["broken frames"] += 1
        self._last_broken = at

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health of the bus, then of each message that is listened to, at `now` [ns]."""
        for (identifier, is_extended), receiver in self._receivers.items():
            receiver.monitor.absence = self._absence(identifier, is_extended)
        health = [receiver.diagnostic(now) for receiver in self._receivers.values()]
        return [self._bus(now), *health, *self.watch.diagnostics(now)]

    def passed(self) -> str:
        """Identifiers that came and that nothing listens to, the most frequent first; empty if there were none."""
        listed = [
            f"0x{identifier:X}{' (29 bits)' if is_extended else ''} × {count}"
            for (identifier, is_extended), count in self._passed.most_common(12)
        ]
        more = len(self._passed) - len(listed)
        return ", ".join(listed) + (f" and {more} more" if more > 0 else "")

    def _absence(self, identifier: int, is_extended: bool) -> str:
        """Why a message may never have come."""
        if (identifier, not is_extended) in self._passed:
            return f"frames with this identifier come with {11 if is_extended else 29} bits: is the database right?"
        if self._other_channels and not self._counts["frames"]:
            return f"frames come from {', '.join(sorted(self._other_channels))}, expected channel {self.channel}"
        passed = self.passed()
        return f"of what comes nothing has its identifier: {passed}" if passed else ""

    def _bus(self, now: int) -> Diagnostic:
        values = {name: str(count) for name, count in self._counts.items()}
        passed = self.passed()
        if passed:
            values["identifiers that nothing listens to"] = passed
        if self.notes:
            values["notes"] = "; ".join(self.notes)
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
