"""A model whose sensors are not perfect: what is identified besides, because nobody knows it of a real car."""

from __future__ import annotations

from typing import Any

from vsense_ros.estimation.integrated import Rates
from vsense_ros.estimation.state_space import Named, expression

STEERING = ("steering_gain", "steering_offset")


class WithSensorErrors:
    """The model with a steering that is gained and off, which are parameters: true road-wheel angle over the measured
    one, and what is to be added to it [rad]. Outputs have offsets that wander, as a road's grade and bank make them:
    further states, `<output>_offset`, in the unit of each output."""

    def __init__(self, model: Rates) -> None:
        self.model = model
        self.offsets = tuple(f"{name}_offset" for name in model.outputs)
        self.states = (*model.states, *self.offsets)
        self.inputs, self.outputs = model.inputs, model.outputs
        self.parameters = (*model.parameters, *STEERING)

    def rates(self, x: Any, u: Any, p: Any) -> list[Any]:
        """As the model's; offsets stay."""
        return [*self.model.rates(x, self._steered(u, p), p), *[0.0] * len(self.offsets)]

    def measured(self, x: Any, u: Any, p: Any) -> list[Any]:
        """What sensors read, (m,)."""
        true = self.model.measured(x, self._steered(u, p), p)
        return [value + x[offset] for value, offset in zip(true, self.offsets, strict=True)]

    def _steered(self, u: Any, p: Any) -> Any:
        values = [u[name] for name in self.inputs]
        values[self.inputs.index("steering")] = p.steering_gain * u.steering + p.steering_offset
        return Named(expression(values), self.inputs, "input")
