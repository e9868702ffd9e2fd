"""A model whose sensors are not perfect, on a road that is not flat: what nobody knows of a real car and its road."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vsense_ros.estimation.integrated import Rates
from vsense_ros.estimation.state_space import Named, expression
from vsense_ros.identification.rinsing import Drive

STEERING = ("steering_gain", "steering_offset", "steering_delay")
RATE = "steering_rate"
WANDER = "steering_wander"
SLOPES = {"lateral_velocity": "bank", "speed": "grade"}  # of the road, by the state that they act on
TIME_CONSTANTS = {WANDER: 3.0, "bank": 10.0, "grade": 10.0}  # by which they go back to zero [s]


class WithSensorErrors:
    """The model with the errors of its sensors, and the slopes of the road.

    Parameters: gain of the steering, true road-wheel angle over the measured one; what is to be added to it [rad]; and
    its delay [s], by which the measured angle comes later than the other signals, to first order:
    δ = gain (δ_m + delay δ̇_m) + offset.

    Further states: offsets of the outputs, `<output>_offset`, in the unit of each, that drift; and what comes and goes
    (Gauss-Markov, `TIME_CONSTANTS`): `steering_wander` [rad], the angle that would turn the car as wind, ruts and the
    play of the steering do, and the accelerations [m/s²] down the `bank` and the `grade` of the road. A slope acts on
    the car, and not on accelerometers: they read the forces that the tyres bring up against it.
    """

    def __init__(self, model: Rates) -> None:
        self.model = model
        self.offsets = tuple(f"{name}_offset" for name in model.outputs)
        self._slopes = {state: name for state, name in SLOPES.items() if state in model.states}
        self.wandering = (WANDER, *self._slopes.values())
        self.errors = (*self.offsets, *self.wandering)
        self.states = (*model.states, *self.errors)
        self.inputs, self.outputs = (*model.inputs, RATE), model.outputs
        self.parameters = (*model.parameters, *STEERING)

    def rates(self, x: Any, u: Any, p: Any) -> list[Any]:
        """As the model's, with the slopes; offsets stay, what wanders goes back to zero."""
        rates = list(self.model.rates(x, self._steered(x, u, p), p))
        for state, slope in self._slopes.items():
            rates[self.model.states.index(state)] -= x[slope]
        return [*rates, *[0.0] * len(self.offsets), *(-x[name] / TIME_CONSTANTS[name] for name in self.wandering)]

    def measured(self, x: Any, u: Any, p: Any) -> list[Any]:
        """Readings (m,) of the sensors."""
        true = self.model.measured(x, self._steered(x, u, p), p)
        return [value + x[offset] for value, offset in zip(true, self.offsets, strict=True)]

    def drive(self, drive: Drive) -> Drive:
        """The drive of the model with the rate of its steering, and errors that are zero at the start."""
        rate = np.gradient(drive.inputs[:, self.model.inputs.index("steering")], drive.h)
        start = np.concatenate([drive.start, np.zeros(len(self.errors))])
        return replace(drive, inputs=np.column_stack([drive.inputs, rate]), start=start)

    def _steered(self, x: Any, u: Any, p: Any) -> Any:
        values = [u[name] for name in self.model.inputs]
        measured = u.steering + p.steering_delay * u.steering_rate
        values[self.model.inputs.index("steering")] = p.steering_gain * measured + p.steering_offset + x.steering_wander
        return Named(expression(values), self.model.inputs, "input")
