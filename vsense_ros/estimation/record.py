"""A run of an extended Kalman filter that is kept step by step: for smoothers and for what could be observed."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Filter, Gaussian, Innovation


class Used(NamedTuple):
    """A measurement as a filter was given it: value and variances (m,), the inputs (k,) of the system then, and the
    largest normalized innovation squared that is believed."""

    sensor: str
    value: Array
    variance: Array
    inputs: Array
    limit: float


@dataclass
class Instant:
    """One time of a run: beliefs before and after its corrections, F (e, e) from the last instant to this one, and the
    information Σ Hᵀ R⁻¹ H (e, e) of its measurements. The step that led to it had the inputs (k,) `inputs`, and began
    with a covariance that something outside of the filter had raised by `widened` (e, e), None where nothing had."""

    time: float  # [s] since the start
    transition: Array
    before: Gaussian
    after: Gaussian
    information: Array
    inputs: Array
    widened: Array | None = None
    used: list[Used] = field(default_factory=list)


class Record(Filter):
    """A filter that does what the given one does, and keeps each step in `instants`, at most `length` of them."""

    def __init__(self, filter: Ekf, length: int | None = None) -> None:
        if not isinstance(filter.system, Dense):
            raise InputError(
                f"only filters of a state space can be recorded, not one of {type(filter.system).__name__}"
            )
        self.filter, self.system, self.length = filter, filter.system, length
        self.memory, self.inputs, self.names, self.sensors = filter.memory, filter.inputs, filter.names, filter.sensors
        self.instants: list[Instant] = []

    def start(self, belief: Gaussian) -> None:
        """As the filter does; what was kept is forgotten."""
        self.filter.start(belief)
        now, e = self.filter.belief(), len(self.filter.covariance)
        self.instants = [Instant(0.0, np.eye(e), now, now, np.zeros((e, e)), self.inputs.copy())]

    def predict(self, h: float) -> None:
        """As the filter does; a new instant."""
        inputs, widened = self.inputs.copy(), self.filter.covariance - self.instants[-1].after.covariance
        self.filter.predict(h)
        now = self.filter.belief()
        transition = self.system.transition_matrix
        time, nothing = self.instants[-1].time + h, np.zeros_like(transition)
        self.instants.append(Instant(time, transition, now, now, nothing, inputs, widened if widened.any() else None))
        if self.length is not None and len(self.instants) > self.length:
            del self.instants[0]

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """As the filter does, kept with the present instant."""
        residual, by_error = (part.copy() for part in self.system.sense(sensor, value))
        given = np.asarray(value, dtype=float).copy(), scale * np.asarray(variance, dtype=float)
        self.instants[-1].used.append(Used(sensor, *given, self.inputs.copy(), limit))
        innovation = self.filter.correct(sensor, value, variance, limit, scale)
        if innovation.accepted:
            present = np.isfinite(residual)
            h = by_error[present]
            self.instants[-1].information += h.T @ (h / np.asarray(variance)[present, None])
            self.instants[-1].after = self.filter.belief()
        return innovation

    def belief(self) -> Gaussian:
        """As the filter."""
        return self.filter.belief()

    def is_valid(self) -> bool:
        """As the filter."""
        return self.filter.is_valid()

    def inflate(self) -> None:
        """As the filter."""
        self.filter.inflate()
        self.instants[-1].after = self.filter.belief()
