"""What a filter may start from, a finite mean and a covariance that is one, and whether errors of its state add up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from systems import YawKkf
from vsense_ros.errors import InputError
from vsense_ros.estimation.gaussian import check_belief
from vsense_ros.estimation.state_space import Named

MEAN, COVARIANCE = np.array([1.0, -2.0]), np.array([[2.0, 0.5], [0.5, 1.0]])


def test_a_mean_and_a_covariance_are_accepted() -> None:
    check_belief(MEAN, COVARIANCE, 2, 2)
    check_belief(MEAN, 0 * COVARIANCE, 2, 2)  # of a state that is known


@pytest.mark.parametrize(
    ("mean", "covariance", "words"),
    [
        (np.array([1.0, np.nan]), COVARIANCE, "finite"),
        (MEAN, np.array([[np.inf, 0.5], [0.5, 1.0]]), "finite"),
        (MEAN[:1], COVARIANCE, "shape"),
        (MEAN, COVARIANCE[:1, :1], "shape"),
        (MEAN, np.array([[2.0, 0.5], [0.4, 1.0]]), "symmetric"),
        (MEAN, np.array([[2.0, 0.0], [0.0, -1.0]]), "not below zero"),
    ],
)
def test_each_defect_alone_is_refused_in_words(mean: np.ndarray, covariance: np.ndarray, words: str) -> None:
    with pytest.raises(InputError, match=words):
        check_belief(mean, covariance, 2, 2)


class Turned(YawKkf):
    """A heading whose error is added in another way."""

    def retract(self, x: Named, delta: Any) -> Any:
        return [x.yaw + delta[0], x.gyro_bias + delta[1]]


class Apart(YawKkf):
    """A heading whose differences are taken in another way."""

    def difference(self, y: Named, x: Named) -> Any:
        return [y.yaw - x.yaw, y.gyro_bias - x.gyro_bias]


def test_a_state_is_flat_only_if_neither_sum_nor_difference_is_its_own() -> None:
    assert YawKkf().is_flat
    assert not Turned().is_flat
    assert not Apart().is_flat
