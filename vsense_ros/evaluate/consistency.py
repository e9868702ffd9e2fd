"""Consistency of a filter: its errors beside the deviations that it states, by its innovations, and by the truth where
a recording has it.

Bar-Shalom, Li & Kirubarajan (2001), section 5.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from vsense_ros.estimation.innovations import Innovations
from vsense_ros.evaluate.metrics import compare
from vsense_ros.messages.recording import Recording

Array = NDArray[np.float64]

SHARE = 0.95  # of all intervals
_EDGE = float(norm.ppf(0.5 + SHARE / 2))


@dataclass(frozen=True)
class Consistency:
    """What the innovations of a sensor, or of all, say about the filter.

    - `log_likelihood`: per credible message, natural logarithm.
    - `nis`: normalized innovation squared of the messages that the gate let pass, over the number of their components;
      within `nis_interval` around 1 if the filter is right. Above: it is too sure of itself.
    - `lag_1`: correlation of successive innovations of a component, that of the component where it is largest; not
      beyond ±`lag_1_bound` if the filter is right.
    """

    messages: int
    refused: int
    log_likelihood: float
    nis: float
    nis_interval: tuple[float, float]
    lag_1: float
    lag_1_bound: float


def consistency(parts: Sequence[Innovations], credible: Sequence[NDArray[np.bool_]]) -> Consistency:
    """Consistency of some sensors on some recordings together; `credible` are their messages of which the
    likelihood is made."""
    density = np.concatenate([part.log_density()[mask] for part, mask in zip(parts, credible, strict=True)])
    accepted = [part.whitened[part.used] for part in parts]
    count = max(sum(int(np.isfinite(values).sum()) for values in accepted), 1)
    low, high = chi2.ppf([0.5 - SHARE / 2, 0.5 + SHARE / 2], count) / count
    correlations = [(float(r), n) for values in accepted for r, n in zip(*lag_1(values), strict=True) if n > 2]
    lag, pairs = max(correlations, key=lambda correlation: abs(correlation[0]), default=(np.nan, 1))
    return Consistency(
        sum(len(part.used) for part in parts),
        sum(int(np.sum(~part.used)) for part in parts),
        float(density.mean()),
        sum(float(np.nansum(values**2)) for values in accepted) / count,
        (float(low), float(high)),
        lag,
        _EDGE / pairs**0.5,
    )


def lag_1(whitened: Array) -> tuple[Array, list[int]]:
    """The correlation of each component of (n, m) with its value one message before, and the number of pairs."""
    before, after = whitened[:-1], whitened[1:]
    finite_pair = np.isfinite(before) & np.isfinite(after)
    before, after = np.where(finite_pair, before, 0.0), np.where(finite_pair, after, 0.0)
    power = np.sqrt(np.sum(before**2, axis=0) * np.sum(after**2, axis=0))
    return np.sum(before * after, axis=0) / np.maximum(power, 1e-300), finite_pair.sum(axis=0).tolist()


@dataclass(frozen=True)
class Error:
    """Error of an estimate: root mean square [unit of the signal], `nees` and the share `inside` two standard
    deviations, as of `SignalScore`. Errors last, so that no interval can be given for their means."""

    rmse: float
    nees: float
    inside: float


def errors_of(output: Recording, truth: Recording) -> dict[str, Error]:
    """Errors of every signal that `truth` has below `reference/` and `output` with a standard deviation below
    `vsense/`."""
    return {
        name: Error(score.rmse, score.nees, score.within_2s)
        for name, score in compare(output, truth).items()
        if score.nees is not None and score.within_2s is not None
    }
