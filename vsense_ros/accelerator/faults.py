"""Faults that are put into the accelerator on purpose, to see that nothing bad comes of them."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, fields

import numpy as np

from vsense_ros.errors import InputError


@dataclass(frozen=True)
class Faults:
    """How likely each is in a response, 0 to 1, and by how much an answer is late where one is."""

    drop: float = 0.0  # no answer
    delay: float = 0.0  # it comes `delay_ms` later
    delay_ms: float = 10.0
    bit_flip: float = 0.0  # one bit on the way
    stuck: float = 0.0  # the result of the request before
    repeat: float = 0.0  # the answer comes twice
    wrong_sequence: float = 0.0
    wrong_sender: float = 0.0  # the number of another observer
    nan: float = 0.0  # one word is a NaN
    silent_error: float = 0.0  # one word is wrong, under a good checksum
    error_status: float = 0.0

    @classmethod
    def of(cls, text: str) -> Faults:
        """From text as `drop: 0.01, delay_ms: 20`. Raises `InputError` for what is no fault or no probability."""
        values: dict[str, float] = {}
        known = [f.name for f in fields(cls)]
        for part in filter(None, (p.strip() for p in text.split(","))):
            name, _, number = (x.strip() for x in part.partition(":"))
            try:
                value = float(number)
            except ValueError:
                raise InputError(f"faults: expected 'name: number', found {part!r}") from None
            if name not in known:
                raise InputError(f"faults: no fault {name!r}; there are {', '.join(known)}")
            if not 0 <= value <= (np.inf if name == "delay_ms" else 1) or value == np.inf:
                raise InputError(f"faults: {name} must be from 0 to 1 (delay_ms: not negative), found {number}")
            values[name] = value
        return cls(**values)

    @property
    def any(self) -> bool:
        return any(getattr(self, f.name) > 0 for f in fields(self) if f.name != "delay_ms")


class Chance:
    """Draws which faults happen, always the same for one seed, and counts them."""

    def __init__(self, faults: Faults, seed: int = 0) -> None:
        self.faults, self.random = faults, np.random.default_rng(seed)
        self.happened: Counter[str] = Counter()

    def strikes(self, name: str) -> bool:
        probability = getattr(self.faults, name)
        if probability <= 0 or self.random.random() >= probability:
            return False
        self.happened[name] += 1
        return True
