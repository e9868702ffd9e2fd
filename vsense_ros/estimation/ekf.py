"""The extended Kalman filter in error coordinates (Jazwinski 1970, section 8.3; Solà 2017, section 6).

The error δ of the state is what has a covariance: the true state is x ⊞ δ. With ⊞ = + it is the textbook's filter. A
correction whitens the innovation, with L Lᵀ = H P Hᵀ + R and W = P Hᵀ L⁻ᵀ, and P ← P - W Wᵀ: symmetric to the last bit,
and a third of Joseph's work (docs/covariance.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Course, Followed, Gaussian, Given, Innovation, Measured, Step
from vsense_ros.estimation.gaussian import COMPONENTS, GaussianFilter, Whitened, check_variances, whiten
from vsense_ros.estimation.linearised import Linearised


class Ekf(GaussianFilter):
    """The extended Kalman filter of any linearised system: compiled where the system is, else in NumPy."""

    in_c: ClassVar[bool] = True  # operations.c knows the step

    def __init__(self, system: Linearised) -> None:
        self.system = system
        self.memory, self.inputs = system.memory, system.inputs
        self.mean, self.covariance = system.mean, system.covariance
        self.names, self.sensors = system.names, system.sensors
        self._operations = system.operations if self.in_c else None
        if self._operations is None:
            self._whitened, self._factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS**2)
        else:
            self._whitened, self._factor = self._operations.whitened, self._operations.factor
        self._views = [_views(self._whitened, self._factor, m) for m in range(COMPONENTS + 1)]

    def at(self, memory: Array) -> Ekf:
        """This filter with its memory in another array (s,): for filters that contain others.

        Raises `InputError` if its system cannot do that.
        """
        place = getattr(self.system, "at", None)
        if place is None:
            raise InputError(f"a filter of {type(self.system).__name__} cannot be a part of another filter")
        return Ekf(place(memory))

    def start(self, belief: Gaussian) -> None:
        """As `GaussianFilter.start`; inputs that the system needs must be there before."""
        self.check(belief)
        self.system.start(belief)
        self.system.linearize()

    def predict(self, h: float) -> None:
        """Go on by `h` [s]."""
        if self._operations is not None:
            self._operations.predict(h)
        else:
            self.system.step(h)

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """As `Filter.correct`. A covariance that has lost positive definiteness is reported, and reset."""
        if len(variance) != len(value):
            check_variances(sensor, value, variance)
        if self._operations is not None:
            nis = self._operations.correct(sensor, value, variance, limit, scale)
        else:
            nis = self._correct(sensor, value, variance, limit, scale)
        if nis != nis:
            self.recover(sensor)
        whitened, factor = self._views[len(value)]
        return Innovation(whitened, factor, nis, 0.0 <= nis <= limit)

    def _correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        """What algebra.c does, in NumPy."""
        innovation = self._innovation(sensor, value, variance, scale)
        innovation.write(self._whitened, self._factor)
        if 0.0 <= innovation.nis <= limit:
            self.covariance -= innovation.projected.T @ innovation.projected
            self.system.retract(innovation.error)
        return innovation.nis

    def _innovation(self, sensor: str, value: Array, variance: Array, scale: float) -> Whitened:
        """Innovation of a measurement with its covariance scale (H P Hᵀ + R), in independent units."""
        residual, by_error = self.system.sense(sensor, value)
        across = by_error @ self.covariance
        return whiten(residual, scale * (across @ by_error.T + np.diag(variance)), across)

    def is_valid(self) -> bool:
        """True if the state is finite and within its bounds, and the variances are positive."""
        return self.system.is_valid() if self._operations is None else self._operations.is_valid()

    def advance(self, step: Step) -> bool:
        """As `Filter.advance`, in one call where the system is compiled."""
        if self._operations is not None:
            return self._operations.advance(step)
        return super().advance(step)

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        """As `Filter.repeat`, in one call where the system is compiled."""
        if self._operations is not None:
            return self._operations.repeat(events)
        return super().repeat(events)

    def follow(self, course: Course, every: int = 0) -> Followed:
        """As `Filter.follow`, in one call where the system is compiled."""
        if self._operations is not None:
            return self._operations.follow(course, self.memory.size, every)
        return super().follow(course, every)


def _views(whitened: Array, factor: Array, m: int) -> tuple[Array, Array]:
    """The parts that a measurement with m components fills."""
    return whitened[:m], factor[: m * m].reshape(m, m)
