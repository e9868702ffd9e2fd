"""Bytes made wrong in the ways that break parsers: flipped, cut, repeated, swapped, at the ends of their range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_NUMBERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**63 - 1, 2**63)
_WORDS = tuple(
    word.encode()
    for word in (
        "", "-1", "0", "nan", "NaN", "inf", "-inf", "1e999", "9" * 40, "1" * 400, "\0", "\n", ",", ";", '"', "'",
        "[", "{", "&a", "*a", "<<: *a", "../" * 8, "/dev/zero", "%s%n", "=cmd", "é", "\ufeff", "- " * 80, ": ",
    )
)  # fmt: skip


def mutated(seed: bytes, random: np.random.Generator, others: Sequence[bytes] = ()) -> bytes:
    """One to eight changes to a seed, or to a part of it joined to a part of another one."""
    data = bytearray(seed)
    if others and random.random() < 0.1:
        other = others[int(random.integers(len(others)))]
        data = data[: int(random.integers(len(data) + 1))] + other[int(random.integers(len(other) + 1)) :]
    for _ in range(1 << int(random.integers(4))):
        at = int(random.integers(len(data) + 1))
        kind = int(random.integers(9))
        if kind == 0 and at < len(data):
            data[at] ^= 1 << int(random.integers(8))
        elif kind == 1 and at < len(data):
            data[at] = int(random.integers(256))
        elif kind == 2:
            del data[at : at + int(random.integers(1, 40))]
        elif kind == 3:
            data[at:at] = data[at : at + int(random.integers(1, 200))] * int(random.integers(1, 4))
        elif kind == 4:
            number = _NUMBERS[int(random.integers(len(_NUMBERS)))]
            width = int(random.choice([1, 2, 4, 8]))
            order = "little" if random.random() < 0.7 else "big"
            data[at : at + width] = (number & ((1 << 8 * width) - 1)).to_bytes(width, order)  # type: ignore[arg-type]
        elif kind == 5:
            data[at:at] = _WORDS[int(random.integers(len(_WORDS)))]
        elif kind == 6:
            data[at:at] = random.bytes(int(random.integers(1, 30)))
        elif kind == 7 and len(data) > 1:
            del data[at:]
        elif kind == 8 and len(data) > 40:
            length = int(random.integers(1, 20))
            other_at = int(random.integers(len(data) - length))
            data[at : at + length] = data[other_at : other_at + length]
    return bytes(data)
