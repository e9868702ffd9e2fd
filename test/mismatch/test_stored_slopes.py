"""Slopes that are kept in a file are those that were computed, and a search holds them in no memory."""

from __future__ import annotations

import tempfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.mismatch.stored_slopes import StoredSlopes, stored

BLOCKS = st.lists(
    st.tuples(st.integers(0, 5), st.integers(0, 4)).flatmap(
        lambda shape: arrays(np.float32, shape, elements=st.floats(width=32))
    ),
    max_size=4,
)


@given(BLOCKS)
def test_what_is_read_is_what_was_stored_block_by_block(blocks: list[np.ndarray]) -> None:
    kept = StoredSlopes(blocks)
    assert len(kept) == len(blocks)
    for i in [*range(len(blocks)), *range(-len(blocks), 0)]:
        np.testing.assert_array_equal(kept[i], blocks[i])
    assert [block.shape for block in kept[1:]] == [block.shape for block in blocks[1:]]
    with pytest.raises(IndexError):
        kept[len(blocks)]


def test_a_transposed_block_keeps_its_places() -> None:
    block = np.arange(6, dtype=np.float32).reshape(2, 3)
    np.testing.assert_array_equal(StoredSlopes([block.T])[0], block.T)


def test_small_slopes_stay_where_they_are_and_large_ones_do_too_where_there_is_no_room(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    small, large = [np.ones((3, 2), np.float32)], [np.ones((EFFORT.stored_from, 1), np.float32)]
    assert stored(small) is small
    assert isinstance(stored(large), StoredSlopes)

    def full(**_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", full)
    assert stored(large) is large
