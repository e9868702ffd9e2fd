"""EKF in discrete form over the whole state, a reference for the errorEKF (Rodríguez 2020, "Kalman filters based on MB
dynamics").

Coordinates, velocities, disturbances and biases are estimated; the forces stay zero, as their covariance is. What the
model lacks enters as white noise on the accelerations, as strong as the errorEKF's correlated forces are at low
frequency.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Gaussian
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.state import FORCE, U

Array = NDArray[np.float64]


class WholeCar(CarBlocks):
    """The car without forces beyond the model's, with full matrices."""

    in_blocks = False

    def rolling(self, speed: float) -> Gaussian:
        belief = super().rolling(speed)
        belief.covariance[FORCE, FORCE] = 0.0
        return belief

    def noise(self, h: float, slow: Array) -> Array:
        """Variances (n - 14,) that `h` [s] add to the velocities and to what comes behind them, which is `slow`
        (n - 28,): 2 σ² τ h on a velocity for a force of deviation σ and correlation time τ."""
        added = np.zeros(self.layout.size)
        added[U] = 2 * self.prior.deviation[FORCE] ** 2 / self.prior.rate[FORCE] * h
        added[FORCE.start :] = slow
        added[FORCE] = 0.0
        return added[U.start :]

    def propagate(self, f: Array, noise: Array) -> None:
        super().propagate(f, self.noise(float(self.h[0]), noise))

    def share_torques(self, shared: Array) -> None:
        """Errors of the wheels' torques are noise of the velocities here, and independent."""

    def retract(self, error: Array) -> None:
        super().retract(error)
        self.linearize()  # what the next sensor is compared with
