"""The continuous extended Kalman filter (CEKF), a reference to compare discrete filters with.

    ẋ = f(x, u) + Σ P Hᵀ R_c⁻¹ (y - h(x)),    Ṗ = A P + P Aᵀ + Q - Σ P Hᵀ R_c⁻¹ H P

(Kalman & Bucy 1961, linearised; the CEKF of Rodríguez 2020 and of Sanjurjo, Naya, Blanco-Claraco, Torres-Moreno &
Giménez-Fernández 2017.) A measurement acts all the time until its sensor sends the next one, R_c = R T with the time T
between them. In each step of the integration the system goes on as in the discrete filter, and then what measurements
do to the covariance is solved exactly for a Jacobian that stays: in a step h a measurement of variance R T / h. So
nothing is lost by the integration, and the covariance stays positive definite however long the steps are; what remains
is that a value is held that is no longer true, the worse the rarer measurements come.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.linearised import Linearised


@dataclass(frozen=True)
class ContinuousSettings:
    """How a continuous filter is integrated, and how long it holds a measurement."""

    longest_step: float = 0.001  # [s] of the integration: short beside the 4 ms between two readings of an IMU
    # [s] between two measurements of a sensor, at least and at most: 500 Hz is the fastest bus of a car, and a sensor
    # that has been silent for longer than 2 s begins anew.
    shortest_period: float = 0.002
    longest_period: float = 2.0


class _Held(NamedTuple):
    """The measurement of one sensor that acts at present, as parts of the filter's memory."""

    times: Array  # (2,) [s]: when it was made, and how long after the one before
    value: Array  # (m,), NaN where nothing acts
    variance: Array  # (m,)


def numbers_held(components: Iterable[int]) -> int:
    """How many `extra` numbers a filter of sensors with these numbers of components keeps in its system's memory."""
    return 1 + sum(2 + 2 * m for m in components)


class Cekf(Ekf):
    """The continuous filter of a linearised system, in whose memory there is place for `numbers_held` extra numbers."""

    in_c: ClassVar[bool] = False  # the steps of operations.c are those of the discrete filter

    def __init__(self, system: Linearised, settings: ContinuousSettings | None = None) -> None:
        super().__init__(system)
        self.settings = ContinuousSettings() if settings is None else settings
        self._time, rest = system.extra[:1], system.extra[1:]
        self._held: dict[str, _Held] = {}
        for name, m in system.components.items():
            times, value, variance, rest = np.split(rest, [2, 2 + m, 2 + 2 * m])
            self._held[name] = _Held(times, value, variance)

    def start(self, belief: Gaussian) -> None:
        """Begin anew, as `Filter.start`; nothing has been measured yet."""
        super().start(belief)
        self._time[0] = 0.0
        longest = self.settings.longest_period
        for held in self._held.values():
            held.times[:], held.value[:] = (-longest, longest), np.nan

    def predict(self, h: float) -> None:
        """Go on by `h` [s]. Raises `FloatingPointError` where the state leaves the finite."""
        count = max(1, int(np.ceil(h / self.settings.longest_step)))
        for _ in range(count):
            self.system.step(h / count)
            for sensor, held in self._held.items():
                if np.isfinite(held.value).any():
                    self._attract(sensor, held.value, held.variance * held.times[1] / (h / count))
            self._time += h / count
        if not np.isfinite(self.mean).all():
            raise FloatingPointError("the continuous filter left the finite")

    def _attract(self, sensor: str, value: Array, variance: Array) -> None:
        """Correct by a measurement that acts during one step, in which it has this variance (m,)."""
        innovation = self._innovation(sensor, value, variance, 1.0)
        if innovation.nis >= 0:
            self.covariance -= innovation.projected.T @ innovation.projected
            self.system.retract(innovation.error)

    def _correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        """Take a measurement, which acts from now on; its innovation is reported as a discrete filter would find it."""
        innovation = self._innovation(sensor, value, variance, scale)
        innovation.write(self._whitened, self._factor)
        shortest, longest = self.settings.shortest_period, self.settings.longest_period
        times, held, held_variance = self._held[sensor]
        times[:] = self._time[0], np.clip(self._time[0] - times[0], shortest, longest)
        held[:], held_variance[:] = value if innovation.nis <= limit else np.nan, variance * scale
        return innovation.nis
