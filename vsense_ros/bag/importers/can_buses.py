"""Which database and mapping is of which bus of a CAN log."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from pathlib import Path

import numpy as np

from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_database import CanDatabase, read_database
from vsense_ros.driver.can_frames import CanFrames
from vsense_ros.driver.can_mapping import CanMapping, load_mapping
from vsense_ros.errors import InputError

_MOST_TRIED = 6  # databases whose buses are found by trying


def decoders(
    databases: Sequence[str | Path], mappings: Sequence[str | Path], channel: str | int | None
) -> list[CanDecoder]:
    """A decoder for each database, which may have its bus before it (`can0=car.dbc`), with the mapping of the same
    place, or with the part of the only mapping whose messages it has."""
    named = [_named(database) for database in databases]
    loaded = [mapping if isinstance(mapping, CanMapping) else load_mapping(mapping) for mapping in mappings]
    if len(named) == 1 and len(loaded) == 1:
        bus, path = named[0]
        return [CanDecoder(path, loaded[0], bus or channel or loaded[0].bus)]
    read = [read_database(path) for _, path in named]
    if len(loaded) == 1:
        loaded = _shared_out(loaded[0], read, [path for _, path in named])
    if len(loaded) != len(named):
        raise InputError(
            f"{len(named)} databases and {len(loaded)} mappings: expected a mapping for each database, in their order, "
            "or one for all"
        )
    return [
        CanDecoder(database, mapping, bus or mapping.bus)
        for (bus, _), database, mapping in zip(named, read, loaded, strict=True)
    ]


def _named(database: str | Path) -> tuple[str | None, Path]:
    """Bus and file of `can0=car.dbc`; a file alone has no bus."""
    bus, separator, path = str(database).partition("=")
    if not separator or Path(database).exists():
        return None, Path(database)
    return bus.lstrip("/"), Path(path)  # which may be a topic of frames


def _shared_out(mapping: CanMapping, databases: Sequence[CanDatabase], paths: Sequence[Path]) -> list[CanMapping]:
    """The part of a mapping for each database: the outputs whose message it has, and no other one."""
    parts: list[list[int]] = [[] for _ in databases]
    for index, output in enumerate(mapping.outputs):
        holding = [place for place, read in enumerate(databases) if output.message in _names(read)]
        if len(holding) != 1:
            where = ", ".join(paths[place].name for place in holding) or "none"
            raise InputError(
                f"mapping {mapping.name}: message {output.message} is in {where} of the databases; expected one: give "
                "each database a mapping of its own"
            )
        parts[holding[0]].append(index)
    mappings = []
    for path, part in zip(paths, parts, strict=True):
        if not part:
            raise InputError(f"mapping {mapping.name}: none of its messages is in {path.name}")
        outputs = tuple(mapping.outputs[index] for index in part)
        used = {output.message for output in outputs}
        checks = {name: check for name, check in mapping.messages.items() if name in used}
        mappings.append(mapping.model_copy(update={"outputs": outputs, "messages": checks}))
    return mappings


def _names(read: CanDatabase) -> set[str]:
    """The messages of a database, and those in its containers."""
    own = {message.name for message in read.database.messages}
    return own | {part.name for message in read.database.messages for part in message.contained_messages or ()}


def assigned(path: Path, decoders: Sequence[CanDecoder], frames: CanFrames, notes: list[str]) -> list[str | int | None]:
    """The bus of each decoder. Several without one get each another bus, so that as many of their messages as possible
    come on it; `InputError` where that is not clear."""
    given = [decoder.channel for decoder in decoders]
    unknown = [bus for bus in given if bus is not None and str(bus) not in frames.channels]
    if len(decoders) == 1 or None not in given or unknown:
        return given
    for place, bus in _by_messages(path, decoders, frames, given).items():
        given[place] = bus
        notes.append(f"{decoders[place].mapping.name} is of the bus {bus}, where its messages come")
    return given


def _by_messages(
    path: Path, decoders: Sequence[CanDecoder], frames: CanFrames, given: Sequence[str | int | None]
) -> dict[int, str]:
    """The bus of each decoder without one, by its place among the decoders: as many of their messages as possible come
    on these buses. Raises `InputError` where there are too few buses, or several answers."""
    taken = {str(bus) for bus in given if bus is not None}
    free = [name for name in frames.channels if name not in taken]
    places = [place for place, bus in enumerate(given) if bus is None]
    say = "say which bus each is of: --dbc BUS=FILE, or the key bus of its mapping"
    if len(free) < len(places) or len(places) > _MOST_TRIED:
        raise InputError(f"{path}: {len(decoders)} databases for the buses {', '.join(frames.channels)}; {say}")
    heard = {(place, bus): _heard(decoders[place], frames, bus) for place in places for bus in free}
    orders = permutations(free, len(places))
    totals = sorted(
        ((sum(heard[pair] for pair in zip(places, order, strict=True)), order) for order in orders), reverse=True
    )
    if len(totals) > 1 and totals[0][0] == totals[1][0]:
        raise InputError(f"{path}: the messages of several databases come on several buses alike; {say}")
    return dict(zip(places, totals[0][1], strict=True))


def _heard(decoder: CanDecoder, frames: CanFrames, bus: str) -> int:
    """How many of the messages that are listened to come on a bus."""
    on_bus = frames.channel == frames.channels.index(bus)
    keys = np.unique(frames.identifier[on_bus].astype(np.int64) << 1 | frames.is_extended[on_bus])
    pairs = [(int(key) >> 1, bool(key & 1)) for key in keys]
    return sum(decoder.listens(*pair) for pair in pairs)
