"""Filters in a row: what one estimates is, with its variance, an input or a measurement of another.

So are the kinematic filters of Leung 2010 (chapter 4): the heading filter's gyro bias corrects the yaw rate by which
the velocity filter turns its axes, and its heading turns the velocity that GNSS measured into the car's axes. How the
errors of two filters belong together is not known here: where much goes back and forth, one filter of all states is the
right one, and its NEES shows it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array, Filter, Gaussian, Innovation
from vsense_ros.estimation.gaussian import check_belief
from vsense_ros.estimation.operations import misfit
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace, Symbols, expression


class Part(Protocol):
    """A filter that can be a part of another: `Ekf` of a `Dense`, `Ukf`."""

    memory: Array
    mean: Array
    covariance: Array
    names: tuple[str, ...]
    sensors: tuple[str, ...]

    def at(self, memory: Array) -> Any:
        """This cascade with its memory in another array (s,)."""


@dataclass(frozen=True)
class PassedInput:
    """Before each step, inputs `names` of the filter `target` are `equation(x, u)` (m,) of the state of `source` and
    the inputs of the cascade; and inputs `variances` (m,), if it has any, their variances."""

    source: str
    target: str
    equation: Callable[[Named, Named], Any]
    names: tuple[str, ...]
    variances: tuple[str, ...] = ()


@dataclass(frozen=True)
class PassedMeasurement:
    """What `sensor` measures becomes, as `equation(x, value)` (m,) of the state of `source`, the `measurement` of the
    filter `target`. Its variances are those of the sensor and of the source, carried through the equation; how its
    components belong together is left out.

    The error of the source changes slowly. Used again before it has, it is no new information: where it stays the same
    for some uses in a row, `repeats` is their number, and its variance counts as many times, so that all of them
    together weigh as much as one."""

    sensor: Measurement
    source: str
    target: str
    measurement: str
    equation: Callable[[Named, ca.SX], Any]
    repeats: float = 1.0


class Cascade(Filter):
    """Filters by name, in the order in which they act. Elements of the state are called `filter.state`.

    `inputs` are those of all filters, by name, that no link fills; `input_names` says in which order. `memory` (s,):
    inputs, then the memory of each filter. It may be given, as a part of another's.
    """

    def __init__(
        self,
        filters: Mapping[str, Part],
        inputs: tuple[PassedInput, ...],
        measurements: tuple[PassedMeasurement, ...],
        memory: Array | None = None,
    ) -> None:
        self._check(filters, inputs, measurements)
        from_outside = _inputs_from_outside(filters, inputs)
        self.input_names = tuple(dict.fromkeys(name for taken in from_outside.values() for _, name in taken))
        lengths = [len(self.input_names), *(len(one.memory) for one in filters.values())]
        self.memory = np.zeros(sum(lengths)) if memory is None else memory
        self.inputs, *parts = np.split(self.memory, np.cumsum(lengths[:-1]).tolist())
        self.filters: dict[str, Any] = {
            key: one.at(part) for (key, one), part in zip(filters.items(), parts, strict=True)
        }
        self.names = tuple(f"{key}.{name}" for key, one in filters.items() for name in one.names)
        outside = _sensors_from_outside(filters, measurements)
        passed_on = [one.sensor.name for one in measurements]
        self.sensors = tuple(dict.fromkeys([*(name for name, _ in outside), *passed_on]))
        self.taken = {
            key: [(i, self.input_names.index(name)) for i, name in taken] for key, taken in from_outside.items()
        }
        self.passed_inputs = tuple(InputLink(one, self) for one in inputs)
        self.passed_measurements = tuple(MeasurementLink(one, self) for one in measurements)
        self.corrected = {
            name: (
                tuple(key for sensor, key in outside if sensor == name),
                tuple(one for one in self.passed_measurements if one.link.sensor.name == name),
            )
            for name in self.sensors
        }

    def at(self, memory: Array) -> Cascade:
        """This cascade with its memory in another array (s,)."""
        memory[:] = self.memory
        inputs = tuple(one.link for one in self.passed_inputs)
        return Cascade(self.filters, inputs, tuple(one.link for one in self.passed_measurements), memory)

    @staticmethod
    def _check(
        filters: Mapping[str, Part], inputs: tuple[PassedInput, ...], given: tuple[PassedMeasurement, ...]
    ) -> None:
        """Raises `InputError` where a link names what is not there."""
        for key in (key for one in (*inputs, *given) for key in (one.source, one.target)):  # type: ignore[attr-defined]
            if key not in filters:
                raise InputError(f"a link names the filter {key!r}; there are: {', '.join(filters)}")
        for link in inputs:
            known = _system(filters[link.target]).inputs
            if unknown := [name for name in (*link.names, *link.variances) if name not in known]:
                raise InputError(f"the filter {link.target!r} has no input {unknown[0]!r}; it has: {', '.join(known)}")
        for derived in given:
            known = filters[derived.target].sensors
            if derived.measurement not in known:
                raise InputError(
                    f"the filter {derived.target!r} has no measurement {derived.measurement!r}; it has: "
                    f"{', '.join(known)}"
                )

    def start(self, belief: Gaussian) -> None:
        """Begin anew; between filters nothing of the covariance is kept."""
        n = [len(one.mean) for one in self.filters.values()]
        e = [len(one.covariance) for one in self.filters.values()]
        mean, covariance = np.asarray(belief.mean, dtype=float), np.asarray(belief.covariance, dtype=float)
        check_belief(mean, covariance, sum(n), sum(e))
        for key, one in self.filters.items():
            self._pass_inputs(key)
            i = list(self.filters).index(key)
            at, of = slice(sum(n[:i]), sum(n[: i + 1])), slice(sum(e[:i]), sum(e[: i + 1]))
            one.start(Gaussian(mean[at], covariance[of, of]))

    def predict(self, h: float) -> None:
        """Go on by `h` [s], one filter after the other."""
        for key, one in self.filters.items():
            self._pass_inputs(key)
            one.predict(h)

    def _pass_inputs(self, key: str) -> None:
        """Give one filter its inputs, of the cascade and of other filters."""
        own = self.filters[key].inputs
        for i, j in self.taken[key]:
            own[i] = self.inputs[j]
        for one in self.passed_inputs:
            if one.link.target == key:
                one.act()

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """Correct every filter that has this sensor, then those to which a link passes it on.

        The innovations of all of them stand one behind the other, as if they were independent; accepted is what each
        has accepted. `limit` holds for each.
        """
        corrected = self.corrected.get(sensor)
        if corrected is None:
            raise InputError(f"the cascade has no sensor {sensor!r}; it has: {', '.join(self.sensors)}")
        keys, links = corrected
        if len(keys) == 1 and not links:
            return self.filters[keys[0]].correct(sensor, value, variance, limit, scale)  # type: ignore[no-any-return]
        innovations = [_copied(self.filters[key].correct(sensor, value, variance, limit, scale)) for key in keys]
        for one in links:
            target, measurement = self.filters[one.link.target], one.link.measurement
            innovations.append(_copied(target.correct(measurement, *one.made(value, variance), limit, scale)))
        return _together(innovations)

    def belief(self) -> Gaussian:
        """Mean and covariance of all filters, nothing between them."""
        every = [one.belief() for one in self.filters.values()]
        return Gaussian(np.concatenate([b.mean for b in every]), block_diag(*(b.covariance for b in every)))

    def is_valid(self) -> bool:
        """True if each filter is valid."""
        return all(one.is_valid() for one in self.filters.values())

    def inflate(self) -> None:
        """Each filter."""
        for one in self.filters.values():
            one.inflate()


def _system(filter: Any) -> StateSpace:
    """The state space of an `Ekf` of a `Dense`, or of a `Ukf`."""
    system = filter.system
    return system if isinstance(system, StateSpace) else system.system


def _sensors_from_outside(
    filters: Mapping[str, Part], measurements: tuple[PassedMeasurement, ...]
) -> list[tuple[str, str]]:
    """Sensors that no link feeds, each with the filter that it corrects."""
    return [(name, key) for key, one in filters.items() for name in one.sensors if not _is_fed(key, name, measurements)]


def _inputs_from_outside(
    filters: Mapping[str, Part], inputs: tuple[PassedInput, ...]
) -> dict[str, list[tuple[int, str]]]:
    """Inputs that no link fills, by filter: the place of each, and its name."""
    passed = {(one.target, name) for one in inputs for name in (*one.names, *one.variances)}
    return {
        key: [(i, name) for i, name in enumerate(_system(one).inputs) if (key, name) not in passed]
        for key, one in filters.items()
    }


def _is_fed(key: str, sensor: str, links: Any) -> bool:
    """True if a link makes this measurement of this filter, under another name than it has outside."""
    return any(one.target == key and one.measurement == sensor for one in links)


class InputLink:
    """A link to inputs, with its function."""

    def __init__(self, link: PassedInput, cascade: Cascade) -> None:
        self.link = link
        self._source, self._own = cascade.filters[link.source], cascade.filters[link.target].inputs
        known = _system(cascade.filters[link.target]).inputs
        self.places = [known.index(name) for name in link.names]  # among the inputs of the target
        self.variances = [known.index(name) for name in link.variances]
        at = Symbols(_system(self._source))
        u = Named(ca.SX.sym("u", len(cascade.input_names)), cascade.input_names, "input")
        inputs = expression(link.equation(at.x, u))
        if inputs.numel() != len(link.names) or len(link.variances) not in (0, len(link.names)):
            raise InputError(f"the link to {', '.join(link.names)} of {link.target!r} gives {inputs.numel()} numbers")
        results = [inputs, at.by_error(inputs)]
        self.function = codegen.function("passed", [at.x.vector, u.vector], results, ("x", "u"))
        self._kernel = Kernel(self.function, [self._source.mean, cascade.inputs])

    def act(self) -> None:
        """Set the inputs."""
        self._kernel.call()
        value, by_error = self._kernel.results
        self._own[self.places] = value[:, 0]
        if self.variances:
            self._own[self.variances] = _variances(by_error, self._source.covariance)


class MeasurementLink:
    """A link to a measurement, with its function."""

    def __init__(self, link: PassedMeasurement, cascade: Cascade) -> None:
        self.link, self._source = link, cascade.filters[link.source]
        at = Symbols(_system(self._source))
        value = ca.SX.sym("value", len(link.sensor.deviations))
        measured = expression(link.equation(at.x, value))
        by = [link.repeats**0.5 * at.by_error(measured), ca.jacobian(measured, value)]
        self._value = np.zeros(value.numel())
        self.function = codegen.function("passed", [at.x.vector, value], [measured, *by], ("x", "value"))
        self._kernel = Kernel(self.function, [self._source.mean, self._value])

    def made(self, value: Array, variance: Array) -> tuple[Array, Array]:
        """Measurement (m,) of the target, and its variances (m,)."""
        if len(value) != len(self._value):
            raise misfit(self.link.sensor.name, len(self._value), value)
        self._value[:] = value
        self._kernel.call()
        measured, by_error, by_value = self._kernel.results
        variances = _variances(by_error, self._source.covariance) + np.square(by_value) @ variance
        return measured[:, 0].copy(), variances


def _variances(by_error: Array, covariance: Array) -> Array:
    """Variances (m,) of what depends on an error by this Jacobian (m, e)."""
    return np.asarray(((by_error @ covariance) * by_error).sum(axis=1))


def _copied(innovation: Innovation) -> Innovation:
    return innovation._replace(whitened=innovation.whitened.copy(), factor=innovation.factor.copy())


def _together(innovations: list[Innovation]) -> Innovation:
    """Several innovations as one."""
    if len(innovations) == 1:
        return innovations[0]
    m = sum(len(one.whitened) for one in innovations)
    whitened, factor, nis, at = np.empty(m), np.zeros((m, m)), -1.0, 0
    for one in innovations:
        part = slice(at, at + len(one.whitened))
        whitened[part], factor[part, part], at = one.whitened, one.factor, part.stop
        if not one.nis < 0:
            nis = max(nis, 0.0) + one.nis
    return Innovation(whitened, factor, nis, all(one.accepted for one in innovations))
