"""The map's origin, kept in a file from one start of the observer to the next."""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write
from vsense_ros.messages.yaml_text import read_text

Origin = tuple[float, float, float]  # latitude, longitude [deg], height [m]
_KEYS = ("latitude_deg", "longitude_deg", "height_m")


def read_origin(path: str | Path) -> Origin | None:
    """The origin in a file, None where the file is not there yet; `InputError` for one that holds something else."""
    if not Path(path).exists():
        return None
    try:
        content = json.loads(read_text(path, 10_000))
        latitude, longitude, height = (float(content[key]) for key in _KEYS)
    except (ValueError, KeyError, TypeError, RecursionError):
        raise InputError(f"{path}: no origin of a map; expected JSON with {', '.join(_KEYS)}; remove it") from None
    if not (abs(latitude) <= 90 and abs(longitude) <= 360 and isfinite(height)):
        raise InputError(f"{path}: {latitude}, {longitude}, {height} is no place on earth; remove the file")
    return latitude, longitude, height


def write_origin(path: str | Path, origin: Origin) -> None:
    """Store an origin, whole or not at all. Raises `InputError` where that is impossible."""
    try:
        with atomic_write(path) as file:
            json.dump(dict(zip(_KEYS, origin, strict=True)), file)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None
