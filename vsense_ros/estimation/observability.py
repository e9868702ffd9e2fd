"""Observability of the state in a run of a filter: which directions the measurements determine, and which not.

The observability Gramian G = Σ Φ_kᵀ H_kᵀ R⁻¹ H_k Φ_k, with Φ_k from the start to the k-th measurement, is the
information that all measurements of a run have of the state at its start if nothing disturbs it (Krener & Ide 2009).
Units of states differ, so that its eigenvalues mean nothing until it is scaled: with the standard deviations σ of what
was known before, σ G σ compares what is measured with that. An eigenvalue of 1 halves the variance in its direction,
one far below 1 leaves it as it was: that is of more use than a rank, which rounding makes full.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.record import Record


@dataclass(frozen=True)
class ObservabilitySettings:
    """From which eigenvalue on a direction counts, and how it is named."""

    # Eigenvalue of σ G σ from which on measurements know more of a direction than was known before [-]: at 1 they halve
    # its variance.
    determined: float = 1.0
    rounding: float = 1e-10  # share of the largest eigenvalue [-]: a double's 1e-16, and sums of some thousand terms
    named_share: float = 0.2  # of the largest component of a direction [-]: smaller ones are not in its name
    unit_share: float = 0.995  # [-], from which on a component is written without a factor, as it would be 1.0


SETTINGS = ObservabilitySettings()


@dataclass(frozen=True)
class Direction:
    """A combination of states: `parts` (e,) in units of prior standard deviations, of length 1, and the `eigenvalue` of
    the scaled Gramian."""

    parts: Array
    eigenvalue: float
    names: tuple[str, ...]

    @property
    def remaining(self) -> float:
        """Standard deviation after the measurements of the run over that before."""
        return float((1 + max(self.eigenvalue, 0.0)) ** -0.5)

    def __str__(self) -> str:
        """In words: `lateral_velocity - 0.8 yaw`, in units of their prior standard deviations."""
        largest = np.abs(self.parts).max()
        order = np.argsort(-np.abs(self.parts), kind="stable")
        sign = np.sign(self.parts[order[0]])
        words = ""
        for i in order:
            share = sign * self.parts[i] / largest
            if abs(share) < SETTINGS.named_share:
                break
            size = "" if abs(share) > SETTINGS.unit_share else f"{abs(share):.2g} "
            words += f"{' + ' if share > 0 else ' - '}{size}{self.names[i]}"
        return words.removeprefix(" + ")


@dataclass(frozen=True)
class Observability:
    """Observability of the states in one run.

    `directions` come weakest first; `prior` and `now` (e,) are standard deviations of the errors, before the run and
    after it, as the filter has them; `rank` counts directions with any information at all.
    """

    names: tuple[str, ...]
    gramian: Array  # scaled, (e, e)
    directions: tuple[Direction, ...]
    rank: int
    prior: Array
    now: Array

    @property
    def ratio(self) -> Array:
        """Standard deviations after the run over those before, (e,)."""
        return np.divide(self.now, self.prior, out=np.ones_like(self.now), where=self.prior > 0)

    @property
    def undetermined(self) -> tuple[Direction, ...]:
        """Directions on which the run has less information than was known before, weakest first."""
        return tuple(one for one in self.directions if one.eigenvalue < SETTINGS.determined)

    def sentences(self) -> list[str]:
        """The report, a sentence a line."""
        count = len(self.names)
        lines = [f"The measurements have information on {self.rank} of {count} directions of the state."]
        for one in self.undetermined:
            lines.append(
                f"{one} (in units of prior standard deviations) is hardly determined: {100 * one.remaining:.3g} % of "
                "its standard deviation remain."
            )
        for name, before, after, ratio in zip(self.names, self.prior, self.now, self.ratio, strict=True):
            lines.append(f"{name}: standard deviation {before:.3g} before the run, {after:.3g} after it ({ratio:.3g}).")
        return lines


def observability(record: Record) -> Observability:
    """Observability of the states in a recorded run. Raises `InputError` if nothing was recorded."""
    if not record.instants:
        raise InputError("nothing was recorded: the filter has not been started")
    names = record.system.system.error_names
    prior = np.sqrt(np.diag(record.instants[0].before.covariance))
    gramian = scaled_gramian(record, prior)
    values, vectors = np.linalg.eigh(gramian)
    directions = tuple(Direction(v, float(w), names) for w, v in zip(values, vectors.T, strict=True))
    rank = int(np.count_nonzero(values > SETTINGS.rounding * max(values[-1], 1e-300)))
    now = np.sqrt(np.diag(record.instants[-1].after.covariance).clip(min=0))
    return Observability(names, gramian, directions, rank, prior, now)


def scaled_gramian(record: Record, deviations: Array) -> Array:
    """σ G σ (e, e) of the state at the first instant, with these standard deviations (e,)."""
    e = len(deviations)
    scaled, total = np.diag(deviations), np.zeros((e, e))
    for instant in record.instants:
        scaled = instant.transition @ scaled
        total += scaled.T @ instant.information @ scaled
    return 0.5 * (total + total.T)
