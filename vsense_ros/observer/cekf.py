"""The continuous extended Kalman filter of the car (CEKF), a reference (Rodríguez 2020, "Kalman filters based on MB
dynamics"; Sanjurjo, Naya, Blanco-Claraco, Torres-Moreno & Giménez-Fernández 2017).

    ẋ = f(x, u) + Σ P Hᵀ R_c⁻¹ (y - h(x)),    Ṗ = A P + P Aᵀ + Q - Σ P Hᵀ R_c⁻¹ H P

A measurement acts all the time until its sensor sends the next one, R_c = R T with the time T between them. In each
step of the integration the model goes on as in the discrete filter, and then what measurements do to the covariance is
solved exactly for a Jacobian that stays: in a step h a measurement of variance R T / h. So nothing is lost by the
integration; what remains is that a value is held that is no longer true, the worse the rarer measurements come.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.gaussian import whiten
from vsense_ros.model.sensors import SensorBase
from vsense_ros.observer.dekf import WholeCar
from vsense_ros.observer.error_ekf import CarFilter

Array = NDArray[np.float64]

LONGEST_STEP = 0.001  # [s] of the integration
SHORTEST_PERIOD, LONGEST_PERIOD = 0.002, 2.0  # [s] that two measurements are taken to be apart


def numbers_held(sensors: Iterable[SensorBase]) -> int:
    """How many numbers the filter keeps in the memory of its car: the time, and of each sensor what it holds."""
    return 1 + sum(2 + 2 * len(sensor.deviations()) for sensor in sensors)


class Cekf(Ekf, CarFilter):
    """On the car without forces beyond the model's, which has room for `numbers_held`."""

    def __init__(self, car: WholeCar) -> None:
        super().__init__(car)
        self.car: WholeCar = car
        self._time, rest = car.extra[:1], car.extra[1:]
        # Of each sensor: when it measured last and how long after the time before [s], what (m,), its variances (m,).
        self._held: dict[str, tuple[Array, Array, Array]] = {}
        for name, sensed in car.sensed.items():
            m = len(car.sensor_list[sensed.index].deviations())
            times, value, variance, rest = np.split(rest, [2, 2 + m, 2 + 2 * m])
            self._held[name] = times, value, variance

    def start(self, belief: Gaussian) -> None:
        """As `Filter.start`; nothing has been measured yet."""
        super().start(belief)
        self._time[0] = 0.0
        for times, value, _ in self._held.values():
            times[:], value[:] = (-LONGEST_PERIOD, LONGEST_PERIOD), np.nan

    def predict(self, h: float) -> None:
        count = max(1, int(np.ceil(h / LONGEST_STEP)))
        for _ in range(count):
            self.car.step(h / count)
            for sensor, (times, value, variance) in self._held.items():
                if np.isfinite(value).any():
                    self._attract(sensor, value, variance * times[1], h / count)
            self._time += h / count
        if not np.isfinite(self.mean).all():
            raise FloatingPointError("the continuous filter left the finite")

    def _attract(self, sensor: str, value: Array, density: Array, h: float) -> None:
        """What a measurement of a spectral density (m,) does in `h` [s]."""
        residual, by_error = self.car.sense(sensor, value)
        across = by_error @ self.covariance
        found = whiten(residual, across @ by_error.T + np.diag(density / h), across)
        if found.nis >= 0:
            self.covariance -= found.projected.T @ found.projected
            self.car.retract(found.error)

    def _correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        """Told as a discrete filter would find it; the measurement acts from now on."""
        residual, by_error = self.car.sense(sensor, value)
        across = by_error @ self.covariance
        found = whiten(residual, scale * (across @ by_error.T + np.diag(variance)), across)
        found.write(self._whitened, self._factor)
        times, held, held_variance = self._held[sensor]
        times[:] = self._time[0], np.clip(self._time[0] - times[0], SHORTEST_PERIOD, LONGEST_PERIOD)
        held[:], held_variance[:] = value if found.nis <= limit else np.nan, variance * scale
        return found.nis
