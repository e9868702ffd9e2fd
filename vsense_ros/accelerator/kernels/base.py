"""The interface of a kernel."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Words = NDArray[np.uint32]


class Kernel(ABC):
    """A computation with a fixed number of words in and out.

    `number` names it in a frame, `top` is its module in `hw/rtl`, `parameters` those that it is built with there, and
    `variants` others of the same function, from the fewest resources to the fewest clocks.
    """

    name: str
    number: int
    top: str
    words_in: int
    words_out: int
    size: int  # n of a frame: rows of a matrix, or 0
    parameters: dict[str, int]
    variants: dict[str, dict[str, int]]
    table_words: int = 0  # of coefficients that are sent once

    @abstractmethod
    def run(self, words: Words, table: Words | None = None) -> tuple[Words, NDArray[np.bool_]]:
        """What the hardware gives for requests (…, words_in): results (…, words_out), and whether each is refused."""

    @abstractmethod
    def cycles(self, **parameters: Any) -> int:
        """Clocks from the last word that comes to the last result, for `parameters` or another variant's."""
