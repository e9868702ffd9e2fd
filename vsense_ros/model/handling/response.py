"""What a handling model does, as numbers: Jacobians, straight running, frequency response, drives with given inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.handling.base import HandlingModel
from vsense_ros.model.parameter import Scalar

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ResponseSettings:
    """Numerical settings of the response of handling models."""

    gamma: float = 1 - 1 / np.sqrt(2)  # [-] of the step: stable however stiff the wheels are
    newton_steps: int = 5  # to a straight run: tyres are nearly linear there


RESPONSE = ResponseSettings()


class Values:
    """The elements of a vector by name, as attributes or keys."""

    def __init__(self, names: Sequence[str], vector: Any) -> None:
        self._of = {name: vector[i] for i, name in enumerate(names)}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name not in self._of:
            raise AttributeError(name)
        return self._of[name]

    def __getitem__(self, name: str) -> Any:
        return self._of[name]


@dataclass(frozen=True)
class Linear:
    """ẋ = A x + B u, y = C x + D u around one state; (n, n), (n, k), (m, n), (m, k)."""

    a: Array
    b: Array
    c: Array
    d: Array

    def gain(self, frequency: Array, output: int, direction: Array) -> NDArray[np.complex128]:
        """Complex response of an output to inputs in a `direction` (k,), at angular frequencies (w,) [rad/s]."""
        unit = np.eye(len(self.a))
        b, d = self.b @ direction, self.d[output] @ direction
        responses = [self.c[output] @ np.linalg.solve(1j * w * unit - self.a, b) + d for w in np.atleast_1d(frequency)]
        return np.array(responses)


class Response:
    """A model with numbers for its parameters."""

    def __init__(self, model: HandlingModel, numbers: Mapping[str, float]) -> None:
        self.model = model
        self.parameters = np.array([numbers[name] for name in model.parameters])
        x, u, p = (ca.SX.sym(k, len(n)) for k, n in (("x", model.states), ("u", model.inputs), ("p", model.parameters)))
        named = [Values(n, v) for n, v in ((model.states, x), (model.inputs, u), (model.parameters, p))]
        rates, outputs = (ca.vertcat(*expressions) for expressions in (model.rates(*named), model.measured(*named)))
        self.rates = ca.Function("rates", [x, u, p], [rates])
        self.outputs = ca.Function("outputs", [x, u, p], [outputs])
        by_state, by_input = (
            [ca.jacobian(function, variables) for function in (rates, outputs)] for variables in (x, u)
        )
        h = ca.SX.sym("h")
        after = rosenbrock_step(self.rates, by_state[0], x, u, p, h)
        self._step = ca.Function("step", [x, u, p, h], [after])
        slopes = ca.SX.sym("slopes", len(model.states), len(model.parameters))
        moved = ca.jacobian(after, x) @ slopes + ca.jacobian(after, p)
        with_slopes, with_slopes_after = (ca.horzcat(*pair) for pair in ((x, slopes), (after, moved)))
        self._slope_step = ca.Function("slope_step", [with_slopes, u, p, h], [with_slopes_after])
        slopes_of_outputs = ca.jacobian(outputs, x) @ slopes + ca.jacobian(outputs, p)
        self._output_slopes = ca.Function("output_slopes", [with_slopes, u, p], [slopes_of_outputs])
        following = model.following(*named)
        followed = ca.vertcat(*(following.get(name, u[i]) for i, name in enumerate(model.inputs)))
        by_motion, by_free_input = ca.jacobian(followed, x), ca.jacobian(followed, u)
        coupled = [
            function
            for a, b in zip(by_state, by_input, strict=True)
            for function in (a + b @ by_motion, b @ by_free_input)
        ]
        self._jacobians = ca.Function("jacobians", [x, u, p], coupled)

    def straight(self, speed: float) -> tuple[Array, Array]:
        """State (n,) and inputs (k,) of a steady straight run at `speed` [m/s]: the driven wheels push against the drag
        of the air."""
        model = self.model
        by_name = dict(zip(model.parameters, self.parameters.tolist(), strict=True))
        moving, inputs = model.rolling(speed, by_name)
        x = np.array([moving.get(name, 0.0) for name in model.states])
        u = np.array([inputs.get(name, 0.0) for name in model.inputs])
        wheels = [i for i, name in enumerate(model.states) if name.startswith("spin_")]
        pushing = [i for i, name in enumerate(model.inputs) if name in model.driven]
        if not pushing:
            return x, u
        balanced = [0, *wheels]  # forward velocity and spins do not change
        for _ in range(RESPONSE.newton_steps):
            linear = self.linear(x, u)
            slope = np.column_stack([linear.b[:, pushing].sum(axis=1), linear.a[:, wheels]])[balanced]
            unbalance = np.asarray(self.rates(x, u, self.parameters)).ravel()[balanced]
            change = np.linalg.solve(slope, unbalance)
            u[pushing] -= change[0]
            x[wheels] -= change[1:]
        return x, u

    def linear(self, x: Array, u: Array) -> Linear:
        """The model around a state (n,) and inputs (k,); wheels roll along with the car (`HandlingModel.following`)."""
        return Linear(*(np.asarray(jacobian) for jacobian in self._jacobians(x, u, self.parameters)))

    def frequency_response(
        self, speed: float, frequency: Array, output: str = "lateral_velocity"
    ) -> NDArray[np.complex128]:
        """Frequency response of an output to the road-wheel angle in straight running at `speed` [m/s], both front
        wheels turned alike, at angular frequencies (w,) [rad/s]."""
        direction = np.array([float(name.startswith("steering")) for name in self.model.inputs])
        return self.linear(*self.straight(speed)).gain(frequency, self.model.outputs.index(output), direction)

    def drive(self, start: Array, inputs: Array, step: float) -> Array:
        """States (n + 1, states) from `start` on, with inputs (n, k) that are held for `step` [s] each."""
        steps = len(inputs)
        run = self._step.mapaccum("drive", steps)
        parameters = np.broadcast_to(self.parameters[:, None], (len(self.parameters), steps))
        after = run(start, inputs.T, parameters, np.full((1, steps), step))
        return np.vstack([start, np.asarray(after).T])

    def sensitivities(self, start: Array, inputs: Array, step: float) -> Array:
        """Derivatives of the outputs by the parameters along a drive, (n, m, p), inputs (n, k) held for `step` [s]: by
        forward propagation, exactly those of the steps that `drive` takes."""
        steps, count = len(inputs), len(self.parameters)
        run, output_slopes = self._slope_step.mapaccum("slopes", steps), self._output_slopes.map(steps)
        parameters = np.broadcast_to(self.parameters[:, None], (count, steps))
        begin = ca.horzcat(ca.DM(start), ca.DM.zeros(len(start), count))
        after = run(begin, inputs.T, parameters, np.full((1, steps), step))
        before = ca.horzcat(begin, after[:, : -(count + 1)])
        slopes = np.asarray(output_slopes(before, inputs.T, parameters))
        return slopes.reshape(len(self.model.outputs), steps, count).transpose(1, 0, 2)


def rosenbrock_step(rates: ca.Function, jacobian: ca.SX, x: ca.SX, u: ca.SX, p: ca.SX, h: Scalar) -> ca.SX:
    """State after `h` [s] by the method ROS2 of second order (Verwer et al. 1999): spin of wheels is stiff."""
    system = ca.SX.eye(x.numel()) - RESPONSE.gamma * h * jacobian
    first = ca.solve(system, rates(x, u, p))
    second = ca.solve(system, rates(x + h * first, u, p) - 2 * first)
    return x + h * (1.5 * first + 0.5 * second)
