"""Files that are there whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from vsense_ros.errors import InputError


@contextmanager
def atomic_write(path: str | Path) -> Iterator[TextIO]:
    """A file to write to, which takes the place of `path` when all is written: who is interrupted, or has no room left,
    keeps the earlier one. Lines end as they are written. What is no file, such as /dev/stdout, is written to as it
    is."""
    with in_place_of(path) as fresh, fresh.open("w", encoding="utf-8", newline="") as file:
        yield file


@contextmanager
def in_place_of(path: str | Path) -> Iterator[Path]:
    """Path at which to write a file that shall take the place of another at once: that of a new one beside `path`, or
    of what is no file. Raises `InputError` where the folder does not exist."""
    target = Path(path).resolve()
    if not target.parent.is_dir():
        raise InputError(f"{path}: there is no folder {Path(path).parent}; create it first, or choose another place")
    if target.exists() and not target.is_file():
        yield target
        return
    fresh = target.with_name(f"{target.name}.new")
    try:
        yield fresh
        fresh.replace(target)
    finally:
        fresh.unlink(missing_ok=True)
