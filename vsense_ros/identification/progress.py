"""How much of a long job is done."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float], None]  # takes the share that is done


def part(progress: Progress | None, index: int, count: int) -> Progress | None:
    """What one of `count` equal parts of a job reports its own share to."""
    return None if progress is None else lambda share: progress((index + share) / count)
