"""Iterated smoothing: the trajectory that fits all measurements of a recorded run best, and how sure that is.

A filter linearises each measurement where it believes to be then, a smoother behind it inherits that. Here all of a run
is linearised at the trajectory x̄ of the last iteration, and the errors δ about it follow from a Kalman filter and a
smoother of that linear system (Rauch, Tung & Striebel 1965):

    δ⁻ = (f(x̄₋) ⊟ x̄) + F δ₋,  P⁻ = F P₋ Fᵀ + Q,      r = z - h(x̄) = H δ + noise,      x̄ ← x̄ ⊞ δ

Repeated until x̄ stays, this is Gauss–Newton on the squares of all measurements and steps over their variances (Bell
1994), in a time proportional to the length of the run, and with the covariance of each instant. States without noise,
whose information would be infinite, need nothing of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.record import Instant, Record, Used
from vsense_ros.estimation.smoother import smoothed, smoothing


@dataclass(frozen=True)
class IterationSettings:
    """When to stop: after `most` iterations, or when no state has changed by more than `change` of its standard
    deviation."""

    most: int = 6
    change: float = 0.02


@dataclass(frozen=True)
class Iterated:
    """Beliefs of all instants of a run, how many iterations it took, and the largest change of a state in the last one
    in standard deviations."""

    beliefs: list[Gaussian]
    iterations: int
    change: float


def iterated(
    record: Record,
    settings: IterationSettings = IterationSettings(),
    progress: Callable[[float], None] = lambda share: None,
) -> Iterated:
    """Beliefs of all instants of a run by Gauss–Newton, from those of the extended smoother as a start.

    A measurement counts where it is within its gate of the last trajectory, so that one which the filter had refused
    while it was wrong is used after all, and the other way round.
    """
    beliefs, change, count = smoothed(record), np.inf, 0
    while count < settings.most and change > settings.change:
        before, beliefs = beliefs, _again(record, beliefs)
        change = max(_change(record.system, new, old) for new, old in zip(beliefs, before, strict=True))
        count += 1
        progress(count / settings.most)
    return Iterated(beliefs, count, change)


def _change(system: Dense, new: Gaussian, old: Gaussian) -> float:
    """Largest change of an element of the error, in standard deviations."""
    deviation = np.sqrt(new.covariance.diagonal().clip(min=1e-300))
    return float(np.max(np.abs(system.difference(new.mean, old.mean)) / deviation))


def _again(record: Record, beliefs: Sequence[Gaussian]) -> list[Gaussian]:
    """One iteration: linearise along a trajectory, and smooth its errors."""
    system, instants = record.system, record.instants
    start = instants[0].before
    error = system.difference(start.mean, beliefs[0].mean)
    covariance = start.covariance
    transition, last = np.eye(len(error)), 0.0
    steps: list[tuple[Array, Gaussian, Gaussian]] = []  # F, errors before and after the measurements of an instant
    for k, (instant, belief) in enumerate(zip(instants, beliefs, strict=True)):
        if k:
            moved, transition, noise = _moved(system, beliefs[k - 1].mean, instant, instant.time - last)
            if instant.widened is not None:
                covariance = covariance + instant.widened
            error = system.difference(moved, belief.mean) + transition @ error
            covariance = transition @ covariance @ transition.T + noise
        last, before = instant.time, Gaussian(error, covariance)
        for used in instant.used:
            error, covariance = _corrected(system, belief, used, error, covariance)
        steps.append((transition, before, Gaussian(error, covariance)))
    return [
        Gaussian(system.retracted(belief.mean, one.mean), one.covariance)
        for belief, one in zip(beliefs, _backwards(steps), strict=True)
    ]


def _moved(system: Dense, mean: Array, instant: Instant, h: float) -> tuple[Array, Array, Array]:
    """State (n,) at an instant by the model from the mean before, F and Q (e, e)."""
    system.mean[:], system.inputs[:] = mean, instant.inputs
    return system.moved(h)


def _corrected(system: Dense, belief: Gaussian, used: Used, error: Array, covariance: Array) -> tuple[Array, Array]:
    """Errors (e,) and their covariance about the mean of a belief, given a measurement."""
    system.mean[:], system.inputs[:] = belief.mean, used.inputs
    residual, by_error = system.sense(used.sensor, used.value)
    present = np.isfinite(residual)
    if not present.any():
        return error, covariance
    r, h, variance = residual[present], by_error[present], used.variance[present]
    if np.isfinite(used.limit):
        expected = np.einsum("ij,jk,ik->i", h, belief.covariance, h) + variance
        if np.sum(r**2 / expected) > used.limit:
            return error, covariance
    across = h @ covariance
    gain = np.linalg.solve(across @ h.T + np.diag(variance), across).T
    covariance = covariance - gain @ across
    return error + gain @ (r - h @ error), 0.5 * (covariance + covariance.T)


def _backwards(steps: Sequence[tuple[Array, Gaussian, Gaussian]]) -> list[Gaussian]:
    """Errors of all instants, given all measurements (Rauch, Tung & Striebel 1965)."""
    later = steps[-1][2]
    beliefs = [later]
    for (_, _, after), (transition, before, _) in zip(reversed(steps[:-1]), reversed(steps[1:]), strict=True):
        gain, covariance = smoothing(after.covariance, transition, before.covariance, later.covariance)
        later = Gaussian(after.mean + gain @ (later.mean - before.mean), covariance)
        beliefs.append(later)
    return beliefs[::-1]
