"""Nonlinear least squares for models that are simulated: damped Gauss-Newton steps with a Gaussian prior and bounds.

A residual costs a simulation and its derivatives cost one for each free parameter, so slopes are secants that are
taken seldom and learn from the steps in between (Broyden, 1965). Where parameters can stand in for one another the
value has a curved valley: what a step that was too long missed shows how the valley bends, and a shorter one follows
it. Residuals come in blocks (windows, recordings), so that a simulation may fail in some of them, and so that a fit
can be judged without some of them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import chain, islice
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from vsense_ros.identification.free_parameter import FreeParameter, with_offsets
from vsense_ros.identification.normal_equations import NormalEquations, minimiser
from vsense_ros.identification.parameter_set import ParameterSet

Array = NDArray[np.float64]
# Slopes are secants, right to a few digits: with half as many bytes, what a search keeps of them takes half as much
# memory. Their products are taken in double precision, as parameters may stand in for one another.
Slopes = NDArray[np.float32]


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the line searches of a fit: decisions of this project, which change how soon a fit ends, not its
    minimum."""

    prior_share: float = 3e-3  # [-] share of the squared residuals that a free parameter one deviation off costs
    secant: float = 0.25  # [-] of a free parameter's likely offset, for secants
    # [-] times that, tried in this order until the simulation diverges in no block
    secant_factors: tuple[float, float, float] = (1.0, -1.0, 0.25)
    sufficient_share: float = 0.25  # [-] share of the fall that the slopes promise, with which a step is taken
    # [-] steps that are tried in this order, from the one on before that which was taken last: what the diagonal of the
    # normal matrix grows by, as a share of itself, and shares of the step along an arc
    caution: tuple[tuple[float, tuple[float, ...]], ...] = (
        (0.0, (1.0, 0.3)), (0.1, (1.0,)), (1.0, (1.0,)), (10.0, (1.0,)),
    )  # fmt: skip
    most_bent: float = 1.5  # [-] that an arc is bent, over the length of the step
    converged_fall: float = 2e-3  # [-] relative fall of the value, actual or promised, that ends the iterations
    unconverged_fall: float = 0.05  # [-] relative fall in the last iteration from which on the fit has not converged
    halvings: int = 60  # of the interval in which the damping is sought


SEARCH = SearchSettings()


class DivergedError(Exception):
    """Raised where a simulation leaves all bounds."""


class ResidualFunction(Protocol):
    """The function that is fitted: weighted differences of measurement and model, by block."""

    @property
    def at_once(self) -> int:
        """How many parameter sets are best simulated side by side."""

    def prepare(self, parameter_sets: Sequence[ParameterSet], near: ParameterSet | None = None) -> None:
        """Simulate up to `at_once` parameter sets, whose residuals are asked for next. Where they are for secants, they
        are `near` another one, and it is enough to simulate how far they are apart."""

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[Array] | None = None) -> list[Array]:
        """(rows,) of each block, in standard deviations. From where the simulation diverges they are those of
        `instead`. Raises `DivergedError` where it diverges and there is nothing instead."""

    def diverged(self, parameter_set: ParameterSet) -> Sequence[bool]:
        """True for each block in which the simulation diverges."""


@dataclass(frozen=True)
class Settings:
    """How a fit is searched for."""

    iterations: int = 8  # at most
    step: float = SEARCH.secant
    secants: Collection[int] = (0, 2, 4)  # iterations after which the slopes are simulated anew
    longest: float = np.inf  # step of an iteration [deviations], as a Euclidean norm
    weight: float | None = None  # what a parameter that is one deviation off costs; by default, `prior_weight`


DEFAULT = Settings()


@dataclass(frozen=True)
class Fit:
    """A parameter set that fits, and all that is needed to judge small changes of it."""

    parameter_set: ParameterSet
    free_parameters: tuple[FreeParameter, ...]
    offsets: Array  # (k,)
    residuals: list[Array]  # by block, (rows,)
    slopes: Sequence[Slopes]  # by block, (rows, k) by the free parameters in units of their deviations
    weight: float  # what a free parameter that is one deviation off costs
    converged: bool = True

    @property
    def scaled_offsets(self) -> Array:
        """(k,) offsets in units of their deviations."""
        return self.offsets / np.array([parameter.deviation for parameter in self.free_parameters])

    @property
    def offset_by_name(self) -> dict[str, float]:
        """Offsets by the name of the free parameter."""
        return {p.name: float(offset) for p, offset in zip(self.free_parameters, self.offsets, strict=True)}

    @property
    def value(self) -> float:
        """The value that is minimised: the squared residuals and the prior's cost."""
        return cost(self.residuals) + self.prior_cost

    @property
    def prior_cost(self) -> float:
        """What it costs that offsets are not zero, in squared standard deviations of residuals."""
        return self.weight * float(self.scaled_offsets @ self.scaled_offsets)

    @cached_property
    def equations(self) -> NormalEquations:
        """Normal equations of the fit."""
        return NormalEquations(
            self.free_parameters, self.scaled_offsets, self.weight,
            np.array([products(s) for s in self.slopes]),
            np.array([s.T @ r for s, r in zip(self.slopes, self.residuals, strict=True)]),
            np.array([r @ r for r in self.residuals]),
            np.array([len(r) for r in self.residuals]),
        )  # fmt: skip

    def joined(self, free_parameters: Sequence[FreeParameter], slopes: Iterable[Slopes]) -> Fit:
        """The fit with further free parameters, of which the slopes (rows, n) by block are given. One that it has
        already, by name, is replaced where it is; all others are at zero."""
        names, present = {parameter.name for parameter in free_parameters}, self.offset_by_name
        remaining = [i for i, parameter in enumerate(self.free_parameters) if parameter.name not in names]
        new = [present.get(parameter.name, 0.0) for parameter in free_parameters]
        return replace(
            self,
            free_parameters=(*(self.free_parameters[i] for i in remaining), *free_parameters),
            offsets=np.append(self.offsets[remaining], new),
            slopes=[
                np.column_stack([present_slopes[:, remaining], further_slopes])
                for present_slopes, further_slopes in zip(self.slopes, slopes, strict=True)
            ],
        )


def products(slopes: NDArray[np.floating[Any]]) -> Array:
    """The products (k, k) of the columns of slopes (rows, k)."""
    double = slopes.astype(np.float64)
    return np.asarray(double.T @ double)


def cost(residuals: Sequence[Array]) -> float:
    """Sum of the squares of all residuals."""
    return float(sum(r @ r for r in residuals))


def prior_weight(residuals: Sequence[Array]) -> float:
    """What a free parameter that is one deviation off costs: `SEARCH.prior_share` of the squared residuals, which are
    taken for no less than those of a model whose residuals are one standard deviation.

    Residuals of neighbouring instants err together, so that many say little more than few: the prior counts against all
    of them, not against one.
    """
    return SEARCH.prior_share * max(cost(residuals), float(sum(len(r) for r in residuals)))


def slope(
    residuals: ResidualFunction, start: ParameterSet, fit: Fit, parameter: FreeParameter, step: float = SEARCH.secant
) -> list[Slopes]:
    """Secant of the residuals, per deviation of a free parameter whose offset is changed by `step` likely ones from a
    fit that began at `start`. Where the simulation diverges with that and does not in the fit, which would tell
    nothing, other steps are tried."""
    return _slope(residuals, fit, _diverged_in(residuals, fit), parameter, _attempts(start, fit, parameter, step))


def _diverged_in(residuals: ResidualFunction, fit: Fit) -> Callable[[], int]:
    """In how many blocks the simulation diverges in a fit: asked once, as few secants need it, and it may take a
    simulation of all blocks."""
    return cache(lambda: sum(residuals.diverged(fit.parameter_set)))


def _slope(
    residuals: ResidualFunction,
    fit: Fit,
    diverged_in_fit: Callable[[], int],
    parameter: FreeParameter,
    attempts: Iterable[tuple[float, ParameterSet]],
) -> list[Slopes]:
    """`slope` by the first of the attempts in which the simulation diverges no more than in the fit."""
    best, fewest = [np.zeros(len(r), np.float32) for r in fit.residuals], len(fit.residuals) + 1
    for change, parameter_set in attempts:
        changed = residuals(parameter_set, fit.residuals)
        diverged = sum(residuals.diverged(parameter_set))
        if diverged < fewest:
            best = [
                ((c - r) * (parameter.deviation / change)).astype(np.float32)
                for c, r in zip(changed, fit.residuals, strict=True)
            ]
            fewest = diverged
        if not diverged or diverged <= diverged_in_fit():
            break
    return best


def slopes_by(
    residuals: ResidualFunction,
    start: ParameterSet,
    fit: Fit,
    free_parameters: Sequence[FreeParameter],
    step: float = SEARCH.secant,
) -> Iterator[list[Slopes]]:
    """`slope` by each of the free parameters, several of which are simulated side by side."""
    at_once, diverged_in_fit = residuals.at_once, _diverged_in(residuals, fit)
    for begin in range(0, len(free_parameters), at_once):
        group = free_parameters[begin : begin + at_once]
        attempts = [_attempts(start, fit, parameter, step) for parameter in group]
        first = [list(islice(attempt, 1)) for attempt in attempts]
        residuals.prepare([parameter_set for attempt in first for _, parameter_set in attempt], fit.parameter_set)
        for parameter, first_choice, further in zip(group, first, attempts, strict=True):
            yield _slope(residuals, fit, diverged_in_fit, parameter, chain(first_choice, further))


def _attempts(
    start: ParameterSet, fit: Fit, parameter: FreeParameter, step: float
) -> Iterator[tuple[float, ParameterSet]]:
    """By how much the offset of a free parameter is changed for a secant, and the parameter set with that, the first
    choice first."""
    offsets = fit.offset_by_name
    present = offsets.get(parameter.name, 0.0)
    free_parameters = (*(other for other in fit.free_parameters if other.name != parameter.name), parameter)
    for share in SEARCH.secant_factors:
        change = share * step * parameter.likely
        if parameter.low <= present + change <= parameter.high:
            offsets[parameter.name] = present + change
            yield (
                change,
                with_offsets(start, free_parameters, np.array([offsets[free.name] for free in free_parameters])),
            )


def slopes_at(
    residuals: ResidualFunction,
    start: ParameterSet,
    fitted: Fit,
    progress: Callable[[], None] = lambda: None,
    step: float = SEARCH.secant,
) -> list[Slopes]:
    """By block, (rows, k): secants by all free parameters of a fit from where it is, per deviation; it began at
    `start`."""
    slopes = [np.zeros((len(r), len(fitted.free_parameters)), np.float32) for r in fitted.residuals]
    for i, columns in enumerate(slopes_by(residuals, start, fitted, fitted.free_parameters, step)):
        for block, column in zip(slopes, columns, strict=True):
            block[:, i] = column
        progress()
    return slopes


def solve(
    slopes: Sequence[Slopes],
    residuals: Sequence[Array],
    scaled_offsets: Array,
    weight: float,
    caution: float = 0.0,
    longest: float = np.inf,
) -> Array:
    """The change (k,) of the free parameters [deviations] that minimises the squared residuals and `weight` times the
    squared offsets, which are `scaled_offsets` (k,) now.

    With `caution` it is shorter, as the damping of Marquardt (1963) makes it; if it is then longer than `longest`, it
    is the best change of that length (Moré, 1978).
    """
    right = _with_residuals(slopes, residuals)
    return _change(_products_of(slopes), right, scaled_offsets, weight, caution, longest)


def _change(
    normal: Array, right: Array, scaled_offsets: Array, weight: float, caution: float, longest: float = np.inf
) -> Array:
    """`solve` from the products `normal` (k, k) of the slopes and `right` (k,) of slopes and residuals."""
    normal = normal + caution * np.diag(np.diag(normal))
    change = minimiser(normal, right, scaled_offsets, weight)
    if np.linalg.norm(change) <= longest:
        return change
    return _of_length(normal, right, scaled_offsets, weight, longest)


def _products_of(slopes: Sequence[Slopes]) -> Array:
    """The products (k, k) of the columns of slopes, of all blocks together."""
    return np.asarray(sum(map(products, slopes)), float)


def _with_residuals(slopes: Sequence[Slopes], residuals: Sequence[Array]) -> Array:
    """The products (k,) of slopes and residuals, of all blocks together."""
    return np.asarray(sum(s.T @ r for s, r in zip(slopes, residuals, strict=True)), float)


def _of_length(normal: Array, right: Array, scaled_offsets: Array, weight: float, length: float) -> Array:
    """The best change of a length: that of the damping, as an addition to the diagonal, which makes it so long."""
    unit, change = np.eye(len(scaled_offsets)), np.zeros(len(scaled_offsets))
    gradient = float(np.linalg.norm(right + weight * scaled_offsets))
    low, high = 0.0, gradient / length  # the change is shorter than the gradient over the damping
    for _ in range(SEARCH.halvings):
        damping = 0.5 * (low + high)
        change = minimiser(normal + damping * unit, right, scaled_offsets, weight)
        low, high = (low, damping) if np.linalg.norm(change) <= length else (damping, high)
    return change


def fit(
    residuals: ResidualFunction,
    start: ParameterSet,
    free_parameters: Sequence[FreeParameter],
    *,
    first: Fit | None = None,
    begin: Array | None = None,
    instead: Sequence[Array] | None = None,
    settings: Settings = DEFAULT,
    progress: Callable[[], None] = lambda: None,
) -> Fit:
    """Change the offsets of `free_parameters` until the value no longer falls.

    It begins at the offsets `begin` (k,) if they are given, otherwise at that of the parameters' `starts` which fits
    best. `first` is a fit from which to go on, with the slopes and the weight to use, and the residuals if it has the
    same parameter set; none are then simulated anew. `instead` are the residuals of blocks in which the simulation
    diverges; without them `DivergedError` is raised where the start cannot be simulated. `progress` is called after
    each slope and each iteration.
    """
    if first is not None:
        present = first.offset_by_name
        begin = np.array([present.get(parameter.name, 0.0) for parameter in free_parameters])
    elif begin is None:
        begin = _best_start(residuals, start, free_parameters)
    (fitted,) = _side_by_side(
        residuals, [_fitting(residuals, start, free_parameters, first, begin, instead, settings, progress)]
    )
    return fitted


def fit_each(
    residuals: ResidualFunction,
    start: ParameterSet,
    first: Iterable[Fit],
    instead: Sequence[Array] | None = None,
) -> list[Fit]:
    """What `fit` makes of each of these fits to go on from, simulated side by side. They are asked for as late as
    possible, because their slopes may be large."""
    return _side_by_side(
        residuals,
        (
            _fitting(
                residuals, start, earlier.free_parameters, earlier, earlier.offsets, instead, DEFAULT, lambda: None
            )
            for earlier in first
        ),
    )


_Fitting = Generator[ParameterSet, None, Fit]  # what is simulated next, and then the fit
_Stepping = Generator[ParameterSet, None, tuple[Fit, int]]  # the same, and which of `SEARCH.caution` it took


def _side_by_side(residuals: ResidualFunction, fittings: Iterable[_Fitting]) -> list[Fit]:
    """The fits. As many as are best simulated side by side go on by one simulation at a time."""
    fits: dict[int, Fit] = {}
    at_work: dict[int, tuple[_Fitting, ParameterSet]] = {}  # with what it simulates next, by place

    def advance(place: int, fitting: _Fitting) -> None:
        try:
            at_work[place] = fitting, next(fitting)
        except StopIteration as end:
            fits[place] = end.value

    waiting = enumerate(fittings)
    while True:
        while len(at_work) < residuals.at_once and (following := next(waiting, None)) is not None:
            advance(*following)
        if not at_work:
            return [fits[place] for place in range(len(fits))]
        if len(at_work) > 1:
            residuals.prepare([parameter_set for _, parameter_set in at_work.values()])
        for place in list(at_work):
            advance(place, at_work.pop(place)[0])


def _fitting(
    residuals: ResidualFunction, start: ParameterSet, free_parameters: Sequence[FreeParameter], first: Fit | None,
    begin: Array, instead: Sequence[Array] | None, settings: Settings, progress: Callable[[], None],
) -> _Fitting:  # fmt: skip
    """`fit`, which yields each parameter set that it is about to simulate."""
    parameter_set = with_offsets(start, free_parameters, begin)
    if first is not None and first.parameter_set.values == parameter_set.values:
        residual_blocks = first.residuals
    else:
        yield parameter_set
        residual_blocks = residuals(parameter_set, instead)
    best = Fit(parameter_set, tuple(free_parameters), begin, residual_blocks, [], 0.0)
    slopes = first.slopes if first else slopes_at(residuals, start, best, progress, settings.step)
    best = replace(best, slopes=slopes)
    fall, taken = 0.0, 0
    for iteration in range(settings.iterations):
        present = replace(best, weight=_weight(settings, first, best))
        best, taken = yield from _stepped(residuals, start, present, instead, settings.longest, max(0, taken - 1))
        fall = 1 - best.value / max(present.value, 1e-12)
        progress()
        if fall < SEARCH.converged_fall:
            break
        if first is None and iteration in settings.secants:
            best = replace(best, slopes=slopes_at(residuals, start, best, progress, settings.step))
    return replace(best, weight=_weight(settings, first, best), converged=fall < SEARCH.unconverged_fall)


def _weight(settings: Settings, first: Fit | None, fitted: Fit) -> float:
    """What a free parameter that is one deviation off costs in a fit."""
    if first is not None:
        return first.weight
    return prior_weight(fitted.residuals) if settings.weight is None else settings.weight


def _best_start(residuals: ResidualFunction, start: ParameterSet, free_parameters: Sequence[FreeParameter]) -> Array:
    """The best of the offsets at which a fit may begin, (k,): the first of each free parameter, the second of each, and
    so on are tried; a parameter that has fewer stays at its first. Raises `DivergedError` if none can be simulated."""
    tried: list[tuple[float, Array]] = []
    for i in range(max((len(parameter.starts) for parameter in free_parameters), default=1)):
        begin = np.array([p.starts[i] if i < len(p.starts) else p.starts[0] for p in free_parameters])
        try:
            tried.append((cost(residuals(with_offsets(start, free_parameters, begin))), begin))
        except DivergedError:
            continue
    if not tried:
        raise DivergedError
    return min(tried, key=lambda attempt: attempt[0])[1]


def _stepped(
    residuals: ResidualFunction, start: ParameterSet, present: Fit, instead: Sequence[Array] | None, longest: float,
    least: int,
) -> _Stepping:  # fmt: skip
    """A fit one step further along the slopes, which learn from it, with a caution of `SEARCH` from the `least` on; the
    same fit if no step is better.

    What a step that was too long missed shows how the way bends: a shorter one follows the arc (as the geodesic
    acceleration of Transtrum and Sethna, 2012, does, with a second derivative that costs no simulation).
    """
    deviations = np.array([parameter.deviation for parameter in present.free_parameters])
    low, high = np.array([k.low for k in present.free_parameters]), np.array([k.high for k in present.free_parameters])
    normal, right = _products_of(present.slopes), _with_residuals(present.slopes, present.residuals)
    best = present
    for taken, (caution, shares) in enumerate(SEARCH.caution[least:], start=least):
        step = _change(normal, right, present.scaled_offsets, present.weight, caution, longest)
        promised = _promised(present, step)
        if promised < SEARCH.converged_fall * present.value:
            break
        bend = np.zeros(len(step))
        for share in shares:
            offsets = np.clip(present.offsets + (share * step + share**2 / 2 * bend) * deviations, low, high)
            parameter_set = with_offsets(start, present.free_parameters, offsets)
            yield parameter_set
            try:
                new_residuals = residuals(parameter_set, instead)
            except DivergedError:
                continue
            tried = replace(present, parameter_set=parameter_set, offsets=offsets, residuals=new_residuals)
            missed = _missed(present, tried)
            if tried.value < best.value:
                best = _with_updated_slopes(present, tried, missed)
            if present.value - tried.value > SEARCH.sufficient_share * share * (2 - share) * promised:
                return best, taken
            bent = _with_residuals(present.slopes, [2 * m / share**2 for m in missed])
            bend = _change(normal, bent, np.zeros(len(step)), present.weight, caution)
            bend *= min(1.0, SEARCH.most_bent * float(np.linalg.norm(step)) / max(float(np.linalg.norm(bend)), 1e-12))
    return best, taken


def _promised(present: Fit, step: Array) -> float:
    """How much less the value is after a step (k,) [deviations], if the residuals follow their slopes."""
    line = [r + s @ step for r, s in zip(present.residuals, present.slopes, strict=True)]
    return (
        present.value
        - cost(line)
        - present.weight * float((present.scaled_offsets + step) @ (present.scaled_offsets + step))
    )


def _missed(present: Fit, tried: Fit) -> list[Array]:
    """By block, what residuals after a step are beyond what the slopes promised."""
    moved = tried.scaled_offsets - present.scaled_offsets
    return [
        new - old - s @ moved for new, old, s in zip(tried.residuals, present.residuals, present.slopes, strict=True)
    ]


def _with_updated_slopes(present: Fit, tried: Fit, missed: Sequence[Array]) -> Fit:
    """A fit after a step, with slopes that would have predicted its residuals and are otherwise as they were
    (Broyden, 1965)."""
    moved = tried.scaled_offsets - present.scaled_offsets
    direction = moved / float(moved @ moved)
    slopes = [(s + np.outer(m, direction)).astype(s.dtype) for s, m in zip(present.slopes, missed, strict=True)]
    return replace(tried, slopes=slopes)
