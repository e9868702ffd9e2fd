"""Inputs of a filter that are computed from its state and a reading, and remembered until the next one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.estimation.filter import Array, Filter
from vsense_ros.estimation.state_space import Named, Symbols, expression
from vsense_ros.model.sensors import SensorBase
from vsense_ros.navigation.space import Definition, Remembered, filters_of, parameters_of


class Memory:
    """A `Remembered` of the filter of a definition, with its function; `input_names` are those of all parts."""

    def __init__(
        self, remembered: Remembered, definition: Definition, filter: Filter, input_names: Sequence[str]
    ) -> None:
        part = filters_of(filter)[list(definition.parts).index(remembered.part)]
        symbols = Symbols(definition.parts[remembered.part][0])
        value = ca.SX.sym("value", 6 if remembered.measures == "rates and forces" else 2)
        errors = symbols.system.error_names
        covariance = ca.SX.sym("covariance", len(errors), len(errors))
        variance = Named(ca.diag(covariance), errors, "element of the error")
        remembered_inputs = remembered.equation(symbols.x, symbols.u, symbols.theta, value, variance)
        self.remembered, self._part, self._parameters = remembered, part, parameters_of(part)
        self.places = [input_names.index(name) for name in remembered_inputs]  # among the inputs of all parts
        self.own = [symbols.system.inputs.index(name) for name in remembered_inputs]  # among those of the part
        self._inputs, self._value = filter.inputs, np.zeros(value.numel())
        results = [expression(list(remembered_inputs.values()))]
        arguments = [*symbols.now, value, covariance]
        self.function = codegen.function("remembered", arguments, results, ("x", "u", "p", "value", "covariance"))
        bound = [part.mean, part.inputs, self._parameters, self._value, part.covariance.reshape(-1)]
        self._kernel = Kernel(self.function, bound)

    def renew(self, value: Array) -> None:
        """Renew the remembered inputs by a reading (m,)."""
        self._value[:] = value
        self._kernel.call()
        values = self._kernel.results[0][:, 0]
        if np.isfinite(values).all():
            self._inputs[self.places] = values
            self._part.inputs[self.own] = values


def memories_of(
    definition: Definition, filter: Filter, input_names: Sequence[str], sensors: Mapping[str, SensorBase]
) -> list[Memory]:
    """The remembered inputs of a filter that any of the sensors can renew."""
    measured = {quantity for sensor in sensors.values() for quantity in sensor.measures}
    return [Memory(one, definition, filter, input_names) for one in definition.remembered if one.measures in measured]
