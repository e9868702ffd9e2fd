"""Sensors with a filter each, and a master that joins what they find (Leung 2010, figure 2.12; Speyer 1979).

Each unit predicts and corrects by its own sensor alone: (x_i, P_i) after, (x̄_i, P̄_i) before its correction. Since all
of them know the same motion, and the same noise of it, the master must not take their estimates for independent. New
in each is the information that its sensor brought:

    P⁻¹   = P̄⁻¹   + Σ (P_i⁻¹     - P̄_i⁻¹)
    P⁻¹ x = P̄⁻¹ x̄ + Σ (P_i⁻¹ x_i - P̄_i⁻¹ x̄_i)

For linear systems this is the centralised filter exactly. The master predicts by the same state space.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from studies.literature.bevly_bias import GYRO, HEADING, MarkovHeading, biases
from studies.literature.finding import Array, Finding
from vsense_ros.estimation.filter import Filter, Gaussian
from vsense_ros.estimation.state_space import Measurement
from vsense_ros.navigation.space import Definition

SOURCE = "figure 2.12, Speyer 1979"
COURSE = Measurement("course", lambda x, z, u, p: x.yaw, (np.radians(0.5),), angles=(0,))  # on the straight
UNITS = (COURSE, HEADING)


class Decentralised:
    """A unit for each measurement, all of one linear state space, and the master; headings stay within ±π."""

    def __init__(self, measurements: Sequence[Measurement], numbers: Mapping[str, float]) -> None:
        definitions = [Definition.of(MarkovHeading(), one) for one in measurements]
        self.units: dict[str, Filter] = {
            one.name: definition.make(numbers) for one, definition in zip(measurements, definitions, strict=True)
        }
        self.master = Definition.of(MarkovHeading()).make(numbers)
        self.measurements = {one.name: one for one in measurements}
        for filter in self.all:
            filter.start(definitions[0].start({}))

    @property
    def all(self) -> list[Filter]:
        """Units, and the master."""
        return [*self.units.values(), self.master]

    def predict(self, inputs: Array, h: float) -> None:
        """All go on by `h` [s] with the same inputs."""
        for filter in self.all:
            filter.inputs[:] = inputs
            filter.predict(h)

    def correct(self, values: Mapping[str, Array]) -> None:
        """Each unit uses its own measurement, then the master takes what is new."""
        matrix, vector = _information(self.master.belief())
        for name, value in values.items():
            unit = self.units[name]
            before = _information(unit.belief())
            unit.correct(*self.measurements[name].measured(value))
            after = _information(unit.belief())
            matrix, vector = matrix + after[0] - before[0], vector + after[1] - before[1]
        covariance = np.linalg.inv(matrix)
        self.master.start(Gaussian(covariance @ vector, (covariance + covariance.T) / 2))

    def as_independent(self) -> Gaussian:
        """The units' estimates weighted as if nothing were common to them: what not to do."""
        every = [_information(unit.belief()) for unit in self.units.values()]
        covariance: Array = np.linalg.inv(sum(matrix for matrix, _ in every)).astype(np.float64)
        return Gaussian(covariance @ sum(vector for _, vector in every), covariance)


def _information(belief: Gaussian) -> tuple[Array, Array]:
    """P⁻¹ (n, n) and P⁻¹ x (n,)."""
    inverse: Array = np.linalg.inv(belief.covariance).astype(np.float64)
    return inverse, inverse @ belief.mean


def drive(random: np.random.Generator, duration: float) -> tuple[Gaussian, Gaussian, Gaussian, Array]:
    """The master's estimate, that of the units as if independent, that of one filter with both sensors, and the true
    bias and heading (2,), after a drive straight ahead with both sensors each second."""
    h = GYRO["sample_time"]
    bias = biases(random, round(duration / h), h, GYRO["bias"], GYRO["time_constant"])
    several, central = Decentralised(UNITS, GYRO), Definition.of(MarkovHeading(), *UNITS)
    one = central.make(GYRO)
    one.start(central.start({}))
    for k, b in enumerate(bias):
        if k % round(1 / h) == 0:
            values = {m.name: m.deviations[0] * random.standard_normal(1) for m in UNITS}
            several.correct(values)
            for m in UNITS:
                one.correct(*m.measured(values[m.name]))
        if k == len(bias) - 1:
            break
        rate = np.array([b + GYRO["gyro_noise"] * random.standard_normal()])
        several.predict(rate, h)
        one.inputs[:] = rate
        one.predict(h)
    return several.master.belief(), several.as_independent(), one.belief(), np.array([0.0, bias[-1]])


def examine() -> list[Finding]:
    """Two hundred drives of 30 s: NEES of heading and bias by the master, and of estimates taken for independent."""
    random = np.random.default_rng(1979)
    nees = []
    for _ in range(200):
        *found, true = drive(random, 30.0)
        nees.append([(e.mean - true) @ np.linalg.solve(e.covariance, e.mean - true) / 2 for e in found[:2]])
    master, independent = np.mean(nees, axis=0)
    beside = "units taken for independent"
    return [
        Finding(
            "decentralised filter", SOURCE, "NEES of heading and bias", "", float(master), beside, float(independent)
        )
    ]
