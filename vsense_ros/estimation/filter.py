"""What everything outside of a filter may do with one: a timeline, a monitor, a report, an exporter."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Gaussian(NamedTuple):
    """A normal distribution of a state: `mean` (n,) and `covariance` (e, e) of its error."""

    mean: Array
    covariance: Array


class Innovation(NamedTuple):
    """What a correction found.

    `whitened` (m,): the innovation in independent units, white and of unit deviation if the filter is right, NaN where
    nothing came. `factor` (m, m): the lower Cholesky factor of its covariance, with which it was whitened; absent
    components stand for themselves, with 1 on the diagonal. The diagonal are the standard deviations of the components
    given those before them. Both are views, valid until the next correction. `nis`: the squared norm of `whitened`, the
    normalized innovation squared; negative where nothing came, NaN where the covariance is not positive definite.
    `accepted`: whether it corrected the state.
    """

    whitened: Array
    factor: Array
    nis: float
    accepted: bool


class Kept(NamedTuple):
    """A copy of a filter's memory, and the address of the array for C."""

    memory: Array
    address: int


class Step(NamedTuple):
    """The way to a time: `steps` predictions of `h` [s] each, before which the memory is copied to `kept`."""

    kept: Kept
    steps: int
    h: float


class Measured(NamedTuple):
    """A measurement of `sensor`, with its variances (m,) and the largest normalized innovation squared believed."""

    sensor: str
    value: Array
    variance: Array
    limit: float


class Given(NamedTuple):
    """Values for the inputs from `first` on; NaN leaves an input as it is."""

    first: int
    value: Array


class Course(NamedTuple):
    """One sensor at a constant rate: N samples, `h` [s] apart, of `inputs` (N, k) and of `values` (N, m) with these
    variances (m,). Inputs change linearly from one sample to the next."""

    sensor: str
    inputs: Array
    values: Array
    variance: Array
    h: float


class Followed(NamedTuple):
    """Normalized innovations squared (N,), and copies of the memory before every so manieth correction (c, s)."""

    nis: Array
    memory: Array


def impossible_at(sample: int, course: Course) -> FloatingPointError:
    """What to raise where a filter could not go on at a sample."""
    return FloatingPointError(
        f"the filter cannot go on {sample * course.h:.2f} s after the start: its state would be none that can be"
    )


def largest_nis(gate: float, components: int) -> float:
    """Normalized innovation squared up to which a measurement is believed that may be off by `gate` standard
    deviations: its expectation grows with the components, its spread with their square root."""
    return float(gate**2 * components**0.5)


class Filter(ABC):
    """`memory` (s,) holds all that changes: whoever copies it and puts it back has the filter as it was, bit by bit."""

    memory: Array
    inputs: Array  # (k,), a part of memory
    names: tuple[str, ...]  # of all that is estimated, (m,)
    sensors: tuple[str, ...]  # that `correct` knows

    @abstractmethod
    def start(self, belief: Gaussian) -> None:
        """Begin anew, at a mean and a covariance."""

    @abstractmethod
    def predict(self, h: float) -> None:
        """Go on by `h` [s]. Raises `FloatingPointError` where that is impossible; the memory is then spoilt."""

    @abstractmethod
    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """Use a measurement (m,) with these variances (m,), unless its normalized innovation squared exceeds `limit`.

        NaN components are absent. `scale` multiplies the covariance of the innovation: more than 1 pulls the state
        towards a measurement that is not believed.
        """

    @abstractmethod
    def belief(self) -> Gaussian:
        """All that is estimated, in the order of `names`: mean (m,) and covariance of the errors (m, m)."""

    @abstractmethod
    def is_valid(self) -> bool:
        """True if the state is finite and within its bounds, and the covariance is definite."""

    @abstractmethod
    def inflate(self) -> None:
        """Forget how errors belong together, and double their standard deviations: after something went wrong."""

    def backup(self) -> Kept:
        """A place where the memory may be kept; what is in it is undefined."""
        memory = np.empty_like(self.memory)
        return Kept(memory, memory.ctypes.data)

    def advance(self, step: Step) -> bool:
        """Keep the memory, then predict. False, and the filter is as it was, if it is not valid or cannot be moved."""
        if not self.is_valid():
            return False
        step.kept.memory[:] = self.memory
        try:
            for _ in range(step.steps):
                self.predict(step.h)
        except (FloatingPointError, np.linalg.LinAlgError):
            self.memory[:] = step.kept.memory
            return False
        return True

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        """Let events happen, each after its step, up to one that the filter could not move to or did not believe.

        Returns how many happened, whether the filter moved to the one that did not, and the normalized innovation
        squared of each (0 for inputs). A filter that is compiled does all of them in one call.
        """
        squares: list[float] = []
        for step, event in events:
            if step is not None and not self.advance(step):
                return len(squares), False, squares
            if isinstance(event, Given):
                self.give(event)
                squares.append(0.0)
                continue
            nis = self.correct(event.sensor, event.value, event.variance, event.limit).nis
            if not nis <= event.limit:
                return len(squares), True, [*squares, nis]
            squares.append(nis)
        return len(squares), False, squares

    def follow(self, course: Course, every: int = 0) -> Followed:
        """Go along a course: correct, step, correct … A step has the mean of the inputs at its two ends; with those of
        one end they would be half a step late.

        A filter that is compiled does all of it in one call. With `every` the memory before every `every`-th correction
        is kept. Raises `FloatingPointError` where the filter cannot go on.
        """
        count, nis, kept = len(course.values), np.full(len(course.values), np.nan), []
        for k, (inputs, value) in enumerate(zip(course.inputs, course.values, strict=True)):
            self.inputs[:] = inputs
            if not self.is_valid():
                raise impossible_at(k, course)
            if every and k % every == 0:
                kept.append(self.memory.copy())
            nis[k] = self.correct(course.sensor, value, course.variance).nis
            if nis[k] != nis[k]:
                raise impossible_at(k, course)
            if k + 1 < count:
                self.inputs[:] = (inputs + course.inputs[k + 1]) / 2
                self.predict(course.h)
        if not self.is_valid():
            raise impossible_at(count - 1, course)
        return Followed(nis, np.array(kept).reshape(-1, self.memory.size))

    def give(self, given: Given) -> None:
        """Take values for inputs."""
        for place, number in enumerate(given.value.tolist(), given.first):
            if isfinite(number):
                self.inputs[place] = number
