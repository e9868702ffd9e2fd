"""Linear least squares with Gaussian priors, for signals whose errors last longer than a sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WEAK = 100.0  # [-] prior deviations that the coefficients of the data alone may be off


@dataclass(frozen=True)
class Posterior:
    """Coefficients (k,) with their covariance (k, k), and the standard deviations (k,) that they had before."""

    values: Array
    covariance: Array
    prior: Array

    @property
    def deviations(self) -> Array:
        """Standard deviations (k,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def left(self) -> Array:
        """Share of the prior standard deviation that remains, (k,)."""
        return self.deviations / self.prior


def posterior(blocks: Sequence[tuple[Array, Array]], mean: Array, prior: Array) -> Posterior:
    """Coefficients c of y = X c over blocks, each X (n, k) and y (n,), given that c is normal with `mean` (k,) and
    standard deviations `prior` (k,).

    Residuals within a block may be correlated: the variance of one is multiplied by how much more the sums over blocks
    vary than sums of independent residuals would (the design effect of cluster sampling, Moulton 1986), and by what
    fitting k coefficients to few blocks hides of it (Cameron & Miller 2015, eq. 10).
    """
    x, y = np.vstack([one for one, _ in blocks]), np.concatenate([one for _, one in blocks])
    before = np.diag(prior**-2.0)
    # A mean that is far off must not count as noise of the data: begin where these alone would have it.
    weak = np.diag((_WEAK * prior) ** -2.0) * max(float(np.mean(y**2)), 1e-18)
    square, product, power = x.T @ x, x.T @ y, np.sum(x**2, axis=0)
    of_blocks = np.array([one.T @ np.column_stack([one, value]) for one, value in blocks])
    at = np.linalg.solve(square + weak, product + weak @ mean)
    few = len(blocks) / max(len(blocks) - x.shape[1], 0.5)
    for _ in range(4):  # the variance depends on the coefficients, and they hardly on it
        residuals = y - x @ at
        variance = max(float(np.mean(residuals**2)), 1e-18)
        sums = of_blocks[:, :, -1] - of_blocks[:, :, :-1] @ at
        effect = few * max(float(np.median(np.sum(sums**2, axis=0) / np.maximum(variance * power, 1e-300))), 1.0)
        information = square / (variance * effect) + before
        at = np.linalg.solve(information, product / (variance * effect) + before @ mean)
    return Posterior(at, np.linalg.inv(information), prior)
