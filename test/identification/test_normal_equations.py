"""Normal equations against least squares on all rows."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros.identification.free_parameter import FreeParameter, added
from vsense_ros.identification.least_squares import Fit
from vsense_ros.identification.parameter_set import ParameterSet

WEIGHT = 3.0  # of a free parameter that is one deviation off


def drawn(seed: int, free_parameters: int = 4, blocks: int = 5) -> Fit:
    """A fit with random slopes and residuals, and blocks of different lengths."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(10, 40, blocks)
    names = [f"unknown {i}" for i in range(free_parameters)]
    every = tuple(FreeParameter(name, "-", float(rng.uniform(0.5, 2)), -9.0, 9.0, added(name)) for name in names)
    return Fit(
        ParameterSet({}), every, rng.normal(size=free_parameters), [rng.normal(size=n) for n in rows],
        [rng.normal(size=(n, free_parameters)) for n in rows], WEIGHT,
    )  # fmt: skip


def stacked(at: Fit, blocks: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """A matrix and a right side whose least squares are the change that fits some blocks."""
    unit = np.sqrt(at.weight) * np.eye(len(at.free_parameters))
    matrix = np.vstack([*(at.slopes[i] for i in blocks), unit])
    return matrix, -np.concatenate([*(at.residuals[i] for i in blocks), unit @ at.scaled_offsets])


@given(st.integers(0, 10_000))
def test_the_change_of_least_value_is_that_of_least_squares_on_all_rows(seed):
    at = drawn(seed)
    everything = list(range(len(at.residuals)))
    matrix, right = stacked(at, everything)
    expected, *_ = np.linalg.lstsq(matrix, right)
    assert_allclose(at.equations.change(), expected, rtol=1e-9, atol=1e-9)
    left = matrix @ expected - right
    assert at.equations.values(expected).sum() == pytest.approx(left @ left)
    assert at.equations.values().sum() == pytest.approx(at.value)


@given(st.integers(0, 10_000), st.sets(st.integers(0, 4), min_size=1, max_size=4))
def test_a_group_of_blocks_is_judged_by_what_fits_the_others(seed, group):
    at = drawn(seed)
    rest = [i for i in range(len(at.residuals)) if i not in group]
    change, *_ = np.linalg.lstsq(*stacked(at, rest))
    off = np.concatenate([at.residuals[i] + at.slopes[i] @ change for i in group])
    share = len(off) / sum(map(len, at.residuals))
    expected = off @ off + share * at.weight * np.sum((at.scaled_offsets + change) ** 2)
    assert at.equations.out_of_sample(sorted(group)) == pytest.approx(expected)


@given(st.integers(0, 10_000))
def test_the_independent_share_of_a_parameter_is_what_the_others_cannot_stand_in_for(seed):
    at = drawn(seed)
    *others, new = at.free_parameters
    rows = np.vstack(at.slopes)
    matrix = np.vstack([rows[:, :-1], np.sqrt(at.weight) * np.eye(len(others))])
    signature = np.append(rows[:, -1], np.zeros(len(others)))
    change, *_ = np.linalg.lstsq(matrix, signature)
    left = rows[:, -1] - rows[:, :-1] @ change
    assert at.equations.independent_share([new]) == pytest.approx(np.linalg.norm(left) / np.linalg.norm(rows[:, -1]))
    assert at.equations.only(range(len(others))).independent_share([new]) == 0.0
