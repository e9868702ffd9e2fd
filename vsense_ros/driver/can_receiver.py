"""One message of a CAN bus: where its signals are, what makes it believed, and the samples made from it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from cantools.database import Message
from cantools.database import Signal as DbcSignal
from numpy.typing import NDArray

from vsense_ros.driver.can_checksum import CHECKSUMS
from vsense_ros.driver.can_mapped_signal import Signal, Valid
from vsense_ros.driver.can_mapping import AnyOutput, CounterCheck, MessageCheck, suggestion
from vsense_ros.driver.can_motion import MotionBase
from vsense_ros.driver.can_samples import InOrder, Template, motion_sample
from vsense_ros.driver.can_signal import Array, Frames, SignalField
from vsense_ros.driver.can_usual import Usual, UsualValue, usual_values
from vsense_ros.driver.can_validity import Validity
from vsense_ros.driver.monitor import NANO, StreamLimits, StreamMonitor
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample
from vsense_ros.messages.units import contradiction


@dataclass(frozen=True, slots=True)
class _Flag:
    """Numbers of another signal, which say something of a value."""

    signal: str
    numbers: frozenset[float]

    def of(self, physical: Mapping[str, Any]) -> Any:
        """True where the signal has one of the numbers; of a number or an array."""
        value = physical[self.signal]
        return np.isin(value, list(self.numbers)) if isinstance(value, np.ndarray) else value in self.numbers


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
    valid: tuple[_Flag, ...] = ()
    negative: _Flag | None = None

    def convert(self, physical: Mapping[str, Any]) -> tuple[Any, Any]:
        """Value in SI, and true if it is in the plausible range; of numbers or arrays."""
        value = physical[self.signals[0]]
        for name in self.signals[1:]:
            value = value + physical[name]
        if self.negative is not None:
            value = value * (1.0 - 2.0 * self.negative.of(physical))
        value = self.gain * value + self.offset
        return value / self.divisor, (self.lowest <= value) & (value <= self.highest)

    @property
    def flags(self) -> tuple[_Flag, ...]:
        """The signals besides those that are summed."""
        return self.valid if self.negative is None else (*self.valid, self.negative)


class _Binder:
    """Binds the signals that a mapping names to those of a message."""

    def __init__(self, message: Message, where: str) -> None:
        self._message, self._where = message, where
        self._known = {s.name: s for s in message.signals}

    def signal(self, name: str, wanted: str) -> DbcSignal:
        """A signal of the message, for the value `name`."""
        if wanted not in self._known:
            raise InputError(
                f"{self._where}, {name}: message {self._message.name} has no signal {wanted!r}"
                f"{suggestion(wanted, self._known)}; it has {', '.join(self._known)}"
            )
        return self._known[wanted]

    def flag(self, name: str, wanted: str, values: tuple[float | str, ...]) -> _Flag:
        """The numbers of a signal that are given as numbers or by their names in the database."""
        signal = self.signal(name, wanted)
        scale, offset = float(signal.scale), float(signal.offset)
        named = {str(text): float(raw) * scale + offset for raw, text in (signal.choices or {}).items()}
        numbers = set()
        for value in values:
            if isinstance(value, str) and value not in named:
                raise InputError(
                    f"{self._where}, {name}: signal {wanted} has no value named {value!r}{suggestion(value, named)}; "
                    f"it has {', '.join(named) or 'none with a name'}"
                )
            numbers.add(named[value] if isinstance(value, str) else float(value))
        return _Flag(wanted, frozenset(numbers))

    def conversion(self, name: str, signal: Signal, valid: Valid | None) -> _Conversion:
        """A signal of the mapping, of an output whose values are believed where `valid` says so."""
        for wanted in signal.signals:
            stated = self.signal(name, wanted).unit or ""
            if abs(signal.factor) == 1.0 and not signal.ignore_stated_unit and contradiction(stated, signal.unit):
                raise InputError(
                    f"{self._where}, {name}: the database gives {self._message.name}.{wanted} in "
                    f"{stated!r}, the mapping says {signal.unit!r}; correct the unit, state the factor between the "
                    "two, or where the database is wrong, ignore_stated_unit: true"
                )
        lowest, highest = (bound * signal.to_si for bound in signal.range) if signal.range else (-math.inf, math.inf)
        return _Conversion(
            name,
            signal.signals,
            signal.factor * signal.to_si,
            signal.offset * signal.to_si,
            lowest,
            highest,
            signal.rolling_radius or 1.0,
            tuple(self.flag(name, v.signal, v.values) for v in (valid, signal.valid) if v is not None),
            None if signal.sign is None else self.flag(name, signal.sign.signal, signal.sign.negative),
        )


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


# Name of a signal, where it is in the data as one number (byte order, shift, mask, bit of the sign), its scale and
# offset, its usual values, its codes for no value, and its field if it is a floating-point number.
_Place = tuple[str, bool, int, int, int, float, float, float, float, dict[int, str], SignalField | None]
_Made = tuple[AnyOutput, dict[str, float]]  # values of an output in SI by their names


class Receiver:
    """One message of the bus: its checks and the outputs made from it. One of J1939 has its codes for no value."""

    def __init__(
        self, message: Message, check: MessageCheck, outputs: list[AnyOutput], where: str, *, of_j1939: bool = False
    ) -> None:
        self.message = message
        self.outputs: list[tuple[AnyOutput, list[_Conversion]]] = []
        self.notes: list[str] = []
        for output in outputs:
            binder = _Binder(message, f"{where}, {output.topic}")
            named = output.named_signals()
            self.outputs.append((output, [binder.conversion(name, s, output.valid) for name, s in named.items()]))
        self.exact_length = check.length
        self.length = message.length if check.length is None else check.length
        self.counter = _CounterState(check.counter, message, where) if check.counter else None
        known = {s.name: s for s in message.signals}
        self.fields = {name: SignalField.of(known[name], message) for name in self._needed(check)}
        self.validity: dict[str, Validity] = {}
        for name, is_ranged in _by_range_of_database(outputs).items():
            field = self.fields[name]
            self.validity[name], doubt = Validity.of(known[name], field, j1939=of_j1939, ranged=is_ranged)
            self.notes += [doubt] if doubt else []
        # On which page of a multiplexed message all are present.
        self.paged = [field for field in self.fields.values() if field.pages]
        beyond = [field.name for field in self.fields.values() if field.last >= self.length]
        if beyond:
            raise InputError(
                f"{where}: {message.name} with {self.length} data bytes has no room for {', '.join(beyond)}"
            )
        self.places = [self._place(name, field) for name, field in self.fields.items()]
        self._usual = self._compiled()
        self._in_order: list[InOrder] = []  # what makes a sample of the usual values of each output
        self._before: dict[str, float] = {}  # the latest value of each signal, unless that is in …
        self._latest: bytes | None = None  # … the data of the latest frame, of which all values were usual
        self._templates: dict[tuple[int, tuple[str, ...]], Template] = {}  # by output and the values that it has
        self.latency = round(check.latency * NANO)
        self.checksum = check.checksum
        if self.checksum is not None and not -1 <= self.checksum.byte < self.length:
            raise InputError(
                f"{where}: checksum byte {self.checksum.byte} of {message.name} is outside its {self.length} bytes"
            )
        self._checked = self.checksum is not None or bool(self.paged)
        self.by_group = of_j1939  # recognised by the parameter group of J1939, from the unit `source`
        self.source = check.source
        self.source_is_given = check.source is not None
        topics = ", ".join(output.topic for output in outputs)
        limits = StreamLimits(timeout=check.timeout, nominal_rate=check.rate)
        self.monitor = StreamMonitor(f"can: {topics} ({message.name}, 0x{message.frame_id:X})", limits)

    def _needed(self, check: MessageCheck) -> list[str]:
        """Names of the signals that outputs are made of, of those that judge them, and of the counter."""
        conversions = [c for _, conversions in self.outputs for c in conversions]
        names = [name for c in conversions for name in (*c.signals, *(flag.signal for flag in c.flags))]
        return list(dict.fromkeys([*names, *([check.counter.signal] if check.counter else [])]))

    def _place(self, name: str, field: SignalField) -> _Place:
        shift = field.shift + 8 * (self.length - 1 - field.last if field.big_endian else field.first)
        sign = 1 << (field.length - 1) if field.is_signed else 0
        validity = self.validity.get(name) or Validity(name, {})
        bounds = validity.usual(field.scale, field.offset)
        mask = (1 << field.length) - 1
        floating = field if field.is_float else None
        return name, field.big_endian, shift, mask, sign, field.scale, field.offset, *bounds, validity.codes, floating

    def _compiled(self) -> Usual | None:
        """What makes usual values; None where the message has pages, or values are sums, floating-point numbers, or
        judged by other signals."""
        conversions = [one for _, every in self.outputs for one in every]
        if self.paged or any(len(one.signals) > 1 or one.flags for one in conversions):
            return None
        if any(self.fields[name].is_float for one in conversions for name in one.signals):
            return None
        places = {place[0]: place for place in self.places}
        return usual_values([[_usual(one, places) for one in every] for _, every in self.outputs], self.length)

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

    def feed(self, data: bytes, arrival: int, received: int | None) -> list[Sample]:
        """Samples of the data of one frame with a time stamp [ns], or none if it is not believed; `received` as in
        `CanDecoder.feed`.

        A signal that has no value costs the values made of it, and the others stay.
        """
        at = arrival if received is None else received
        if len(data) != self.length or self._checked:
            reason = self.objection(data)
            if reason is not None:
                self.monitor.fault(reason, at)
                return []
            if self.paged and not all(field.has(data) for field in self.paged):
                self.monitor.passed("other multiplexer page")
                return []
        usual = None if self._usual is None else self._usual(data)
        if usual is None:
            made = self._judged_values(data, at)
            if not made or not self.monitor.accept(arrival, received):
                return []
            return [self._sample(output, values, arrival - self.latency, at) for output, values in made]
        if self.counter is not None and (
            reason := self.counter.objection(int(self.fields[self.counter.check.signal].physical(data)))
        ):
            self.monitor.fault(reason, at)
            return []
        self._latest = data
        if not self.monitor.accept(arrival, received):
            return []
        in_order = self._in_order or self._prepare()
        if len(in_order) == 1:
            return [in_order[0](usual[0], arrival - self.latency, at)]
        return [make(values, arrival - self.latency, at) for make, values in zip(in_order, usual, strict=True)]

    def _prepare(self) -> list[InOrder]:
        """Make what makes samples of usual values."""
        for output, conversions in self.outputs:
            names = tuple(one.name for one in conversions)
            if isinstance(output, MotionBase):
                self._in_order.append(partial(_motion_in_order, output, names))
            else:
                self._in_order.append(Template.of(output, names).filled_in_order)
        return self._in_order

    def _judged_values(self, data: bytes, at: int) -> list[_Made]:
        """The values of the outputs that can be believed at a time [ns]; the rest is counted."""
        if self._latest is not None:
            self._before, self._latest = self._physical(self._latest)[0], None
        physical, refused = self._physical(data)
        if self.counter is not None:
            reason = self.counter.objection(int(physical[self.counter.check.signal]))
            if reason is not None:
                self.monitor.fault(reason, at)
                return []
        if refused:
            self._refuse(physical, refused, at)
        self._before = physical
        made: list[_Made] = []
        for output, conversions in self.outputs:
            values = self._values(conversions, physical, refused, at)
            if values and (not isinstance(output, MotionBase) or output.is_whole(values)):
                made.append((output, values))
        return made

    def _sample(self, output: AnyOutput, values: dict[str, float], stamp: int, received: int) -> Sample:
        if isinstance(output, MotionBase):
            return motion_sample(output, values, stamp, received)
        key = id(output), tuple(values)
        template = self._templates.get(key)
        if template is None:
            template = self._templates[key] = Template.of(output, key[1])
        return template.filled(values, stamp, received)

    def _values(
        self, conversions: list[_Conversion], physical: dict[str, float], refused: dict[str, str], at: int
    ) -> dict[str, float]:
        """The values of an output in SI by their names, without those that are none."""
        values: dict[str, float] = {}
        for conversion in conversions:
            if refused and any(name in refused for name in conversion.signals):
                continue
            unbelieved = next((f for f in conversion.valid if not f.of(physical)), None) if conversion.valid else None
            if unbelieved is not None:
                self.monitor.fault(_not_valid(conversion, unbelieved), at)
                continue
            value, plausible = conversion.convert(physical)
            if plausible:
                values[conversion.name] = value
            else:
                self.monitor.fault(f"{conversion.name} out of range", at)
        return values

    def _physical(self, data: bytes) -> tuple[dict[str, float], dict[str, str]]:
        """Physical values of the signals that are asked for, from the whole of the data as one number, and of those
        that are not in their range, or that are codes, what is said of them."""
        big = int.from_bytes(data[: self.length], "big")
        little = int.from_bytes(data, "little")
        values = {}
        unusual: dict[str, str] = {}
        for name, is_big, shift, mask, sign, scale, offset, lowest, highest, codes, floating in self.places:
            raw = ((big if is_big else little) >> shift) & mask
            if raw & sign:
                raw -= mask + 1
            value = values[name] = raw * scale + offset if floating is None else floating.physical(data)
            if not lowest <= value <= highest or raw in codes:
                unusual[name] = self.validity[name].objection(raw, value, self._before.get(name))
        return values, unusual

    def _refuse(self, physical: dict[str, float], unusual: dict[str, str], at: int) -> None:
        """Report the signals that are unusual; those that are taken all the same leave `unusual`, and the others have
        the value that they had before."""
        for name, reason in list(unusual.items()):
            if not reason:
                del unusual[name]
                self.monitor.doubts[self.validity[name].beyond] += 1
                continue
            self.monitor.fault(reason, at)
            if name in self._before:
                physical[name] = self._before[name]
            else:
                physical[name] = math.nan

    def table(
        self, data: Frames, lengths: NDArray[np.int64], faults: Counter[str], said: Counter[str]
    ) -> list[tuple[AnyOutput, NDArray[np.intp], dict[str, Array]]]:
        """Values of all frames of a log at once, as `feed` has them one by one: data (n, bytes) and lengths (n,), in
        the order of the log.

        Returns for each output its rows, and its values in them by name, NaN where there is none. `faults` counts the
        frames that are not believed by their reason, `said` what is said of single signals. Time stamps are not judged.
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
        raw = {name: field.raw_of(data) for name, field in self.fields.items()}
        physical: dict[str, Any] = {name: field.physical_of(data, raw[name]) for name, field in self.fields.items()}
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
        doubted: Counter[str] = Counter()
        usable = {name: v.of_all(raw[name], physical[name], good, doubted) for name, v in self.validity.items()}
        made = []
        for output, conversions in self.outputs:
            values = {one.name: _believed_values(one, physical, good, usable, doubted) for one in conversions}
            rows = np.flatnonzero(_present(output, values))
            made.append((output, rows, {name: value[rows] for name, value in values.items()}))
        said.update({f"{self.message.name}: {text}": count for text, count in doubted.items() if count})
        return made

    def diagnostic(self, now: int) -> Diagnostic:
        """Health of the message at `now` [ns]."""
        values = {} if self.counter is None else {"lost by the counter": str(self.counter.lost)}
        return self.monitor.diagnostic(now, values)


def _by_range_of_database(outputs: Iterable[AnyOutput]) -> dict[str, bool]:
    """The signals that values are made of, and whether their range in the database holds: a range of the mapping takes
    its place."""
    ranged: dict[str, bool] = {}
    for output in outputs:
        for signal in output.named_signals().values():
            for name in signal.signals:
                ranged[name] = ranged.get(name, False) or signal.range is None
    return ranged


def _believed_values(
    conversion: _Conversion,
    physical: Mapping[str, Any],
    good: NDArray[np.bool_],
    usable: Mapping[str, NDArray[np.bool_]],
    doubted: Counter[str],
) -> Array:
    """A value of all frames (n,), NaN where the frame is not `good`, a signal of it not `usable`, a flag says that it
    is not valid, or it is out of its range; `doubted` counts the last two."""
    value, plausible = conversion.convert(physical)
    believed = good.copy()
    for name in conversion.signals:
        believed &= usable[name]
    for flag in conversion.valid:
        doubted[_not_valid(conversion, flag)] += int((believed & ~flag.of(physical)).sum())
        believed &= flag.of(physical)
    doubted[f"{conversion.name} out of range"] += int((believed & ~plausible).sum())
    believed &= plausible
    value[~believed] = np.nan
    return value


def _usual(conversion: _Conversion, places: Mapping[str, _Place]) -> UsualValue:
    """A value of one signal that no other judges."""
    _, big_endian, shift, mask, sign, scale, offset, lowest, highest, codes, _ = places[conversion.signals[0]]
    of_signal = big_endian, shift, mask, sign, scale, offset, lowest, highest
    to_si = conversion.gain, conversion.offset, conversion.lowest, conversion.highest, conversion.divisor
    return UsualValue(*of_signal, *to_si, frozenset(codes))


def _motion_in_order(
    output: MotionBase, names: tuple[str, ...], values: tuple[float, ...], stamp: int, received: int
) -> Sample:
    return motion_sample(output, dict(zip(names, values, strict=True)), stamp, received)


def _present(output: AnyOutput, values: Mapping[str, Array]) -> NDArray[np.bool_]:
    """True for the frames (n,) that make a message of an output: a motion needs all values of one of its forms, any
    other output one value."""
    known = {name: ~np.isnan(value) for name, value in values.items()}
    if isinstance(output, MotionBase):
        forms = [form for form in output.forms if known.keys() >= set(form)]
        return np.any([np.all([known[name] for name in form], axis=0) for form in forms], axis=0)
    return np.any(list(known.values()), axis=0)


def _not_valid(conversion: _Conversion, flag: _Flag) -> str:
    return f"{conversion.name} is not valid by {flag.signal}"
