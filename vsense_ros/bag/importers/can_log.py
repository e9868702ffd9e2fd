"""CAN logs (candump, ASC, BLF, TRC, GVRET, MDF4 bus logging) by a database and a mapping, as the CAN driver has them.

The checks are those of the driver: counters, checksums, ranges. Frames are decoded all at once.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsense_ros.bag.importers import build, can_buses
from vsense_ros.bag.importers.build import Array, Stamps
from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_frames import CanFrames
from vsense_ros.driver.can_log import format_of, frames_in_pieces, read_frames
from vsense_ros.driver.can_mapping import AnyOutput, ImuOutput, JointStateOutput
from vsense_ros.driver.can_motion import MotionBase
from vsense_ros.driver.samples import ABSENT, UNMEASURED_VARIANCE
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import FIELDS, Channel, Recording

NAME = "can_log"
DESCRIPTION = (
    "CAN log with a database and a mapping (candump, .asc, .blf, .trc, GVRET .csv, .mf4, BUSMASTER, CRTD, Vehicle Spy)"
)
NEEDS = ("dbc",)  # without a database an MDF4 file is one of signals

_FRAME = 64  # [byte] that a frame takes in a log as text, about

_Part = tuple[AnyOutput, Stamps, Stamps, dict[str, Array]]  # stamps of measurement and arrival, values by name


def matches(path: Path) -> bool:
    """True if `path` begins like a CAN log."""
    return path.is_file() and format_of(path) is not None


def read(
    path: Path,
    *,
    dbc: str | Path | Sequence[str | Path] | None = None,
    mapping: str | Path | Sequence[str | Path] | None = None,
    channel: str | int | None = None,
) -> Recording:
    """The topics that the mapping makes of the log; `channel` is the bus, where the log has several.

    With several databases each is of a bus: `can0=car.dbc`, or as its mapping says (`bus`), or the bus on which the
    messages of its mapping come. There is a mapping for each, in their order, or one whose messages are in one each.

    Times are those of the log: Unix times where it has a date, else from its start.
    """
    decoders = decoders_of(path, dbc, mapping, channel)
    return decoded(path, read_frames(path), decoders)


def pieces(
    path: Path,
    size: int,
    *,
    dbc: str | Path | Sequence[str | Path] | None = None,
    mapping: str | Path | Sequence[str | Path] | None = None,
    channel: str | int | None = None,
) -> Iterator[Recording]:
    """The topics of the log in pieces of about `size` bytes of frames, which follow each other in time."""
    decoders = decoders_of(path, dbc, mapping, channel)
    buses: list[str | int | None] | None = None
    came: set[str] = set()
    passed = ""
    for frames in frames_in_pieces(path, max(size // _FRAME, 1)):
        notes = _notes(path, frames, decoders)
        buses = can_buses.assigned(path, decoders, frames, notes) if buses is None else buses
        parts, passed = _parts(path, frames, decoders, buses, notes, is_piece=True)
        came |= {part[0].message for part in parts}
        yield _recording(path, frames, parts, notes)
    yield Recording({}, path.stem, tuple(_missing(path, decoders, came, passed)), 0, {"source": NAME})


def decoded(path: Path, frames: CanFrames, decoders: Sequence[CanDecoder]) -> Recording:
    """The topics that decoders make of the frames of a file. Raises `InputError` if none of their messages is there."""
    notes = _notes(path, frames, decoders)
    buses = can_buses.assigned(path, decoders, frames, notes)
    parts, passed = _parts(path, frames, decoders, buses, notes)
    notes += _missing(path, decoders, {part[0].message for part in parts}, passed)
    return _recording(path, frames, parts, notes)


def _notes(path: Path, frames: CanFrames, decoders: Sequence[CanDecoder]) -> list[str]:
    """What the decoders and the reader of the log have to say."""
    notes = [*(note for decoder in decoders for note in decoder.notes), *frames.losses]
    if frames.counts_from_zero:
        notes.append(f"{path.name}: the log has no date; its times count from its start")
    return notes


def _parts(
    path: Path,
    frames: CanFrames,
    decoders: Sequence[CanDecoder],
    buses: Sequence[str | int | None],
    notes: list[str],
    *,
    is_piece: bool = False,
) -> tuple[list[_Part], str]:
    """What the outputs of the mappings get, and identifiers that nothing listens to; a bus may be silent in a piece."""
    arrival = build.nanoseconds(frames.time)
    parts: list[_Part] = []
    passed = ""
    for decoder, bus in zip(decoders, buses, strict=True):
        if is_piece and bus is not None and str(bus) not in frames.channels:
            continue
        own, passed = _decoded(decoder, frames, _of_channel(path, frames, bus), arrival, notes)
        parts += own
    return parts, passed


def _recording(path: Path, frames: CanFrames, parts: Sequence[_Part], notes: Sequence[str]) -> Recording:
    topics = dict.fromkeys(part[0].topic for part in parts)
    channels = {topic: _channel(topic, [part for part in parts if part[0].topic == topic]) for topic in topics}
    damage = tuple(loss for loss in frames.losses if loss.startswith("unreadable after"))
    return Recording(channels, path.stem, tuple(dict.fromkeys(notes)), 0, {"source": NAME}, damage)


def decoders_of(
    path: Path,
    dbc: str | Path | Sequence[str | Path] | None,
    mapping: str | Path | Sequence[str | Path] | None,
    channel: str | int | None,
) -> list[CanDecoder]:
    """The decoder of each bus; a mapping beside the log is taken where none is given. Raises `InputError` where the
    database or the mapping is missing."""
    beside = [own_mapping for ending in (".yaml", ".yml") if (own_mapping := path.with_suffix(ending)).exists()]
    mapping = mapping if mapping is not None else next(iter(beside), None)
    if dbc is None or mapping is None:
        missing = " and ".join(
            n for n, v in (("a database (--dbc FILE)", dbc), ("a mapping (--mapping FILE)", mapping)) if v is None
        )
        raise InputError(f"{path}: a CAN log is frames of bytes; what they mean needs {missing}, as in config/can")
    return can_buses.decoders(_several(dbc), _several(mapping), channel)


def _missing(path: Path, decoders: Sequence[CanDecoder], came: Collection[str], passed: str) -> list[str]:
    """A note on the messages of the mappings that never came, beside the identifiers that nothing listens to. Raises
    `InputError` where none of the messages came."""
    outputs = [output for decoder in decoders for output in decoder.mapping.outputs]
    if not came:
        heard = f"; identifiers that came: {passed}" if passed else ""
        wanted = ", ".join(dict.fromkeys(output.message for output in outputs))
        raise InputError(f"{path}: none of the messages that the mapping uses ({wanted}) is in the log{heard}")
    never = {output.message for output in outputs} - set(came)
    if not never:
        return []
    return [f"never came: {', '.join(sorted(never))}; what came and nothing listens to: {passed or 'nothing'}"]


def _several(files: str | Path | Sequence[str | Path]) -> list[str | Path]:
    return [files] if isinstance(files, str | Path) else list(files)


def _of_channel(path: Path, frames: CanFrames, channel: str | int | None) -> NDArray[np.intp]:
    """Rows of the frames of one bus."""
    if channel is None:
        return np.arange(len(frames))
    if str(channel) not in frames.channels:
        raise InputError(f"{path}: no channel {channel!r}; it has {', '.join(frames.channels)}")
    return np.flatnonzero(frames.channel == frames.channels.index(str(channel)))


def _decoded(
    decoder: CanDecoder, frames: CanFrames, rows: NDArray[np.intp], arrival: Stamps, notes: list[str]
) -> tuple[list[_Part], str]:
    """What the outputs of the mapping get from the frames, and which identifiers nothing listens to."""
    keys = frames.identifier[rows].astype(np.int64) << 1 | frames.is_extended[rows]
    order = np.argsort(keys, kind="stable")
    starts = np.flatnonzero(np.diff(keys[order], prepend=-1))
    parts: list[_Part] = []
    faults: Counter[str] = Counter()
    said: Counter[str] = Counter()
    passed: list[tuple[int, str]] = []
    # In the order in which they came first, which decides whom of several senders of a group is listened to.
    groups = sorted((rows[group] for group in np.split(order, starts[1:]) if len(group)), key=lambda group: group[0])
    for group in groups:
        identifier, is_extended = int(frames.identifier[group[0]]), bool(frames.is_extended[group[0]])
        receiver = decoder.receiver(identifier, is_extended)
        container = decoder.container(identifier, is_extended) if receiver is None else None
        if container is not None:
            group = _one_bus(frames, group, container.message.name, notes)
            for inside, within, data in container.parts(frames.rows(group), frames.length[group]):
                lengths = np.full(len(data), inside.length)
                for output, good, values in inside.table(data, lengths, faults, said):
                    received = arrival[group[within[good]]]
                    parts.append((output, received - inside.latency, received, values))
            continue
        if receiver is None:
            passed.append((len(group), f"0x{identifier:X}{' (29 bits)' if is_extended else ''} × {len(group)}"))
            continue
        group = _one_bus(frames, group, receiver.message.name, notes)
        for output, good, values in receiver.table(frames.rows(group), frames.length[group], faults, said):
            received = arrival[group[good]]
            if len(good):
                parts.append((output, received - receiver.latency, received, values))
    notes += [f"{count} frames left out: {reason}" for reason, count in faults.most_common()]
    notes += [f"{text} ({count} times)" for text, count in said.most_common()]
    passed.sort(reverse=True)
    more = f" and {len(passed) - 12} more" if len(passed) > 12 else ""
    return parts, ", ".join(text for _, text in passed[:12]) + more


def _one_bus(frames: CanFrames, group: NDArray[np.intp], name: str, notes: list[str]) -> NDArray[np.intp]:
    """The frames of the bus that has the most of a message, where several have it."""
    buses, count = np.unique(frames.channel[group], return_counts=True)
    if len(buses) == 1:
        return group
    chosen = buses[np.argmax(count)]
    listed = ", ".join(frames.channels[bus] or "?" for bus in buses)
    notes.append(f"{name} is on the channels {listed}; those of {frames.channels[chosen]} are used (option channel)")
    return group[frames.channel[group] == chosen]


def _channel(topic: str, parts: list[_Part]) -> Channel:
    """One topic from the messages that give parts of it: each row has the values of one, and NaN for the others."""
    received = np.concatenate([part[2] for part in parts])
    order: NDArray[np.intp] | slice = np.argsort(received, kind="stable")
    if len(parts) == 1 and (np.diff(received) >= 0).all():
        order = slice(None)  # nothing is copied
    stamp = np.concatenate([part[1] for part in parts])[order]
    received = received[order]

    def column(name: str, absent: float = np.nan) -> Array:
        values = [part[3].get(name, np.full(len(part[1]), absent)) for part in parts]
        return np.concatenate(values)[order]

    output = parts[0][0]
    if isinstance(output, JointStateOutput):
        names = tuple(dict.fromkeys(name for part in parts for name in part[3]))
        empty = np.zeros((len(stamp), 0))
        columns = dict.fromkeys(FIELDS["sensor_msgs/msg/JointState"], empty)
        columns[output.field] = np.column_stack([column(name) for name in names])
        return Channel(topic, "sensor_msgs/msg/JointState", stamp, received, columns, "", names)
    if isinstance(output, MotionBase):
        # Made of one message each, so that all parts have the same values.
        made = [part[0].columns(part[3]) for part in parts if isinstance(part[0], MotionBase)]
        columns = {name: np.concatenate([columns[name] for columns in made])[order] for name in made[0]}
        frame, child = output.frames
        return Channel(topic, output.message_kind, stamp, received, columns, frame, (), child)
    assert isinstance(output, ImuOutput)
    return Channel(topic, "sensor_msgs/msg/Imu", stamp, received, _imu(parts, order), output.frame_id)


def _imu(parts: list[_Part], order: NDArray[np.intp] | slice) -> dict[str, Array]:
    rows = sum(len(part[1]) for part in parts)
    columns: dict[str, Array] = {
        "orientation": np.broadcast_to([0.0, 0.0, 0.0, 1.0], (rows, 4)),
        "orientation_covariance": build.same(rows, 9, -1.0),
    }
    for field in ("angular_velocity", "linear_acceleration"):
        names = [f"{field}_{axis}" for axis in "xyz"]
        vectors, covariances = [], []
        for output, stamps, _, values in parts:
            assert isinstance(output, ImuOutput)
            given = [values.get(name) for name in names]
            if all(values_ is None for values_ in given):
                vectors.append(np.zeros((len(stamps), 3)))
                covariances.append(build.same(len(stamps), 9, -1.0))
                continue
            vectors.append(np.column_stack([np.full(len(stamps), np.nan) if v is None else v for v in given]))
            deviation = {str(axis): signal.standard_deviation or 0.0 for axis, signal in output.axes.items()}
            variances = [deviation.get(name, 0.0) ** 2 or UNMEASURED_VARIANCE for name in names]
            covariances.append(_covariance(vectors[-1], variances))
        columns[field] = (np.concatenate(vectors) if len(vectors) > 1 else vectors[0])[order]
        columns[f"{field}_covariance"] = (np.concatenate(covariances) if len(parts) > 1 else covariances[0])[order]
    return columns


def _covariance(vectors: Array, variances: list[float]) -> Array:
    """Covariances (n, 9) of vectors (n, 3) with these variances [SI²]; axes that are NaN are not measured, and a vector
    of which none is measured is absent, and becomes zero."""
    missing = np.isnan(vectors)
    covariances = np.broadcast_to(np.diag(variances).ravel(), (len(vectors), 9))
    if not (missing & (np.array(variances) != UNMEASURED_VARIANCE)).any():
        return covariances
    covariances = covariances.copy()
    covariances[:, [0, 4, 8]] = np.where(missing, UNMEASURED_VARIANCE, covariances[:, [0, 4, 8]])
    absent = missing.all(axis=1)
    covariances[absent] = ABSENT
    vectors[absent] = 0.0
    return covariances
