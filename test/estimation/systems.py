"""Systems that the tests of filters run on, each with numbers: a state space, what measures it, and where it starts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.estimation import attitude
from vsense_ros.estimation.cekf import Cekf, ContinuousSettings, numbers_held
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace


class YawKkf(StateSpace):
    """Heading and bias of the yaw gyro: ψ̇ = r - b (Leung 2010, eq. 4.1; Bevly et al. 2001)."""

    names = ("yaw", "gyro_bias")
    inputs = ("yaw_rate",)

    def __init__(self, rate_noise: float = 0.005, bias_drift: float = 1e-5) -> None:
        self.density = np.square([rate_noise, bias_drift])

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * (u.yaw_rate - x.gyro_bias), x.gyro_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.density * h


class VelocityKkf(StateSpace):
    """Velocity and biases of the accelerometers: v̇ = a - b - ω × v (Leung 2010, eq. 4.4)."""

    names = ("forward", "forward_bias", "lateral", "lateral_bias")
    inputs = ("acceleration_x", "acceleration_y", "yaw_rate")

    def __init__(self, noise: float = 0.1, bias_drift: float = 1e-3) -> None:
        self.density = np.square([noise, bias_drift, noise, bias_drift])

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        forward = u.acceleration_x - x.forward_bias + u.yaw_rate * x.lateral
        lateral = u.acceleration_y - x.lateral_bias - u.yaw_rate * x.forward
        return [x.forward + h * forward, x.forward_bias, x.lateral + h * lateral, x.lateral_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.density * h


COURSE = Measurement("course", lambda x, z, u, p: x.yaw, (0.02,), angles=(0,))
VELOCITY = Measurement("velocity", lambda x, z, u, p: [x.forward, x.lateral], (0.1, 0.1))
SPEED = Measurement("speed", lambda x, z, u, p: x.forward, (0.05,))


class SingleTrack(StateSpace):
    """Lateral velocity and yaw rate of a linear single-track model at any speed (Riekert & Schunck 1940)."""

    names = ("lateral_velocity", "yaw_rate")
    inputs = ("steer_angle", "speed")
    parameters = ("mass", "yaw_inertia", "to_front", "to_rear", "front_stiffness", "rear_stiffness")
    auxiliaries = ("lateral_acceleration",)

    def __init__(self, density: tuple[float, float] = (1e-2, 1e-3)) -> None:
        self.density = np.square(density)

    def forces(self, x: Named, u: Named, theta: Named) -> tuple[ca.SX, ca.SX]:
        front = theta.front_stiffness * (u.steer_angle - (x.lateral_velocity + theta.to_front * x.yaw_rate) / u.speed)
        return front, -theta.rear_stiffness * (x.lateral_velocity - theta.to_rear * x.yaw_rate) / u.speed

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        front, rear = self.forces(x, u, theta)
        sideways = (front + rear) / theta.mass - u.speed * x.yaw_rate
        turning = (theta.to_front * front - theta.to_rear * rear) / theta.yaw_inertia
        return [x.lateral_velocity + h * sideways, x.yaw_rate + h * turning]

    def auxiliary(self, x: Named, u: Named, theta: Named) -> Any:
        front, rear = self.forces(x, u, theta)
        return (front + rear) / theta.mass

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.density * h


IMU = Measurement("imu", lambda x, z, u, p: [x.yaw_rate, z.lateral_acceleration], (0.003, 0.1))
SALOON = {
    "mass": 1858.0, "yaw_inertia": 3515.0, "to_front": 1.36, "to_rear": 1.546,
    "front_stiffness": 154780.0, "rear_stiffness": 147540.0,
}  # fmt: skip


STIFFNESS = ("front_stiffness", "rear_stiffness")
REST = {name: value for name, value in SALOON.items() if name not in STIFFNESS}


class Pendulum(StateSpace):
    """A nonlinear one: angle [rad] and rate of a pendulum with damping, in the semi-implicit Euler form."""

    names = ("angle", "rate")
    parameters = ("length", "damping")

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        rate = x.rate - h * (9.81 / theta.length * ca.sin(x.angle) + theta.damping * x.rate)
        return [x.angle + h * rate, rate]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [1e-6 * h, 1e-2 * h]


BOB = Measurement("bob", lambda x, z, u, p: [ca.sin(x.angle), ca.cos(x.angle)], (0.05, 0.05))


class Chain(StateSpace):
    """27 states, each of the first 13 a smooth function of six others, the rest constant: as much arithmetic as a car
    of 4 degrees of freedom with 14 parameters that are identified (Best & Bogdanski 2016)."""

    names = tuple(f"x{i}" for i in range(27))
    inputs = ("push",)

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        v, moved = x.vector, []
        for i in range(13):
            others = [v[(i + j) % 27] for j in (1, 3, 5, 7, 13, 20)]
            size = ca.sqrt(1 + sum(o * o for o in others))
            pull = ca.sin(ca.atan(1.3 * size - 0.4 * (size - ca.atan(size)))) * others[0] / size
            moved.append(v[i] + h * (pull - 0.5 * v[i] + u.push))
        return ca.vertcat(*moved, v[13:])

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return np.full(27, 1e-6) * h


LINK = Measurement("link", lambda x, z, u, p: [x.x0, x.x1 * x.x2, x.x5 + x.x20], (0.1, 0.1, 0.1))


@dataclass(frozen=True)
class Case:
    """A system with all that a filter of it needs, and inputs (k,) by time [s]."""

    system: StateSpace
    measurements: tuple[Measurement, ...]
    mean: tuple[float, ...]
    deviations: tuple[float, ...]
    parameters: dict[str, float] = field(default_factory=dict)
    inputs: Callable[[float], Any] = lambda time: ()
    h: float = 0.01

    @property
    def start(self) -> Gaussian:
        return Gaussian(np.array(self.mean), np.diag(np.square(self.deviations)))

    def dense(self) -> Dense:
        return Dense(self.system, self.measurements, self.parameters)

    def begun(self, filter: Any) -> Any:
        """The filter, with the first inputs, at the start."""
        filter.inputs[:] = self.inputs(0.0)
        filter.start(self.start)
        return filter


LINEAR = {
    "heading": Case(YawKkf(), (COURSE,), (0.1, 0.0), (0.1, 0.02), inputs=lambda t: [0.3 * np.sin(t)]),
    "velocity": Case(
        VelocityKkf(),
        (VELOCITY, SPEED),
        (10.0, 0.0, 0.0, 0.0),
        (1.0, 0.5, 1.0, 0.5),
        inputs=lambda t: [np.sin(t), 2 * np.sin(0.5 * t), 0.2 * np.sin(0.5 * t)],
    ),
    "single track": Case(
        SingleTrack(), (IMU,), (0.0, 0.0), (0.3, 0.1), SALOON, lambda t: [0.05 * np.sin(2.5 * t), 15.0 + t]
    ),
}
NONLINEAR = {
    "pendulum": Case(Pendulum(), (BOB,), (0.8, 0.0), (0.1, 0.1), {"length": 1.2, "damping": 0.1}),
    "chain": Case(Chain(), (LINK,), (0.1,) * 27, (0.3,) * 27, inputs=lambda t: [np.sin(t)]),
}
CASES = {**LINEAR, **NONLINEAR}


def continuous(case: Case, settings: ContinuousSettings | None = None) -> Cekf:
    """The continuous filter of a case."""
    held = numbers_held(len(one.deviations) for one in case.measurements)
    return Cekf(Dense(case.system, case.measurements, case.parameters, extra=held), settings)


def measured(case: Case, steps: int, every: int = 5, seed: int = 0) -> list[tuple[Array, list[Any]]]:
    """Inputs of each step and what is measured after it, of random numbers about what is expected."""
    random, found = np.random.default_rng(seed), []
    expected = Truth(case, random)
    for i in range(1, steps + 1):
        u = np.array(case.inputs(i * case.h), dtype=float)
        expected.step(u)
        values = [expected.measure(one) for one in case.measurements] if i % every == 0 else []
        found.append((u, values))
    return found


class Truth:
    """A run of the system itself, with the independent noises that its filter assumes, and its measurements."""

    def __init__(self, case: Case, random: np.random.Generator | None = None) -> None:
        self.case, self._filter = case, case.dense()
        if random is not None:
            self.begin(random)

    def begin(self, random: np.random.Generator) -> None:
        """From a state of which the filter is told the mean and the deviations."""
        self.random = random
        self._filter.mean[:] = self.case.mean
        self._filter.retract(random.normal(size=len(self.case.deviations)) * self.case.deviations)

    @property
    def state(self) -> Array:
        return self._filter.mean

    def parameters(self, values: dict[str, float]) -> None:
        """From now on the system has these."""
        self._filter.parameters[:] = [values[name] for name in self.case.system.parameters]

    def step(self, u: Array) -> None:
        system = self._filter
        system.inputs[:] = u
        system.covariance[:] = 0.0
        system.step(self.case.h)
        deviations = np.sqrt(system.noise.diagonal())
        system.retract(deviations * self.random.normal(size=len(deviations)))

    def measure(self, one: Measurement) -> Any:
        residual, _ = self._filter.sense(one.name, np.zeros(len(one.deviations)))
        noise = self.random.normal(size=len(one.deviations)) * one.deviations
        return one.measured(noise - residual)


def drive(filter: Any, case: Case, run: list[tuple[Array, list[Any]]]) -> list[Any]:
    """Lead a filter through a run, and return its innovations."""
    found = []
    for u, values in run:
        filter.inputs[: len(u)] = u
        filter.predict(case.h)
        for value in values:
            innovation = filter.correct(*value)
            found.append(innovation._replace(whitened=innovation.whitened.copy(), factor=innovation.factor.copy()))
    return found


class Attitude(StateSpace):
    """Attitude by quaternion and biases of three gyros: an error-state filter (Solà 2017), n = 7, e = 6."""

    names = ("w", "i", "j", "k", "bias_x", "bias_y", "bias_z")
    errors = ("about_x", "about_y", "about_z", "bias_x", "bias_y", "bias_z")
    inputs = ("rate_x", "rate_y", "rate_z")

    def __init__(self, rate_noise: float = 0.01, bias_drift: float = 1e-4) -> None:
        self.density = np.square([rate_noise] * 3 + [bias_drift] * 3)

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        q, bias = x.vector[:4], x.vector[4:]
        return ca.vertcat(attitude.product(q, attitude.rotation(h * (u.vector - bias))), bias)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.density * h

    def retract(self, x: Named, delta: ca.SX) -> Any:
        return ca.vertcat(attitude.retract(x.vector[:4], delta[:3]), x.vector[4:] + delta[3:])

    def difference(self, y: Named, x: Named) -> Any:
        return ca.vertcat(attitude.difference(y.vector[:4], x.vector[:4]), y.vector[4:] - x.vector[4:])


def _seen(x: Named, direction: list[float]) -> ca.SX:
    """A direction of the frame of reference, in the body."""
    return attitude.turned(attitude.inverse(x.vector[:4]), ca.DM(direction))


GRAVITY = Measurement("gravity", lambda x, z, u, p: _seen(x, [0, 0, 1]), (0.02,) * 3)
NORTH = Measurement("north", lambda x, z, u, p: _seen(x, [0, 1, 0]), (0.05,) * 3)
ATTITUDE = Case(
    Attitude(),
    (GRAVITY, NORTH),
    (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    (0.2, 0.2, 0.2, 0.02, 0.02, 0.02),
    inputs=lambda t: [0.5 * np.sin(t), 0.3 * np.cos(0.7 * t), 0.4],
)
