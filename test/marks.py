"""Which tests run when: fast and slow ones in `make test`, those marked `exam` in `make exam` alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def exam_except(values: Iterable[Any], *kept: Any) -> list[Any]:
    """Parameters of a test of which `make test` takes only those in `kept`, and `make exam` the others.

    `ValueError` if one of `kept` is not among the values, so that a renamed parameter is not silently left out.
    """
    values = list(values)
    if unknown := [value for value in kept if value not in values]:
        raise ValueError(f"{unknown} not among the parameters {values}")
    return [value if value in kept else pytest.param(*_parts(value), marks=pytest.mark.exam) for value in values]


def _parts(value: Any) -> tuple[Any, ...]:
    """Several arguments of a test stand in a tuple."""
    return value if isinstance(value, tuple) else (value,)
