"""The car on its own: from inputs, or a driver, to motions and tyre forces.

The step is the observer's (ROS2 with the exact Jacobian), at a length where its error no longer shows: second order,
stable however stiff the tyres become near standstill.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Kernel
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import GAMMA, model_functions
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import (
    BANK,
    COORDINATES,
    DISTURBANCES,
    GRADE,
    INPUTS,
    RATES,
    ROAD,
    ROAD_HEIGHT,
    SPEED_X,
    SPEED_Y,
    SPIN,
    VELOCITY,
    WHEEL_OUTPUTS,
    WHEELS,
    YAW,
    X,
    Y,
    Z,
)
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.simulation.surface import Surface
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

_SLOPES = slice(GRADE, BANK + 1)

# (time [s], q (14,), u (14,)) → road-wheel angle [rad], wheel torques fl, fr, rl, rr [N m], and of a car with rear
# steering the angle of its rear wheels [rad]: the first of `model.coordinates.INPUTS`. It is asked once a step, in
# order of time, for the middle of the step, with the state at the step's beginning; it may keep a memory, but must not
# change or keep the arrays it is given.
Driver = Callable[[float, Array, Array], Array]


@dataclass(frozen=True)
class Trajectory:
    """What the car did, n instants; coordinates and their units as in `model.coordinates`."""

    t: Array  # (n,) [s]
    q: Array  # (n, 14)
    u: Array  # (n, 14)
    udot: Array  # (n, 14)
    wheels: Array  # (n, 7, 4) as Car.wheel_outputs
    inputs: Array  # (n, 6) as model.coordinates.INPUTS, those of the step that begins here
    disturbances: Array | None = None  # (n, 7) as model.coordinates.DISTURBANCES; zeros if not given
    internal_state: Array | None = None  # (n, k) as Car.internal_state, in the step that begins here

    @classmethod
    def unfilled(cls, t: Array) -> Trajectory:
        """Room for the instants `t` (n,) [s]."""
        n = len(t)
        q, u, udot = (np.empty((n, COORDINATES)) for _ in range(3))
        wheels = np.empty((n, len(WHEEL_OUTPUTS), len(WHEELS)))
        return cls(t, q, u, udot, wheels, inputs=np.empty((n, len(INPUTS))))

    @property
    def acceleration(self) -> Array:
        """Kinematic acceleration of `cog` in body axes, (n, 3) [m/s²]."""
        return self.udot[:, VELOCITY] + np.cross(self.u[:, RATES], self.u[:, VELOCITY])

    @property
    def side_slip(self) -> Array:
        """Angle from the car's heading to its velocity, positive to the left, (n,) [rad]."""
        return np.arctan2(self.u[:, SPEED_Y], self.u[:, SPEED_X])


def axle_of(vehicle: Vehicle, wheel: int) -> Axle:
    """The axle of wheel 0 to 3 (fl, fr, rl, rr)."""
    return vehicle.physics.front if wheel < 2 else vehicle.physics.rear


def rolling_radii(vehicle: Vehicle) -> Array:
    """Effective rolling radius of each wheel under its static load, (4,) [m]."""
    chassis = vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    arms = (chassis.cog_to_rear_axle, chassis.cog_to_front_axle)
    radii = []
    for i in range(len(WHEELS)):
        axle = axle_of(vehicle, i)
        load = chassis.mass * GRAVITY * arms[i // 2] / wheelbase / 2
        radii.append(axle.unloaded_radius - (1 - axle.dynamic_radius_factor) * load / axle.tyre_stiffness)
    return np.array(radii)


def rolling_straight(vehicle: Vehicle, speed: float = 0.0) -> tuple[Array, Array]:
    """Coordinates and velocities (14 each) of the car in its design position at `speed` [m/s] along the map's x."""
    q, u = np.zeros(COORDINATES), np.zeros(COORDINATES)
    q[Z] = vehicle.physics.chassis.cog_height
    u[SPEED_X] = speed
    u[SPIN] = speed / rolling_radii(vehicle)
    return q, u


def simulate(
    vehicle: Vehicle,
    driver: Driver,
    duration: float,
    *,
    step: float = 1e-3,
    keep_every: int = 1,
    q: Array | None = None,
    u: Array | None = None,
    force: Array | None = None,
    disturbances: Array | None = None,
    surface: Surface | None = None,
) -> Trajectory:
    """Drive a car for `duration` [s] in steps of `step` [s], and keep every `keep_every`-th instant from the first on.

    `q`, `u` (14) is the state at the beginning (default: standing in the design position), `force` (14) a constant
    generalized force beyond the model's, `disturbances` (7) road and offsets as in
    `model.coordinates.DISTURBANCES`, to which the vehicle's effects add the slopes of their roads. On a `surface` the
    road is that where the car is.
    Raises `FloatingPointError` where the motion leaves what the coordinates can describe (a pitch of 90°).
    """
    start_q, start_u = rolling_straight(vehicle)
    now_q = np.array(start_q if q is None else q, dtype=float)
    now_u = np.array(start_u if u is None else u, dtype=float)
    inputs = np.zeros(len(INPUTS))
    extra = np.zeros(COORDINATES) if force is None else np.array(force, dtype=float)
    constant = np.zeros(len(DISTURBANCES)) if disturbances is None else np.array(disturbances, dtype=float)
    around = constant.copy()
    road = vehicle.physics.effects.present()
    car = car_of(vehicle)
    functions = model_functions(car)
    internal_state = np.zeros(car.internal_state.numel())
    arguments = [now_q, now_u, extra, around, inputs, vehicle.parameter_vector(), internal_state]
    linearize = Kernel(functions["linearize"], arguments)
    outputs = Kernel(functions["dynamics"], arguments)
    udot, by_q, by_u, _, by_q_rates = linearize.results
    inverse = np.zeros(COORDINATES**2)
    h = np.array([step])
    advance = Kernel(functions["advance"], [*arguments, h, inverse, by_q.reshape(-1, order="F")])
    # The internal state belongs to the beginning of a step, inputs to its middle.
    inputs_at_begin = np.zeros(len(INPUTS))
    beginning = [*arguments[:4], inputs_at_begin, *arguments[5:], h]
    move_on = Kernel(functions["internal_state"], beginning) if internal_state.size else None
    unit = np.eye(COORDINATES)

    steps = round(duration / step)
    recorded_steps = range(0, steps + 1, keep_every)
    result = replace(
        Trajectory.unfilled(np.array([i * step for i in recorded_steps])),
        disturbances=np.empty((len(recorded_steps), len(DISTURBANCES))),
        internal_state=np.empty((len(recorded_steps), internal_state.size)),
    )
    row, set_out = 0, float(now_q[YAW])
    for i in range(steps + 1):
        if surface is not None:
            around[ROAD] = surface.under(now_q[X], now_q[Y], now_q[YAW])
        elif road:
            around[_SLOPES] = constant[_SLOPES] + np.sum(
                [effect.slope(now_q[YAW] - set_out) for effect in road], axis=0
            )
        inputs_at_begin[:] = inputs
        command = driver((i + 0.5) * step, now_q.copy(), now_u.copy())
        inputs[: len(command)] = command
        inputs_at_begin[:] = (inputs_at_begin + inputs) / 2 if i else inputs
        if move_on is not None:
            move_on.call()
            internal_state[:] = move_on.results[0][:, 0]
        linearize.call()
        if i % keep_every == 0:
            outputs.call()
            result.q[row], result.u[row], result.udot[row] = now_q, now_u, udot.ravel()
            result.wheels[row], result.inputs[row] = outputs.results[1], inputs
            result.disturbances[row] = around  # type: ignore[index]
            result.internal_state[row] = internal_state  # type: ignore[index]
            row += 1
        slope = by_u + (GAMMA * step) * by_q_rates
        inverse[:] = np.linalg.inv(unit - (GAMMA * step) * slope).reshape(-1, order="F")
        advance.call()
        if surface is None:
            around[ROAD_HEIGHT] += step * float(np.sin(around[_SLOPES]) @ now_u[[SPEED_X, SPEED_Y]])
        now_q[:], now_u[:] = advance.results[0][:, 0], advance.results[1][:, 0]
        if not np.isfinite(now_u.sum()):
            raise FloatingPointError(f"{vehicle.name}: the motion left the model's range at {i * step:g} s")
    return result
