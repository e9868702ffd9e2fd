"""Identification of a model's parameters by a Kalman filter that goes over the same drives again and again.

Best & Bogdanski (2016) call a pass that starts from the parameters of the last one rinsing: the state starts anew at
the first sample, the parameters go on. They make 200 passes; here it ends when the force curves of the tyres stand
still. With the paper's settings, longer is not better: parameters that the drive does not determine creep away along a
valley while everything that can be seen stands still.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.augmented import Augmented
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Course, Gaussian
from vsense_ros.estimation.gaussian import GaussianFilter
from vsense_ros.estimation.integrated import Integrated, Rates
from vsense_ros.estimation.state_space import Measurement, Symbols
from vsense_ros.estimation.ukf import Ukf
from vsense_ros.identification.progress import Progress

Kind = Literal["extended", "unscented"]
SENSOR = "outputs"


@dataclass(frozen=True)
class RinsingSettings:
    """Settings of the passes over a drive (Best & Bogdanski 2016 call them rinsing)."""

    converged_share: float = 1e-3  # [-] of its peak: a curve that moves less in a pass has converged
    kappa: float = 1.0  # [-] of the unscented filter (Best & Bogdanski 2016, eq. 7)
    most_passes: int = 30  # over a drive
    pieces: int = 20  # of a drive, whose estimates are compared with each other
    attempts: int = 4  # at a pass that cannot go on
    history: int = 10  # samples between two of the memory that is kept of a pass


RINSING = RinsingSettings()


@dataclass(frozen=True)
class Drive:
    """Samples `h` [s] apart: inputs (N, k) and outputs (N, m) of a model, and the state (n,) at the first of them. A
    filter is given one in `every` of the outputs: so far apart their noise is independent."""

    name: str
    h: float
    inputs: Array
    outputs: Array
    start: Array
    begin: float = 0.0  # of the first sample, since the recording began [s]
    every: int = 1
    noise: tuple[float, ...] = ()  # standard deviations of the outputs (m,), where the recording has them

    @property
    def seconds(self) -> Array:
        """Time of each sample since the first, (N,) [s]."""
        return np.arange(len(self.inputs), dtype=np.float64) * np.float64(self.h)

    def part(self, first: int, last: int, start: Array) -> Drive:
        """Samples from `first` up to `last`, of which the first finds the state `start`."""
        return replace(
            self, inputs=self.inputs[first:last], outputs=self.outputs[first:last], start=start,
            begin=self.begin + first * self.h,
        )  # fmt: skip

    @property
    def sampled_outputs(self) -> Array:
        """Outputs (N, m) that a filter is given; the others are not numbers."""
        if self.every == 1:
            return self.outputs
        outputs = np.full(self.outputs.shape, np.nan)
        outputs[:: self.every] = self.outputs[:: self.every]
        return outputs


def low_passed(values: Array, h: float, cut_off: float) -> Array:
    """Columns (N, m), `h` [s] apart, without what is faster than a cut-off [Hz], and without delay."""
    from scipy.signal import butter, filtfilt  # which takes long to load, and an observer does not need

    smooth: Array = filtfilt(*butter(2, 2 * cut_off * h), values, axis=0)
    return np.ascontiguousarray(smooth, dtype=np.float64)


def independent(h: float, cut_off: float) -> int:
    """One in how many samples, `h` [s] apart, has noise of its own after a low-pass with a cut-off [Hz] (Nyquist).

    A Kalman filter takes the noise of its measurements to be independent. Where it is not, the state follows it from
    sample to sample, the innovations are correlated with the sensitivities, and parameters come out wrong however long
    the drive is (Ljung 1999, ch. 8).
    """
    return max(1, round(0.5 / (cut_off * h)))


@dataclass(frozen=True)
class Noise:
    """What the filter takes for noise: standard deviations of the outputs (m,), of the state at the start (n,), and
    by state the densities [unit/√s] of what disturbs the model."""

    outputs: Sequence[float]
    start: Sequence[float]
    disturbances: Mapping[str, float]
    inputs: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Schedule:
    """How the parameters are let go: before each pass they have a standard deviation of `first` of their size, `ratio`
    times as much before the next, and not less than `least`. Curves that move less than `still` of their peak in a pass
    stand still, and so do parameters of their size."""

    first: float = 0.15
    ratio: float = 0.5
    least: float = 0.05
    still: float = RINSING.converged_share
    passes: int = RINSING.most_passes

    def share(self, index: int) -> float:
        """Standard deviation before this pass, of the size."""
        return max(self.first * self.ratio**index, self.least)

    def deviations(self, index: int, scales: Array) -> Array:
        """Deviations of the free parameters before this pass, (p,)."""
        return self.share(index) * scales

    def may_end(self, index: int) -> bool:
        """True if a pass in which nothing moves may be the last."""
        return self.share(index) <= self.least

    def variance(self, before: Pass | None, outputs: Sequence[float]) -> Array:
        """Variance of the outputs (m,), after the pass before."""
        return np.square(np.asarray(outputs, dtype=float))


@dataclass(frozen=True)
class Pass:
    """One pass over all drives: parameters at its end (p,), and how far the curves moved in it, of their peaks; the
    root mean square normalized innovation of a component, and the mean squares (m,) of the innovations; processor time
    [s]; parameters (c, p) and the trace (c,) of their covariance, in units of their sizes, on the way; what
    they were believed to be at the ends of `RINSING.pieces` pieces of each drive."""

    values: Array
    moved: float
    innovation: float
    variance: Array
    seconds: float
    history: Array = field(repr=False)
    trace: Array = field(repr=False)
    beliefs: tuple[Gaussian, ...] = field(repr=False, default=())


OURS = Schedule()
Curves = Callable[[Mapping[str, float]], Array]  # parameters by name → curves (c, q), each over its peak


class Identifier:
    """A model, values for all its parameters, and the names of those that are free. `scales` (p,) are sizes of the free
    parameters: deviations are shares of these; by default their values. `drifts` (p,) [unit/√s] let them change on the
    way. `form` has the shares of their values by which errors of form make some of them wrong, where these are not the
    usual ones.

    Raises `InputError` for an unknown name, one without a size, and where nothing is free.
    """

    def __init__(
        self,
        model: Rates,
        values: Mapping[str, float],
        free: Sequence[str],
        noise: Noise,
        *,
        kind: Kind = "extended",
        curves: Curves | None = None,
        scales: Sequence[float] | Array | None = None,
        drifts: Sequence[float] | Array | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
        form: Mapping[str, float] | None = None,
    ) -> None:
        if not free:
            raise InputError("there is no free parameter: nothing to identify")
        if unknown := [name for name in free if name not in values]:
            raise InputError(f"there is no parameter {unknown[0]!r}; there are: {', '.join(values)}")
        self.model, self.values, self.free, self.noise, self.kind = model, dict(values), tuple(free), noise, kind
        self.curves, self.form = curves, form or {}
        ends = [(bounds or {}).get(name, (-np.inf, np.inf)) for name in free]
        self.low, self.high = np.array(ends).T
        self._check_start()
        self.scales = np.abs(self.begin() if scales is None else np.asarray(scales, dtype=float))
        if not (self.scales > 0).all():
            at_fault = self.free[int(np.argmin(self.scales))]
            raise InputError(f"{at_fault} starts at zero: it needs a size that it may have")
        drifts = np.zeros(len(free)) if drifts is None else np.asarray(drifts, dtype=float)
        system = Integrated(model, noise.disturbances, noise.inputs)
        self._states = len(system.names)
        augmented = Augmented(system, dict(zip(self.free, drifts.tolist(), strict=True)))
        fixed = {name: values[name] for name in augmented.parameters}
        sensor = system.measurement(noise.outputs, SENSOR)
        self.filter: GaussianFilter
        if kind == "extended":
            self.filter = Ekf(Dense(augmented, [sensor], fixed))
        else:
            self.filter = Ukf(augmented, [sensor], fixed, kappa=RINSING.kappa)
        self._outputs = _outputs(model, augmented)
        self._others = np.array([values[name] for name in augmented.parameters])

    def _check_start(self) -> None:
        """Raises `InputError` for a parameter that begins at one of its bounds, or beyond."""
        for name, value, low, high in zip(self.free, self.begin(), self.low, self.high, strict=True):
            if not low < value < high:
                raise InputError(
                    f"{name} starts at {value:.4g}, but must lie between {low:.4g} and {high:.4g}: give it a value "
                    "that such a car may have"
                )

    def named(self, values: Array) -> dict[str, float]:
        """All parameters by name, with these for the free ones."""
        return self.values | dict(zip(self.free, map(float, values), strict=True))

    def begin(self) -> Array:
        """Values of the free parameters at the start, (p,)."""
        return np.array([self.values[name] for name in self.free], dtype=float)

    def follow(
        self, drives: Sequence[Drive], values: Array, covariance: Array, variance: Array | None = None
    ) -> tuple[Gaussian, Pass]:
        """Go over all drives from these parameters (p,) and their covariance (p, p); what they are believed to be at
        the end, and the pass. Raises `FloatingPointError` where the filter cannot go on."""
        n, size = self._states, self._states + len(self.free)
        variance = np.square(np.asarray(self.noise.outputs, dtype=float)) if variance is None else variance
        belief = Gaussian(np.asarray(values, dtype=float), covariance)
        seconds, total, count = 0.0, 0.0, 0
        history, traces, squares, beliefs = [], [], [], [belief]
        for drive in drives:
            begun = time.process_time()
            nis, memory, belief = self._along(drive, belief, variance)
            seconds += time.process_time() - begun
            total, count = total + float(nis[nis >= 0].sum()), count + int((nis >= 0).sum()) * len(variance)
            means, covariances = memory[:, :size], memory[:, size : size + size**2].reshape(-1, size, size)
            history.append(means[:, n:])
            traces.append((covariances.diagonal(axis1=1, axis2=2)[:, n:] / self.scales**2).sum(axis=1))
            ends = np.linspace(0, len(memory), RINSING.pieces, endpoint=False, dtype=int)[1:]
            beliefs += [Gaussian(means[i, n:].copy(), covariances[i, n:, n:].copy()) for i in ends]
            beliefs.append(belief)
            expected = self.outputs(means, drive.inputs[:: RINSING.history])
            squares.append((drive.outputs[:: RINSING.history] - expected) ** 2)
        outside = (belief.mean <= self.low) | (belief.mean >= self.high)
        if outside.any():
            first_outside = int(np.argmax(outside))
            raise FloatingPointError(
                f"{self.free[first_outside]} went to {belief.mean[first_outside]:.4g}, beyond its bounds "
                f"{self.low[first_outside]:.4g} and {self.high[first_outside]:.4g}"
            )
        filter_pass = Pass(
            belief.mean, self.moved(np.asarray(values), belief.mean), float(np.sqrt(total / max(count, 1))),
            np.nanmean(np.concatenate(squares), axis=0), seconds, np.concatenate(history),
            np.concatenate(traces), tuple(beliefs),
        )  # fmt: skip
        return belief, filter_pass

    def _along(self, drive: Drive, belief: Gaussian, variance: Array) -> tuple[Array, Array, Gaussian]:
        """One drive: normalized innovations squared, memory, and what the parameters are believed to be at its end."""
        n, size = self._states, self._states + len(self.free)
        spread = np.zeros((size, size))
        spread[:n, :n], spread[n:, n:] = np.diag(np.square(self.noise.start)), belief.covariance
        self.filter.inputs[:] = drive.inputs[0]
        self.filter.start(Gaussian(np.concatenate([drive.start, belief.mean]), spread))
        course = Course(SENSOR, drive.inputs, drive.sampled_outputs, variance, drive.h)
        nis, memory = self.filter.follow(course, RINSING.history)
        end = self.filter.belief()
        return nis, memory, Gaussian(end.mean[n:], end.covariance[n:, n:])

    def outputs(self, means: Array, inputs: Array) -> Array:
        """What the model's outputs (c, m) are at states with parameters (c, n + p) and inputs (c, k)."""
        outputs = self._outputs.map(len(means))(means.T, inputs.T, np.tile(self._others[:, None], len(means)))
        return np.array(outputs).T

    def moved(self, before: Array, after: Array) -> float:
        """How far the curves moved, of their peaks; without curves, the parameters, of their sizes."""
        if self.curves is None:
            return float(np.abs((after - before) / self.scales).max())
        change = self.curves(self.named(after)) - self.curves(self.named(before))
        return float(np.sqrt((change**2).mean(axis=1)).max())


@dataclass(frozen=True)
class Rinsed:
    """What passes came to: the free parameters (p,), whether the curves stand still, and each pass."""

    values: Array
    settled: bool
    passes: tuple[Pass, ...]


def rinse(
    identifier: Identifier,
    drives: Sequence[Drive],
    schedule: Schedule = OURS,
    *,
    begin: Array | None = None,
    progress: Progress | None = None,
) -> Rinsed:
    """Pass after pass, until the curves stand still (the parameters, where there are no curves) in one that begins with
    the least deviation, or one cannot go on. Raises `FloatingPointError` where the first cannot, even with less
    deviation."""
    values, passes = identifier.begin() if begin is None else begin, list[Pass]()
    for index in range(schedule.passes):
        variance = schedule.variance(passes[-1] if passes else None, identifier.noise.outputs)
        try:
            filter_pass = _cautiously(
                identifier, drives, values, schedule.deviations(index, identifier.scales), variance
            )
        except FloatingPointError:
            if not passes:
                raise
            break
        passes.append(filter_pass)
        values = filter_pass.values
        if progress is not None:
            progress((index + 1) / schedule.passes)
        if filter_pass.moved < schedule.still and schedule.may_end(index):
            break
    if progress is not None:
        progress(1.0)
    return Rinsed(values, passes[-1].moved < schedule.still and index == len(passes) - 1, tuple(passes))


def _cautiously(
    identifier: Identifier, drives: Sequence[Drive], values: Array, deviations: Array, variance: Array
) -> Pass:
    """A pass; with half the deviations where that takes parameters or states to where nothing can be, and again."""
    for attempt in range(RINSING.attempts):
        try:
            return identifier.follow(drives, values, np.diag((deviations / 2**attempt) ** 2), variance)[1]
        except FloatingPointError as error:
            last = error
    raise last


def _outputs(model: Rates, augmented: Augmented) -> ca.Function:
    """(state with parameters, inputs, other parameters) → outputs (m,)."""
    symbols = Symbols(augmented)
    measured = Measurement(SENSOR, lambda x, z, u, p: list(model.measured(x, u, p)), (1.0,) * len(model.outputs))
    return ca.Function(
        "outputs", [symbols.x.vector, symbols.u.vector, symbols.theta.vector], [symbols.measured(measured)[0]]
    )
