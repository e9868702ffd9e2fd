"""What a filter of this package is: one state space, or several in a row, with its start and what it estimates.

A state space says besides its equations how far its states may be off at start (`prior`), and what of the car's motion
it estimates (`motion`), by the names in `MOTION`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.estimation.cascade import Cascade, PassedInput, PassedMeasurement
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Filter, Gaussian
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace
from vsense_ros.model.sensors.base import MeasuredQuantity

# The car's motion as an odometry has it: position [m] and attitude [rad] of cog on the map, velocity [m/s] and rates
# [rad/s] in its own axes, acceleration [m/s²], and the side-slip angle [rad] of filters that know no lateral velocity.
MOTION = (
    "east", "north", "up", "roll", "pitch", "yaw",
    "forward_velocity", "lateral_velocity", "vertical_velocity", "roll_rate", "pitch_rate", "yaw_rate",
    "forward_acceleration", "lateral_acceleration", "vertical_acceleration", "side_slip",
)  # fmt: skip

FirstReadings = Mapping[str, float]  # what the first readings give, by the names of states


class NavigationSpace(StateSpace):
    """A state space of a filter."""

    prior: Mapping[str, float] = {}  # standard deviations at start, by elements of the error

    def begin(self, first_readings: FirstReadings) -> Mapping[str, float]:
        """States at start by name, those that are not zero."""
        return {name: first_readings[name] for name in self.names if name in first_readings}

    def motion(self, x: Named, u: Named, theta: Named) -> Mapping[str, Any]:
        """What it estimates of the car's motion, by the names in `MOTION`."""
        return {name: x[name] for name in self.names if name in MOTION}

    def sampled(self, x: Named, u: Named, theta: Named, h: ca.SX, **deviations: Any) -> ca.SX:
        """Noise (e, e) of inputs with these standard deviations at each sample, as G Q Gᵀ in eq. 2.25 of Leung 2010:
        of steps as long as `theta.sample_time`, a step adds (h σ)², and as much in shorter ones together."""
        samples_per_step = theta.sample_time / h
        return self.noise_of_inputs(x, u, theta, h, {name: d**2 * samples_per_step for name, d in deviations.items()})

    def uncertain(self, name: str, first_readings: FirstReadings) -> float:
        """Standard deviation at start of an element of the error."""
        return self.prior[name]

    def start(self, first_readings: FirstReadings) -> Gaussian:
        """Mean and covariance at start, by the first readings and the numbers of the car."""
        initial = self.begin(first_readings)
        deviations = np.array([self.uncertain(name, first_readings) for name in self.error_names])
        return Gaussian(np.array([initial.get(name, 0.0) for name in self.names]), np.diag(deviations**2))


def drifting(h: Any, *densities: Any) -> ca.SX:
    """Covariance that random walks add in `h` [s]; `densities` are standard deviations after one second."""
    return ca.diag(ca.vertcat(*map(ca.SX, densities)) ** 2) * h


@dataclass(frozen=True)
class Remembered:
    """Inputs of a filter that are no readings but made of them and of its state, such as a mean of the past: with each
    reading of the sensor that `measures` this, before it corrects anything, the inputs by name become `equation(x, u,
    θ, value, variance)` of the `part` with that name; `variance` are those of its errors."""

    part: str
    measures: MeasuredQuantity
    equation: Callable[[Named, Named, Named, ca.SX, Named], Mapping[str, Any]]


Part = tuple[NavigationSpace, tuple[Measurement, ...]]


@dataclass(frozen=True)
class Definition:
    """A filter of this package: its `parts` by name, and the links between them. Of parts that estimate the same
    motion, the last counts."""

    parts: Mapping[str, Part]
    passed_inputs: tuple[PassedInput, ...] = ()
    passed_measurements: tuple[PassedMeasurement, ...] = ()
    remembered: tuple[Remembered, ...] = ()
    finds_heading: bool = False  # whether it begins without knowing any
    make_part: Callable[[NavigationSpace, tuple[Measurement, ...], Mapping[str, float]], Any] = field(
        default=lambda system, measurements, numbers: Ekf(Dense(system, measurements, numbers))
    )

    @classmethod
    def of(
        cls, system: NavigationSpace, *measurements: Measurement, remembered: tuple[Remembered, ...] = ()
    ) -> Definition:
        """Definition of a filter that is one extended Kalman filter."""
        return cls({"": (system, measurements)}, remembered=remembered)

    @property
    def is_cascade(self) -> bool:
        """True if it is several filters in a row."""
        return len(self.parts) > 1

    def make(self, numbers: Mapping[str, float]) -> Filter:
        """The filter, with these numbers of the car, of which it takes what it needs."""
        parts = {}
        for name, (system, measurements) in self.parts.items():
            own_numbers = {key: numbers[key] for key in system.parameters}
            parts[name] = self.make_part(system, measurements, own_numbers)
        if self.is_cascade:
            return Cascade(parts, self.passed_inputs, self.passed_measurements)
        only_part: Filter = next(iter(parts.values()))
        return only_part

    def start(self, first_readings: FirstReadings) -> Gaussian:
        """Mean and covariance at start, nothing between parts."""
        beliefs = [system.start(first_readings) for system, _ in self.parts.values()]
        sizes = [len(belief.covariance) for belief in beliefs]
        covariance = np.zeros((sum(sizes), sum(sizes)))
        for offset, belief in zip(np.cumsum([0, *sizes]), beliefs, strict=False):
            rows = slice(offset, offset + len(belief.covariance))
            covariance[rows, rows] = belief.covariance
        return Gaussian(np.concatenate([belief.mean for belief in beliefs]), covariance)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of all that is estimated."""
        return tuple(
            f"{name}.{state}" if self.is_cascade else state
            for name, (system, _) in self.parts.items()
            for state in system.names
        )

    @property
    def errors(self) -> tuple[str, ...]:
        """Names of the elements of the error."""
        return tuple(
            f"{name}.{error}" if self.is_cascade else error
            for name, (system, _) in self.parts.items()
            for error in system.error_names
        )

    @property
    def deviations(self) -> Array:
        """Standard deviations of the errors at start."""
        return np.array([system.prior[element] for system, _ in self.parts.values() for element in system.error_names])

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the readings that drive it."""
        passed = {(link.target, name) for link in self.passed_inputs for name in (*link.names, *link.variances)}
        needed = ((part, name) for part, (system, _) in self.parts.items() for name in system.inputs)
        return tuple(dict.fromkeys(name for part, name in needed if (part, name) not in passed))

    @property
    def measurements(self) -> tuple[Measurement, ...]:
        """The measurements that correct the filter from outside, each name once."""
        fed = {(link.target, link.measurement) for link in self.passed_measurements}
        from_outside = [
            measurement
            for part, (_, measurements) in self.parts.items()
            for measurement in measurements
            if (part, measurement.name) not in fed
        ]
        all_measurements = [*from_outside, *(link.sensor for link in self.passed_measurements)]
        return tuple({measurement.name: measurement for measurement in all_measurements}.values())


def filters_of(filter: Filter) -> tuple[Any, ...]:
    """The extended or unscented filters that a filter is made of."""
    return tuple(filter.filters.values()) if isinstance(filter, Cascade) else (filter,)


def parameters_of(part: Any) -> Array:
    """Parameters (p,) of a filter of one state space."""
    return np.asarray(part.system.parameters if hasattr(part.system, "memory") else part.parameters)


def error_names(part: Any) -> tuple[str, ...]:
    """Names of the elements of the error of one of a filter's parts."""
    system = part.system
    return tuple(getattr(system, "system", system).error_names)
