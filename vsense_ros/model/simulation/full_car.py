"""The car with all its bodies on its own: as `closed_loop`, with the same drivers and the same trajectories."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Kernel, compiled
from vsense_ros.errors import InputError
from vsense_ros.model import spatial
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.car.kinematic_tables import SteeringRack, WheelPosition, steering_rack
from vsense_ros.model.car.pose import leaning
from vsense_ros.model.car.road import bent, turning
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import (
    BANK,
    BANK_CHANGE,
    COORDINATES,
    DISTURBANCES,
    GRADE,
    GRADE_CHANGE,
    INPUTS,
    PITCH,
    POSE,
    RADIUS_ERROR,
    RATES,
    ROAD,
    ROAD_HEIGHT,
    ROLL,
    SPIN,
    STEERING,
    STEERING_OFFSET,
    TORQUES,
    TRAVEL,
    VELOCITY,
    WHEEL_OUTPUTS,
    WHEELS,
    YAW,
    X,
    Y,
    Z,
)
from vsense_ros.model.multibody.augmented_lagrangian import base_functions
from vsense_ros.model.multibody.integrator import Integrator
from vsense_ros.model.multibody.outside import Outside
from vsense_ros.model.simulation.closed_loop import Driver, Trajectory, rolling_straight
from vsense_ros.model.simulation.surface import Surface
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

NEAR = 1e-6  # opening of the linkages [m] before the last iteration: after it there is none


class FullCarPlant:
    """A full car that takes the inputs of the simplified one and shows its motion in the same 14 coordinates.

    `q`, `u`, `udot` (14) are those of `model.coordinates` at the present time; write `force` (14, generalized forces
    beyond the model's) and `disturbances` (the road; steering offset) in place. The rack follows the mean road-wheel
    angle that it takes at design height.

    Within a step the road's axes stand still. Then they are moved to where the car has come to, and turned as the road
    is there: on a `surface` that is geometry; else slopes are those that are given, and curvature turns the axes. Each
    wheel stands on the tangent plane of the road below it. `tolerance` and `outside` are those of its integrator.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        step: float,
        car: FullCar | None = None,
        rack: SteeringRack | None = None,
        surface: Surface | None = None,
        *,
        tolerance: float = 1e-9,
        outside: Outside | None = None,
    ) -> None:
        if vehicle.physics.steering.rear:
            raise InputError(f"{vehicle.name}: the full car has no rear steering; set physics.steering.rear to false")
        if vehicle.physics.trailer is not None:
            raise InputError(f"{vehicle.name}: the full car tows no trailer; leave physics.trailer out")
        self.car = car or FullCar(vehicle)
        self.step_length = step
        self.rack = rack or steering_rack(vehicle)
        self.integrator: Integrator = self.car.integrator(vehicle, step, tolerance, outside)
        self._vehicle = vehicle
        state = self.integrator.state
        motion, placing = compiled("full_car_motion", [self.car.motion_function(), self.car.placing_function()])
        self._guides = self.integrator.guides.reshape(-1, order="F")
        self._motion = Kernel(motion, [state.z, state.dz, state.ddz, self._guides, self.integrator.parameters])
        self.q, self.u, self.udot = (result.reshape(-1, order="F") for result in self._motion.results)
        self._target_q, self._target_u = np.zeros(COORDINATES), np.zeros(COORDINATES)
        self._place = Kernel(
            placing, [state.z, self._guides, self.integrator.parameters, self._target_q, self._target_u]
        )
        self.surface = surface
        # Where the road's axes stand in space: origin [m], heading [rad]; place of `cog` as a step begins [m].
        self._foot, self._origin, self._heading = np.zeros(3), np.zeros(3), 0.0
        self.force = np.zeros(COORDINATES)
        self.disturbances = np.zeros(len(DISTURBANCES))
        chassis, tracks = vehicle.physics.chassis, (vehicle.physics.front.track, vehicle.physics.rear.track)
        arms = (chassis.cog_to_front_axle, -chassis.cog_to_rear_axle)
        self._stands = np.array([[arms[i // 2], (0.5 - i % 2) * tracks[i // 2]] for i in range(len(WHEELS))])
        names = ("rise", "slope_x", "slope_y")
        self._of_road = np.array([[self.car.input_index(wheel, name) for name in names] for wheel in WHEELS])
        self._rates = base_functions(self.car.mechanism)[1]
        self._angle = self._rate = 0.0
        self._motion.call()

    def place(self, q: Array, u: Array, inputs: Array) -> None:
        """Puts the car into a state of the simplified one (14 each), with the wheels held at the angle of `inputs`."""
        mechanism, state = self.car.mechanism, self.integrator.state
        self._hold(inputs)
        corners = self.car.corner_parameters(self.integrator.parameters)
        for i, numbers in enumerate(corners):
            wheel = WheelPosition(self.car.corners[i // 2], numbers)
            rows = slice(mechanism.offsets[i], mechanism.offsets[i + 1])
            state.z[rows] = wheel.coordinates(q[TRAVEL][i], self._guides[0])
        if self.surface is not None:
            state.z[POSE] = q[POSE]
            self._stand(self.surface)
        self._act(inputs)
        self.correct(q, u)

    def correct(self, q: Array, u: Array) -> None:
        """Moves the car to a state nearby (14 each), as an observer does; accelerations follow from the equations.

        Raises `InputError` for a travel that the linkages do not reach, and leaves the car where it was.
        """
        self._target_q[:], self._target_u[:] = q, u
        self._place.call()
        placed, rates, violation = self._place.results
        if not violation.item() < NEAR:
            raise InputError(
                f"the full car cannot be put to travels {np.round(1e3 * q[TRAVEL], 1).tolist()} mm from where it is: "
                f"its linkages stay open by {violation.item():.2g} m; give a state nearby, within the stops"
            )
        state = self.integrator.state
        state.z[:], state.dz[:] = placed[:, 0], rates[:, 0]
        self.settle()

    def settle(self) -> None:
        """Makes rates and accelerations fit what was written into the car, which stays where it is."""
        self.integrator.settle()
        self._motion.call()

    def step(self, inputs: Array) -> None:
        """One step with the mean road-wheel angle [rad] and the wheel torques [N m], of its end (6,)."""
        self._integrate(inputs)
        self._move_road(self.step_length)

    def _integrate(self, inputs: Array) -> None:
        """A step while the road's axes stand still."""
        angle = float(inputs[STEERING] - self.disturbances[STEERING_OFFSET])
        rate = (angle - self._angle) / self.step_length
        self._guides[:] = self.rack.motion(angle, rate, (rate - self._rate) / self.step_length)
        self._angle, self._rate = angle, rate
        self._act(inputs)
        self.integrator.step()
        self._motion.call()

    def _move_road(self, duration: float) -> None:
        """Puts the road's axes to where the car has come to within a while [s]; where it is in space does not change,
        nor how it moves."""
        state, around = self.integrator.state, self.disturbances
        if self.surface is not None:
            state.z[POSE] = self._over_surface(self.surface)
        elif around[[GRADE_CHANGE, BANK_CHANGE]].any():
            roll, pitch = state.z[ROLL], state.z[PITCH]
            velocity = _rotation(roll, pitch, 0.0) @ self.u[VELOCITY]
            about_x, about_y = (duration * rate for rate in turning(around, velocity[X], velocity[Y]))
            state.z[[ROLL, PITCH, YAW]] -= about_x / np.cos(pitch), about_y, about_x * np.tan(pitch)
        else:
            return
        velocity = np.concatenate([self.u[RATES], self.u[VELOCITY]])
        state.dz[POSE] = np.asarray(self._rates(state.z[POSE])) @ velocity
        self._motion.call()

    def _over_surface(self, surface: Surface) -> Array:
        """The coordinates of the chassis (6,) over the surface below it; writes its form to the disturbances."""
        around, q = self.disturbances, self.integrator.state.z[POSE]
        axes = _axes(around[GRADE], around[BANK])  # as they stood during the step, turned by yaw from the map's
        turn = _rotation(0.0, 0.0, self._heading)
        road = turn @ axes
        moved = np.array([q[X], q[Y], 0.0]) - self._origin  # of cog, along the plane of the step
        unturn = _rotation(0.0, 0.0, -self._heading)
        place = self._foot + road @ (unturn @ moved) + road[:, 2] * q[Z]
        body = road @ _rotation(q[ROLL], q[PITCH], q[YAW] - self._heading)
        heading = float(np.arctan2(body[1, 0], body[0, 0]))
        foot = place[:2].copy()
        for _ in range(3):
            grade, bank, _, _, height = surface.under(foot[0], foot[1], heading)
            road_axes = _rotation(0.0, 0.0, heading) @ _axes(grade, bank)
            height_over_road = (place[2] - height) / road_axes[2, 2]
            foot = place[:2] - road_axes[:2, 2] * height_over_road
            ahead = road_axes.T @ body[:, 0]
            heading += float(np.arctan2(ahead[1], ahead[0]))
        around[ROAD] = surface.under(foot[0], foot[1], heading)
        road_axes = _rotation(0.0, 0.0, heading) @ _axes(around[GRADE], around[BANK])
        over_road = road_axes.T @ body
        self._foot = np.array([*foot, around[ROAD_HEIGHT]])
        self._origin, self._heading = np.array([*place[:2], 0.0]), heading
        height_over_road = float((place - self._foot) @ road_axes[:, 2])
        roll, pitch = np.arctan2(over_road[2, 1], over_road[2, 2]), -np.arcsin(over_road[2, 0])
        return np.array([*place[:2], height_over_road, roll, pitch, heading])

    def _stand(self, surface: Surface) -> None:
        """The road's axes where the car is put."""
        q = self.integrator.state.z[POSE]
        self._heading = float(q[YAW])
        self.disturbances[ROAD] = surface.under(q[X], q[Y], self._heading)
        self._foot, self._origin = np.array([q[X], q[Y], self.disturbances[ROAD_HEIGHT]]), np.array([q[X], q[Y], 0.0])

    def advance(self, inputs: Array, duration: float) -> None:
        """`duration` [s] with constant inputs, in equal steps of at most the length that the car was made with."""
        count = max(1, int(np.ceil(duration / self.step_length - 1e-9)))
        usual, self.step_length = self.step_length, duration / count
        self.integrator.h[0] = self.step_length
        try:
            for _ in range(count):
                self._integrate(inputs)
                if self.surface is not None:
                    self._move_road(self.step_length)
            if self.surface is None:
                self._move_road(duration)
        finally:
            self.step_length = self.integrator.h[0] = usual

    def memory(self) -> Array:
        """All that the car keeps from one step to the next, but for what is written into it and how it is steered."""
        state = self.integrator.state
        return np.concatenate([state.z, state.dz, state.ddz, state.multipliers])

    def recall(self, memory: Array, inputs: Array) -> None:
        """Puts the car where it was when it had this `memory`, but for its steering: forces are those of now and of
        `inputs`, and the wheels are held at their angle, for which the linkages are closed by `correct`.

        Wheels that were turned to another angle within a step would take the noise of a steering sensor for motion.
        """
        state = self.integrator.state
        parts = (state.z, state.dz, state.ddz, state.multipliers)
        values = np.split(memory, np.cumsum([part.size for part in parts[:-1]]))
        for part, value in zip(parts, values, strict=True):
            part[:] = value
        self._hold(inputs)
        self._act(inputs)

    @property
    def wheels(self) -> Array:
        """Tyre forces and slips at the present time, (7, 4), rows as `Car.wheel_outputs`."""
        return self.integrator.outputs().reshape(len(WHEELS), len(WHEEL_OUTPUTS)).T

    def _hold(self, inputs: Array) -> None:
        """The wheels at the mean angle of `inputs`, at rest."""
        self._angle, self._rate = float(inputs[STEERING] - self.disturbances[STEERING_OFFSET]), 0.0
        self._guides[:] = self.rack.motion(self._angle)

    def _act(self, inputs: Array) -> None:
        integrator, force = self.integrator, self.force
        integrator.wrench[spatial.ANGULAR], integrator.wrench[spatial.LINEAR] = force[RATES], force[VELOCITY]
        along, across = np.sin(self.disturbances[[GRADE, BANK]])
        yaw = integrator.state.z[YAW]
        down = -GRAVITY * np.array([along, across, np.sqrt(1 - along**2 - across**2)])
        integrator.gravity[:] = _rotation(0.0, 0.0, yaw) @ down
        integrator.inputs[self._of_road] = self._under_wheels()
        for i, wheel in enumerate(WHEELS):
            integrator.inputs[self.car.input_index(wheel, "torque")] = inputs[TORQUES][i] + force[SPIN][i]
            integrator.inputs[self.car.input_index(wheel, "travel_force")] = force[TRAVEL][i]

    def _under_wheels(self) -> Array:
        """The road below each wheel (4, 3), as `CORNER_INPUTS` has it."""
        if self.surface is None:
            return np.column_stack(bent(self.disturbances, *self._stands.T))
        axes = _rotation(0.0, 0.0, self._heading) @ _axes(self.disturbances[GRADE], self.disturbances[BANK])
        under_wheels = np.empty((len(WHEELS), 3))
        for row, stand in zip(under_wheels, self._stands, strict=True):
            place = self._foot + axes[:, :2] @ stand
            for _ in range(2):  # along the normal to the surface
                height, gradient, _ = self.surface.shape(place[0], place[1])
                normal = axes.T @ np.array([*-gradient, 1.0])
                gap = (height - place[2]) / normal[2]
                place = place + axes[:, 2] * gap
            slopes = -normal[:2] / normal[2]
            below = float(axes[:, 2] @ (place - self._foot))
            row[:] = slopes @ stand - below, *slopes
        return under_wheels


def simulate_full_car(
    vehicle: Vehicle,
    driver: Driver,
    duration: float,
    *,
    step: float = 0.002,
    keep_every: int = 1,
    q: Array | None = None,
    u: Array | None = None,
    force: Array | None = None,
    disturbances: Array | None = None,
    surface: Surface | None = None,
) -> Trajectory:
    """As `closed_loop.simulate`, for a vehicle with a `linkage` section.

    The driver is asked for the inputs at the end of each step. Raises `InputError` where a step does not converge or
    the rack cannot follow the driver.
    """
    plant = FullCarPlant(vehicle, step, surface=surface)
    if force is not None:
        plant.force[:] = force
    if disturbances is not None:
        if disturbances[RADIUS_ERROR] != 0:
            raise InputError(
                f"the full car has no relative error of the tyre radius, found {disturbances[RADIUS_ERROR]:g}: change "
                "unloaded_radius instead"
            )
        plant.disturbances[:] = disturbances
    start_q, start_u = rolling_straight(vehicle)
    start_q = start_q if q is None else q
    start_u = start_u if u is None else u
    inputs, command = np.zeros(len(INPUTS)), driver(0.0, start_q.copy(), start_u.copy())
    inputs[: len(command)] = command
    plant.place(start_q, start_u, inputs)
    steps = round(duration / step)
    recorded_steps = range(0, steps + 1, keep_every)
    result = replace(
        Trajectory.unfilled(np.array([i * step for i in recorded_steps])),
        disturbances=np.empty((len(recorded_steps), len(DISTURBANCES))),
    )
    row = 0
    for i in range(steps + 1):
        if i:
            command = driver(i * step, plant.q.copy(), plant.u.copy())
            inputs[: len(command)] = command
            plant.step(inputs)
        if i % keep_every == 0:
            result.q[row], result.u[row], result.udot[row] = plant.q, plant.u, plant.udot
            result.wheels[row], result.inputs[row] = plant.wheels, inputs
            result.disturbances[row] = plant.disturbances  # type: ignore[index]
            row += 1
    return result


def _axes(grade: float, bank: float) -> Array:
    """Road axes to level ones with the same heading, 3×3."""
    return _rotation(float(leaning(grade, bank)), -grade, 0.0)


def _rotation(roll: float, pitch: float, yaw: float) -> Array:
    """Body to ground, 3×3."""
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
