"""From a fit that leaves something over to the effects that would explain it.

Refit, screen, refit the shortlist, judge on what was left out: candidates are first compared by what is left of their
signature after the base parameters have been fitted anew to it (a projection, per window, so that any recording can be
left out), then fitted in full.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.mismatch.fit import DivergedError, Fit, Residuals, cost, fit, slope, solve, strength
from vsense_ros.mismatch.knobs import Candidate, Knob
from vsense_ros.mismatch.prediction import Setting

Array = NDArray[np.float64]

SHORTLIST = 4  # by the fall of the cost, and as many by its fall on what was left out
SECANT = 1.0  # deviations: some effects have no slope at zero


@dataclass(frozen=True)
class Signature:
    """What a candidate would do to the residuals, and what of it cannot be had from the base parameters."""

    candidate: Candidate
    slopes: list[Array]  # by window, (rows, k)
    keep: float  # share of the signature that is left after the base parameters have been fitted to it [-]
    gain: float  # relative fall of the cost, linearly
    left_out: float  # the same on recordings that the fit did not see


@dataclass(frozen=True)
class Explanation:
    """A candidate fitted together with the base parameters."""

    candidate: Candidate
    fit: Fit
    keep: float
    gain: float  # relative fall of the cost
    left_out: float  # the same on recordings that the fit did not see
    improved: float  # share of the windows that fit better
    deviations: Array  # standard deviation of each size, in its unit

    @property
    def score(self) -> float:
        """What chance must not reach: the smaller gain."""
        return min(self.gain, self.left_out)

    @property
    def sizes(self) -> dict[str, float]:
        """Values by dotted name."""
        first = len(self.fit.knobs) - len(self.candidate.knobs)
        return {k.name: float(a) for k, a in zip(self.fit.knobs[first:], self.fit.amounts[first:], strict=True)}


def groups(residuals: Residuals) -> list[list[int]]:
    """Windows that are left out together: those of a recording, or each alone where there is one recording."""
    windows = residuals.predictor.evidence.windows
    numbers = sorted({w.recording for w in windows})
    if len(numbers) > 1:
        return [[i for i, w in enumerate(windows) if w.recording == number] for number in numbers]
    return [[i] for i in range(len(windows))]


def screen(
    residuals: Residuals, base: Fit, candidates: Sequence[Candidate], progress: Callable[[], None] = lambda: None
) -> list[Signature]:
    """All candidates with a signature, the likeliest first."""
    columns: dict[str, list[Array]] = {}
    found = []
    for candidate in candidates:
        for knob in candidate.knobs:
            if knob.name not in columns:
                columns[knob.name] = slope(residuals, base, knob, base.setting, SECANT)
                progress()
        slopes = [np.column_stack(parts) for parts in zip(*(columns[k.name] for k in candidate.knobs), strict=True)]
        if not any(np.abs(s).max(initial=0.0) > 1e-6 for s in slopes):
            continue
        joint = _joined(base, candidate.knobs, slopes)
        gain, left_out = _gains(residuals, base, joint)
        found.append(Signature(candidate, slopes, _keep(base, slopes), gain, left_out))
    return sorted(found, key=lambda s: min(s.gain, s.left_out), reverse=True)


def explain(
    residuals: Residuals,
    start: Setting,
    base: Fit,
    signatures: Sequence[Signature],
    progress: Callable[[], None] = lambda: None,
) -> list[Explanation]:
    """The likeliest candidates, fitted in full, best first."""
    found = []
    by_gain = sorted(signatures, key=lambda s: s.gain, reverse=True)[:SHORTLIST]
    chosen = {s.candidate.name: s for s in (*by_gain, *signatures[:SHORTLIST])}
    for signature in chosen.values():
        joint = _joined(base, signature.candidate.knobs, signature.slopes)
        try:
            fitted = fit(residuals, start, joint.knobs, first=joint, iterations=5)
        except DivergedError:
            continue
        progress()
        gain = 1 - fitted.cost / base.cost
        before = sum(_left_out(base, group) for group in groups(residuals))
        after = sum(_left_out(fitted, group) for group in groups(residuals))
        windows = [float(a @ a) < float(b @ b) for a, b in zip(fitted.residuals, base.residuals, strict=True) if len(b)]
        found.append(
            Explanation(
                signature.candidate, fitted, signature.keep, gain, 1 - after / before, float(np.mean(windows)),
                _deviations(fitted)[len(base.knobs) :],
            )
        )  # fmt: skip
    return sorted(found, key=lambda e: e.score, reverse=True)


def _joined(base: Fit, knobs: Sequence[Knob], slopes: Sequence[Array]) -> Fit:
    """The base fit with further knobs, not turned yet."""
    return replace(
        base,
        knobs=(*base.knobs, *knobs),
        amounts=np.append(base.amounts, np.zeros(len(knobs))),
        slopes=[np.column_stack(pair) for pair in zip(base.slopes, slopes, strict=True)],
    )


def _prior(fitted: Fit) -> Array:
    return fitted.amounts / np.array([knob.deviation for knob in fitted.knobs])


def _moved(fitted: Fit, change: Array, windows: Sequence[int]) -> float:
    return cost([fitted.residuals[i] + fitted.slopes[i] @ change for i in windows])


def _left_out(fitted: Fit, group: Sequence[int]) -> float:
    """Cost of windows after a fit to all others, linearly."""
    rest = [i for i in range(len(fitted.residuals)) if i not in group]
    if not rest:
        return cost([fitted.residuals[i] for i in group])
    change = solve(
        [fitted.slopes[i] for i in rest], [fitted.residuals[i] for i in rest], _prior(fitted),
        strength(fitted.residuals),
    )  # fmt: skip
    return _moved(fitted, change, group)


def _gains(residuals: Residuals, base: Fit, joint: Fit) -> tuple[float, float]:
    every = range(len(base.residuals))
    change = solve(joint.slopes, joint.residuals, _prior(joint), strength(joint.residuals))
    gain = 1 - _moved(joint, change, every) / base.cost
    before = sum(_left_out(base, group) for group in groups(residuals))
    after = sum(_left_out(joint, group) for group in groups(residuals))
    return gain, 1 - after / before


def _keep(base: Fit, slopes: Sequence[Array]) -> float:
    """Share of the signature that stays when the base parameters are fitted to it, in the norm of the residuals."""
    whole, left = 0.0, 0.0
    for column in range(slopes[0].shape[1]):
        signature = [s[:, column] for s in slopes]
        change = solve(base.slopes, signature, np.zeros(len(base.knobs)), strength(base.residuals))
        whole += cost(signature)
        left += cost([r + s @ change for r, s in zip(signature, base.slopes, strict=True)])
    return float(np.sqrt(left / whole)) if whole > 0 else 0.0


def _deviations(fitted: Fit) -> Array:
    """Standard deviations of the knobs. Residuals of neighbouring instants err together: the spread between windows
    says how much they tell, by a jackknife over windows."""
    weight, prior = strength(fitted.residuals), _prior(fitted)
    every = range(len(fitted.residuals))
    changes = np.array(
        [
            solve(
                [fitted.slopes[i] for i in every if i != out], [fitted.residuals[i] for i in every if i != out],
                prior, weight,
            )
            for out in every
        ]
    )  # fmt: skip
    n = len(changes)
    if n < 2:
        return np.array([knob.deviation for knob in fitted.knobs])
    spread = np.sqrt((n - 1) / n * np.sum((changes - changes.mean(axis=0)) ** 2, axis=0))
    return spread * np.array([knob.deviation for knob in fitted.knobs])
