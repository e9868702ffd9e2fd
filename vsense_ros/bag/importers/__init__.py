"""Recordings of other formats, one module each. A new one is a module with NAME, DESCRIPTION, matches, read, and a
line in `IMPORTERS`."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsense_ros.bag import mcap
from vsense_ros.bag.importers import comma2k19, csv, genesis, mdf4, racelogic_vbb
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording


@dataclass(frozen=True)
class Importer:
    """A format: its name, what it is, how it is recognised, and how it is read."""

    name: str
    description: str
    matches: Callable[[Path], bool]
    read: Callable[..., Recording]

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the keyword options of `read`."""
        return tuple(inspect.signature(self.read).parameters)[1:]


def _is_bag(path: Path) -> bool:
    return path.suffix == ".mcap" or (path / "metadata.yaml").exists() or any(path.glob("*.mcap"))


IMPORTERS = (
    Importer("mcap", "ROS 2 bag in MCAP", _is_bag, mcap.read_bag),
    Importer(comma2k19.NAME, comma2k19.DESCRIPTION, comma2k19.matches, comma2k19.read),
    Importer(genesis.NAME, genesis.DESCRIPTION, genesis.matches, genesis.read),
    Importer(racelogic_vbb.NAME, racelogic_vbb.DESCRIPTION, racelogic_vbb.matches, racelogic_vbb.read),
    Importer(mdf4.NAME, mdf4.DESCRIPTION, mdf4.matches, mdf4.read),
    Importer(csv.NAME, csv.DESCRIPTION, csv.matches, csv.read),
)


def find_importer(path: str | Path) -> Importer:
    """The importer for what `path` holds. Raises `InputError` if there is none."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    for importer in IMPORTERS:
        if importer.matches(path):
            return importer
    known = "; ".join(f"{importer.name}: {importer.description}" for importer in IMPORTERS)
    raise InputError(f"{path}: no importer knows this. Known: {known}")


def import_recording(path: str | Path, **options: Any) -> Recording:
    """Read a recording of any known format; `options` go to its importer.

    Raises `InputError` if nothing knows the format or an option is not one of its importer.
    """
    importer = find_importer(path)
    unknown = [name for name in options if name not in importer.options]
    if unknown:
        allowed = ", ".join(importer.options) or "none"
        raise InputError(f"{path}: importer {importer.name} has no option {unknown[0]!r}; it has: {allowed}")
    return importer.read(Path(path), **options)
