"""UKF over the whole state, a reference for the errorEKF: no Jacobians, but a car for every sigma point.

With as many states as here the weight of the mean is zero (κ = 0), which keeps all weights positive; the points are
then those of the cubature filter (Julier & Uhlmann 1997; Arasaratnam & Haykin 2009).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.car import car_of
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.steps import model_functions, sensor_functions
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.kalman import FORCE, SURROUND, Q, U
from vsense_ros.observer.whole_state import WholeState

Array = NDArray[np.float64]


class Ukf(WholeState):
    """Sigma points are columns (n, 2k) of whole states, the forces among them zero."""

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        super().__init__(vehicle, sensors)
        car = car_of(vehicle)
        self._count = 2 * len(self.kept)
        functions = model_functions(car)
        self._dynamics, self._step = (functions[name].map(self._count) for name in ("dynamics", "advance"))
        sensing = sensor_functions(car, self.sensors)
        self._measure = [None if s.is_input else sensing[s.kind].map(self._count) for s in self.sensors]

    def _points(self) -> Array:
        deviation = np.sqrt(len(self.kept)) * _root(self.covariance[self._block])
        points = np.tile(self.state[:, None], self._count)
        points[self.kept, : len(self.kept)] += deviation
        points[self.kept, len(self.kept) :] -= deviation
        return points

    def _arguments(self, points: Array) -> list[Array]:
        same = (np.tile(a[:, None], self._count) for a in (self.inputs, self.parameters, self._effects))
        return [*(points[part] for part in (Q, U, FORCE, SURROUND)), *same]

    def predict(self, h: float) -> None:
        self._move_effects(h)
        self._kalman.transition(h)
        points = self._points()
        # The step's matrix may be any: that of the mean serves all.
        inverse, by_q = (np.tile(m, self._count) for m in (self._kalman.inverse, self._linearize.results[1]))
        q, u = self._step(*self._arguments(points), np.full((1, self._count), h), inverse, by_q)
        points[Q], points[U] = np.asarray(q), np.asarray(u)
        points[FORCE.start :] *= self._process(h).decay[:, None]
        self.state[:] = points.mean(axis=1)
        apart = (points - self.state[:, None])[self.kept]
        self.covariance[self._block] = apart @ apart.T / self._count + np.diag(self.noise(h))

    def expect(self, index: int) -> tuple[Array, Array, Array]:
        sensor, measure = self.sensors[index], self._measure[index]
        assert measure is not None, "inputs have no innovation"
        points = self._points()
        arguments = self._arguments(points)
        udot = np.asarray(self._dynamics(*arguments)[0]) if sensor.uses_acceleration else np.zeros((14, self._count))
        q, u, _, around, inputs, *_ = arguments
        mounting = np.tile(np.asarray(sensor.mounting(), dtype=float)[:, None], self._count)
        measured = np.asarray(measure(q, u, udot, around, inputs, points[self.layout.biases[index]], mounting)[0])
        expected = measured.mean(axis=1)
        apart = measured - expected[:, None]
        across = (points - self.state[:, None])[self.kept] @ apart.T / self._count
        return expected, across, apart @ apart.T / self._count


def _root(covariance: Array) -> Array:
    """Square root of a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))
