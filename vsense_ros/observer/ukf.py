"""UKF over the whole state, a reference for the errorEKF: no Jacobians, but a car for every sigma point.

With as many states as here the weight of the mean is zero (κ = 0), which keeps all weights positive; the points are
then those of the cubature filter (Julier & Uhlmann 1997; Arasaratnam & Haykin 2009).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Kernel
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import model_functions, sensor_functions
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.kalman import FORCE, SURROUND, Q, U
from vsense_ros.observer.whole_state import WholeState

Array = NDArray[np.float64]


class Ukf(WholeState):
    """Sigma points are rows (2k, n) of whole states, the forces among them zero."""

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        super().__init__(vehicle, sensors)
        car = car_of(vehicle)
        functions, sensing = model_functions(car), sensor_functions(car, self.sensors)
        count = self._count = 2 * len(self.kept)

        def rows(size: int) -> Array:
            return np.zeros((count, size))

        # Arguments of all points; what they share is filled in with the state.
        self._parts = [(rows(s.stop - s.start), s) for s in (Q, U, FORCE, SURROUND)]
        self._shared = [(rows(len(a)), a) for a in (self.inputs, self.parameters, self._effects)]
        state = [part.reshape(-1) for part, _ in (*self._parts, *self._shared)]
        inverse, by_q = self._kalman.inverse, self._linearize.results[1]
        # The step's matrix may be any: that of the mean serves all.
        self._matrices = [(rows(m.size), m.reshape(-1, order="F")) for m in (self._h, inverse, by_q)]
        step = [*state, *(m.reshape(-1) for m, _ in self._matrices)]
        self._step = Kernel(functions["advance"].map(count), step)
        self._dynamics = Kernel(functions["dynamics"].map(count), state)
        self._measures: list[tuple[Kernel, Array] | None] = [None] * len(self.sensors)
        q, u, _, around, inputs, *_ = state
        udot = self._dynamics.results[0].reshape(-1, order="F")
        for i, sensor in enumerate(self.sensors):
            if not sensor.is_input:
                biases = rows(len(sensor.biases()))
                mounting = np.tile(np.asarray(sensor.mounting(), dtype=float), count)
                arguments = [q, u, udot, around, inputs, biases.reshape(-1), mounting]
                self._measures[i] = Kernel(sensing[sensor.kind].map(count), arguments), biases

    def _points(self) -> Array:
        """Sigma points (2k, n), which the arguments of the functions are set to."""
        deviation = np.sqrt(len(self.kept)) * _root(self.covariance[self._block])
        points = np.tile(self.state, (self._count, 1))
        points[: len(self.kept), self.kept] += deviation.T
        points[len(self.kept) :, self.kept] -= deviation.T
        for part, where in self._parts:
            part[:] = points[:, where]
        for part, value in self._shared:
            part[:] = value
        return points

    def predict(self, h: float) -> None:
        self._move_effects(h)
        self._kalman.transition(h)
        points = self._points()
        for part, value in self._matrices:
            part[:] = value
        self._step.call()
        q, u = self._step.results
        points[:, Q], points[:, U] = q.T, u.T
        self._relax(points[:, FORCE.start :], self._process(h))
        self.state[:] = points.mean(axis=0)
        apart = (points - self.state)[:, self.kept]
        self.covariance[self._block] = apart.T @ apart / self._count + np.diag(self.noise(h))

    def expect(self, index: int) -> tuple[Array, Array, Array]:
        measure = self._measures[index]
        assert measure is not None, "inputs have no innovation"
        kernel, biases = measure
        points = self._points()
        biases[:] = points[:, self.layout.biases[index]]
        if self.sensors[index].uses_acceleration:
            self._dynamics.call()
        kernel.call()
        measured = kernel.results[0].T
        expected = measured.mean(axis=0)
        apart = measured - expected
        across = (points - self.state)[:, self.kept].T @ apart / self._count
        return expected, across, apart.T @ apart / self._count


def _root(covariance: Array) -> Array:
    """Square root of a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))
