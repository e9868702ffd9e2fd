"""How well a drive determines the free parameters, and which it leaves undetermined.

The posterior covariance of a pass that began with the prior covariance D² gives the information of the drive alone,
I = P⁻¹ - D⁻². Units of parameters differ, so that its eigenvalues mean nothing until it is scaled, D I D: an eigenvalue
of 1 halves the variance of its direction, one far below 1 leaves what was known before.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.observability import Direction
from vsense_ros.identification.rinsing import Drive, Identifier


@dataclass(frozen=True)
class InformationSettings:
    """Bounds from which parameters count as determined: decisions of this project."""

    # [-] share of the prior deviation: a parameter of which no more remains is determined
    determined_share: float = 0.3
    determined_share_of_curve: float = 0.5  # [-] likewise for a parameter that is judged by its curve
    # [-] deviation over that with all other parameters known: beyond, it cannot be separated from them
    inseparable_ratio: float = 5.0
    most_steps: int = 6  # of Gauss and Newton
    longest_step: float = 0.5  # [prior deviations]
    last_step: float = 0.01  # [prior deviations] the step with which the iteration ends
    # [-] share of its value by which errors of form, of the integration's steps and of filters before it make a
    # parameter wrong however long the drive is: pieces of the drive agree about that. Measured on twins that are driven
    # to their limits, whose intervals held in 63 % instead of 90 % of the cases without it.
    form_share: float = 0.005
    prior_share: float = 0.05  # [-] of the prior deviations, with which the information of the drives is evaluated
    correlated: float = 0.9  # [-] correlation from which on two parameters are named together


INFORMATION = InformationSettings()


@dataclass(frozen=True)
class Information:
    """Information about the parameters `names` at `values` (p,), with prior deviations (p,): `scaled` information D I D
    (p, p). Deviations include errors of form, which no longer drive makes less (`form`).

    Where the slopes of the log-likelihood of the pieces of the drives are known, `pieces` (c, p), scaled likewise,
    deviations are those of an estimate by a model that is not right, if they are larger (White 1982).
    """

    names: tuple[str, ...]
    values: Array
    prior: Array
    scaled: Array
    disagreement: float = 1.0  # of the pieces of the drive, by which the information was divided
    pieces: Array | None = None
    form: Array | float = INFORMATION.form_share  # (p,) or of all, shares of their values

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters, prior and drive together (p, p)."""
        inverse = np.linalg.inv(self.scaled + np.eye(len(self.names)))
        return self.prior[:, None] * inverse * self.prior

    @property
    def deviations(self) -> Array:
        """Standard deviations (p,), prior and drive together."""
        return np.array([self.deviation_of(direction) for direction in np.eye(len(self.names))])

    @property
    def remaining_share(self) -> Array:
        """Share of the prior deviation that remains, (p,)."""
        return self.deviations / self.prior

    @property
    def correlation(self) -> Array:
        """Correlation matrix (p, p) of the parameters."""
        deviations = np.sqrt(self.covariance.diagonal())
        return np.asarray(self.covariance / np.outer(deviations, deviations))

    @property
    def directions(self) -> tuple[Direction, ...]:
        """Combinations of parameters in units of their prior deviations, the least determined first."""
        values, vectors = np.linalg.eigh(self.scaled)
        return tuple(Direction(v, float(w), self.names) for w, v in zip(values, vectors.T, strict=True))

    def deviation_of(self, gradient: Array) -> float:
        """Standard deviation of a function of the parameters with this gradient (p,)."""
        form = float(np.sum((self.form * self.values * gradient) ** 2))
        right = float(np.sqrt(gradient @ self.covariance @ gradient + form))
        if self.pieces is None:
            return right
        # Not of all parameters at once: there are hardly more pieces than these.
        inverse = np.linalg.inv(self.scaled * self.disagreement + np.eye(len(self.names)))
        by_prior = inverse @ (self.prior * gradient)
        influence = self.pieces @ by_prior
        wrong = len(influence) * influence.var(ddof=1) + by_prior @ by_prior
        return max(right, float(np.sqrt(wrong + form)))

    @property
    def amplification(self) -> Array:
        """How many times as large the deviation of each parameter (p,) is as if all others were known: the square root
        of its variance inflation factor (Belsley, Kuh & Welsch 1980). Errors of the model come out as many times as
        large, and no longer drive makes that less."""
        ridge = 1e-9 * np.trace(self.scaled) / len(self.names) * np.eye(len(self.names))
        inverse = np.linalg.inv(self.scaled + ridge)
        return np.sqrt(np.maximum(self.scaled.diagonal() * inverse.diagonal(), 1.0))

    def weakest(self, judged_by_curve: Collection[str] = ()) -> Direction:
        """The combination that is hardest to determine, whatever each parameter is known to, in units of what is known
        of each alone; those that are judged by their curve are left out, and count as unknown."""
        inverse = np.linalg.inv(self.scaled + 1e-9 * np.trace(self.scaled) / len(self.names) * np.eye(len(self.names)))
        compared = [i for i, name in enumerate(self.names) if name not in judged_by_curve]
        scaled_covariance = np.linalg.inv(inverse[np.ix_(compared, compared)])
        precisions = 1 / np.sqrt(scaled_covariance.diagonal())
        values, vectors = np.linalg.eigh(precisions[:, None] * scaled_covariance * precisions)
        return Direction(vectors[:, 0], float(values[0]), tuple(self.names[i] for i in compared))

    def without(self, name: str) -> Information:
        """The information if one parameter were known, at its present value."""
        remaining = [i for i, other in enumerate(self.names) if other != name]
        square = np.ix_(remaining, remaining)
        return Information(
            tuple(self.names[i] for i in remaining), self.values[remaining], self.prior[remaining], self.scaled[square],
            self.disagreement, None if self.pieces is None else self.pieces[:, remaining],
            self.form[remaining] if isinstance(self.form, np.ndarray) else self.form,
        )  # fmt: skip

    def pairs(self) -> list[tuple[str, str, float]]:
        """Parameters that the drive can hardly separate, with their correlation, the closest first."""
        pairs = [
            (self.names[i], self.names[j], float(self.correlation[i, j]))
            for i in range(len(self.names)) for j in range(i) if abs(self.correlation[i, j]) >= INFORMATION.correlated
        ]  # fmt: skip
        return sorted(pairs, key=lambda pair: -abs(pair[2]))


def information(identifier: Identifier, drives: Sequence[Drive], values: Array, prior: Array) -> Information:
    """What drives say of the parameters around `values` (p,), whose prior deviations are `prior` (p,).

    The pass that computes it begins with only a `INFORMATION.prior_share` of these, so that the equations stay as they
    are there. It is divided by how much more the pieces of the drives disagree about the parameters than noise would
    make them. Raises `FloatingPointError` where the pass cannot go on.
    """
    return _with_score(identifier, drives, np.asarray(values, dtype=float), prior)[0]


def weigh(identifier: Identifier, drives: Sequence[Drive], values: Array, start: Array, prior: Array) -> Information:
    """The parameters that are likeliest by prior and drives together, and what is known of them: Gauss-Newton steps
    from `values` (p,), where passes have ended, with the prior around `start` (p,). A direction that the drives do not
    determine goes back to where it started. Raises `FloatingPointError` where a pass cannot go on."""
    values = np.asarray(values, dtype=float)
    weighed, score = _with_score(identifier, drives, values, prior)
    for _ in range(INFORMATION.most_steps):
        step = np.linalg.solve(weighed.scaled + np.eye(len(prior)), score + (start - values) / prior)
        step *= min(1.0, INFORMATION.longest_step / max(float(np.abs(step).max()), 1e-12))
        inside = 0.01 * (identifier.high - identifier.low)
        inside[~np.isfinite(inside)] = 0.0
        new = np.clip(values + prior * step, identifier.low + inside, identifier.high - inside)
        try:
            weighed, score = _with_score(identifier, drives, new, prior)
        except FloatingPointError:
            break
        values = new
        if np.abs(step).max() < INFORMATION.last_step:
            break
    return weighed


def _with_score(
    identifier: Identifier, drives: Sequence[Drive], values: Array, prior: Array
) -> tuple[Information, Array]:
    """The information, and the score (p,): the gradient of the log-likelihood at `values`, both scaled by the prior
    deviations."""
    deviations = INFORMATION.prior_share * prior
    belief, filter_pass = identifier.follow(drives, values, np.diag(deviations**2))
    scaled_covariance = belief.covariance / np.outer(deviations, deviations)
    precision = np.linalg.inv(scaled_covariance)
    scaled = precision - np.eye(len(prior))
    scaled = 0.5 * (scaled + scaled.T) / INFORMATION.prior_share**2
    score = precision @ ((belief.mean - values) / deviations) / INFORMATION.prior_share
    vectors = [
        np.linalg.solve(belief_of_piece.covariance / np.outer(prior, prior), (belief_of_piece.mean - values) / prior)
        for belief_of_piece in filter_pass.beliefs
    ]
    overconfidence = disagreement(np.diff(vectors, axis=0), scaled)
    form = np.array([identifier.form.get(name, INFORMATION.form_share) for name in identifier.free])
    found = Information(identifier.free, values, prior, scaled / overconfidence, overconfidence, form=form)
    return found, score / overconfidence


def disagreement(added: Array, scaled: Array) -> float:
    """Variance of what the pieces of a drive say of the parameters, over what the filter takes it for: 1 if all of its
    noise is right, more if the model errs otherwise in one piece than in another.

    `added` (c, p) are the slopes of the log-likelihood of each piece, whose covariance is the information of the piece;
    of a filter with a belief N(m, P), what the piece adds to P⁻¹ (m - θ) (White 1982, of estimates by a model that is
    not right).
    """
    eigenvalues, directions = np.linalg.eigh(scaled)
    determined = eigenvalues > 1.0
    if not determined.any():
        return 1.0
    squares = ((added - added.mean(axis=0)) @ directions[:, determined]) ** 2
    count = len(added) - 1
    return float(np.mean(squares.sum(axis=0) / eigenvalues[determined]) * (count + 1) / max(count, 1))


@dataclass(frozen=True)
class Refusal:
    """A parameter that the drives do not determine: the `remaining_share` of its prior deviation, and its
    `amplification`; `inseparable_from` names the parameters that it cannot be separated from."""

    name: str
    remaining_share: float
    amplification: float
    inseparable_from: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Why, in a sentence without its full stop."""
        if self.inseparable_from:
            return (
                f"{self.name} cannot be separated from {' and '.join(self.inseparable_from)}: together they are "
                f"{self.amplification:.0f} times as uncertain as alone"
            )
        return (
            f"{self.name} is not determined: {100 * self.remaining_share:.0f} % of its prior standard deviation remain"
        )


def refusals(weighed: Information, judged_by_curve: Collection[str] = ()) -> list[Refusal]:
    """Parameters that are not determined, or cannot be separated from others.

    Of one that is determined no more than `INFORMATION.determined_share` of its prior deviation is left. One whose
    deviation is more than `INFORMATION.inseparable_ratio` times that alone cannot be separated. Both are milder with
    those that are `judged_by_curve`: a shape factor and a curvature make up one force curve, which may well be
    determined where they are not.
    """
    refused = []
    for i, (name, remaining, amplification) in enumerate(
        zip(weighed.names, weighed.remaining_share, weighed.amplification, strict=True)
    ):
        of_curve = name in judged_by_curve
        if remaining > (INFORMATION.determined_share_of_curve if of_curve else INFORMATION.determined_share):
            refused.append(Refusal(name, float(remaining), float(amplification)))
        elif amplification > INFORMATION.inseparable_ratio and not of_curve:
            closest = [int(j) for j in np.argsort(-np.abs(weighed.correlation[i])) if j != i]
            correlated = [j for j in closest if abs(weighed.correlation[i, j]) > INFORMATION.correlated]
            inseparable_from = tuple(weighed.names[j] for j in correlated[:2] or closest[:1])
            refused.append(Refusal(name, float(remaining), float(amplification), inseparable_from))
    return refused
