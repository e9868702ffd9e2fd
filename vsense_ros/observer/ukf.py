"""Unscented Kalman filter over the whole state of the car, a reference for the errorEKF (Julier & Uhlmann 1997)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Kernel
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.gaussian import whiten
from vsense_ros.model.car.steps import sensor_functions
from vsense_ros.observer.dekf import WholeCar
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.state import DISTURB, FORCE, Q, U

Array = NDArray[np.float64]


class Ukf(Ekf, CarFilter):
    """Sigma points are rows (2k, n) of whole states, the forces among them zero."""

    def __init__(self, car: WholeCar) -> None:
        super().__init__(car)
        self.car: WholeCar = car
        n = car.layout.size
        self.kept = np.r_[0 : FORCE.start, FORCE.stop : n]
        self._block = np.ix_(self.kept, self.kept)
        count = self._count = 2 * len(self.kept)

        def rows(size: int) -> Array:
            return np.zeros((count, size))

        # Arguments of all points; what they share is filled in with the state.
        self._parts = [(rows(s.stop - s.start), s) for s in (Q, U, FORCE, DISTURB)]
        self._shared = [(rows(len(a)), a) for a in (car.inputs, car.parameters, car.effects)]
        state = [part.reshape(-1) for part, _ in (*self._parts, *self._shared)]
        # The step's matrix may be any: that of the mean serves all.
        self._matrices = [(rows(m.size), m.reshape(-1, order="F")) for m in (car.h, car.inverse, car.by_q)]
        step = [*state, *(m.reshape(-1) for m, _ in self._matrices)]
        self._step = Kernel(car.functions["advance"].map(count), step)
        self._dynamics = Kernel(car.functions["dynamics"].map(count), state)
        sensing = sensor_functions(car.car, car.sensor_list)
        self._measures: dict[str, tuple[Kernel, Array]] = {}
        q, u, _, around, inputs, *_ = state
        udot = self._dynamics.results[0].reshape(-1, order="F")
        for name, sensed in car.sensed.items():
            biases = rows(sensed.biases.stop - sensed.biases.start)
            mounting = np.tile(sensed.mounting, count)
            arguments = [q, u, udot, around, inputs, biases.reshape(-1), mounting]
            kernel = Kernel(sensing[car.sensor_list[sensed.index].kind].map(count), arguments)
            self._measures[name] = kernel, biases

    def _points(self) -> Array:
        """Sigma points (2k, n), which the arguments of the functions are set to."""
        deviation = np.sqrt(len(self.kept)) * _root(self.covariance[self._block])
        points = np.tile(self.mean, (self._count, 1))
        points[: len(self.kept), self.kept] += deviation.T
        points[len(self.kept) :, self.kept] -= deviation.T
        for part, elements in self._parts:
            part[:] = points[:, elements]
        for part, value in self._shared:
            part[:] = value
        return points

    def predict(self, h: float) -> None:
        car = self.car
        car.move_effects(h)
        car.respond(h)
        car.kinematics.call()
        process = car.process(h)
        noise = car.noise(h, car.map_road(h, process))
        points = self._points()
        for part, value in self._matrices:
            part[:] = value
        self._step.call()
        q, u = self._step.results
        faster = u.T - points[:, U]
        points[:, Q], points[:, U] = q.T, u.T
        car.relax(points[:, FORCE.start :], h, faster, process)
        self.mean[:] = points.mean(axis=0)
        differences = (points - self.mean)[:, self.kept]
        self.covariance[self._block] = differences.T @ differences / self._count
        car.add_noise(noise)
        car.linearize()

    def _correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        """With the covariances of the sigma points in place of P Hᵀ and H P Hᵀ."""
        expected, across, spread = self._expect(sensor)
        correction = whiten(value - expected, scale * (spread + np.diag(variance)), across.T)
        correction.write(self._whitened, self._factor)
        if 0.0 <= correction.nis <= limit:
            self.mean[self.kept] += correction.error
            remaining = self.covariance[self._block] - correction.projected.T @ correction.projected
            self.covariance[self._block] = 0.5 * (remaining + remaining.T)
            self.car.linearize()  # what the next sensor is compared with
        return correction.nis

    def _expect(self, sensor: str) -> tuple[Array, Array, Array]:
        """What a sensor should measure (m,), covariance with the state (k, m), and its own (m, m) without noise."""
        kernel, biases = self._measures[sensor]
        sensed, points = self.car.sensed[sensor], self._points()
        biases[:] = points[:, sensed.biases]
        if sensed.uses_acceleration:
            self._dynamics.call()
        kernel.call()
        measured = kernel.results[0].T
        expected = measured.mean(axis=0)
        differences = measured - expected
        across = (points - self.mean)[:, self.kept].T @ differences / self._count
        return expected, across, differences.T @ differences / self._count


def _root(covariance: Array) -> Array:
    """Square root of a positive semidefinite matrix."""
    values, vectors = np.linalg.eigh(covariance)
    return vectors * np.sqrt(np.maximum(values, 0.0))
