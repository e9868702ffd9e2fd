"""The guard of a filter: a state that no car can have is not published, and the filter goes back to one that it can.

A filter diverges where what it is given contradicts its model for good, as the recording of a car without steering
angle does. It then goes on with numbers that are finite and mean nothing. Six signs are looked for: a car that lies on
its side, a road that is steeper than roads are, a speed that is not known, a covariance that is none, forces that stay
the same, bit by bit, while the car moves, and tyres that carry nothing for longer than a car flies. After the first
sign the filter goes on from its last good state; after several in a row it is given up, which is an error, and starts
anew later.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import degrees, radians
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Filter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GuardSettings:
    """Limits beyond which a filter has diverged: decisions of this project."""

    largest_tilt: float = radians(60)  # [rad] of roll and pitch on the map: a car that leans so far has rolled over
    # [rad] of grade and bank: the steepest street has 19°; more where the vehicle file gives its roads so much, namely
    steepest_road: float = radians(25)
    road_deviations: float = 8.0  # [-] of the standard deviations there
    looks_until_steep: int = 10  # [-] in which the road was steeper
    largest_speed_deviation: float = 10.0  # [m/s] beyond which a speed is not known
    settling: float = 5.0  # [s] from the start on in which the speed need not be known
    # [-] least eigenvalue of the correlation matrix of the errors; rounding makes it 1e-9 at most
    least_eigenvalue: float = -1e-5
    moving: float = 1.0  # [m/s] above which forces change from one look to the next
    between_looks: float = 0.1  # [s]
    looks_until_frozen: int = 10  # [-] in which nothing changed
    least_load: float = 0.02  # [-] of the car's weight, below which no tyre touches the road
    looks_until_weightless: int = 6  # [-] in which none did
    looks_between_covariances: int = 10  # [-] the eigenvalues of a covariance take as long as ten steps
    good_share: float = 0.5  # [-] of the limits, up to which a state is kept to go back to
    most_recoveries: int = 5  # [-] after which the filter is given up, within
    recoveries_within: float = 60.0  # [s]
    pause: float = 5.0  # [s] after a filter was given up, before it starts anew


GUARD = GuardSettings()


class Vitals(NamedTuple):
    """What the guard looks at of one state: the larger of roll and pitch on the map [rad], the larger of grade and bank
    of the road over the largest that can be [-], speed and its standard deviation [m/s], the share of the car's weight
    that its tyres carry [-], and groups of numbers none of which can all stay the same while the car moves; NaN where a
    filter has no such thing."""

    tilt: float
    steepness: float
    speed: float
    speed_deviation: float
    load: float
    changing: tuple[Array, ...]


class Guard:
    """Watches one filter; `failures` are the sentences of all times when it was given up, with their stamps [ns]."""

    def __init__(self, filter: Filter) -> None:
        self._filter = filter
        self._good = filter.backup().memory
        self._good_stamp: int | None = None
        self._recoveries: deque[int] = deque(maxlen=GUARD.most_recoveries)
        self._started = self._looked = self._looks = self._same = self._steep = self._weightless = 0
        self._changing: list[bytes] = []
        self.failures: list[tuple[int, str]] = []

    def begin(self, stamp: int) -> None:
        """The filter starts, at a time [ns]."""
        self._good_stamp = None
        self._recoveries.clear()
        self._started = self._looked = stamp
        self._looks = self._same = self._steep = self._weightless = 0

    def due(self, stamp: int) -> bool:
        """True if it is time to look."""
        return not 0 <= stamp - self._looked < GUARD.between_looks * 1e9

    def look(self, stamp: int, vitals: Vitals) -> str:
        """What shows that the filter has diverged, in words; empty for nothing. A good state is kept."""
        self._looked = stamp
        self._looks += 1
        wrong = self._wrong(stamp, vitals)
        shares = (
            vitals.tilt / GUARD.largest_tilt,
            vitals.steepness,
            vitals.speed_deviation / GUARD.largest_speed_deviation,
        )
        doubtful = wrong or self._same or self._weightless
        if not doubtful and not any(share > GUARD.good_share for share in shares):
            self._good[:] = self._filter.memory
            self._good_stamp = stamp
        return wrong

    def _wrong(self, stamp: int, vitals: Vitals) -> str:
        if vitals.tilt > GUARD.largest_tilt:
            return (
                f"the car would lean by {degrees(vitals.tilt):.0f}°, where {degrees(GUARD.largest_tilt):.0f}° is the "
                "most that a car can"
            )
        self._steep = self._steep + 1 if vitals.steepness > 1 else 0
        if self._steep >= GUARD.looks_until_steep:
            return f"the road would be {vitals.steepness:.1f} times as steep as roads are"
        settled = stamp - self._started > GUARD.settling * 1e9
        if settled and vitals.speed_deviation > GUARD.largest_speed_deviation:
            return (
                f"the speed is only known to {vitals.speed_deviation:.3g} m/s, where "
                f"{GUARD.largest_speed_deviation:g} m/s is the limit"
            )
        moving = abs(vitals.speed) > GUARD.moving
        before, self._changing = self._changing, [group.tobytes() for group in vitals.changing]
        same = any(one == other for one, other in zip(before, self._changing, strict=False))
        self._same = self._same + 1 if same and moving else 0
        if self._same >= GUARD.looks_until_frozen:
            return f"forces have not changed for {self._same * GUARD.between_looks:.1f} s at {vitals.speed:.1f} m/s"
        self._weightless = self._weightless + 1 if vitals.load < GUARD.least_load and moving else 0
        if self._weightless >= GUARD.looks_until_weightless:
            return (
                f"no tyre would have touched the road for {self._weightless * GUARD.between_looks:.1f} s at "
                f"{vitals.speed:.1f} m/s"
            )
        if self._looks % GUARD.looks_between_covariances == 0 and not is_covariance(self._filter.belief().covariance):
            return "the covariance of its errors is not positive definite any more"
        return ""

    def recovered(self, stamp: int) -> bool:
        """Count that the filter had to go back; False if that was once too often, and it is to be given up."""
        self._recoveries.append(stamp)
        many = len(self._recoveries) == GUARD.most_recoveries
        return not (many and 0 <= stamp - self._recoveries[0] < GUARD.recoveries_within * 1e9)

    def restore(self, stamp: int) -> float | None:
        """Put the last good state back, with less trust in it; how old it is [s]. None if there is none."""
        if self._good_stamp is None:
            return None
        self._filter.memory[:] = self._good
        self._filter.inflate()
        self._same = self._steep = self._weightless = 0
        return max(stamp - self._good_stamp, 0) * 1e-9

    def give_up(self, stamp: int, why: str) -> None:
        """The filter is stopped."""
        self.failures.append((stamp, why))

    def pausing(self, stamp: int) -> bool:
        """True while a filter that was given up does not start yet."""
        return bool(self.failures) and 0 <= stamp - self.failures[-1][0] < GUARD.pause * 1e9


def is_covariance(covariance: Array) -> bool:
    """True if a matrix (n, n) is finite and positive semidefinite, but for rounding."""
    deviation = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    if not np.isfinite(covariance).all() or np.any(covariance.diagonal() < 0):
        return False
    some = deviation > 0
    correlation = covariance[np.ix_(some, some)] / np.outer(deviation[some], deviation[some])
    correlation[np.diag_indices_from(correlation)] -= GUARD.least_eigenvalue
    try:
        np.linalg.cholesky(correlation)
    except np.linalg.LinAlgError:
        return False
    return True
