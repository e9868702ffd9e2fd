"""What is known of a past state when all that came after it is known too (Rauch, Tung & Striebel 1965).

Backwards through a recorded run, in error coordinates: with C = P Fᵀ (P⁻)⁻¹, where P is the covariance after the
corrections of an instant and P⁻ the one before those of the next,

    x_s ← x ⊞ C (x_s⁺ ⊟ x⁻),  P_s ← P + C (P_s⁺ - P⁻) Cᵀ
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.record import Instant, Record


def smoothed(record: Record) -> list[Gaussian]:
    """Beliefs of all instants of a run, each in the light of the whole of it."""
    return _backwards(record.instants, record.system)


def _backwards(instants: Sequence[Instant], system: Dense) -> list[Gaussian]:
    beliefs = [instants[-1].after]
    for now, following in zip(reversed(instants[:-1]), reversed(instants[1:]), strict=True):
        beliefs.append(_step(now, following, beliefs[-1], system))
    return beliefs[::-1]


def _step(now: Instant, following: Instant, later: Gaussian, system: Dense) -> Gaussian:
    """The belief of an instant, from that of the one that follows."""
    p, before = now.after.covariance, following.before
    gain, covariance = smoothing(p, following.transition, before.covariance, later.covariance)
    return Gaussian(system.retracted(now.after.mean, gain @ system.difference(later.mean, before.mean)), covariance)


def smoothing(after: Array, transition: Array, before: Array, later: Array) -> tuple[Array, Array]:
    """Gain C and covariance (e, e) of the smoother, as the module has them, from the covariances (e, e) after the
    measurements of an instant, before those of the next one, and given all later ones."""
    gain = right_divided(after @ transition.T, before)
    covariance = after + gain @ (later - before) @ gain.T
    return gain, 0.5 * (covariance + covariance.T)


def right_divided(a: Array, p: Array) -> Array:
    """A P⁻¹; where P is singular, as of what is known exactly, its pseudo-inverse."""
    try:
        return np.asarray(np.linalg.solve(p, a.T).T)
    except np.linalg.LinAlgError:
        return np.asarray(a @ np.linalg.pinv(p, hermitian=True))


class FixedLag(Record):
    """A filter that is followed, `lag` steps behind, by a smoother: what a past state was, soon after it."""

    def __init__(self, filter: Ekf, lag: int) -> None:
        super().__init__(filter, lag + 1)

    def delayed(self) -> tuple[float, Gaussian]:
        """Time [s] and belief of the oldest instant that is kept, in the light of all up to the present."""
        return self.instants[0].time, _backwards(self.instants, self.system)[0]
