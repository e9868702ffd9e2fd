"""asammdf with what it lacks where a file is damaged."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any


def make_asammdf_careful() -> None:
    """Objects of asammdf whose file could not be read fall over when they are dropped: in their destructor, printing a
    traceback, or by looking for an attribute without end. What it has in C reads where a file says, also beyond the
    end of a record, and ends the process there. What it logs of damage beside raising it is for its own users."""
    from asammdf import MDF
    from asammdf.blocks import mdf_v3, mdf_v4

    def drop(self: Any) -> None:
        with suppress(Exception):
            self.close()

    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    for kind in (mdf_v3.MDF3, mdf_v4.MDF4):
        kind.__del__ = drop
    if "_mdf" not in vars(MDF):
        MDF._mdf = None
    for module in (mdf_v3, mdf_v4):
        for name, guarded in _GUARDED.items():
            plain = getattr(module, name, None)
            if plain is not None and not hasattr(plain, "guards"):
                setattr(module, name, guarded(plain))


def _within(record: int, pieces: Iterable[Sequence[int]]) -> None:
    """Raise unless each piece, where it begins and how long it is, lies in a record of so many bytes."""
    from asammdf.blocks.utils import MdfException

    for begin, size, *_ in pieces:
        if record <= 0 or begin < 0 or size < 0 or begin + size > record:
            raise MdfException(f"a channel of {size} bytes at byte {begin} in records of {record} bytes")


def _one(plain: Any) -> Any:
    def get_channel_raw_bytes(data: Any, record_size: int, byte_offset: int, byte_count: int) -> Any:
        _within(record_size, [(byte_offset, byte_count)])
        return plain(data, record_size, byte_offset, byte_count)

    return _guards(get_channel_raw_bytes, plain)


def _several(plain: Any) -> Any:
    def get_channel_raw_bytes_parallel(data: Any, record_size: int, signals: Any, *others: Any) -> Any:
        _within(record_size, signals)
        return plain(data, record_size, signals, *others)

    return _guards(get_channel_raw_bytes_parallel, plain)


def _whole(plain: Any) -> Any:
    def get_channel_raw_bytes_complete(
        blocks: Any, signals: Any, name: str, cycles: int, record_size: int, invalidation_bytes: int, *others: Any
    ) -> Any:
        _within(record_size, signals)
        # Of each a bit that says whether it is valid, behind the record; none where it is negative.
        _within(invalidation_bytes, [(bit // 8, 1) for *_, bit in signals if bit >= 0])
        return plain(blocks, signals, name, cycles, record_size, invalidation_bytes, *others)

    return _guards(get_channel_raw_bytes_complete, plain)


def _invalid(plain: Any) -> Any:
    def get_invalidation_bits_array(data: Any, size: int, bit: int, *others: Any) -> Any:
        _within(size, [(bit // 8, 1)])
        return plain(data, size, bit, *others)

    return _guards(get_invalidation_bits_array, plain)


def _longest(plain: Any) -> Any:
    def get_vlsd_max_sample_size(data: bytes, offsets: Any, count: int) -> Any:
        if count and len(offsets):
            _within(len(data), [(int(offsets.max()), 4)])
        return plain(data, offsets, count)

    return _guards(get_vlsd_max_sample_size, plain)


def _guards(made: Any, plain: Any) -> Any:
    made.guards = plain
    return made


_GUARDED = {
    "get_channel_raw_bytes": _one,
    "get_channel_raw_bytes_parallel": _several,
    "get_channel_raw_bytes_complete": _whole,
    "get_invalidation_bits_array": _invalid,
    "get_vlsd_max_sample_size": _longest,
}
