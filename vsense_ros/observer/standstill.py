"""Where a car stands, or was first seen, whose heading is not known yet.

Until the car moves, GNSS says where the antenna is, and nothing says on which side of it the centre of gravity lies.
Many positions at one place are worth more than the last of them; they are taken for independent, as the filter does.
Where only positions know north, the way from there gives the heading: the filter knows it but for a turn.
"""

from __future__ import annotations

from cmath import exp, phase
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StandstillSettings:
    """Settings of the heading by the way from standstill: decisions of this project."""

    least_deviations: float = 10.0  # that a way must be longer than the deviation of its ends to give a heading
    shortest_way: float = 2.0  # [m] of a way that gives a heading
    length_error: float = 0.3  # [-] of a way, beyond which one of its ends is wrong
    way_error: float = 0.1  # [-] of the way from standstill to where the heading is estimated
    heading_error: float = 0.05  # [rad] of the heading of a way with exact ends


STANDSTILL = StandstillSettings()


class Standstill:
    """The mean of the positions since the car stopped, each weighted by what it is worth."""

    def __init__(self) -> None:
        self._precision = 0.0  # [1/m²]
        self._antenna = self._arm = 0j  # in the map, and seen from cog: x + i y [m]
        self._yaw = 0.0  # that the filter had meanwhile [rad]
        self._left = False

    @property
    def known(self) -> bool:
        """True if the car has stood since the start."""
        return self._precision > 0

    @property
    def antenna(self) -> Array:
        """Mean in the map, (2,) [m]."""
        return np.array([self._antenna.real, self._antenna.imag])

    def add(self, position: Array, variance: Array, mounting: Array, yaw: float) -> None:
        """Take in a position (2,) [m] of an antenna at `mounting` (3,) [m], if it is one; `yaw` [rad] is the filter's.
        A stop at another place begins a new mean."""
        if not np.isfinite(position).all():
            return
        if self._left:
            self._precision, self._left = 0.0, False
        precision = 1 / float(variance.max())
        self._precision += precision
        self._antenna += (complex(*position) - self._antenna) * precision / self._precision
        self._arm, self._yaw = complex(*mounting[:2]), yaw

    def leave(self) -> None:
        """Note that the car moves."""
        self._left = True

    def heading(self, position: Array, was: float, antenna: Array, variance: Array) -> tuple[float, float] | None:
        """Yaw [rad] where the filter has `was` and its standard deviation, if the way that it has driven to `position`
        (2,) is long enough; `antenna` (2,) [m] with its `variance` (2,) is where that way ends in the map."""
        if not self.known:
            return None
        driven = complex(*position) - self._antenna + self._arm * (exp(1j * was) - exp(1j * self._yaw))
        displacement = complex(*antenna) - self._antenna
        deviation = float(np.sqrt(variance.max() + 1 / self._precision))
        if not abs(displacement) > max(STANDSTILL.least_deviations * deviation, STANDSTILL.shortest_way):
            return None
        if not abs(abs(driven) - abs(displacement)) < STANDSTILL.length_error * abs(displacement):
            return None
        return was + phase(displacement / driven), float(
            np.hypot(STANDSTILL.heading_error, deviation / abs(displacement))
        )

    def place(self, position: Array, was: float, yaw: float) -> tuple[Array, float]:
        """Where cog is in the map (2,) [m] and its standard deviation [m], once the heading is known to be `yaw` where
        the filter had `was` [rad]: the way to the filter's `position` (2,) was driven in another direction."""
        turn = exp(1j * (yaw - was))
        displacement = complex(*position) - self._antenna
        place = self._antenna + turn * (displacement - exp(1j * self._yaw) * self._arm)
        return np.array([place.real, place.imag]), float(
            np.hypot(self._precision**-0.5, STANDSTILL.way_error * abs(displacement))
        )
