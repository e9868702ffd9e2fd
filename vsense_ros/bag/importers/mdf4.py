"""Measurement files of ASAM MDF, version 3 and 4, by a channel mapping (see `mapping.py`)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.columns import recording_from
from vsense_ros.bag.importers.mapping import Column, Ref
from vsense_ros.driver.mdf import make_asammdf_careful
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

Array = NDArray[np.float64]

NAME = "mdf4"
DESCRIPTION = "ASAM MDF measurement with a channel mapping (.mf4, .mdf, .dat)"


def matches(path: Path) -> bool:
    """True if `path` begins like an MDF file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(3) == b"MDF"


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """The topics that the mapping makes of the channels; a `column` of the mapping is a channel name.

    `mapping` is a YAML file or its content; by default the file of the same name with `.yaml`. Time counts from the
    start of the measurement that the file states, unless the mapping gives another.
    """
    wanted = mapping_file.load(mapping_file.default_mapping(path, mapping), path)
    with _open(path) as file:
        if wanted.time.start is None:
            start = file.header.start_time
            start = start if start.tzinfo else start.replace(tzinfo=UTC)
            wanted = wanted.model_copy(update={"time": wanted.time.model_copy(update={"start": start})})
        times: dict[int, Array] = {}
        return recording_from(wanted, lambda ref: _column(path, file, ref, times), path.stem, NAME)


def channels(path: Path) -> tuple[dict[str, Any], dict[str, str]]:
    """Values (n,) and units of all channels of numbers whose names stand once, by name."""
    values: dict[str, Any] = {}
    stated: dict[str, str] = {}
    times: dict[int, Array] = {}
    with _open(path) as file:
        for name, places in file.channels_db.items():
            if len(places) != 1 or name.lower() in ("t", "time", "timestamp", "timestamps"):
                continue
            try:
                column = _column(path, file, Ref(name), times)
            except InputError:
                continue
            values[name], stated[name] = column.values, column.unit
    return values, stated


def _open(path: Path) -> Any:
    """The file, by asammdf."""
    from asammdf import MDF
    from asammdf.blocks.utils import MdfException

    with path.open("rb") as stream:
        stream.seek(64)
        if stream.read(4).removeprefix(b"##")[:2] != b"HD":
            raise InputError(f"{path}: the MDF file is damaged: no measurement header at byte 64; copy it again")
    make_asammdf_careful()
    try:
        return MDF(path)
    except MemoryError:
        raise
    except (MdfException, OSError, ValueError, LookupError, TypeError, ArithmeticError, AttributeError) as error:
        raise InputError(f"{path}: cannot be read as MDF: {error}") from None
    except Exception as error:
        if type(error).__module__.partition(".")[0] not in ("zlib", "struct", "lz4", "zstandard"):
            raise
        raise InputError(f"{path}: cannot be read as MDF: {error}") from None


def _place(path: Path, file: Any, ref: Ref) -> tuple[int, int]:
    """Group and index of the channel that a mapping names. Raises `InputError` if there is none, or several."""
    places = file.channels_db.get(ref.name, ())
    groups = dict.fromkeys(group for group, _ in places)
    if ref.group is not None and ref.group not in groups:
        elsewhere = f"; it is in {', '.join(map(str, groups))}" if groups else ""
        raise InputError(f"{path}: no channel {ref.name!r} in group {ref.group}{elsewhere}")
    if not places:
        close = sorted(channel for channel in file.channels_db if str(ref.name).lower() in channel.lower())
        hint = f"; similar: {', '.join(close[:8])}" if close else ""
        raise InputError(f"{path}: no channel {ref.name!r}{hint}")
    if ref.group is None and len(places) > 1:
        listed = ", ".join(f"{group} ({file.groups[group].channel_group.cycles_nr} samples)" for group in groups)
        raise InputError(
            f"{path}: channel {ref.name!r} is in {len(places)} groups: {listed}; say which, group: {places[0][0]}"
        )
    return next(place for place in places if ref.group in (None, place[0]))


def _column(path: Path, file: Any, ref: Ref, times: dict[int, Array]) -> Column:
    """A channel; the `times` of its group, which take as long to read, are kept for the others of the group."""
    from asammdf.blocks.utils import MdfException

    group, index = _place(path, file, ref)
    try:
        if group in times and file.version >= "4":
            samples, invalid = file.get(ref.name, group=group, index=index, samples_only=True)
            unit = file.groups[group].channels[index].unit
        else:
            signal = file.get(ref.name, group=group, index=index)
            samples, invalid, unit = signal.samples, signal.invalidation_bits, signal.unit
            times[group] = np.asarray(signal.timestamps, np.float64)
    except (MdfException, ValueError, LookupError, OSError, TypeError) as error:
        raise InputError(f"{path}: channel {ref.name!r} cannot be read: {error}") from None
    if samples.dtype.kind not in "biuf" or samples.ndim != 1:
        raise InputError(f"{path}: channel {ref.name!r} holds {samples.dtype}, expected numbers")
    values = np.asarray(samples, np.float64)
    if len(values) != len(times[group]):
        raise InputError(f"{path}: channel {ref.name!r} has {len(values)} values at {len(times[group])} times")
    if invalid is not None:
        values = np.where(np.asarray(invalid, bool), np.nan, values)
    return Column(times[group], values, unit or "")
