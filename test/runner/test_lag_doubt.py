"""What lags of sensors may do to an estimate, doubted as far as a lane change shows it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.runner.lag_doubt import TURN, LagDoubt

Array = NDArray[np.float64]
PAIR = (0, 1)


@dataclass(frozen=True)
class Turning:
    """A sensor of a lane change from 3 to 7 s with 0.3 rad/s at most, up to a time `until` [s], with stamps that are
    `late` [s]; it measures by a `share` more."""

    until: float
    late: float = 0.0
    share: float = 0.0
    period: float = 0.01

    @property
    def rows(self) -> Array:
        return np.array([[0.0, 0.0, 0.0, 0.0]] * 2 + [[self.until, 0.0, 0.0, 0.0]])

    def rates(self, times: Array, span: float) -> Array:
        t = np.clip(times - self.late - 3.0, 0.0, 4.0)
        turning = (1 + self.share) * 0.3 * np.sin(0.5 * np.pi * t) * np.sin(0.25 * np.pi * t) ** 2
        return np.array([turning, np.zeros_like(times)])


def doubts(late: float = 0.0, share: float = 0.0) -> list[float]:
    """Doubt about the lag of two sensors by how they turn [s], twice a second for 10 s."""
    doubt = LagDoubt({(PAIR, TURN): 0.03, (PAIR, 1): 0.07})
    lags = []
    for until in np.arange(0.5, 10.0, 0.5):
        doubt.compare({0: Turning(until), 1: Turning(until, late, share)}, {})
        lags.append(doubt.lags[TURN])
    return lags


def test_a_sensor_that_shows_more_of_a_turn_is_not_doubted_to_be_late() -> None:
    assert max(doubts(share=0.2)) < 0.01


def test_a_sensor_that_is_late_is_doubted_however_much_of_a_turn_it_shows() -> None:
    for share in (0.0, 0.2):
        assert 0.1 < max(doubts(late=0.15, share=share)) < 0.2
        assert doubts(late=0.15, share=share)[-1] > 0.1
