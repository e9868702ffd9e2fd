"""The folder in which compiled code and downloads are kept from one run to the next."""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
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


def kept(name: str, content: Sequence[str], make: Callable[[Path], Path]) -> Path:
    """Return the library made from `content`: the one in the cache, or else what `make` builds in an empty folder.

    `make` returns the path of its result, which one step moves to its place, so that processes may build at once.
    `name` is for humans: it begins the file's name. A library that another user could have written is built again.
    Raises `OSError` where nothing can be kept: also where the cache is not safe (`unsafe`).
    """
    key = hashlib.sha256(chr(10).join(content).encode()).hexdigest()
    target = compiled_folder() / f"{name}-{key[:20]}.so"
    target.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    _close_to_group(target.parent)
    if reason := unsafe(target.parent):
        raise PermissionError(
            f"{reason}: what is compiled is not kept in it; name a folder of your own in VSENSE_CACHE"
        )
    if _usable(target):
        return target
    with one_builder(target):
        if not _usable(target):
            with tempfile.TemporaryDirectory(dir=target.parent) as folder:
                made = make(Path(folder))
                made.chmod(0o700)
                os.replace(made, target)
    return target


@cache
def digest_of(folder: Path) -> str:
    """SHA-256 of all code in a folder: of its Python and C, by path and content."""
    found = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*.*") if p.suffix in (".py", ".c", ".h")):
        found.update(f"{path.relative_to(folder)}\n".encode() + path.read_bytes())
    return found.hexdigest()


def unsafe(path: Path) -> str:
    """Say in a few words why code must not be run from a file or folder: another user could have put it there.

    Empty where only this user and root can change it, and each folder above it, also by a group that others are in.
    Folders that all may write to, as /tmp, are safe if their sticky bit keeps users from each other's files. Systems
    without users are taken to be safe.
    """
    if not hasattr(os, "getuid"):
        return ""
    trusted = (os.getuid(), 0)
    for place in (path, *path.absolute().parents):
        status = place.lstat() if place == path else place.stat()
        if stat.S_ISLNK(status.st_mode):
            return f"{place} is a link"
        if status.st_uid not in trusted:
            return f"{place} belongs to somebody else"
        others = stat.S_IWOTH | (stat.S_IWGRP if place == path or _has_others(status.st_gid) else 0)
        if status.st_mode & others and (place == path or not status.st_mode & stat.S_ISVTX):
            return f"{place} can be changed by others"
    return ""


@cache
def _has_others(group: int) -> bool:
    """True if a group has members other than this user and root, or is not known."""
    import grp
    import pwd

    try:
        listed = {pwd.getpwnam(name).pw_uid for name in grp.getgrgid(group).gr_mem}
    except KeyError:
        return True
    members = listed | {user.pw_uid for user in pwd.getpwall() if user.pw_gid == group}
    return bool(members - {os.getuid(), 0})


def _usable(library: Path) -> bool:
    return library.exists() and not unsafe(library)


def _close_to_group(folder: Path) -> None:
    """Take from the group what a umask of 002 gave it, where a group is usually its user alone."""
    status = folder.stat()
    if hasattr(os, "getuid") and status.st_uid == os.getuid() and status.st_mode & stat.S_IWGRP:
        folder.chmod(stat.S_IMODE(status.st_mode) & ~stat.S_IWGRP)


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
