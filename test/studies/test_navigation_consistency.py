"""Scores of how true a stated standard deviation is."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from studies.navigation_consistency import Score, summary


def test_errors_of_the_stated_size_have_a_nees_of_one_and_are_within_three_deviations_as_often_as_normal_numbers() -> (
    None
):
    deviation = np.linspace(0.1, 2.0, 100_000)
    score = Score.of(deviation * np.random.default_rng(0).standard_normal(deviation.size), deviation)
    assert score.nees == pytest.approx(1.0, abs=0.02)
    assert score.share == pytest.approx(100 * (norm.cdf(3.0) - norm.cdf(-3.0)), abs=0.1)


def test_what_a_filter_says_it_does_not_know_is_not_counted() -> None:
    assert Score.of(np.array([1.0, 5.0, np.nan]), np.array([1.0, np.inf, 1.0])) == Score(1, 1, 1.0)


def test_drives_count_by_their_estimates() -> None:
    drives = {"a": {"yaw": Score(100, 100, 50.0)}, "b": {"yaw": Score(300, 150, 750.0)}}
    assert summary({"one": drives}) == {"one": {"yaw": {"within_3s": 62.5, "nees": 2.0}}}
