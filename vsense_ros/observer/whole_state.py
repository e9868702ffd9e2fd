"""What the two reference observers share: filters of the whole state, without force estimation.

Coordinates, velocities, surroundings and biases are estimated, in the order and the arrays of the errorEKF; the forces
stay zero. What the model lacks enters as white noise on the accelerations, as strong as the errorEKF's correlated
forces are at low frequency.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.kalman import FORCE, U

Array = NDArray[np.float64]


class WholeState(ErrorEkf, ABC):
    """`kept` (k,) are the elements of the state that are estimated."""

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        super().__init__(vehicle, sensors)
        n = self.layout.size
        self.kept = np.r_[0 : FORCE.start, FORCE.stop : n]
        self._block = np.ix_(self.kept, self.kept)

    def start(self, speed: float) -> None:
        super().start(speed)
        self.covariance[FORCE, FORCE] = 0.0

    def noise(self, h: float) -> Array:
        """Variances (k,) that `h` [s] add: 2 σ² τ h on a velocity for a force of deviation σ and correlation time τ."""
        added = np.zeros(self.layout.size)
        added[U] = 2 * self.prior.deviation[FORCE] ** 2 / self.prior.rate[FORCE] * h
        added[FORCE.start :] = self._process(h).noise
        return added[self.kept]

    def correct(self, index: int, value: Array, variance: Array, limit: float, scale: float = 1.0) -> float:
        present = np.isfinite(value)
        if not present.any():
            return -1.0
        expected, across, spread = self.expect(index)
        innovation = (value - expected)[present]
        total = scale * (spread[np.ix_(present, present)] + np.diag(variance[present]))
        across = across[:, present]
        gain = np.linalg.solve(total, across.T).T
        nis = float(innovation @ np.linalg.solve(total, innovation))
        if nis <= limit:
            self.state[self.kept] += gain @ innovation
            left = self.covariance[self._block] - gain @ total @ gain.T
            self.covariance[self._block] = 0.5 * (left + left.T)
            self.linearize()  # what the next sensor is compared with
        return nis

    @abstractmethod
    def expect(self, index: int) -> tuple[Array, Array, Array]:
        """Of a sensor: what it should measure (m,), covariance with the state (k, m), and its own (m, m) without
        noise."""
