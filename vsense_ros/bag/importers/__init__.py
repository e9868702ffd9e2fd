"""Recordings of any format, one module each. A new one is a module in this folder with NAME, DESCRIPTION,
`matches(path)`, and `read(path, **options)`; the other modules here, which have no NAME, are what several share."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

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


def importers() -> list[Importer]:
    """The importers of this folder in the order in which they are asked: by name, those that judge by a file's ending
    alone (LAST = True) after the others."""
    modules = [import_module(f"{__name__}.{found.name}") for found in iter_modules(__path__)]
    formats = [module for module in modules if hasattr(module, "NAME")]
    formats.sort(key=lambda module: getattr(module, "LAST", False))
    return [Importer(module.NAME, module.DESCRIPTION, module.matches, module.read) for module in formats]


def find_importer(path: str | Path) -> Importer:
    """The importer for what `path` holds. Raises `InputError` if there is none."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    known = importers()
    for importer in known:
        if importer.matches(path):
            return importer
    names = "; ".join(f"{importer.name}: {importer.description}" for importer in known)
    raise InputError(f"{path}: no importer knows this. Known: {names}")


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
