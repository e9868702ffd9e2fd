"""The extended Kalman filter in error coordinates (Solà 2017); where ⊞ is + it is the textbook's (Jazwinski 1970)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import lapack

from vsense_ros.estimation.filter import Array, Filter, Gaussian, Given, Innovation, Measured, Step
from vsense_ros.estimation.linearised import Linearised


class Ekf(Filter):
    """The filter of any `Linearised` system, by its operations in C where it has them."""

    def __init__(self, system: Linearised) -> None:
        self.system = system
        self.memory, self.mean, self.covariance, self.inputs = (
            system.memory,
            system.mean,
            system.covariance,
            system.inputs,
        )
        self.names, self.sensors = system.names, system.sensors
        self.operations = system.operations

    def start(self, belief: Gaussian) -> None:
        self.system.start(belief)
        self.system.linearize()

    def belief(self) -> Gaussian:
        return Gaussian(self.mean, self.covariance)

    def is_valid(self) -> bool:
        return self.system.is_valid()

    def set_element(self, index: int, value: float, deviation: float) -> None:
        self.mean[index] = value
        self.covariance[index, :] = self.covariance[:, index] = 0.0
        self.covariance[index, index] = deviation**2

    def inflate(self) -> None:
        self.covariance[:] = np.diag(np.clip(np.diag(self.covariance), 1e-12, 1e8) * 4)

    def predict(self, h: float) -> None:
        if self.operations is None:
            self.system.step(h)
        else:
            self.operations.predict(h)

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        if self.operations is None:
            return self._correct(sensor, value, variance, limit, scale)
        nis, m = self.operations.correct(sensor, value, variance, limit, scale), len(value)
        factor = self.operations.factor[: m * m].reshape(m, m)
        return Innovation(self.operations.whitened[:m], factor, nis, 0 <= nis <= limit)

    def _correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> Innovation:
        """P ← P - W Wᵀ with W = P Hᵀ L⁻ᵀ and L Lᵀ = H P Hᵀ + R: symmetric, and a third of Joseph's work."""
        m = len(value)
        innovation, h = self.system.sense(sensor, value)
        present = np.isfinite(innovation)
        whitened, whole = np.full(m, np.nan), np.eye(m)
        if not present.any():
            return Innovation(whitened, whole, -1.0, False)
        h, innovation = h[present], innovation[present]
        across = h.dot(self.covariance)
        total = scale * (across.dot(h.T) + np.diag(variance[present]))
        factor, failed = lapack.dpotrf(total, lower=True)
        if failed:
            return Innovation(whitened, whole, float("nan"), False)
        whitening = lapack.dtrtri(factor, lower=True)[0]
        projected, weights = whitening.dot(across), whitening.dot(innovation)
        whitened[present], whole[np.ix_(present, present)] = weights, factor
        nis = float(weights.dot(weights))
        if not nis <= limit:
            return Innovation(whitened, whole, nis, False)
        self.covariance -= projected.T.dot(projected)
        self.system.retract(weights.dot(projected))
        return Innovation(whitened, whole, nis, True)

    def advance(self, step: Step) -> bool:
        return super().advance(step) if self.operations is None else self.operations.advance(step)

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        return super().repeat(events) if self.operations is None else self.operations.repeat(events)
