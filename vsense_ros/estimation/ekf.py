"""The extended Kalman filter in error coordinates (Jazwinski 1970, section 8.3; Solà 2017, section 6).

The error δ of the state is what has a covariance: the true state is x ⊞ δ. With ⊞ = + it is the textbook's filter. A
correction whitens the innovation, with L Lᵀ = H P Hᵀ + R and W = P Hᵀ L⁻ᵀ, and P ← P - W Wᵀ: symmetric to the last bit,
and a third of Joseph's work (docs/covariance.md).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Filter, Gaussian, Given, Innovation, Measured, Step
from vsense_ros.estimation.linearised import Linearised

COMPONENTS = 16  # of a measurement, at most, as in algebra.c
log = logging.getLogger(__name__)


class Ekf(Filter):
    """Of any linearised system: compiled where the system is, else in NumPy."""

    def __init__(self, system: Linearised) -> None:
        self.system = system
        self.memory, self.inputs = system.memory, system.inputs
        self.names, self.sensors = system.names, system.sensors
        self._operations = system.operations
        if self._operations is None:
            self._whitened, self._factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS**2)
        else:
            self._whitened, self._factor = self._operations.whitened, self._operations.factor
        self._views = [_views(self._whitened, self._factor, m) for m in range(COMPONENTS + 1)]

    @property
    def mean(self) -> Array:
        """(n,), a part of memory."""
        return self.system.mean

    @property
    def covariance(self) -> Array:
        """Of the error (e, e), a part of memory."""
        return self.system.covariance

    def start(self, belief: Gaussian) -> None:
        """Begin anew. Raises `InputError` where mean or covariance do not fit the system, or it is singular there."""
        mean, covariance = np.asarray(belief.mean, dtype=float), np.asarray(belief.covariance, dtype=float)
        check_belief(mean, covariance, len(self.system.mean), len(self.system.covariance))
        self.system.mean[:], self.system.covariance[:] = mean, covariance
        self.system.linearize()

    def predict(self, h: float) -> None:
        """Go on by `h` [s]."""
        if self._operations is not None:
            self._operations.predict(h)
        else:
            self.system.step(h)

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """As `Filter.correct`. A covariance that is not positive definite any more is told, and begun anew."""
        if self._operations is not None:
            nis = self._operations.correct(sensor, value, variance, limit, scale)
        else:
            nis = self._correct(sensor, value, variance, limit, scale)
        if nis != nis:
            self._recover(sensor)
        whitened, factor = self._views[len(value)]
        return Innovation(whitened, factor, nis, 0.0 <= nis <= limit)

    def _correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        """What algebra.c does, in NumPy."""
        residual, by_error = self.system.sense(sensor, value)
        found = whiten(residual, by_error, variance, self.system.covariance, scale)
        _write(found, self._whitened, self._factor)
        if 0.0 <= found.nis <= limit:
            w = found.projected
            self.system.covariance -= w.T @ w
            self.system.retract(found.whitened[found.present] @ w)
        return found.nis

    def _recover(self, sensor: str) -> None:
        """Begin the covariance anew if it was what spoilt a correction."""
        if is_definite(self.system.covariance):
            return
        log.warning(
            "correcting by %s: the covariance is not positive definite any more; its correlations are forgotten and "
            "its standard deviations doubled",
            sensor,
        )
        self.inflate()

    def belief(self) -> Gaussian:
        """Mean and covariance, copied."""
        return Gaussian(self.system.mean.copy(), self.system.covariance.copy())

    def is_valid(self) -> bool:
        """Whether the state is finite and within its bounds, and the variances positive."""
        return self.system.is_valid()

    def inflate(self) -> None:
        """Forget how errors belong together, and double their standard deviations."""
        inflate(self.system.covariance)

    def advance(self, step: Step) -> bool:
        """As `Filter.advance`, in one call where the system is compiled."""
        if self._operations is not None:
            return self._operations.advance(step)
        return super().advance(step)

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        """As `Filter.repeat`, in one call where the system is compiled."""
        if self._operations is not None:
            return self._operations.repeat(events)
        return super().repeat(events)


class Whitened:
    """An innovation in independent units: `present` (m,) and `whitened` (m,), and of the c present components L
    (c, c), the `factor` of their covariance, and `projected` = L⁻¹ H P (c, e)."""

    def __init__(
        self, present: NDArray[np.bool_], whitened: Array, factor: Array, projected: Array, nis: float
    ) -> None:
        self.present, self.whitened, self.factor = present, whitened, factor
        self.projected, self.nis = projected, nis


def whiten(residual: Array, by_error: Array, variance: Array, covariance: Array, scale: float = 1.0) -> Whitened:
    """The innovation `residual` (m,) with its Jacobian `by_error` (m, e) in independent units; NaN is absent.

    Its normalized innovation squared is negative where nothing is present, NaN where the covariance of the innovation,
    multiplied by `scale`, is not positive definite.
    """
    present = np.isfinite(residual)
    whitened = np.full(len(residual), np.nan)
    h, r = by_error[present], residual[present]
    if not r.size:
        return Whitened(present, whitened, np.zeros((0, 0)), np.zeros((0, len(covariance))), -1.0)
    across = h @ covariance
    total = scale * (across @ h.T + np.diag(np.asarray(variance)[present]))
    try:
        factor = np.asarray(np.linalg.cholesky(total), dtype=np.float64)
    except np.linalg.LinAlgError:
        return Whitened(present, whitened, np.full_like(total, np.nan), across, np.nan)
    both = solve_triangular(factor, np.column_stack([across, r]), lower=True, check_finite=False)
    whitened[present] = both[:, -1]
    return Whitened(present, whitened, factor, both[:, :-1], float(both[:, -1] @ both[:, -1]))


def is_definite(covariance: Array) -> bool:
    """Whether a covariance (e, e) is positive definite."""
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return False
    return bool(np.isfinite(covariance).all())


def inflate(covariance: Array) -> None:
    """Leave of a covariance (e, e) its variances, four times as large; one that is not a number becomes large."""
    variances = np.nan_to_num(np.diag(covariance), nan=1e8)
    covariance[:] = np.diag(np.clip(variances, 1e-12, 1e8) * 4)


def check_belief(mean: Array, covariance: Array, n: int, e: int) -> None:
    """Raises `InputError` if these are not the mean (n,) and covariance (e, e) of something."""
    if mean.shape != (n,) or covariance.shape != (e, e):
        raise InputError(
            f"the filter starts from a mean of shape ({n},) and a covariance of shape ({e}, {e}), "
            f"but got {mean.shape} and {covariance.shape}"
        )
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise InputError("the mean and the covariance that a filter starts from must be finite")
    if not np.allclose(covariance, covariance.T, rtol=1e-9) or (np.diag(covariance) < 0).any():
        raise InputError("the covariance that a filter starts from must be symmetric, with variances not below zero")


def _views(whitened: Array, factor: Array, m: int) -> tuple[Array, Array]:
    """The parts that a measurement with m components fills."""
    return whitened[:m], factor[: m * m].reshape(m, m)


def _write(found: Whitened, whitened: Array, factor: Array) -> None:
    """Leave what a correction found where C leaves it."""
    m = len(found.whitened)
    whitened[:m] = found.whitened
    square = factor[: m * m].reshape(m, m)
    square[:] = np.eye(m)
    square[np.ix_(found.present, found.present)] = found.factor
