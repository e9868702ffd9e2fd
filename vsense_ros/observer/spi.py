"""SPI: state, parameter and input observer (Rodríguez 2020): the errorEKF, and a parameter filter coupled to it.

Unlike the slides' two filters, which each take the other's mean for the truth, the two here know how far the errors of
state and inputs come from those of the parameters; `parameter_filter` says how.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian, Given, Innovation, Measured, Step
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.model.car.car import Car
from vsense_ros.model.coordinates import COORDINATES, STEERING, TORQUES
from vsense_ros.model.sensors import SensorBase
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.car_operations import CarOperations, Learned
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.parameter_ekf import ParameterEkf
from vsense_ros.observer.parameter_filter import ParameterFilter
from vsense_ros.observer.parameter_ukf import ParameterUkf
from vsense_ros.observer.state import FORCE, U

Array = NDArray[np.float64]

FILTERS: dict[str, type[ParameterFilter]] = {"ekf": ParameterEkf, "ukf": ParameterUkf}


@dataclass(frozen=True)
class SpiSettings:
    """Limits of observability, and the short simulated drive on which parameters without any effect are detected."""

    # A parameter counts as determined once its standard deviation is this share of the one at start [-]: three quarters
    # of its variance are then explained by measurements.
    determined_share: float = 0.5
    # Fisher information of the trial drive on a parameter, over its own size squared [-]; rounding is far below it, and
    # the parameter with the least effect of all in the vehicle file far above.
    least_information: float = 1e-6
    bound_share: float = 0.1  # [-] of the standard deviation at start, within which a parameter is at its bound
    trial_speeds: tuple[float, ...] = (1.0, 8.0, 25.0)  # [m/s]: parking, in town, on a road
    trial_step: float = 0.01  # [s]
    trial_steps: int = 30  # at each speed
    trial_steering: float = 0.08  # [rad], amplitude: beyond the linear range of tyres at 25 m/s
    trial_torque: float = 150.0  # [N m], amplitude at each rear wheel
    trial_rate: float = 0.4  # [rad], phase of steering and torques in a step: a period of 0.16 s


SETTINGS = SpiSettings()


@dataclass(frozen=True)
class Observability:
    """What a recording so far determines of the parameters, whatever state and forces were.

    `deviation` (k,) are the standard deviations, `share` (k,) these over those at start. `information` (k,) are the
    eigenvalues of the Fisher information in units of what was known at start: one of 3 halves a standard deviation, and
    those above 1 count in `rank`. `correlation` (k, k) is that of the errors now: close to ±1 where only a combination
    is determined.
    """

    names: tuple[str, ...]
    deviation: Array
    share: Array
    information: Array
    correlation: Array

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters that are known at least twice as well as at start."""
        limit = SETTINGS.determined_share
        return tuple(name for name, share in zip(self.names, self.share, strict=True) if share <= limit)

    @property
    def rank(self) -> int:
        """Number of independent combinations of parameters that the recording determines better than the start."""
        return int(np.sum(self.information > 1))

    def __str__(self) -> str:
        undetermined = [name for name in self.names if name not in self.determined]
        text = f"determined so far: {', '.join(self.determined) or 'nothing'}"
        return text + (f"; not yet: {', '.join(undetermined)}" if undetermined else "")


def numbers_kept(size: int, count: int) -> int:
    """How many numbers an SPI keeps in the memory of its car, for a state of `size` and `count` parameters."""
    return count + count * count + size * count + count * count + COORDINATES * count


class Spi(CarFilter):
    """The errorEKF of a vehicle whose file lists `observer.parameters`, with the filter of these.

    `car` has place for `numbers_kept`. The covariance of the car is that of the state for known parameters,
    `parameter_covariance` (k, k) that of the parameters, and `sensitivity` (n, k) what couples them. `information`
    (k, k) is the Fisher information of the measurements since the start on the parameters, the inverse of the
    covariance they alone would give. `kind` finds the effect of the parameters: by derivatives, or by sigma points.
    """

    def __init__(self, car: CarBlocks, kind: type[ParameterFilter]) -> None:
        settings = car.vehicle.observer.parameters
        self.car, self.memory, self.inputs, self.sensors = car, car.memory, car.inputs, car.sensors
        self.parameter_names = tuple(settings)
        self.names = car.names + self.parameter_names
        self.covariance = car.covariance
        self._state_filter = Ekf(car)
        self._columns = np.array([car.car.parameter_names.index(name) for name in settings])
        self.equations = kind(car.car, tuple(self._columns.tolist()), car.layout.size)
        self._take_settings()
        self._share_memory()
        self._bind()
        self._operations = car.operations
        if car.operations is not None and not self._compile(car.operations):
            self._operations = self._state_filter._operations = None
        self._refuse_unobservable()

    def _take_settings(self) -> None:
        settings = self.car.vehicle.observer.parameters.values()
        self._initial = self.car.parameters[self._columns]
        self.prior_deviation = np.array([s.deviation for s in settings])
        bounds = [s.bounds(value) for s, value in zip(settings, self._initial, strict=True)]
        self.lower, self.upper = (np.array(b) for b in zip(*bounds, strict=True))
        self._drift = np.array([s.drift for s in settings]) ** 2
        self._drifts = bool(self._drift.any())

    def _share_memory(self) -> None:
        n, k = self.car.layout.size, len(self.parameter_names)
        sizes = [k, k * k, n * k, k * k, COORDINATES * k]
        parts = np.split(self.car.extra[: sum(sizes)], np.cumsum(sizes[:-1]).tolist())
        self._learned = self.car.extra[: sum(sizes[:-1])]
        self.values, self._m, self._s, self._information, self._by_parameters = parts
        self.parameter_covariance, self.information = self._m.reshape(k, k), self._information.reshape(k, k)
        self.sensitivity = self._s.reshape(k, n).T
        self._others = np.zeros((self.equations.elsewhere, COORDINATES)).T  # accelerations of cars that act elsewhere
        self._decay = np.zeros(n - U.stop)
        operations = self.car.operations
        self._whitened = np.full(COMPONENTS, np.nan) if operations is None else operations.whitened
        self._factor = np.zeros(COMPONENTS * COMPONENTS) if operations is None else operations.factor

    def _bind(self) -> None:
        """The functions of the parameter filter, to the arrays."""
        car, effect = self.car, self._by_parameters
        biases = tuple((rows.start, rows.stop) for rows in car.layout.biases)
        functions = _functions(self.equations, car.sensor_list, biases)
        flat = [m.reshape(-1, order="F") for m in car.linearized.results[:4]]
        *state, effects = car.arguments
        arguments = [*state, *flat, self._s, self._m, effects]
        arguments += [self._others.T.reshape(-1)] if self.equations.elsewhere else []
        self._effect = Kernel(functions["parameters_effect"], arguments, effect)
        kinematics = [r.reshape(-1, order="F") for r in car.kinematics.results[:3]]
        by_error = [car.gain.reshape(-1), *kinematics, car.road_map.reshape(-1)]
        step = [self._s, self._m, effect, self._drift, *by_error, car.h, self._decay]
        self._spread = Kernel(functions["parameters_predict"], step)
        self._seen: dict[str, Learned] = {}
        for name, sensed in car.sensed.items():
            function = functions[f"seen_{sensed.index}"]
            self._seen[name] = self._learner(name, function, functions["parameters_learn"], arguments)

    def _learner(self, name: str, function: ca.Function, learn: ca.Function, arguments: Sequence[Array]) -> Learned:
        """The functions by which a sensor corrects the parameters, bound to arrays."""
        car, effect, sensed = self.car, self._by_parameters, self.car.sensed[name]
        variance = car.sensor_list[sensed.index].deviations() ** 2
        size = len(variance)
        whitened, factor = self._whitened[:size], self._factor[: size * size]
        jacobians = [r.reshape(-1, order="F") for r in sensed.kernel.results[1:]]
        measured = [car.mean[sensed.biases], sensed.mounting, variance, whitened, factor, *jacobians]
        sees = Kernel(function, [*arguments, effect, *measured])
        g, right, d = (r.reshape(-1, order="F") for r in sees.results[1:])
        weighted, projected = sees.results[0].T, np.zeros(sees.results[0].T.shape)
        size_learned, n = len(self._learned), car.layout.size
        learned = np.zeros(size_learned + n + COORDINATES)
        correction = [projected.reshape(-1), g, right, d, self._information, self.values, self.lower, self.upper]
        learns = Kernel(learn, [*arguments, effect, *correction], learned)
        corrected, change, udot = np.split(learned, [size_learned, size_learned + n])
        return Learned(sees, variance, whitened, factor, weighted, projected, learns, corrected, change, udot)

    def _compile(self, operations: CarOperations) -> bool:
        """Let C do all this; False if any of it is not compiled."""
        moved, grown, added = (r.reshape(-1, order="F") for r in self._spread.results)
        arrays = {
            "learned": self._learned,
            "sensitivity": self._s,
            "covariance": self._m,
            "decay": self._decay,
            "physical": self.car.parameters,
            "moved": moved,
            "grown": grown,
            "added": added,
        }
        return operations.learn((self._effect, self._spread), self._drifts, self._columns, arrays, self._seen)

    def _refuse_unobservable(self) -> None:
        """Drive a little, and sum the information that sensors have on parameters if state and forces are known: an
        upper bound.

        Raises `InputError` for a parameter without any effect on what is measured.
        """
        trial, scale = SETTINGS, np.maximum(self.prior_deviation, np.abs(self._initial))
        amplitude = np.zeros(len(self.inputs))
        amplitude[STEERING] = trial.trial_steering
        amplitude[TORQUES] = 0.0, 0.0, trial.trial_torque, trial.trial_torque
        total = np.zeros(len(self.parameter_names))
        for speed in trial.trial_speeds:
            self.start_rolling(speed)
            for i in range(trial.trial_steps):
                self.inputs[:] = amplitude * np.sin(trial.trial_rate * i + 0.5)
                self.linearize()
                for name, learned in self._seen.items():
                    self.car.sensed[name].kernel.call()
                    learned.whitened[:], learned.factor[:] = 0.0, np.diag(learned.variance**0.5).flat
                    learned.seen.call()
                    _, g, _, spread = learned.seen.results
                    regression = spread.T @ np.linalg.inv(self.parameter_covariance) * scale
                    total += np.einsum("pk,pq,qk->k", regression, g, regression)
                self.predict(trial.trial_step)
        for name, information in zip(self.parameter_names, total, strict=True):
            if not information > trial.least_information:
                kinds = ", ".join(sensor.kind for sensor in self.car.sensor_list) or "none"
                raise InputError(
                    f"{self.car.vehicle.name}: {name} cannot be estimated: it changes nothing that the sensors "
                    f"({kinds}) measure, however the car is driven; take it out of observer.parameters, or add a "
                    "sensor on which it has an effect"
                )
        self.memory[:] = 0.0
        self.car.forget()
        self._reset()

    def _reset(self) -> None:
        self.values[:] = self._initial
        self.car.parameters[self._columns] = self._initial
        self.parameter_covariance[:] = np.diag(self.prior_deviation**2)
        self.sensitivity[:] = 0.0
        self.information[:] = 0.0

    def start(self, belief: Gaussian) -> None:
        """As `Filter.start`, of the state; the parameters begin as in the vehicle file."""
        self._reset()
        self.car.start(belief)
        self.linearize()

    def set_element(self, index: int, value: float, deviation: float) -> None:
        self._state_filter.set_element(index, value, deviation)
        self.sensitivity[index] = 0.0

    def is_valid(self) -> bool:
        return self.car.is_valid()

    def inflate(self) -> None:
        self._state_filter.inflate()
        self.sensitivity[:] = 0.0

    def linearize(self) -> None:
        self.car.linearize()
        self._find_effect()

    def _find_effect(self) -> None:
        """Compute the effect of the parameters on the accelerations at the present state."""
        self._effect.call()

    def predict(self, h: float) -> None:
        if self._operations is not None:
            self._state_filter.predict(h)  # in C that includes the parameters
            return
        decay = self.car.process(h).decay  # with the brakes as they are before the step, as the state's
        self._state_filter.predict(h)
        self._move_parameters(h, decay)
        self._find_effect()

    def _move_parameters(self, h: float, decay: Array) -> None:
        """Propagate the estimates of the parameters through a step of `h` [s], which has just been made, and in which
        the errors of the states behind the velocities have decayed to the shares `decay` (n - 28,)."""
        self.car.h[0], self._decay[:] = h, decay
        self._spread.call()
        sensitivity, covariance, added = self._spread.results
        self.sensitivity[:] = sensitivity
        if self._drifts:
            self.parameter_covariance[:] = covariance
            self.covariance += added @ added.T

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        innovation = self._state_filter.correct(sensor, value, variance, limit, scale)
        if self._operations is None and scale == 1.0 and innovation.accepted:
            self._learn(self._seen[sensor], innovation, variance)  # what is forced upon the filter is no information
        return innovation

    def _learn(self, learned: Learned, innovation: Innovation, variance: Array) -> None:
        """Correct the parameters by a measurement by which the state has just been corrected."""
        car = self.car
        learned.variance[:] = variance
        learned.whitened[:], learned.factor[:] = innovation.whitened, innovation.factor.reshape(-1)
        learned.seen.call()
        np.dot(self.covariance, learned.weighted, out=learned.projected)
        learned.learn.call()
        self._learned[:] = learned.learned
        car.parameters[self._columns] = self.values
        change = learned.change
        car.error[FORCE] = change[FORCE]
        car.forces.call()
        change[FORCE] = car.forces.results[0][:, 0]
        car.mean += change
        car.udot[:, 0] += learned.udot

    def advance(self, step: Step) -> bool:
        return super().advance(step) if self._operations is None else self._operations.advance(step)

    def repeat(self, events: Sequence[tuple[Step | None, Measured | Given]]) -> tuple[int, bool, list[float]]:
        return super().repeat(events) if self._operations is None else self._operations.repeat(events)

    def belief(self) -> Gaussian:
        m, s = self.parameter_covariance, self.sensitivity
        across = s @ m
        covariance = np.block([[self.covariance + across @ s.T, across], [across.T, m]])
        return Gaussian(np.append(self.car.mean, self.values), covariance)

    def at_bounds(self) -> tuple[str, ...]:
        """Parameters that would be elsewhere if their bounds let them: something else is wrong with the car."""
        tolerance = SETTINGS.bound_share * self.prior_deviation
        is_at_bound = (self.values <= self.lower + tolerance) | (self.values >= self.upper - tolerance)
        return tuple(name for name, is_there in zip(self.parameter_names, is_at_bound, strict=True) if is_there)

    def observability(self) -> Observability:
        """How well the measurements since the start determine each parameter."""
        prior = self.prior_deviation
        deviation = np.sqrt(np.diag(self.parameter_covariance))
        return Observability(
            self.parameter_names,
            deviation,
            deviation / prior,
            np.linalg.eigvalsh(prior[:, None] * self.information * prior),
            self.parameter_covariance / np.outer(deviation, deviation),
        )


def _functions(
    equations: ParameterFilter, sensors: tuple[SensorBase, ...], biases: tuple[tuple[int, int], ...]
) -> dict[str, ca.Function]:
    return _compiled(type(equations), equations.car, equations.columns, equations.size, sensors, biases)


def equations_of(
    parameter_filter: ParameterFilter, sensors: tuple[SensorBase, ...], biases: tuple[tuple[int, int], ...]
) -> list[ca.Function]:
    """The functions of a parameter filter: effect of the parameters, a step, and corrections by each sensor."""
    corrections = [
        parameter_filter.seen(f"seen_{i}", sensor, slice(*rows))
        for i, (sensor, rows) in enumerate(zip(sensors, biases, strict=True))
        if not sensor.is_input
    ]
    return [parameter_filter.effect(), parameter_filter.predict(), parameter_filter.learn(), *corrections]


@cache
def _compiled(
    kind: type[ParameterFilter],
    car: Car,
    columns: tuple[int, ...],
    size: int,
    sensors: tuple[SensorBase, ...],
    biases: tuple[tuple[int, int], ...],
) -> dict[str, ca.Function]:
    functions = equations_of(kind(car, columns, size), sensors, biases)
    return {f.name(): f for f in codegen.compiled("parameters", functions)}
