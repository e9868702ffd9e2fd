"""The car of table 1 of Best & Bogdanski (2016) as a plant, its driver, and the sensors of its CAN bus.

The plant is not the filter's: Runge-Kutta steps of 1 ms in place of 10, wheels that spin under
torques, and a driver of its own. What the identification gets is sampled at 100 Hz, noisy, and low-passed at 10 Hz.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.state_space import Named, expression
from vsense_ros.identification.rinsing import Drive, independent, low_passed
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.handling.best_4dof import PAPER, Best4Dof

STEP = 0.01  # [s] between two samples
SUBSTEPS = 10  # of the plant in a sample
SPIN_INERTIA = 1.4  # of a wheel [kg m²]
CUT_OFF = 10.0  # of the filters in the car [Hz]
# Standard deviations before the low-pass: steering [rad], wheel spin [rad/s]; accelerations [m/s²], roll rate [rad/s].
INPUT_NOISE = (0.0003, 0.03, 0.03, 0.03, 0.03)
OUTPUT_NOISE = (0.1, 0.1, 0.005)
_START_SPEED = 18.0  # [m/s]


@dataclass(frozen=True)
class Twin:
    """A run of the plant: states (N, 13) and inputs (N, 5) as the model has them."""

    states: Array
    inputs: Array

    @property
    def clean(self) -> Array:
        """Outputs without noise, (N, 3)."""
        return _outputs(self.states, self.inputs)

    def recorded(self, seed: int, name: str = "twin", cut_off: float = CUT_OFF, noise: float = 1.0) -> Drive:
        """What the sensors say, low-passed at a cut-off [Hz]; `noise` is a factor on their noise."""
        random = np.random.default_rng(seed)
        inputs = self.inputs + noise * random.standard_normal(self.inputs.shape) * INPUT_NOISE
        outputs = self.clean + noise * random.standard_normal(self.clean.shape) * OUTPUT_NOISE
        inputs, outputs = low_passed(inputs, STEP, cut_off), low_passed(outputs, STEP, cut_off)
        every = independent(STEP, cut_off)
        return Drive(name, STEP, inputs, outputs, self.states[0].copy(), every=every)


@dataclass
class Command:
    """What the driver does in a sample: rate of the road-wheel angle is limited to `quickest` [rad/s]; `force` is that
    of all wheels together [N]."""

    steering: float
    force: float
    quickest: float = 0.8


Driver = Callable[[int, Array, float], Command]  # sample, state of the plant (17,), road-wheel angle


def drive(driver: Driver, seconds: float, values: Mapping[str, float] = PAPER, speed: float = _START_SPEED) -> Twin:
    """Let the car be driven from straight ahead at a speed [m/s]."""
    count = round(seconds / STEP)
    plant, x, driven_by = _plant(), np.zeros(17), np.zeros(5)
    radius = values["wheel_radius"]
    x[0], x[13:] = speed, speed / radius
    kernel = codegen.Kernel(plant, [x, driven_by, np.array(list(values.values()))])
    states, known, torque, angle = np.zeros((count, 13)), np.zeros((count, 5)), np.zeros(4), 0.0
    for k in range(count):
        command = driver(k, x, angle)
        reach = command.quickest * STEP
        turned = min(max(command.steering - angle, -reach), reach)
        torque += STEP / 0.06 * (_torques(command.force, x, radius) - torque)
        states[k], known[k, 0], known[k, 1:] = x[:13], angle, x[13:]
        driven_by[1:] = torque
        for i in range(SUBSTEPS):
            driven_by[0] = angle + turned * (i + 0.5) / SUBSTEPS  # wheels turn without jumps, as a recording has them
            kernel.call()
            x[:] = kernel.results[0][:, 0]
        angle += turned
    return Twin(states, known)


def _torques(force: float, x: Array, radius: float) -> Array:
    """Torques of the four wheels [N m]: rear-wheel drive, brakes at all four, released by the driver where a wheel
    locks or spins."""
    wanted = np.zeros(4)
    if force > 0:
        wanted[2:] = min(force * radius / 2, 2600.0)
    else:
        wanted[:2] = max(0.65 * force * radius / 2, -2600.0)
        wanted[2:] = max(0.35 * force * radius / 2, -1400.0)
    slip = radius * x[13:] / max(x[0], 3.0) - 1
    turning = abs(x[2]) > 0.15
    sliding = abs(x[1]) > 0.05 * max(x[0], 3.0) or abs(x[2]) > 0.12
    wanted[(slip < -0.2) & (wanted < 0)] = 0.0
    wanted[(slip > (0.06 if sliding else 0.3)) & (wanted > 0)] = 0.0
    if turning:
        wanted[2:] = np.maximum(wanted[2:], 0.0)
    return wanted


def rich_driver(seed: int, level: float = 1.0) -> Driver:
    """Steers, brakes and accelerates at once, at a `level` of 1 up to the limits of the tyres; catches slides."""
    random, L = np.random.default_rng(seed), PAPER["wheelbase"]
    mass = (PAPER["front_weight"] + PAPER["rear_weight"]) / 9.80665
    plan: dict[str, Any] = {"speed_until": 0, "steer_until": 0, "target": 18.0, "boost": 1.0, "noise": 0.0}

    def drive(k: int, x: Array, angle: float) -> Command:
        if k >= plan["speed_until"]:
            plan["speed_until"] = k + int(random.uniform(100, 450))
            plan["target"], plan["boost"] = random.uniform(11, 32), 2.0 if random.random() < 0.35 else 1.0
        if k >= plan["steer_until"]:
            plan["steer_until"], plan["begun"] = k + int(random.uniform(80, 400)), k
            plan["mode"] = random.choice(["step", "sine", "zero", "ramp", "noise"], p=[0.3, 0.25, 0.15, 0.15, 0.15])
            speed = max(x[0], 6.0)
            limit = 9.0 * (L + 0.004 * speed**2) / speed**2
            size = level * random.uniform(0.15, 1.6) * limit * random.choice([-1, 1])
            plan["size"], plan["frequency"] = float(np.clip(size, -0.35, 0.35)), random.uniform(0.3, 1.8)
            plan["noise"] = 0.0
        at, size = (k - plan["begun"]) * STEP, plan["size"]
        if plan["mode"] == "noise":
            plan["noise"] += -3 * STEP * plan["noise"] + 1.2 * size * STEP**0.5 * random.standard_normal()
        wanted = {
            "step": size, "sine": size * np.sin(2 * np.pi * plan["frequency"] * at), "zero": 0.0,
            "ramp": size * min(at / 2, 1.0), "noise": plan["noise"],
        }[plan["mode"]]  # fmt: skip
        slip = float(np.arctan2(x[1], max(x[0], 3.0)))
        slides = abs(slip) > 0.1
        force = mass * plan["boost"] * float(np.clip(1.5 * (plan["target"] - x[0]), -10 * level, 6 * level))
        if x[0] < 5.0:
            plan["target"] = 20.0
        if slides:
            return Command(slip, min(force, 0.0), 2.5)
        return Command(float(wanted), force)

    return drive


def step_then_brake(k: int, x: Array, angle: float) -> Command:
    """Straight on, a step of the steering at 4 s, straight again, and from 12 s a step with braking."""
    at = k * STEP
    turned = 0.045 if 4.0 <= at < 8.0 else -0.05 if 12.0 <= at < 18.0 else 0.0
    force = -9000.0 if 14.0 <= at < 16.0 else 600.0 if at < 14.0 else 0.0
    return Command(turned, force)


def straight(k: int, x: Array, angle: float) -> Command:
    """Accelerates until the rear wheels spin, and brakes hard, straight on."""
    phase = (k * STEP) % 10.0
    if phase < 5.0:
        return Command(0.0, 14000.0 if x[0] < 30.0 else 0.0)
    return Command(0.0, -14000.0 if x[0] > 10.0 and phase < 8.0 else 0.0)


def random_steering(seed: int) -> Driver:
    """Constant speed, and a steering angle that wanders with a time constant of 0.5 s."""
    random, angle, speed = np.random.default_rng(seed), {"now": 0.0}, 20.0

    def drive(k: int, x: Array, _: float) -> Command:
        angle["now"] += -2.0 * STEP * angle["now"] + 0.08 * STEP**0.5 * random.standard_normal()
        return Command(angle["now"], 1500.0 * (speed - x[0]))

    return drive


@cache
def _plant() -> ca.Function:
    """A step of 1 ms of the car with its wheels: (state (17,), road-wheel angle and wheel torques (5,), parameters)."""
    model = Best4Dof()
    x, driven_by, p = ca.SX.sym("x", 17), ca.SX.sym("u", 5), ca.SX.sym("p", len(model.parameters))
    angle, torques = driven_by[0], driven_by[1:]
    named = Named(p, model.parameters)

    def rates(at: ca.SX) -> ca.SX:
        state, inputs = Named(at[:13], model.states), Named(ca.vertcat(angle, at[13:]), model.inputs)
        along, _ = model.tyre_forces(state)
        spin = [(torques[i] - named.wheel_radius * along[i]) / SPIN_INERTIA for i in range(len(WHEELS))]
        return ca.vertcat(expression(list(model.rates(state, inputs, named))), *spin)

    h = STEP / SUBSTEPS
    k1 = rates(x)
    k2 = rates(x + h / 2 * k1)
    k3 = rates(x + h / 2 * k2)
    k4 = rates(x + h * k3)
    moved = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return codegen.compiled("twin", [codegen.function("plant", [x, driven_by, p], [moved], ("x", "u", "p"))])[0]


def _outputs(states: Array, inputs: Array) -> Array:
    model = Best4Dof()
    x, u, p = ca.SX.sym("x", 13), ca.SX.sym("u", 5), ca.SX(np.array(list(PAPER.values())))
    measured = model.measured(Named(x, model.states), Named(u, model.inputs), Named(p, model.parameters))
    function = ca.Function("outputs", [x, u], [expression(list(measured))])
    return np.array(function.map(len(states))(states.T, inputs.T)).T
