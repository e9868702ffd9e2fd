"""What is on a CAN bus: identifiers, rates, and the signals that databases find in the frames, with their values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cantools.database import Message
from numpy.typing import NDArray

from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_frames import CanFrames
from vsense_ros.driver.can_log import read_frames
from vsense_ros.driver.can_signal import SignalField
from vsense_ros.errors import InputError

Array = NDArray[np.float64]

_J1939_NULL_ADDRESS = 0xFE  # stands for any sender in databases of J1939


@dataclass(frozen=True)
class HeardSignal:
    """A signal of a database with its values in the log: `time` (n,) [s], `value` (n,) in `unit` as stated."""

    message: str  # as a mapping calls it
    name: str
    unit: str
    bits: int
    has_names: bool  # its values have names in the database
    minimum: float | None  # plausible values by the database
    maximum: float | None
    step: float  # between two values
    time: Array
    value: Array

    @property
    def low(self) -> float:
        """Least value in the log."""
        return float(self.value.min())

    @property
    def high(self) -> float:
        """Largest value in the log."""
        return float(self.value.max())

    @property
    def rate(self) -> float:
        """Frames in a second [Hz], in the median; 0 for less than two."""
        steps = np.diff(self.time)
        steps = steps[steps > 0]
        return float(1.0 / np.median(steps)) if len(steps) else 0.0

    @property
    def label(self) -> str:
        """Message and signal."""
        return f"{self.message}.{self.name}"


@dataclass(frozen=True)
class HeardMessage:
    """An identifier on the bus: how many frames of which length, how often [Hz], and its signals if a database knows it
    (`name` is empty if none does)."""

    identifier: int
    is_extended: bool
    channels: tuple[str, ...]
    count: int
    length: int
    rate: float
    name: str
    signals: tuple[HeardSignal, ...]


@dataclass(frozen=True)
class CanSurvey:
    """All that was heard in a log; `notes` say what was lost or left out on the way."""

    name: str
    duration: float  # [s]
    messages: tuple[HeardMessage, ...]
    notes: tuple[str, ...]

    @property
    def signals(self) -> list[HeardSignal]:
        """The signals of all messages."""
        return [signal for message in self.messages for signal in message.signals]


def survey(log: str | Path, databases: Sequence[str | Path] = ()) -> CanSurvey:
    """Look at all identifiers of a log, and decode what the databases know; of two that know one the first counts.

    Raises `InputError` for a log or a database that cannot be read.
    """
    frames = read_frames(Path(log))
    if not len(frames):
        raise InputError(f"{log}: there is no data frame in it")
    known: dict[tuple[int, bool], tuple[str, Message]] = {}
    notes = list(frames.losses)
    for path in databases:
        read = read_database(path)
        notes += read.notes
        names = [message.name for message in read.database.messages]
        for message in read.database.messages:
            alike = names.count(message.name) > 1
            name = f"{message.name}@0x{message.frame_id:X}" if alike else message.name
            known.setdefault((message.frame_id, message.is_extended_frame), (name, message))
    keys = frames.identifier.astype(np.int64) << 1 | frames.is_extended
    order = np.argsort(keys, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(keys[order])) + 1)
    messages = tuple(_message(frames, group, known) for group in groups)
    return CanSurvey(Path(log).name, float(np.ptp(frames.time)), messages, tuple(notes))


def _message(
    frames: CanFrames, group: NDArray[np.intp], known: dict[tuple[int, bool], tuple[str, Message]]
) -> HeardMessage:
    identifier, extended = int(frames.identifier[group[0]]), bool(frames.is_extended[group[0]])
    name, message = _named(identifier, extended, known)
    time = frames.time[group]
    steps = np.diff(time)
    steps = steps[steps > 0]
    channels = tuple(frames.channels[bus] for bus in np.unique(frames.channel[group]))
    if len(channels) > 1:  # the bus that has the most of it
        buses, count = np.unique(frames.channel[group], return_counts=True)
        group = group[frames.channel[group] == buses[np.argmax(count)]]
    return HeardMessage(
        identifier,
        extended,
        channels,
        len(time),
        int(np.median(frames.length[group])),
        float(1.0 / np.median(steps)) if len(steps) else 0.0,
        name,
        () if message is None else tuple(_signals(frames, group, name, message)),
    )


def _named(
    identifier: int, extended: bool, known: dict[tuple[int, bool], tuple[str, Message]]
) -> tuple[str, Message | None]:
    """The message of an identifier, of one of J1939 whoever sends it."""
    message = known.get((identifier, extended))
    if message is None and extended:
        message = known.get((identifier & ~0xFF | _J1939_NULL_ADDRESS, True))
    return message or ("", None)


def _signals(frames: CanFrames, group: NDArray[np.intp], name: str, message: Message) -> list[HeardSignal]:
    data = frames.rows(group)
    heard = []
    for signal in message.signals:
        field = SignalField.of(signal, message)
        rows = (frames.length[group] > field.last) & (data.shape[1] > field.last)
        if data.shape[1] > field.last:
            rows = rows & field.has_of(data)
        if not rows.any():
            continue
        values = field.physical_of(data[rows])
        good = np.isfinite(values)
        if not good.any():
            continue
        heard.append(
            HeardSignal(
                name,
                signal.name,
                signal.unit or "",
                signal.length,
                bool(signal.choices),
                None if signal.minimum is None else float(signal.minimum),
                None if signal.maximum is None else float(signal.maximum),
                abs(field.scale),
                frames.time[group][rows][good],
                values[good],
            )
        )
    return heard
