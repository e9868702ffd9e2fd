"""A filter of the vocabulary on the sensors of a car: what a reading is to its inputs and measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from typing import NamedTuple

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.cascade import Cascade
from vsense_ros.estimation.filter import Array, Filter, Gaussian, Innovation, Kept, largest_nis
from vsense_ros.estimation.state_space import Named, Symbols, expression
from vsense_ros.model.sensors import SensorBase, words_of
from vsense_ros.navigation.readings import (
    CONDITIONS_AT,
    INPUTS,
    MEASUREMENTS,
    SINCE_FIX,
    SPEED,
    RollingSpeed,
    travelling_speed,
)
from vsense_ros.navigation.space import Definition, Remembered, filters_of, parameters_of

_NOTHING = Innovation(np.zeros(0), np.zeros((0, 0)), 0.0, True)


NEVER = 1e6  # [s] since the last fix, where there has been none


class Use(NamedTuple):
    """What a reading is used for: inputs by (place in the filter, place in the reading), the input `speed`, remembered
    inputs, measurements by name with how they are made, the largest normalized innovation squared that is believed and
    their usual variances, and conditions with zeros and variances."""

    inputs: tuple[tuple[int, int], ...]
    speed: Callable[[Array], float] | None
    remembered: tuple[Memory, ...]
    measurements: tuple[tuple[str, Callable[[Array, Array], tuple[Array, Array]], float, Array], ...]
    conditions: tuple[tuple[str, Array, Array], ...]
    gate: float


class Aided(Filter):
    """The filter of a definition, with numbers of the car, corrected by the readings of its `sensors`.

    A reading is one of a sensor in the axes of the car. Raises `InputError` where none of the sensors tells what an
    input needs, or nothing tells what any measurement does. `filter` may be given, as `definition` makes it.
    """

    def __init__(
        self,
        name: str,
        definition: Definition,
        numbers: Mapping[str, float],
        sensors: Mapping[str, SensorBase],
        filter: Filter | None = None,
    ) -> None:
        self.name, self.definition = name, definition
        self.filter = definition.make(numbers) if filter is None else filter
        self.memory, self.inputs, self.names = self.filter.memory, self.filter.inputs, self.filter.names
        self.sensors = tuple(sensors)
        self.input_names = self.filter.input_names if isinstance(self.filter, Cascade) else definition.inputs
        self._check(sensors)
        self.since_fix = self.input_names.index(SINCE_FIX) if SINCE_FIX in self.input_names else None
        self.restart_clock()
        radius = numbers.get("rolling_radius", 0.3)
        self.use = {key: self._use(sensor, _speed_of(sensor, sensors, radius)) for key, sensor in sensors.items()}
        self.fixes = {key for key, sensor in sensors.items() if "course" in sensor.tells}

    def _check(self, sensors: Mapping[str, SensorBase]) -> None:
        told: set[str] = {what for sensor in sensors.values() for what in sensor.tells}
        kinds = ", ".join(sorted({words_of(sensor.kind) for sensor in sensors.values()})) or "none"
        for name in self.input_names:
            source = INPUTS.get(name)
            if source is not None and source.tells not in told:
                raise InputError(
                    f"the filter {self.name!r} needs the input {name}, of a sensor that tells {source.tells!r}; the "
                    f"vehicle file lists {kinds}"
                )
        names = [one.name for one in self.definition.measurements if one.name in MEASUREMENTS]
        if names and not any(MEASUREMENTS[name].tells in told for name in names):
            raise InputError(
                f"the filter {self.name!r} is corrected by {', '.join(names)}, of a sensor that tells "
                f"{MEASUREMENTS[names[0]].tells!r}; the vehicle file lists {kinds}"
            )

    def _use(self, sensor: SensorBase, speed: Callable[[Array], float] | None) -> Use:
        tells, gate = sensor.tells, sensor.gate
        inputs = tuple(
            (i, INPUTS[name].places[0])
            for i, name in enumerate(self.input_names)
            if name in INPUTS and INPUTS[name].tells in tells
        )
        made, conditions = [], []
        for one in self.definition.measurements:
            source = MEASUREMENTS.get(one.name)
            if source is not None and source.tells in tells:
                limit = largest_nis(gate, len(one.deviations)) if sensor.deviations().any() else np.inf
                made.append((one.name, source.of, limit, one.variances))
            elif source is None and CONDITIONS_AT in tells:
                conditions.append((one.name, np.zeros(len(one.deviations)), one.variances))
        remembered = tuple(Memory(one, self) for one in self.definition.remembered if one.tells in tells)
        speed = speed if SPEED in self.input_names else None
        return Use(inputs, speed, remembered, tuple(made), tuple(conditions), gate)

    def uses(self, sensor: str) -> bool:
        """Whether readings of this sensor do anything."""
        use = self.use[sensor]
        return bool(use.inputs or use.speed or use.remembered or use.measurements or use.conditions)

    def needs(self, sensor: SensorBase) -> bool:
        """Whether any input depends on what this sensor tells."""
        wanted = {INPUTS[name].tells for name in self.input_names if name in INPUTS and not name.startswith("held")}
        return bool(wanted & sensor.tells)

    def start(self, belief: Gaussian) -> None:
        self.filter.start(belief)

    def restart_clock(self) -> None:
        """There has been no fix yet."""
        if self.since_fix is not None:
            self.inputs[self.since_fix] = NEVER

    def predict(self, h: float) -> None:
        self.filter.predict(h)
        if self.since_fix is not None:
            self.inputs[self.since_fix] += h

    def give_reading(self, sensor: str, value: Array) -> None:
        """Take the inputs of a reading (m,); NaN leaves one as it is."""
        self._give(sensor, value)

    def _give(self, sensor: str, value: Array) -> None:
        use = self.use[sensor]
        numbers, inputs = value.tolist(), self.inputs
        for place, component in use.inputs:
            if isfinite(numbers[component]):
                inputs[place] = numbers[component]
        if use.speed is not None and isfinite(speed := use.speed(value)):
            inputs[self.input_names.index(SPEED)] = speed

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """All that a reading (m,) of a sensor does. The normalized innovation squared that is returned compares with
        the `limit` of the sensor as the worst of its measurements does with its own."""
        use = self.use[sensor]
        for memory in use.remembered:
            memory.renew(value)
        worst, accepted, found = 0.0, True, _NOTHING
        for name, make, own, usual in use.measurements:
            made, variances = make(value, variance)
            if not variances.all():  # of a sensor that the multibody car takes for an input without noise
                variances = np.where(variances > 0, variances, usual)
            most = own * (limit / largest_nis(use.gate, len(value))) if isfinite(limit) and isfinite(own) else np.inf
            found = self.filter.correct(name, made, variances, most, scale)
            share = found.nis / own * largest_nis(use.gate, len(value)) if isfinite(own) else 0.0
            worst, accepted = (share if not share <= worst else worst), accepted and (found.accepted or found.nis < 0)
        self._give(sensor, value)
        if self.since_fix is not None and sensor in self.fixes and accepted and isfinite(value[0]):
            self.inputs[self.since_fix] = 0.0
        for name, nothing, variances in use.conditions:
            self.filter.correct(name, nothing, variances)
        return found._replace(nis=worst, accepted=accepted)

    def belief(self) -> Gaussian:
        return self.filter.belief()

    def is_valid(self) -> bool:
        return self.filter.is_valid()

    def inflate(self) -> None:
        self.filter.inflate()

    def backup(self) -> Kept:
        return self.filter.backup()


class Memory:
    """A `Remembered` of a filter, with its function."""

    def __init__(self, remembered: Remembered, filter: Aided) -> None:
        names = list(filter.definition.parts)
        part = filters_of(filter.filter)[names.index(remembered.part)]
        at = Symbols(filter.definition.parts[remembered.part][0])
        value = ca.SX.sym("value", 6 if remembered.tells == "rates and forces" else 2)
        errors = at.system.error_names
        covariance = ca.SX.sym("covariance", len(errors), len(errors))
        variance = Named(ca.diag(covariance), errors, "element of the error")
        found = remembered.equation(at.x, at.u, at.theta, value, variance)
        self.remembered, self._part, self._parameters = remembered, part, parameters_of(part)
        self.places = [filter.input_names.index(name) for name in found]  # among the inputs of all parts
        self.own = [at.system.inputs.index(name) for name in found]  # among those of the part
        self._inputs, self._value = filter.inputs, np.zeros(value.numel())
        results = [expression(list(found.values()))]
        arguments = [*at.now, value, covariance]
        self.function = codegen.function("remembered", arguments, results, ("x", "u", "p", "value", "covariance"))
        bound = [part.mean, part.inputs, self._parameters, self._value, part.covariance.reshape(-1)]
        self._kernel = Kernel(self.function, bound)

    def renew(self, value: Array) -> None:
        """With a reading (m,)."""
        self._value[:] = value
        self._kernel.call()
        found = self._kernel.results[0][:, 0]
        if np.isfinite(found).all():
            self._inputs[self.places] = found
            self._part.inputs[self.own] = found


def usable(sensors: Mapping[str, SensorBase]) -> dict[str, SensorBase]:
    """Those sensors that any filter of this package could use."""
    used = {one.tells for one in INPUTS.values()} | {one.tells for one in MEASUREMENTS.values()}
    return {key: one for key, one in sensors.items() if not used.isdisjoint(one.tells)}


def _speed_of(sensor: SensorBase, sensors: Mapping[str, SensorBase], radius: float) -> Callable[[Array], float] | None:
    """How a reading tells the input `speed`, if it is this sensor that does."""
    rolling = any("rolling speed" in one.tells for one in sensors.values())
    if rolling and "rolling speed" in sensor.tells:
        return RollingSpeed(radius)
    if not rolling and "course" in sensor.tells:
        return travelling_speed
    return None
