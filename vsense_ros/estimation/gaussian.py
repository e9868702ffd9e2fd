"""What all filters share that know a mean and a covariance: how they begin, recover, and whiten an innovation."""

from __future__ import annotations

import logging
from math import isfinite

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Filter, Gaussian

COMPONENTS = 16  # of a measurement, at most, as in algebra.c
log = logging.getLogger(__name__)


class GaussianFilter(Filter):
    """A filter whose `mean` (n,) and `covariance` (e, e) of the error are parts of its memory."""

    mean: Array
    covariance: Array

    def start(self, belief: Gaussian) -> None:
        """Begin anew. Raises `InputError` where mean or covariance do not fit the system, or it is singular there."""
        self.check(belief)
        self.mean[:], self.covariance[:] = belief.mean, belief.covariance

    def check(self, belief: Gaussian) -> None:
        """Raises `InputError` where mean or covariance do not fit the system."""
        mean, covariance = np.asarray(belief.mean, dtype=float), np.asarray(belief.covariance, dtype=float)
        check_belief(mean, covariance, len(self.mean), len(self.covariance))

    def set_element(self, index: int, value: float, deviation: float) -> None:
        """Set one element of the mean, whose error then has this standard deviation and no correlation; of states whose
        error is a difference."""
        self.mean[index] = value
        self.covariance[index, :] = self.covariance[:, index] = 0.0
        self.covariance[index, index] = deviation**2

    def belief(self) -> Gaussian:
        """Mean and covariance, copied."""
        return Gaussian(self.mean.copy(), self.covariance.copy())

    def inflate(self) -> None:
        """Forget how errors belong together, and double their standard deviations."""
        inflate(self.covariance)

    def recover(self, sensor: str) -> None:
        """Begin the covariance anew, and say so, if it was what spoilt a correction by this sensor."""
        if is_definite(self.covariance):
            return
        log.warning(
            "correcting by %s: the covariance is not positive definite any more; its correlations are forgotten and "
            "its standard deviations doubled",
            sensor,
        )
        self.inflate()


class Whitened:
    """An innovation in independent units.

    `present` (m,) says which components are there; `whitened` (m,) is NaN elsewhere. Of the c that are there: L (c, c),
    the `factor` of their covariance, and `projected` = L⁻¹ H P (c, e). `nis`: the normalized innovation squared.
    """

    def __init__(
        self, present: NDArray[np.bool_], whitened: Array, factor: Array, projected: Array, nis: float
    ) -> None:
        self.present, self.whitened, self.factor = present, whitened, factor
        self.projected, self.nis = projected, nis

    @property
    def error(self) -> Array:
        """Error of the state according to the measurement (e,)."""
        return self.whitened[self.present] @ self.projected

    def write(self, whitened: Array, factor: Array) -> None:
        """Leave what was found where `Innovation` looks for it; absent components stand for themselves in L."""
        m = len(self.whitened)
        whitened[:m] = self.whitened
        square = factor[: m * m].reshape(m, m)
        square[:] = np.eye(m)
        square[np.ix_(self.present, self.present)] = self.factor


def whiten(residual: Array, total: Array, across: Array) -> Whitened:
    """The innovation `residual` (m,), NaN where absent, with its covariance `total` (m, m), in independent units.

    `across` (m, e) is its covariance with the error of the state. The normalized innovation squared is negative where
    nothing is present, NaN where the covariance is not positive definite.
    """
    present = np.isfinite(residual)
    whitened = np.full(len(residual), np.nan)
    measured = residual
    if not present.all():
        total, across, measured = total[np.ix_(present, present)], across[present], residual[present]
        if not measured.size:
            return Whitened(present, whitened, total, across, -1.0)
    # LAPACK itself: NumPy and SciPy spend more time on looking at such small matrices than on their decomposition.
    factor, failed = lapack.dpotrf(total, lower=True)
    if failed or not isfinite(factor.item(-1)):
        return Whitened(present, whitened, np.full_like(total, np.nan), across, np.nan)
    inverse = lapack.dtrtri(factor, lower=True)[0]
    weights, projected = inverse.dot(measured), inverse.dot(across)
    whitened[present] = weights
    return Whitened(present, whitened, factor, projected, float(weights.dot(weights)))


def check_variances(sensor: str, value: Array, variance: Array) -> None:
    """Raises `InputError` if a measurement has not as many variances as components."""
    if len(variance) != len(value):
        raise InputError(f"a measurement of {sensor!r} has {len(value)} variances, but got {len(variance)}")


def is_definite(covariance: Array) -> bool:
    """True if a covariance (e, e) is finite and positive definite."""
    if not np.isfinite(covariance).all():
        return False
    try:
        np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError:
        return False
    return True


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
