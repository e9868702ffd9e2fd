"""By which angle the velocities of a sensor differ from those that a filter expects: how wrong its heading is."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TurnSettings:
    """When refused velocities show that a heading is wrong: decisions of this project."""

    fewest: int = 5  # [-] velocities, which have to differ from what was expected by one angle,
    least: float = 0.1  # [rad] at least, and
    scatter: float = 0.2  # [-] of it between them at most
    deviation: float = 0.05  # [rad] of the heading, at least, once it is turned by that
    slowest: float = 2.0  # [m/s] of a velocity that shows a direction


TURN = TurnSettings()


class Turns:
    """The angles between the newest refused velocities of one sensor and what was expected of them."""

    def __init__(self) -> None:
        self._newest: deque[float] = deque(maxlen=2 * TURN.fewest)  # [rad] counterclockwise

    def add(self, measured: Array, expected: Array) -> None:
        """Take in a refused velocity east and north (2,) and the expected one [m/s]."""
        if np.minimum(np.hypot(*measured), np.hypot(*expected)) >= TURN.slowest:
            self._newest.append(float(np.angle(complex(*measured) / complex(*expected))))

    def of_all(self) -> tuple[float, float] | None:
        """The angle by which all of them are turned and its standard deviation [rad]; None where they do not agree on
        one."""
        if len(self._newest) < TURN.fewest:
            return None
        angle = float(np.median(self._newest))
        scatter = float(np.median(np.abs(np.array(self._newest) - angle)))
        if abs(angle) < TURN.least or scatter > TURN.scatter * abs(angle):
            return None
        return angle, max(scatter, TURN.deviation)
