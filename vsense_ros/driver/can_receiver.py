"""One message of a CAN bus: where its signals are, what makes it believed, and the samples made from it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import can
import numpy as np
from cantools.database import Message
from cantools.database import Signal as DbcSignal
from numpy.typing import NDArray

from vsense_ros.driver import samples
from vsense_ros.driver.can_checksum import CHECKSUMS
from vsense_ros.driver.can_mapping import (
    CounterCheck,
    ImuOutput,
    JointStateOutput,
    MessageCheck,
    Signal,
    SignBit,
    suggestion,
)
from vsense_ros.driver.can_signal import Array, Frames, SignalField
from vsense_ros.driver.monitor import NANO, StreamLimits, StreamMonitor
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample
from vsense_ros.messages.units import contradiction

Output = JointStateOutput | ImuOutput


@dataclass(frozen=True, slots=True)
class _Conversion:
    """A `Signal` bound to the DBC: the physical values that it sums, their sign, and one affine map to SI."""

    name: str
    signals: tuple[str, ...]
    sign: SignBit | None  # the sum is a magnitude, negative where this says so
    gain: float
    offset: float  # [SI]
    lowest: float  # [SI], before a rolling radius is applied
    highest: float
    divisor: float  # rolling radius [m] or 1

    def convert(self, physical: Mapping[str, Any]) -> tuple[Any, Any]:
        """Value in SI, and true if it is in the plausible range; of numbers or arrays."""
        total = sum(physical[name] for name in self.signals)
        if self.sign is not None:
            total = total * (1 - 2 * (physical[self.sign.signal] == self.sign.negative))
        value = self.gain * total + self.offset
        return value / self.divisor, (self.lowest <= value) & (value <= self.highest)


def _bind(name: str, signal: Signal, message: Message, where: str) -> tuple[_Conversion, list[DbcSignal]]:
    known = {s.name: s for s in message.signals}
    bound = []
    for wanted in (*signal.signals, *([signal.sign.signal] if signal.sign else [])):
        if wanted not in known:
            raise InputError(
                f"{where}, {name}: message {message.name} has no signal {wanted!r}{suggestion(wanted, known)}; "
                f"it has {', '.join(known)}"
            )
    for wanted in signal.signals:
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
        signal.sign,
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


class Receiver:
    """One message of the bus: its checks and the outputs made from it."""

    def __init__(self, message: Message, check: MessageCheck, outputs: list[Output], where: str) -> None:
        self.message = message
        self.outputs: list[tuple[Output, list[_Conversion]]] = []
        self.notes: list[str] = []
        self.ranges: dict[str, _Range] = {}
        for output in outputs:
            self.outputs.append((output, self._bound(output, where)))
        self.exact_length = check.length
        self.length = message.length if check.length is None else check.length
        self.counter = _CounterState(check.counter, message, where) if check.counter else None
        known = {s.name: s for s in message.signals}
        self.fields = {name: SignalField.of(known[name], message) for name in self._needed(check)}
        # On which page of a multiplexed message all are present.
        self.paged = [field for field in self.fields.values() if field.pages]
        beyond = [field.name for field in self.fields.values() if field.last >= self.length]
        if beyond:
            raise InputError(
                f"{where}: {message.name} with {self.length} data bytes has no room for {', '.join(beyond)}"
            )
        self.places = [self._place(name, field) for name, field in self.fields.items()]
        self.latency = round(check.latency * NANO)
        self.checksum = check.checksum
        if self.checksum is not None and not -1 <= self.checksum.byte < self.length:
            raise InputError(
                f"{where}: checksum byte {self.checksum.byte} of {message.name} is outside its {self.length} bytes"
            )
        self.by_group = False  # recognised by the parameter group of J1939, from the unit `source`
        self.source = check.source
        self.source_is_given = check.source is not None
        topics = ", ".join(output.topic for output in outputs)
        limits = StreamLimits(timeout=check.timeout, nominal_rate=check.rate)
        self.monitor = StreamMonitor(f"can: {topics} ({message.name}, 0x{message.frame_id:X})", limits)

    def _bound(self, output: Output, where: str) -> list[_Conversion]:
        """The conversions of an output, whose signals' ranges become those that are checked."""
        conversions = []
        for name, signal in output.named_signals().items():
            conversion, checked = _bind(name, signal, self.message, f"{where}, {output.topic}")
            conversions.append(conversion)
            for stated in checked:
                limits, doubt = _range_of(stated, SignalField.of(stated, self.message))
                if limits is not None:
                    self.ranges[stated.name] = limits
                elif doubt and doubt not in self.notes:
                    self.notes.append(doubt)
        return conversions

    def _needed(self, check: MessageCheck) -> list[str]:
        """Names of the signals that outputs are made of, and of the counter."""
        bound = [conversion for _, conversions in self.outputs for conversion in conversions]
        names = [name for one in bound for name in (*one.signals, *([one.sign.signal] if one.sign else []))]
        return list(dict.fromkeys([*names, *([check.counter.signal] if check.counter else [])]))

    def _place(self, name: str, field: SignalField) -> tuple[str, SignalField, int, int, int]:
        """Name and field of a signal, and where it is in the data as one number: shift, mask, and bit of the sign."""
        shift = field.shift + 8 * (self.length - 1 - field.last if field.big_endian else field.first)
        return name, field, shift, (1 << field.length) - 1, 1 << (field.length - 1) if field.is_signed else 0

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
        """Samples of one frame, or none if it is not believed; times as in `CanDecoder.feed`."""
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
        made: list[tuple[Output, dict[str, float]]] = []
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
    ) -> tuple[NDArray[np.intp], list[tuple[Output, dict[str, Array]]]]:
        """Values of all frames of a log at once, as `feed` has them one by one: data (n, bytes) and lengths (n,), in
        the order of the log.

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
        """Health of the message at `now` [ns]."""
        values = {} if self.counter is None else {"lost by the counter": str(self.counter.lost)}
        return self.monitor.diagnostic(now, values)


def _sample(output: Output, values: dict[str, float], stamp: int, received: int) -> Sample:
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
