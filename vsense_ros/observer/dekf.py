"""EKF in discrete form over the whole state, a reference for the errorEKF (Rodríguez 2020, "Kalman filters based on MB
dynamics")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.observer.kalman import DYNAMIC, FORCE, GAIN_COLUMNS, SURROUND, Q, U
from vsense_ros.observer.whole_state import WholeState

Array = NDArray[np.float64]


class Dekf(WholeState):
    """Written as in a textbook, with full matrices."""

    def predict(self, h: float) -> None:
        self._move_effects(h)
        self._kalman.transition(h)
        self._kinematics.call()
        self._advance.call()
        f = self._transition(h)
        moved = f @ self.covariance[self._block] @ f.T + np.diag(self.noise(h))
        self.covariance[self._block] = 0.5 * (moved + moved.T)
        self.state[Q], self.state[U] = self._advance.results[0][:, 0], self._advance.results[1][:, 0]
        self._relax(self.state[FORCE.start :], self._process(h))

    def _transition(self, h: float) -> Array:
        """(k, k) derivative of the state after a step by that before it."""
        f = np.eye(self.layout.size)
        f[U] = 0.0
        f[U, GAIN_COLUMNS] = self._kalman.gain
        by_angles, by_velocity = self._kinematics.results
        f[:6, 3:6] += h * by_angles
        f[:6] += h * by_velocity @ f[14:20]
        f[6:14] += h * f[20:28]
        f[FORCE.start :, FORCE.start :] = np.diag(self._process(h).decay)
        return f[self._block]

    def expect(self, index: int) -> tuple[Array, Array, Array]:
        sense = self._sense[index]
        assert sense is not None, "inputs have no innovation"
        sense.call()
        expected, by_q, by_u, by_udot, by_surroundings = sense.results
        _, udot_by_q, udot_by_u, udot_by_surroundings, _ = self._linearize.results
        h = np.zeros((len(expected), self.layout.size))
        h[:, Q], h[:, U], h[:, SURROUND] = by_q, by_u, by_surroundings
        h[:, DYNAMIC] += by_udot @ udot_by_q
        h[:, U] += by_udot @ udot_by_u
        h[:, SURROUND] += by_udot @ udot_by_surroundings
        biases = self.layout.biases[index]
        h[:, biases] += np.eye(len(expected))[:, : biases.stop - biases.start]
        h = h[:, self.kept]
        across = self.covariance[self._block] @ h.T
        return expected[:, 0], across, h @ across
