"""SPI: state, parameter and input observer (Rodríguez 2020): the errorEKF, and a parameter filter coupled to it.

Unlike the slides' two filters, which each take the other's mean for the truth, the two here know how far the errors of
state and inputs come from those of the parameters; `parameter_filter` says how.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.compiled_step import Learned
from vsense_ros.observer.error_ekf import ErrorEkf, layout
from vsense_ros.observer.kalman import FORCE, SURROUND, Q, U
from vsense_ros.observer.parameter_ekf import ParameterEkf
from vsense_ros.observer.parameter_filter import ParameterFilter
from vsense_ros.observer.parameter_ukf import ParameterUkf

Array = NDArray[np.float64]

PARTS = (Q, U, FORCE, SURROUND)
FILTERS: dict[str, type[ParameterFilter]] = {"ekf": ParameterEkf, "ukf": ParameterUkf}
TOLD = 0.5  # a parameter counts as told once its standard deviation is this share of the one at start
_LEAST = 1e-6  # information of a lively drive on a parameter, over its own size, below which it has no effect
_STEP = 0.01  # [s] of that drive


@dataclass(frozen=True)
class Observability:
    """What a recording so far tells of the parameters, whatever state and forces were.

    `deviation` (k,) are the standard deviations, `share` (k,) the same over those at start. `information` (k,) are the
    eigenvalues of the Fisher information in units of what was known at start: one of 3 halves a standard deviation, and
    those above 1 count in `rank`. `correlation` (k, k) is that of the errors now: close to ±1 where only a combination
    is told.
    """

    names: tuple[str, ...]
    deviation: Array
    share: Array
    information: Array
    correlation: Array

    @property
    def told(self) -> tuple[str, ...]:
        """Parameters that are known at least twice as well as at start."""
        return tuple(name for name, share in zip(self.names, self.share, strict=True) if share <= TOLD)

    @property
    def rank(self) -> int:
        """Number of independent combinations of parameters of which the recording tells more than was known."""
        return int(np.sum(self.information > 1))

    def __str__(self) -> str:
        rest = [name for name in self.names if name not in self.told]
        told = f"told so far: {', '.join(self.told) or 'nothing'}"
        return told + (f"; not yet: {', '.join(rest)}" if rest else "")


class Spi(ErrorEkf):
    """The errorEKF of a vehicle whose file lists `observer.parameters`, with the filter of these.

    `covariance` is that of the state for known parameters, `parameter_covariance` (k, k) that of the parameters, and
    `sensitivity` (n, k) what couples them. `information` (k, k) is what the measurements since the start told of the
    parameters, the inverse of the covariance they alone would give.
    """

    at_once = True
    filters: ClassVar[dict[str, type[ParameterFilter]]] = FILTERS

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        settings = vehicle.observer.parameters
        self.parameter_names = tuple(settings)
        n, k = layout(sensors).size, len(settings)
        known = k + k * k + n * k + k * k
        super().__init__(vehicle, sensors, extra=known + 14 * k)
        self._learned, effect = self.extra[:known], self.extra[known:]
        parts = np.split(self._learned, np.cumsum([k, k * k, n * k]).tolist())
        self.values = parts[0]
        self.parameter_covariance, self.information = (parts[i].reshape(k, k) for i in (1, 3))
        self.sensitivity = parts[2].reshape(k, n).T
        car = car_of(vehicle)
        self._columns = np.array([car.parameter_names.index(name) for name in settings])
        self._initial = self.parameters[self._columns]
        self.prior_deviation = np.array([s.deviation for s in settings.values()])
        bounds = [s.bounds(value) for s, value in zip(settings.values(), self._initial, strict=True)]
        lower, upper = (np.array(b) for b in zip(*bounds, strict=True))
        self.lower, self.upper = lower, upper
        drift = np.array([s.drift for s in settings.values()]) ** 2
        self._drifts = bool(drift.any())
        biases = tuple((where.start, where.stop) for where in self.layout.biases)
        kind, columns = self.filters[vehicle.observer.parameter_filter], tuple(self._columns.tolist())
        self._filter = kind(car, columns, n)
        self._others = np.zeros((self._filter.elsewhere, 14)).T  # accelerations of cars that act elsewhere
        functions = _functions(kind, car, columns, n, self.sensors, biases)
        q, u, force, around = (self.state[s] for s in PARTS)
        flat = [m.reshape(-1, order="F") for m in self._linearize.results[:4]]
        s, m = parts[2], parts[1]
        arguments = [q, u, force, around, self.inputs, self.parameters, *flat, s, m, self._effects]
        arguments += [self._others.T.reshape(-1)] if self._filter.elsewhere else []
        self._effect = Kernel(functions["parameters_effect"], arguments, effect)
        kinematics = [r.reshape(-1, order="F") for r in self._kinematics.results]
        self._decay = np.zeros(n - U.stop)
        gain = self._kalman.gain.reshape(-1)
        self._spread = Kernel(
            functions["parameters_predict"], [s, m, effect, drift, gain, *kinematics, self._h, self._decay]
        )
        self._seen: list[Learned | None] = [None] * len(self.sensors)
        for i, sensor in enumerate(self.sensors):
            sense = self._sense[i]
            if sense is None:
                continue
            variance, size = sensor.deviations() ** 2, len(sensor.deviations())
            mounting = np.asarray(sensor.mounting(), dtype=float)
            sensed = [r.reshape(-1, order="F") for r in sense.results[1:]]
            bias = self.state[self.layout.biases[i]]
            whitened, factor = self._kalman.whitened[:size], self._kalman.factor[: size * size]
            seen = Kernel(
                functions[f"seen_{i}"], [*arguments, effect, bias, mounting, variance, whitened, factor, *sensed]
            )
            g, told, d = (r.reshape(-1, order="F") for r in seen.results[1:])
            told_of, projected = seen.results[0].T, np.zeros(seen.results[0].T.shape)
            learned = np.zeros(known + n + 14)
            found = [projected.reshape(-1), g, told, d, parts[3], parts[0], lower, upper]
            learn = Kernel(functions["parameters_learn"], [*arguments, effect, *found], learned)
            told, change, udot = np.split(learned, [known, known + n])
            self._seen[i] = Learned(seen, variance, whitened, factor, told_of, projected, learn, told, change, udot)
        self._added_force = self._force.results[0].reshape(-1, order="F")
        self._accelerations = self.udot.reshape(-1, order="F")
        moved, grown, added = (r.reshape(-1, order="F") for r in self._spread.results)
        if self._in_c is not None and not self._in_c.learn(
            (self._effect, self._spread),
            self._drifts,
            self._columns,
            {
                "learned": self._learned,
                "sensitivity": s,
                "covariance": m,
                "decay": self._decay,
                "physical": self.parameters,
                "moved": moved,
                "grown": grown,
                "added": added,
            },
            self._seen,
        ):
            self._in_c = None
        self._refuse_what_cannot_be_told()

    def _refuse_what_cannot_be_told(self) -> None:
        """Drive a little and see what the sensors would tell if state and forces were known: no less can they tell.

        Raises `InputError` for a parameter without any effect on what is measured.
        """
        told, scale = np.zeros(len(self.parameter_names)), np.maximum(self.prior_deviation, np.abs(self._initial))
        for speed in (1.0, 8.0, 25.0):
            self.start(speed)
            for i in range(30):
                self.inputs[:] = np.array([0.08, 0.0, 0.0, 150.0, 150.0]) * np.sin(0.4 * i + 0.5)
                self.linearize()
                for sense, known in zip(self._sense, self._seen, strict=True):
                    if sense is not None and known is not None:
                        sense.call()
                        known.whitened[:], known.factor[:] = 0.0, np.diag(known.variance**0.5).flat
                        known.seen.call()
                        _, g, _, spread = known.seen.results
                        regression = spread.T @ np.linalg.inv(self.parameter_covariance) * scale
                        told += np.einsum("pk,pq,qk->k", regression, g, regression)
                self.predict(_STEP)
        for name, information in zip(self.parameter_names, told, strict=True):
            if not information > _LEAST:
                kinds = ", ".join(sensor.kind for sensor in self.sensors) or "none"
                raise InputError(
                    f"{self.vehicle.name}: {name} cannot be estimated: it changes nothing that the sensors ({kinds}) "
                    "measure, however the car is driven; take it out of observer.parameters, or add a sensor on which "
                    "it has an effect"
                )
        self.memory[:] = 0.0
        self.parameters[:] = self.vehicle.parameter_vector()
        self._reset()

    def _reset(self) -> None:
        self.values[:] = self._initial
        self.parameters[self._columns] = self._initial
        self.parameter_covariance[:] = np.diag(self.prior_deviation**2)
        self.sensitivity[:] = 0.0
        self.information[:] = 0.0

    def start(self, speed: float) -> None:
        self._reset()
        super().start(speed)

    def place(self, index: int, value: float, deviation: float) -> None:
        super().place(index, value, deviation)
        self.sensitivity[index] = 0.0

    def lose_trust(self) -> None:
        super().lose_trust()
        self.sensitivity[:] = 0.0

    def linearize(self) -> None:
        super().linearize()
        self._effect.call()

    def predict(self, h: float) -> None:
        super().predict(h)
        if self._in_c is None:
            self._move_parameters(h)

    def _move_parameters(self, h: float) -> None:
        """What a step of `h` [s], which has just been made, changes of what is known of the parameters."""
        self._h[0], self._decay[:] = h, self._process(h).decay
        self._spread.call()
        sensitivity, covariance, added = self._spread.results
        self.sensitivity[:] = sensitivity
        if self._drifts:
            self.parameter_covariance[:] = covariance
            self.covariance += added @ added.T

    def correct(self, index: int, value: Array, variance: Array, limit: float, scale: float = 1.0) -> float:
        nis = super().correct(index, value, variance, limit, scale)
        known = self._seen[index] if self._in_c is None else None
        if scale == 1.0 and known is not None and 0 <= nis <= limit:  # what is forced upon the filter tells nothing
            self._learn(known, variance)
        return nis

    def _learn(self, known: Learned, variance: Array) -> None:
        """What a measurement by which the state has just been corrected tells of the parameters."""
        known.variance[:] = variance
        known.seen.call()
        np.dot(self.covariance, known.told_of, out=known.projected)
        known.learn.call()
        self._learned[:] = known.learned
        self.parameters[self._columns] = self.values
        change = known.change
        self._error[FORCE] = change[FORCE]
        self._force.call()
        change[FORCE] = self._added_force
        self.state += change
        self._accelerations += known.udot

    @property
    def names(self) -> tuple[str, ...]:
        return self.layout.names + self.parameter_names

    def estimated(self) -> tuple[Array, Array]:
        m, s = self.parameter_covariance, self.sensitivity
        across = s @ m
        return np.append(self.state, self.values), np.block([[self.covariance + across @ s.T, across], [across.T, m]])

    def at_bounds(self) -> tuple[str, ...]:
        """Parameters that would be elsewhere if their bounds let them: something else is wrong with the car."""
        there = (self.values <= self.lower) | (self.values >= self.upper)
        return tuple(name for name, is_there in zip(self.parameter_names, there, strict=True) if is_there)

    def observability(self) -> Observability:
        """What the measurements since the start told of the parameters."""
        prior = self.prior_deviation
        deviation = np.sqrt(np.diag(self.parameter_covariance))
        return Observability(
            self.parameter_names,
            deviation,
            deviation / prior,
            np.linalg.eigvalsh(prior[:, None] * self.information * prior),
            self.parameter_covariance / np.outer(deviation, deviation),
        )


@cache
def _functions(
    kind: type[ParameterFilter],
    car: Car,
    columns: tuple[int, ...],
    size: int,
    sensors: tuple[SensorBase, ...],
    biases: tuple[tuple[int, int], ...],
) -> dict[str, ca.Function]:
    made = kind(car, columns, size)
    functions = [made.effect(), made.predict(), made.learn()]
    functions += [
        made.seen(f"seen_{i}", sensor, slice(*where))
        for i, (sensor, where) in enumerate(zip(sensors, biases, strict=True))
        if not sensor.is_input
    ]
    return {f.name(): f for f in codegen.compiled("parameters", functions)}
