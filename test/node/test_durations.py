"""Percentiles of durations, beside NumPy's of all of them."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.node.durations import Durations


@given(st.lists(st.floats(2e-6, 900.0), min_size=1, max_size=300), st.sampled_from([50, 90, 99, 99.9]))
def test_a_percentile_is_right_to_a_percent(seconds: list[float], percent: float) -> None:
    found = Durations()
    for one in seconds:
        found.add(one)
    expected = float(np.percentile(seconds, percent, method="inverted_cdf"))
    assert found.percentile(percent) == pytest.approx(expected, rel=0.011)


def test_what_cannot_be_is_counted_as_shortest_or_longest() -> None:
    found = Durations()
    assert np.isnan(found.percentile(50))
    for one in (-1.0, 0.0, 1e-9, 1e6):
        found.add(one)
    assert found.count == 4
    assert found.percentile(50) <= 1e-6
    assert found.percentile(99.9) == pytest.approx(1e3, rel=0.05)


def test_a_million_of_them_take_no_more_memory_than_one() -> None:
    found = Durations()
    found.add(1e-3)
    before = sys.getsizeof(found._counts)
    for _ in range(1_000_000):
        found.add(1e-3)
    assert sys.getsizeof(found._counts) == before
