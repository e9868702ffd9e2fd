"""Bytes of a serial sensor with their times of arrival, as a text file: one `<time [ns]> <hex>` a line."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from vsense_ros.errors import InputError


def write_byte_log(path: str | Path, entries: Iterable[tuple[int, bytes]]) -> None:
    """Write times [ns] and bytes."""
    with Path(path).open("w", encoding="ascii") as file:
        file.writelines(f"{time} {data.hex()}\n" for time, data in entries)


def read_byte_log(path: str | Path) -> list[tuple[int, bytes]]:
    """Times [ns] and bytes; `InputError` names the line that is neither."""
    entries = []
    try:
        lines = Path(path).read_text(encoding="ascii").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as a byte log: {error}") from None
    for number, line in enumerate(lines, 1):
        time, _, data = line.partition(" ")
        try:
            entries.append((int(time), bytes.fromhex(data)))
        except ValueError:
            raise InputError(f"{path}, line {number}: expected '<time in ns> <hex>', found {line[:40]!r}") from None
    return entries
