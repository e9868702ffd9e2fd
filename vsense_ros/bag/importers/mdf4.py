"""Measurement files of ASAM MDF, version 3 and 4, by a channel mapping (see `mapping.py`)."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np

from vsense_ros.bag.importers import mapping as mapping_file
from vsense_ros.bag.importers.build import Array
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

NAME = "mdf4"
DESCRIPTION = "ASAM MDF measurement with a channel mapping (.mf4, .mdf, .dat)"


def matches(path: Path) -> bool:
    """Whether `path` begins like an MDF file."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(3) == b"MDF"


def read(path: Path, *, mapping: str | Path | Mapping[str, Any] | None = None) -> Recording:
    """The topics that the mapping makes of the channels; a `column` of the mapping is a channel name.

    `mapping` is a YAML file or its content; by default the file of the same name with `.yaml`. Time counts from the
    start of the measurement that the file states, unless the mapping gives another.
    """
    from asammdf import MDF
    from asammdf.blocks.utils import MdfException

    wanted = mapping_file.load(mapping_file.default_mapping(path, mapping), path)
    # asammdf recurses without end when it drops a file whose header it could not read, so that is looked at first.
    with path.open("rb") as stream:
        stream.seek(64)
        if stream.read(4).removeprefix(b"##")[:2] != b"HD":
            raise InputError(f"{path}: the MDF file is damaged: no measurement header at byte 64; copy it again")
    try:
        file = MDF(path)
    except (MdfException, OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: cannot be read as MDF: {error}") from None
    with file:
        if wanted.time.start is None:
            start = file.header.start_time
            start = start if start.tzinfo else start.replace(tzinfo=UTC)
            wanted = wanted.model_copy(update={"time": wanted.time.model_copy(update={"start": start})})

        def column(name: str) -> tuple[Array, Array]:
            try:
                signal = file.get(name)
            except MdfException:
                close = sorted(channel for channel in file.channels_db if name.lower() in channel.lower())
                hint = f"; similar: {', '.join(close[:8])}" if close else ""
                raise InputError(f"{path}: no channel {name!r} or more than one of this name{hint}") from None
            if signal.samples.dtype.kind not in "biuf" or signal.samples.ndim != 1:
                raise InputError(f"{path}: channel {name!r} holds {signal.samples.dtype}, expected numbers")
            return np.asarray(signal.timestamps, np.float64), np.asarray(signal.samples, np.float64)

        return mapping_file.apply(wanted, column, path.stem, NAME)
