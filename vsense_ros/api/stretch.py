"""A recording, or a part of it, as a user writes it: `lap.mcap@207:310`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vsense_ros.errors import InputError


@dataclass(frozen=True)
class Stretch:
    """A recording, or the part of it from one time to another [s since its first stamp]."""

    path: Path
    begin: float | None = None
    end: float | None = None

    @classmethod
    def parse(cls, text: str | Path) -> Stretch:
        """Read `recording`, or `recording@from:to` in seconds since its first stamp, of which either may be left out.

        A path that exists is taken as it is, whatever is in its name. Raises `InputError` for limits that are none.
        """
        path, separator, limits = str(text).rpartition("@")
        begin, colon, end = limits.partition(":")
        if Path(text).exists() or not separator or not colon:
            return cls(Path(text))
        try:
            first, last = (float(part) if part else None for part in (begin, end))
        except ValueError:
            raise InputError(f"{text}: expected recording@from:to in seconds, found {limits!r}") from None
        if first is not None and last is not None and first >= last:
            raise InputError(f"{text}: it ends before it begins")
        return cls(Path(path), first, last)

    @property
    def name(self) -> str:
        """Name of the file."""
        return self.path.name

    @property
    def limits(self) -> str:
        """Limits as a user writes them behind the path, such as `@207:310`; empty for the whole recording."""
        if self.begin is None and self.end is None:
            return ""
        return f"@{'' if self.begin is None else f'{self.begin:g}'}:{'' if self.end is None else f'{self.end:g}'}"


def distinct_names(stretches: Sequence[Stretch]) -> dict[Path, str]:
    """Names that begin with the folder, for recordings whose names are the same without it."""
    files = [stretch.path for stretch in stretches]
    files_by_name = Counter(path.stem for path in {path.resolve() for path in files})
    return {
        path: f"{path.resolve().parent.name}/{path.name}" for path in files if files_by_name[path.resolve().stem] > 1
    }
