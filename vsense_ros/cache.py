"""The folder in which compiled code and downloads are kept from one run to the next."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def user_folder() -> Path:
    """The project's folder in the user's cache, which need not exist: `$XDG_CACHE_HOME/vsense_ros`, by default
    `~/.cache/vsense_ros` (XDG Base Directory Specification 0.8)."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(named) if os.path.isabs(named) else Path.home() / ".cache") / "vsense_ros"


def compiled_folder() -> Path:
    """Folder of compiled code: `$VSENSE_CACHE` if it is set, else the user's cache. It need not exist."""
    named = os.environ.get("VSENSE_CACHE")
    return Path(named) if named else user_folder()


@contextmanager
def one_builder(target: Path) -> Iterator[None]:
    """Let one process at a time build `target`; the others wait here.

    It only saves work: builders move their result to its place in one step, so that systems without `flock` may build
    twice.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    with target.with_suffix(".lock").open("a", encoding="ascii") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
