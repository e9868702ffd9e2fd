"""Fitting what may be wrong to the data set: weighted residuals, their derivatives, and damped Gauss-Newton steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vsense_ros.mismatch.candidates import FreeParameter
from vsense_ros.mismatch.equations import Equations, least
from vsense_ros.mismatch.signals import SHAKING, difference, grid
from vsense_ros.mismatch.simulation import ParameterSet, Predictor
from vsense_ros.model.sensors import compared_signals

Array = NDArray[np.float64]

PRIOR = 3e-3  # of the data set: as much as a misfit of that share costs a free parameter that is one deviation off
SHARE = 0.03  # of a signal's own size that a good model may miss, which no sensor is better than
OUTLIER = 40.0  # standard deviations beyond which a residual counts as that many
# Standard deviations of all signals together from where on an instant counts for less and less (as Cauchy's loss has
# it): a simulated car that spins at the limit, where the real one just did not, says no more than that.
FAR = 5.0
ASTRAY_BEFORE = 1.0  # [s] that a car which gets lost is astray already
LEAST_KEPT = 50  # instants of a window, below which nothing of it is compared
STEP = 0.25  # of a free parameter's likely amount, for derivatives
STEPS = (1.0, -1.0, 0.25)  # times that, tried in this order until the simulated car is lost nowhere
ITERATIONS = 8
# Steps that are tried in this order until the value falls by a `SUFFICIENT` share of what the slopes promise: caution,
# and shares of the step along an arc. Where several parameters can stand in for one another the value has a curved
# valley, out of which the straight step leads.
SUFFICIENT = 0.25
CAUTION = ((0.0, (1.0, 0.3, 0.1)), (0.1, (1.0,)), (1.0, (1.0,)), (10.0, (1.0,)))
BENT = 1.5  # most that an arc is bent, over the length of the step
GRIP = (0.0, 0.2, -0.2)  # changes of all grip from which to start: a car that slides has a cost of its own
SHAKEN = 1.4  # how much further off a good model is in signals that any road shakes
SETTLED = 2e-3  # relative fall of the value, had or promised, that ends the iterations
UNSETTLED = 0.05  # the same in the last of them, from where on the fit is none


class DivergedError(Exception):
    """A simulation left all bounds."""


class Residuals:
    """Weighted differences of measurement and simulation."""

    def __init__(self, predictor: Predictor) -> None:
        self.predictor = predictor
        measured = predictor.measured
        names = [name for name in compared_signals() if any(name in m for m in measured)]
        self.deviation = {}
        for name in names:
            size = np.concatenate([m[name] - m[name].mean() for m in measured if name in m]).std()
            noise = np.median([n[name] for n in predictor.noise if name in n] or [0.0])
            self.deviation[name] = float(np.linalg.norm([compared_signals()[name].floor, SHARE * size, noise]))
        self.layout = [[name for name in names if name in m] for m in measured]
        self._instants = [grid(window) for window in predictor.dataset.windows]

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[Array] | None = None) -> list[Array]:
        """Of each window, (signals × instants) in the order of `layout`; in standard deviations, and less where the
        simulation has gone `FAR`. Once the simulated car is lost they are those of `instead`, if that is given.

        Raises `DivergedError` where a simulation leaves all bounds and there is nothing instead.
        """
        if instead is None:
            found = self._until(parameter_set, [np.inf] * len(self.layout))
            return [rows.reshape(-1) for rows in found]
        found = self._until(parameter_set, self.predictor.lost_from(parameter_set))
        return [
            np.column_stack([rows, known.reshape(len(rows), -1)[:, rows.shape[1] :]]).reshape(-1)
            if len(rows)
            else known
            for rows, known in zip(found, instead, strict=True)
        ]

    def compared(self, parameter_set: ParameterSet, until: Sequence[float]) -> list[Array]:
        """The same, of each window up to a time [s] alone."""
        return [rows.reshape(-1) for rows in self._until(parameter_set, until)]

    def _until(self, parameter_set: ParameterSet, until: Sequence[float]) -> list[Array]:
        """Of each window (signals, instants) before it is `ASTRAY_BEFORE` a time [s]; nothing if those are few."""
        result = []
        simulations = zip(self.predictor.measured, self.predictor.simulated(parameter_set), strict=True)
        for (measured, simulated), names, t, end in zip(simulations, self.layout, self._instants, until, strict=True):
            kept = len(t) if np.isinf(end) else int(np.searchsorted(t, end - ASTRAY_BEFORE))
            if kept < min(LEAST_KEPT, len(t)) or not names:
                result.append(np.zeros((len(names), 0)))
                continue
            if not simulated:
                raise DivergedError
            off = difference({n: v[:kept] for n, v in measured.items()}, {n: v[:kept] for n, v in simulated.items()})
            rows = np.array([off[name] / self.deviation[name] for name in names if name in off]).reshape(-1, kept)
            result.append(tempered(np.clip(rows, -OUTLIER, OUTLIER)))
        return result

    @staticmethod
    def level(residuals: Sequence[Array]) -> float:
        """Root mean square of all residuals, in standard deviations."""
        return float(np.sqrt(cost(residuals) / max(sum(len(r) for r in residuals), 1)))

    def worst(self, residuals: Sequence[Array]) -> float:
        """Root mean square of the worst signal's residuals, in standard deviations; of signals that a road shakes in
        multiples of what that does."""
        return self.furthest(residuals)[1]

    def furthest(self, residuals: Sequence[Array]) -> tuple[str, float]:
        """The worst signal by name, empty if there is none, and how bad it is."""
        good = self.good(residuals)
        off = {name: error / good[name] for name, error in self.deviations(residuals).items()}
        return max(off.items(), key=itemgetter(1), default=("", 0.0))

    def good(self, residuals: Sequence[Array]) -> dict[str, float]:
        """Root mean square of what a good model leaves of each signal, in standard deviations: more of those that any
        road shakes, by how much this one does."""
        errors = self.deviations(residuals)
        shaken = {name for name, signal in compared_signals().items() if signal.shaken}
        road = SHAKEN * max(1.0, errors.get(SHAKING, 1.0))
        return {name: road if name in shaken else 1.0 for name in errors}

    def deviations(self, residuals: Sequence[Array]) -> dict[str, float]:
        """Root mean square of each signal's residual, in standard deviations."""
        return self._root_mean_squares(residuals, lambda rows: rows)

    def by_signal(self, residuals: Sequence[Array]) -> dict[str, float]:
        """Root mean square of each signal's error in its unit."""
        found = self._root_mean_squares(residuals, untempered)
        return {name: off * self.deviation[name] for name, off in found.items()}

    def _root_mean_squares(self, residuals: Sequence[Array], of: Callable[[Array], Array]) -> dict[str, float]:
        parts: dict[str, list[Array]] = {}
        for rows, names in zip(residuals, self.layout, strict=True):
            if len(rows):
                for name, part in zip(names, of(rows.reshape(len(names), -1)), strict=True):
                    parts.setdefault(name, []).append(part)
        return {name: float(np.sqrt(np.mean(np.concatenate(p) ** 2))) for name, p in parts.items()}


def tempered(off: Array) -> Array:
    """(signals, instants), shorter at instants where all signals together are far off."""
    far = np.maximum(np.mean(off**2, axis=0) / FAR**2, 1e-12)
    return np.asarray(off * np.sqrt(np.log1p(far) / far))


def untempered(tempered: Array) -> Array:
    """The inverse of `tempered`."""
    near = np.maximum(np.mean(tempered**2, axis=0) / FAR**2, 1e-12)
    return np.asarray(tempered * np.sqrt(np.expm1(near) / near))


@dataclass(frozen=True)
class Fit:
    """A setting that fits, and all that is needed to judge changes of it linearly."""

    parameter_set: ParameterSet
    free_parameters: tuple[FreeParameter, ...]
    offsets: Array  # (k,)
    residuals: list[Array]  # by window
    slopes: list[Array]  # by window, (rows, k) by the free parameters in units of their deviations
    weight: float  # what a free parameter that is one deviation off costs
    converged: bool = True

    @property
    def prior(self) -> Array:
        """Where the free parameters are, in deviations."""
        return self.offsets / np.array([parameter.deviation for parameter in self.free_parameters])

    @property
    def value(self) -> float:
        """What is minimised: the squared residuals, and what it costs that free parameters are not where they were
        expected."""
        return cost(self.residuals) + self.paid

    @property
    def paid(self) -> float:
        """What it costs that free parameters are not where they were expected, in squared deviations."""
        return self.weight * float(self.prior @ self.prior)

    @cached_property
    def equations(self) -> Equations:
        """Its normal equations."""
        return Equations(
            self.free_parameters, self.prior, self.weight,
            np.array([s.T @ s for s in self.slopes]),
            np.array([s.T @ r for s, r in zip(self.slopes, self.residuals, strict=True)]),
            np.array([r @ r for r in self.residuals]),
            np.array([len(r) for r in self.residuals]),
        )  # fmt: skip


def cost(residuals: Sequence[Array]) -> float:
    """Sum of squares."""
    return float(sum(r @ r for r in residuals))


def turned(start: ParameterSet, free_parameters: Sequence[FreeParameter], offsets: Array) -> ParameterSet:
    """The setting with all free parameters turned, one after the other."""
    for parameter, offset in zip(free_parameters, offsets, strict=True):
        start = start.changed(parameter.turn(start.values, float(offset)))
    return start


def slope(
    residuals: Residuals, start: ParameterSet, fit: Fit, parameter: FreeParameter, step: float = STEP
) -> list[Array]:
    """Secant of the residuals by a free parameter that is turned by `step` likely amounts from a fit that began at
    `start`, per deviation; by less where the car gets lost with that and does not in the fit, which would tell
    nothing."""
    best, fewest = [np.zeros(len(r)) for r in fit.residuals], len(fit.residuals) + 1
    for by, parameter_set in _attempts(start, fit, parameter, step):
        changed = residuals(parameter_set, fit.residuals)
        lost = sum(residuals.predictor.lost(parameter_set))
        if lost < fewest:
            best = [(c - r) * (parameter.deviation / by) for c, r in zip(changed, fit.residuals, strict=True)]
            fewest = lost
        if not lost or lost <= sum(residuals.predictor.lost(fit.parameter_set)):
            break
    return best


def slopes_by(
    residuals: Residuals, start: ParameterSet, fit: Fit, free_parameters: Sequence[FreeParameter], step: float = STEP
) -> Iterator[list[Array]]:
    """`slope` by each of the free parameters, several of which are driven side by side."""
    ahead = residuals.predictor.ahead
    for begin in range(0, len(free_parameters), ahead):
        together = free_parameters[begin : begin + ahead]
        first = (next(_attempts(start, fit, parameter, step), None) for parameter in together)
        residuals.predictor.foresee([attempt[1] for attempt in first if attempt is not None])
        yield from (slope(residuals, start, fit, parameter, step) for parameter in together)


def _attempts(
    start: ParameterSet, fit: Fit, parameter: FreeParameter, step: float
) -> Iterator[tuple[float, ParameterSet]]:
    """By how much a free parameter is turned for a secant, and the car with that, the likeliest first."""
    offsets = dict(zip((known.name for known in fit.free_parameters), fit.offsets, strict=True))
    present = float(offsets.get(parameter.name, 0.0))
    free_parameters = (*(known for known in fit.free_parameters if known.name != parameter.name), parameter)
    for share in STEPS:
        by = share * step * parameter.likely
        if parameter.low <= present + by <= parameter.high:
            offsets[parameter.name] = present + by
            yield by, turned(start, free_parameters, np.array([offsets[known.name] for known in free_parameters]))


def solve(
    slopes: Sequence[Array], residuals: Sequence[Array], prior: Array, strength: float, caution: float = 0.0
) -> Array:
    """The change of the free parameters, in deviations, that minimises the squared residuals and `strength` times the
    squared distance of the free parameters from zero, where `prior` (k,) is where they are now. With `caution` it is
    shorter, as Levenberg and Marquardt would have it."""
    normal = sum((s.T @ s for s in slopes), np.zeros((len(prior), len(prior))))
    right = sum((s.T @ r for s, r in zip(slopes, residuals, strict=True)), np.zeros(len(prior)))
    normal = normal + caution * np.diag(np.diag(normal))
    return least(normal, right, prior, strength)


def strength(residuals: Sequence[Array]) -> float:
    """How much a free parameter that is one deviation off costs: as much as a misfit of `PRIOR` of the data set.

    Residuals of neighbouring instants err together, so that many say little more than few.
    """
    return PRIOR * max(cost(residuals), float(sum(len(r) for r in residuals)))


def fit(
    residuals: Residuals,
    start: ParameterSet,
    free_parameters: Sequence[FreeParameter],
    *,
    first: Fit | None = None,
    begin: Array | None = None,
    instead: Sequence[Array] | None = None,
    iterations: int = ITERATIONS,
    progress: Callable[[], None] = lambda: None,
) -> Fit:
    """Turn `free_parameters` until the value no longer falls, from the amounts `begin` (k,) if they are given. `first`
    is a fit of the same free parameters from which to go on, with the slopes to use; `instead` are the residuals of
    windows in which the simulated car gets lost; without them `DivergedError` is raised where the start cannot be
    simulated.
    """
    offsets = np.zeros(len(free_parameters)) if begin is None else begin
    if first is not None:
        known = dict(zip((parameter.name for parameter in first.free_parameters), first.offsets, strict=True))
        offsets = np.array([known.get(parameter.name, 0.0) for parameter in free_parameters])
    elif begin is None:
        offsets = _likeliest(residuals, start, free_parameters, offsets)
    parameter_set = turned(start, free_parameters, offsets)
    best = Fit(parameter_set, tuple(free_parameters), offsets, residuals(parameter_set, instead), [], 0.0)
    best = replace(best, slopes=first.slopes if first else slopes_at(residuals, start, best, progress))
    fall = 0.0
    for iteration in range(iterations):
        at = replace(best, weight=first.weight if first else strength(best.residuals))
        best = _stepped(residuals, start, at, instead)
        fall = 1 - best.value / max(at.value, 1e-12)
        progress()
        if fall < SETTLED:
            break
        if first is None and iteration in (0, 2, 4):
            best = replace(best, slopes=slopes_at(residuals, start, best, progress))
    weight = first.weight if first else strength(best.residuals)
    return replace(best, weight=weight, converged=fall < UNSETTLED)


def _stepped(residuals: Residuals, start: ParameterSet, at: Fit, instead: Sequence[Array] | None) -> Fit:
    """A fit one step further along the slopes, which learn from it (Broyden, 1965); the same fit if no step is better.

    What a step that was too long missed tells how the way bends: a shorter one follows the arc (as the geodesic
    acceleration of Transtrum and Sethna, 2012, does, with a second derivative that costs no simulation).
    """
    deviations = np.array([parameter.deviation for parameter in at.free_parameters])
    low, high = np.array([k.low for k in at.free_parameters]), np.array([k.high for k in at.free_parameters])
    best = at
    for caution, shares in CAUTION:
        step = solve(at.slopes, at.residuals, at.prior, at.weight, caution)
        line = [r + s @ step for r, s in zip(at.residuals, at.slopes, strict=True)]
        promised = at.value - cost(line) - at.weight * float((at.prior + step) @ (at.prior + step))
        if promised < SETTLED * at.value:
            break
        bend = np.zeros(len(step))
        for share in shares:
            offsets = np.clip(at.offsets + (share * step + share**2 / 2 * bend) * deviations, low, high)
            parameter_set = turned(start, at.free_parameters, offsets)
            try:
                tried = replace(
                    at, parameter_set=parameter_set, offsets=offsets, residuals=residuals(parameter_set, instead)
                )
            except DivergedError:
                continue
            moved = tried.prior - at.prior
            missed = [
                new - old - s @ moved for new, old, s in zip(tried.residuals, at.residuals, at.slopes, strict=True)
            ]
            if tried.value < best.value:
                learnt = moved / float(moved @ moved)
                best = replace(tried, slopes=[s + np.outer(m, learnt) for s, m in zip(at.slopes, missed, strict=True)])
            if at.value - tried.value > SUFFICIENT * share * (2 - share) * promised:
                return best
            bend = solve(at.slopes, [2 * m / share**2 for m in missed], np.zeros(len(step)), at.weight, caution)
            bend *= min(1.0, BENT * float(np.linalg.norm(step)) / max(float(np.linalg.norm(bend)), 1e-12))
    return best


def _likeliest(
    residuals: Residuals, start: ParameterSet, free_parameters: Sequence[FreeParameter], offsets: Array
) -> Array:
    """Of several values of the grip the one that fits best, as offsets of the free parameters."""
    found = []
    for change in GRIP:
        tried = np.array(
            [
                change if parameter.name.startswith("grip") else a
                for parameter, a in zip(free_parameters, offsets, strict=True)
            ]
        )
        try:
            found.append((cost(residuals(turned(start, free_parameters, tried))), change, tried))
        except DivergedError:
            continue
    if not found:
        raise DivergedError
    return min(found, key=lambda one: one[0])[2]


def slopes_at(residuals: Residuals, start: ParameterSet, at: Fit, progress: Callable[[], None]) -> list[Array]:
    """By window, (rows, k): secants by the free parameters of a fit from where it is, per deviation; it began at
    `start`."""
    slopes = [np.zeros((len(r), len(at.free_parameters))) for r in at.residuals]
    for i, columns in enumerate(slopes_by(residuals, start, at, at.free_parameters)):
        for window, column in zip(slopes, columns, strict=True):
            window[:, i] = column
        progress()
    return slopes
