"""SPI on the car with all its bodies: the errorEKF on `FullCarBlocks`, and the parameter filters of `spi`.

The effect of parameters is the difference between full cars that have others: these are put to the filter's state, or
to that of a sigma point, and their accelerations are compared. How errors propagate from there, and what they do to the
sensors, follows from the simplified car, as in the errorEKF.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from itertools import combinations, combinations_with_replacement

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Innovation
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.full_car import FullCarBlocks
from vsense_ros.observer.parameter_ekf import ParameterEkf
from vsense_ros.observer.parameter_filter import ParameterFilter, numbered
from vsense_ros.observer.parameter_ukf import ParameterUkf
from vsense_ros.observer.spi import Spi
from vsense_ros.observer.state import DISTURB, Q, U

Array = NDArray[np.float64]

NEARBY = 0.1  # standard deviations to either side, of a central difference


class OnFullCars(ParameterFilter):
    """A parameter filter that is given the accelerations of full cars with other parameters."""

    @abstractmethod
    def deviations(self) -> tuple[ca.SX, ca.SX]:
        """Deviations of these cars from the filter's: parameters (k×p), state (n×p), by S and M."""


class FullCarParameterEkf(ParameterEkf, OnFullCars):
    """Sensitivities by central differences: two cars for each parameter, in the state of the filter."""

    @property
    def elsewhere(self) -> int:
        return 2 * self.count

    @property
    def _steps(self) -> ca.SX:
        return NEARBY * ca.sqrt(ca.diag(self.covariance))

    def effect(self) -> ca.Function:
        above, below = ca.horzsplit(self.others, self.count)
        effect = (above - below) @ ca.diag(0.5 / self._steps)
        return codegen.function("parameters_effect", self.arguments, [effect], numbered(len(self.arguments)))

    def deviations(self) -> tuple[ca.SX, ca.SX]:
        steps = ca.diag(self._steps)
        return ca.horzcat(steps, -steps), ca.SX(self.size, self.elsewhere)


class FullCarParameterUkf(ParameterUkf, OnFullCars):
    """Each sigma point is a full car, in the state in which the errorEKF would then have it."""

    @property
    def elsewhere(self) -> int:
        return self.width

    def accelerations(self, arguments: list[ca.MX], deviation: ca.MX, of_state: ca.MX) -> ca.MX:
        """Theirs, and what errors of the disturbances add, in which the cars do not differ."""
        by_disturbances, of_other_cars = arguments[9], arguments[13]
        return of_other_cars + by_disturbances @ of_state[DISTURB, :]

    def deviations(self) -> tuple[ca.SX, ca.SX]:
        points = self.points(self.covariance)
        return points, self.sensitivity @ points


class FullCarNumbers:
    """The numbers of full cars whose parameters are others than in the file, as a polynomial of second order.

    To find them exactly takes milliseconds, since linkages are assembled and springs chosen for what they carry. The
    polynomial passes through the cars with one or two parameters a standard deviation away (within the bounds).
    """

    def __init__(self, car: FullCar, vehicle: Vehicle) -> None:
        settings, values = vehicle.observer.parameters, vehicle.values()
        self._value = np.array([values[name] for name in settings])
        self._scale = np.array([s.deviation for s in settings.values()])
        below, above = [], []
        for s, value in zip(settings.values(), self._value, strict=True):
            least, largest = np.clip((value - s.deviation, value + s.deviation), *s.bounds(value))
            # Where the file's value is a bound, both lie on one side of it.
            below.append(least if least < value else (value + largest) / 2)
            above.append(largest if largest > value else (value + least) / 2)
        k = len(settings)
        places = [self._value]
        for i in range(k):
            for side in (below, above):
                places.append(np.where(np.arange(k) == i, side, self._value))
        places += [np.where(np.isin(np.arange(k), pair), above, self._value) for pair in combinations(range(k), 2)]
        numbers = [
            car.parameters(vehicle.with_parameters(dict(zip(settings, map(float, place), strict=True))))
            for place in places
        ]
        self._coefficients = np.linalg.solve(np.array([self._powers(place) for place in places]), np.array(numbers))

    def at(self, values: Array) -> Array:
        """Numbers of the car with these parameters (k,)."""
        return self._powers(values) @ self._coefficients

    def _powers(self, values: Array) -> Array:
        x = [1.0, *((values - self._value) / self._scale).tolist()]
        return np.array([a * b for a, b in combinations_with_replacement(x, 2)])


FULL_CAR_FILTERS: Mapping[str, type[ParameterFilter]] = {"ekf": FullCarParameterEkf, "ukf": FullCarParameterUkf}


class FullCarSpi(Spi):
    """The errorEKF on the full car with the filter of its vehicle's `observer.parameters`."""

    car: FullCarBlocks

    def __init__(self, car: FullCarBlocks, kind: type[ParameterFilter]) -> None:
        self._numbers = FullCarNumbers(car.plant.car, car.vehicle)
        car.numbers = lambda: self._numbers.at(self.values)
        super().__init__(car, kind)

    def _find_effect(self) -> None:
        self._act_elsewhere()
        super()._find_effect()

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        if isinstance(self.equations, ParameterUkf) and self.car.sensed[sensor].uses_acceleration:
            try:
                self._act_elsewhere()
            except FloatingPointError:
                m = len(value)
                return Innovation(np.full(m, np.nan), np.eye(m), float("nan"), False)
        return super().correct(sensor, value, variance, limit, scale)

    def _act_elsewhere(self) -> None:
        """Accelerations of the cars that have other parameters."""
        plant, (q, u) = self.car.plant, (self.car.mean[Q], self.car.mean[U])
        self.car.put_back()
        self._deviations.call()
        of_parameters, of_state = self._deviations.results
        moved = of_state[: U.stop].any()
        try:
            for i, deviation in enumerate(of_parameters.T):
                if deviation.any():  # the UKF's first car has none and is the plant as it stands
                    plant.integrator.parameters[:] = self._numbers.at(self.values + deviation)
                    if moved:
                        plant.correct(q + of_state[Q, i], u + of_state[U, i])
                    else:
                        plant.settle()
                self._others[:, i] = plant.udot
        except InputError as error:
            raise FloatingPointError(str(error)) from None

    @cached_property
    def _deviations(self) -> Kernel:
        """The function that computes how the parameters of the other cars deviate."""
        equations = self.equations
        assert isinstance(equations, OnFullCars)
        function = codegen.function(
            "parameters_elsewhere", [equations.sensitivity, equations.covariance], [*equations.deviations()], ("S", "M")
        )
        return Kernel(function, [self._s, self._m])
