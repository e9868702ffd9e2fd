"""Columns that grow hold the same numbers, in memory or on the disk; an order of arrival may be made piece by piece."""

from pathlib import Path

import numpy as np
import pytest

from vsense_ros.errors import InputError
from vsense_ros.messages import growing
from vsense_ros.messages.growing import GROWING, Growing
from vsense_ros.messages.recording import by_arrival


def test_a_column_that_outgrows_memory_is_a_map_of_all_its_rows_on_the_disk():
    rows = np.random.default_rng(0).normal(size=(2 * GROWING.in_memory // 8 // 3, 3))
    long, short = Growing(), Growing()
    for begin in range(0, len(rows), 10_000):
        long.add(rows[begin : begin + 10_000, ::-1])
    for row in rows[:3]:
        short.add(row[None])
    assert isinstance(long.column(), np.memmap)
    np.testing.assert_array_equal(long.column(), rows[:, ::-1])
    np.testing.assert_array_equal(short.column(), rows[:3])


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_is_said_in_a_sentence(monkeypatch):
    with Path("/dev/full").open("r+b", buffering=0) as full:
        monkeypatch.setattr(growing, "TemporaryFile", lambda: full)
        with pytest.raises(InputError, match="no room for a long recording's estimates"):
            Growing().add(np.zeros((GROWING.in_memory // 8 + 1, 1)))


def test_an_order_of_arrival_made_in_pieces_is_that_of_all_at_once_with_ties_in_the_order_of_the_streams():
    noise = np.random.default_rng(1)
    received = [np.sort(noise.integers(0, 60, count)) for count in (200, 0, 31, 7)]
    expected = [(time, place) for place, times in enumerate(received) for time in times.tolist()]
    for at_once in (1, 3, 50, 1000):
        streams = [iter([(time, place) for time in times.tolist()]) for place, times in enumerate(received)]
        assert list(by_arrival(received, streams, at_once)) == sorted(expected)
