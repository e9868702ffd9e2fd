"""A filter of the vocabulary on the sensors of a car: what a reading is to its inputs and measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import isfinite, nan
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.estimation.cascade import Cascade
from vsense_ros.estimation.filter import Array, Filter, Gaussian, Innovation, Kept, Step, largest_nis
from vsense_ros.estimation.state_space import Symbols
from vsense_ros.model.sensors import SensorBase
from vsense_ros.navigation.memory import memories_of
from vsense_ros.navigation.reading_use import Use, check_sensors, speed_from
from vsense_ros.navigation.readings import (
    INPUTS,
    NOISE_OF_INPUTS,
    SINCE_FIX,
    SPEED,
    Components,
)
from vsense_ros.navigation.reckoning import AXES, Reckoning
from vsense_ros.navigation.space import Definition, error_names, filters_of, parameters_of

_NOTHING = Innovation(np.zeros(0), np.zeros((0, 0)), 0.0, True)
_BEYOND = 1.01  # times the largest normalized innovation squared, of a reading that is refused


NEVER = 1e6  # [s] since the last fix, where there has been none


class Aided(Filter):
    """The filter of a definition, with numbers of the car, corrected by the readings of its `sensors`.

    A reading is one of a sensor in the axes of the car. An axis of the first inertial sensor that drives the filter,
    and is absent or refused, is reckoned from the other sensors, with what that adds to the covariance (`reckoning`). A
    subclass may keep as many numbers as `behind` says at the end of the memory. Raises `InputError` where none of the
    sensors measures what an input needs, or nothing measures what any measurement does.
    """

    def __init__(
        self,
        name: str,
        definition: Definition,
        numbers: Mapping[str, float],
        sensors: Mapping[str, SensorBase],
        behind: int = 0,
    ) -> None:
        self.name, self.definition = name, definition
        inner: Any = definition.make(numbers)
        self.input_names = inner.input_names if isinstance(inner, Cascade) else definition.inputs
        self.inertial = next((key for key, source in sensors.items() if "rates and forces" in source.measures), None)
        self.driving = {AXES.index(n): i for i, n in enumerate(self.input_names) if n in AXES and self.inertial}
        self.reckoning: Reckoning | None = None
        self.filter: Filter = inner
        self.memory = inner.memory
        if hasattr(inner, "at"):  # a particle filter has no other place
            size = len(inner.memory)
            self.memory = np.zeros(size + Reckoning.SIZE + behind)
            own_memory, axes, self.behind = np.split(self.memory, [size, size + Reckoning.SIZE])
            self.filter = inner.at(own_memory)
            if self.driving and set(numbers) >= Reckoning.NUMBERS:
                self.reckoning = Reckoning(axes, list(self.driving), numbers)
        self.inputs, self.names, self.sensors = self.filter.inputs, self.filter.names, tuple(sensors)
        self._of_axes: OfAxes | None = None  # made when it is needed
        self._of_measurements: OfMeasurements | None = None  # made when it is needed
        names_of_parts = [system.inputs for system, _ in definition.parts.values()]
        self._noise = [_variances(names, numbers) for names in names_of_parts]
        self._reckoned = [_inertial_inputs(names) for names in names_of_parts]
        self._takes = {key: self.reckoning.takes(source) if self.reckoning else None for key, source in sensors.items()}
        check_sensors(name, definition, self.input_names, sensors)
        self.since_fix = self.input_names.index(SINCE_FIX) if SINCE_FIX in self.input_names else None
        self.restart_clock()
        radius = numbers.get("rolling_radius", 0.3)
        memories = memories_of(definition, self.filter, self.input_names, sensors)
        self.use = {
            key: Use.of(sensor, definition, self.input_names, memories, speed_from(sensor, sensors, radius))
            for key, sensor in sensors.items()
        }
        numbers_each = len(AXES) + len(self.conditions)
        self._factor = np.eye(numbers_each)  # of the newest inertial innovation
        self._deviations = self._factor.reshape(-1)[:: numbers_each + 1]  # its diagonal
        self.fixes = {key for key, sensor in sensors.items() if "course" in sensor.measures}

    def uses(self, sensor: str) -> bool:
        """True if readings of this sensor do anything."""
        return self.use[sensor].does_something

    def needs(self, sensor: SensorBase) -> bool:
        """True if any input depends on what this sensor measures."""
        measured = {
            INPUTS[name].measures for name in self.input_names if name in INPUTS and not name.startswith("held")
        }
        return bool(measured & sensor.measures)

    @property
    def judged(self) -> tuple[int, ...]:
        """Axes of the first inertial sensor, places in `AXES`, that drive the filter or correct it."""
        if self.inertial is None or self.reckoning is None:
            return ()
        measured = (place for _, make, _, _ in self.use[self.inertial].measurements for place in _places(make))
        return tuple(sorted({*self.driving, *measured}))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of what is required of the motion at each inertial reading, one for each number."""
        if self.inertial is None:
            return ()
        return tuple(name for name, nothing, _ in self.use[self.inertial].conditions for _ in nothing)

    def start(self, belief: Gaussian) -> None:
        self.filter.start(belief)

    def restart_clock(self) -> None:
        """There has been no fix yet."""
        if self.since_fix is not None:
            self.inputs[self.since_fix] = NEVER
        if self.reckoning is not None:
            self.reckoning.restart()

    def predict(self, h: float) -> None:
        if self.reckoning is not None and self.reckoning.go_on(h):
            self._reckon(self.reckoning, h)
        self.filter.predict(h)
        if self.since_fix is not None:
            self.inputs[self.since_fix] += h

    def advance(self, step: Step) -> bool:
        """As `Filter.advance`; the filter inside makes a step at once where no axis has to be reckoned."""
        reckoning, size = self.reckoning, len(self.filter.memory)
        if reckoning is None or (step.steps > 1 and self.since_fix is not None):
            return super().advance(step)
        behind, kept_memory = self.memory[size:], step.kept.memory
        kept_memory[size:] = behind
        if reckoning.go_on(step.steps * step.h):
            behind[:] = kept_memory[size:]
            return super().advance(step)
        if not self.filter.advance(Step(Kept(kept_memory[:size], step.kept.address), step.steps, step.h)):
            behind[:] = kept_memory[size:]
            return False
        if self.since_fix is not None:
            self.inputs[self.since_fix] += step.h
        return True

    def _reckon(self, reckoning: Reckoning, h: float) -> None:
        """Drive the filter by what the other sensors say of the axes that are not believed, and know it less well."""
        reckoning.reckon(h)
        doubted = reckoning.doubted.tolist()
        density = np.zeros(len(AXES))
        for axis, place in self.driving.items():
            if doubted[axis]:
                self.inputs[place] = reckoning.expected[axis]
                density[axis] = reckoning.spoils(axis)
        if self._of_axes is None:
            self._of_axes = OfAxes(self)
        self._of_axes.add(density, h)

    def variances_of_inputs(self) -> list[Array]:
        """Variances (k,) of the inputs of each part now: those of their sensors, and of an axis that is reckoned what
        `reckoning` knows of it."""
        if self.reckoning is None or not self.reckoning.doubted.any():
            return self._noise
        variances_of_parts = [variances.copy() for variances in self._noise]
        for variances, places in zip(variances_of_parts, self._reckoned, strict=True):
            for place, axis in places:
                if self.reckoning.doubted[axis]:
                    variances[place] = self.reckoning.variance[axis]
        return variances_of_parts

    def innovation_of_axis(self, axis: int, value: Array, variance: Array) -> Innovation:
        """How far an axis of a reading (6,) of the first inertial sensor is from what is expected of it, which leaves
        the filter as it is. Alone it has a number in the innovation."""
        whitened, factor = np.full(len(AXES) + len(self.conditions), nan), np.eye(len(AXES) + len(self.conditions))
        distance, deviation = nan, 1.0
        if axis in self.driving and self.reckoning is not None:
            difference, deviation = self.reckoning.innovation(axis, float(value[axis]), float(variance[axis]))
            distance = difference / deviation
        else:
            for name, make, _, usual in self.use[self.inertial or ""].measurements:
                if axis in (places := _places(make)):
                    innovation = self._measure(name, make(value, variance), usual, -1.0, 1.0)
                    component = places.index(axis)
                    distance, deviation = (
                        innovation.whitened.item(component),
                        innovation.factor.item(component, component),
                    )
        whitened[axis], factor[axis, axis] = distance, deviation
        return Innovation(whitened, factor, distance * distance, False)

    def measures(self, name: str) -> bool:
        """True if any sensor makes the measurement of this name."""
        return any(name == measured for use in self.use.values() for measured, *_ in use.measurements)

    def compares_on_map(self, sensor: str) -> bool:
        """True if readings of a sensor are compared as they are, east and north."""
        names = [measured for measured, *_ in self.use[sensor].measurements]
        return names in (["gnss_velocity"], ["gnss_position"]) and not isinstance(self.filter, Cascade)

    def move(self, element: int, by: float, deviation: float) -> None:
        """Let an element of `names` jump by this; its error has this standard deviation and no correlation then."""
        name, place = self.names[element], element
        for part in filters_of(self.filter):
            if place >= len(part.names):
                place -= len(part.names)
                continue
            error = error_names(part).index(name.rpartition(".")[2])
            for ekf in getattr(part, "bank", [part]):
                ekf.mean[place] += by
                ekf.covariance[error, :] = ekf.covariance[:, error] = 0.0
                ekf.covariance[error, error] = deviation**2
            if hasattr(part, "mix"):
                part.mix()
            return

    def give_reading(self, sensor: str, value: Array) -> None:
        """Take the inputs of a reading (m,); NaN leaves one as it is."""
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
        if sensor == self.inertial and self.reckoning is not None:
            return self._correct_inertial(self.reckoning, sensor, value, variance, limit, scale)
        if (take := self._takes[sensor]) is not None:
            take(value)
        for memory in use.remembered:
            memory.renew(value)
        worst, accepted, innovation = 0.0, True, _NOTHING
        for name, make, own_limit, usual in use.measurements:
            innovation = self._measure(
                name, make(value, variance), usual, use.largest(own_limit, limit, len(value)), scale
            )
            share = innovation.nis / own_limit * largest_nis(use.gate, len(value)) if isfinite(own_limit) else 0.0
            worst = share if not share <= worst else worst
            accepted = accepted and (innovation.accepted or innovation.nis < 0)
        self.give_reading(sensor, value)
        if self.since_fix is not None and sensor in self.fixes and accepted and isfinite(value[0]):
            self.inputs[self.since_fix] = 0.0
        for name, nothing, variances in use.conditions:
            self.filter.correct(name, nothing, variances + self._variance_of_reckoning(name))
        return Innovation(innovation.whitened, innovation.factor, worst, accepted)

    def _measure(
        self, name: str, reading: tuple[Array, Array], usual: Array, largest: float, scale: float
    ) -> Innovation:
        value, variances = reading
        if not variances.all():  # of a sensor that the multibody car takes for an input without noise
            variances = np.where(variances > 0, variances, usual)
        return self.filter.correct(name, value, variances + self._variance_of_reckoning(name), largest, scale)

    def _variance_of_reckoning(self, name: str) -> Array | float:
        """Variances (m,) of a measurement by the axes that are reckoned, on which it depends; 0 without any."""
        if self.reckoning is None or not self.reckoning.doubted.any():
            return 0.0
        if self._of_measurements is None:
            self._of_measurements = OfMeasurements(self)
        doubted = self.reckoning.doubted > 0
        return self._of_measurements.variances(name, np.where(doubted, self.reckoning.variance, 0.0))

    def _correct_inertial(
        self, reckoning: Reckoning, sensor: str, value: Array, variance: Array, limit: float, scale: float
    ) -> Innovation:
        """Correct by a reading of the first inertial sensor.

        Its innovation has one component for each of `AXES`, NaN where the filter does not use it, and one for each of
        `conditions`. An axis that is not believed makes the normalized innovation squared larger than the gate's
        square. Without a limit, all is believed.
        """
        use = self.use[sensor]
        gate = use.gate if isfinite(limit) else np.inf
        whitened, deviations, refused = reckoning.read(value, variance, gate)
        if refused:
            value = value.copy()
            value[refused] = nan
        for memory in use.remembered:
            memory.renew(value)
        for name, make, own_limit, usual in use.measurements:
            largest_nis_of_measurement = use.largest(own_limit, limit, len(value))
            innovation = self._measure(name, make(value, variance), usual, largest_nis_of_measurement, scale)
            for k, place in enumerate(_places(make)):
                whitened[place], deviations[place] = innovation.whitened.item(k), innovation.factor.item(k, k)
                if not innovation.accepted and innovation.nis >= 0:
                    refused.append(place)
        self.give_reading(sensor, value)
        worst = -1.0
        for distance in whitened:
            if distance * distance > worst:
                worst = distance * distance
        if refused:
            worst = max(worst, _BEYOND * gate**2)
        self.refused = tuple(refused)
        for name, nothing, variances in use.conditions:
            innovation = self.filter.correct(name, nothing, variances + self._variance_of_reckoning(name))
            whitened += innovation.whitened.tolist()
            deviations += innovation.factor.diagonal().tolist()
        self._deviations[:] = deviations
        return Innovation(np.array(whitened), self._factor, worst, not refused)

    def belief(self) -> Gaussian:
        return self.filter.belief()

    def is_valid(self) -> bool:
        return self.filter.is_valid()

    def inflate(self) -> None:
        self.filter.inflate()


class OfAxes:
    """What axes of an inertial sensor add to the covariance of a filter that they drive, where they are reckoned."""

    def __init__(self, filter: Aided) -> None:
        self._length, self._parts = np.zeros(1), []
        parts = zip(filter.definition.parts.values(), filters_of(filter.filter), strict=True)
        for (system, _), part in parts:
            axes = [AXES.index(name) for name in system.inputs if name in AXES]
            if not axes:
                continue
            symbols, densities = Symbols(system), ca.SX.sym("densities", len(axes))
            variances = {AXES[axis]: densities[k] / symbols.h for k, axis in enumerate(axes)}
            added = ca.densify(system.noise_of_inputs(symbols.x, symbols.u, symbols.theta, symbols.h, variances))
            function = codegen.function(
                "added", [*symbols.now, symbols.h, densities], [added], ("x", "u", "p", "h", "densities")
            )
            own_densities, kernels = np.zeros(len(axes)), []
            for ekf in getattr(part, "bank", [part]):
                kernel = Kernel(function, [ekf.mean, ekf.inputs, parameters_of(ekf), self._length, own_densities])
                kernels.append((kernel, ekf.covariance))
            self._parts.append((axes, own_densities, kernels))

    def add(self, density: Array, h: float) -> None:
        """White noise of these densities (6,) for a step of `h` [s]."""
        self._length[0] = h
        for axes, own_densities, kernels in self._parts:
            own_densities[:] = density[axes]
            for kernel, covariance in kernels:
                kernel.call()
                covariance += kernel.results[0]


class OfMeasurements:
    """What axes of an inertial sensor that are reckoned add to the variances of measurements in which they occur: the
    velocity of an antenna depends on how fast the car turns."""

    def __init__(self, filter: Aided) -> None:
        self._slopes: dict[str, tuple[list[int], ca.Function, Any]] = {}  # axes, slopes (m, axes) by them, and the part
        parts = zip(filter.definition.parts.items(), filters_of(filter.filter), strict=True)
        for (part_name, (system, measurements)), part in parts:
            symbols = Symbols(system)
            places = [i for i, name in enumerate(system.inputs) if name in AXES]
            for measurement in measurements:
                measured, _ = symbols.measured(measurement)
                slopes = ca.jacobian(measured, symbols.u.vector)[:, places]
                if slopes.nnz():
                    name = f"{part_name}.{measurement.name}" if filter.definition.is_cascade else measurement.name
                    axes = [AXES.index(system.inputs[i]) for i in places]
                    self._slopes[name] = axes, ca.Function("slopes", symbols.now, [ca.densify(slopes)]), part

    def variances(self, name: str, of_axes: Array) -> Array | float:
        """Variances (m,) of a measurement by those of the axes (6,), to first order."""
        if name not in self._slopes:
            return 0.0
        axes, slopes, part = self._slopes[name]
        return np.asarray(slopes(part.mean, part.inputs, parameters_of(part))) ** 2 @ of_axes[axes]


def _places(make: Callable[[Array, Array], tuple[Array, Array]]) -> list[int]:
    """Components of a reading that a measurement consists of."""
    return make.places if isinstance(make, Components) else []


def _variances(names: Sequence[str], numbers: Mapping[str, float]) -> Array:
    """Variances (n,) of the noise of inputs, 0 for those of which the car has no number."""
    return np.array([numbers.get(NOISE_OF_INPUTS.get(name, ""), 0.0) ** 2 for name in names])


def _inertial_inputs(names: Sequence[str]) -> list[tuple[int, int]]:
    """The place of each input that is an axis of an inertial sensor, and the number of the axis."""
    return [(i, AXES.index(name)) for i, name in enumerate(names) if name in AXES]
