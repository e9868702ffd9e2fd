"""The multibody car with the forces that it lacks, as an extended Kalman filter works with it.

`Ekf(CarBlocks(vehicle, sensors))` is the errorEKF (Sanjurjo, Dopico, Luaces & Naya 2018; Rodríguez 2020): the model
runs on its own, and the filter estimates the *errors* of its coordinates, velocities and accelerations, x = [Δq, Δu,
Δu̇], and of the slow quantities around it. ⊞ adds to coordinates and velocities, and through the mass matrix to the
generalized forces, ΔQ = M Δu̇, which the model keeps until the next correction.

Unlike the slides, which propagate errors as a triple integrator, the transition here is the exact linearisation of the
model step, so that the tyres' damping of side slip and yaw is known to the filter. Most of it is zero or diagonal:
`car_blocks.c` works on its blocks, some 40,000 multiplications for 52 states instead of the 280,000 of F P Fᵀ.
Without a compiler the same is done here with full matrices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Kernel
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.car.steps import GAMMA, compiled_wheel_forces, model_functions, sensor_functions
from vsense_ros.model.coordinates import (
    ATTITUDE,
    BANK,
    BANK_CHANGE,
    COORDINATES,
    GRADE,
    GRADE_CHANGE,
    INPUTS,
    POSE,
    ROAD,
    ROAD_HEIGHT,
    SURFACE,
)
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_operations import SINGULAR, CarOperations
from vsense_ros.observer.state import (
    DISTURB,
    DYNAMIC,
    FOLLOWED,
    FORCE,
    FORM,
    FORWARD,
    GAIN_COLUMNS,
    ROAD_STATES,
    SLOPE_CHANGES,
    SLOPES,
    TWIST,
    Prior,
    Q,
    U,
    couple,
    largest_state,
    layout,
    rolling_state,
)

Array = NDArray[np.float64]

SURVEYED = 4  # numbers: where the road was last looked up, and what was known of it there
_SLOW = U.stop  # states from here on decay by themselves, towards a mean
_UNIT = np.eye(COORDINATES)
ROADS = ROAD.stop  # states of the road under the car
_OF_FORCES = np.concatenate([DYNAMIC, np.arange(U.start, U.stop), np.arange(DISTURB.start, DISTURB.stop)])
TWIST_SIZE = TWIST.stop - TWIST.start
ROAD_SLOW = slice(ROAD_STATES.start - _SLOW, ROAD_STATES.stop - _SLOW)  # of the states behind the velocities


@dataclass(frozen=True)
class Sensed:
    """What the filter needs of a sensor: its function, bound to the state, and where its biases stand."""

    index: int
    kernel: Kernel  # results: expected (m, 1), and Jacobians by q, u, udot, disturbances
    biases: slice
    uses_acceleration: bool
    mounting: Array


class Process(NamedTuple):
    """Decay of the states behind the velocities within some time and variance that it adds to them, (n - 28,) each, and
    where the two stand, one after the other."""

    decay: Array
    noise: Array
    address: int

    @classmethod
    def of(cls, decay: Array, noise: Array) -> Process:
        """With both in one array, as C reads them."""
        both = np.array([decay, noise])
        return cls(both[0], both[1], both.ctypes.data)


class CarBlocks:
    """One vehicle with one set of sensors.

    `mean` (n,) holds coordinates, velocities, generalized forces, disturbances and biases; `covariance` (n, n) belongs
    to the errors of the same elements, with accelerations [m/s², rad/s²] in place of the forces. `inputs` (5,) drive
    the model, `surveyed` (4,) is where the road was last looked up, east and north [m], and for each of its slopes 1
    where it was known. All this and the last linearisation stand in `memory`. A filter that is built upon this one may
    keep `extra` numbers of its own there.
    """

    in_blocks: ClassVar[bool] = True  # C knows the step

    def __init__(
        self, vehicle: Vehicle, sensors: dict[str, SensorBase], *, extra: int = 0, prior: Prior | None = None
    ) -> None:
        self.vehicle, self.sensor_list = vehicle, tuple(sensors.values())
        self.layout = layout(sensors)
        self.names, self.sensors = self.layout.names, tuple(sensors)
        self.prior = Prior.of(vehicle, sensors) if prior is None else prior
        self.car = car_of(vehicle)
        self.functions = model_functions(self.car)
        self._allocate(extra)
        self._bind(self.car, sensors)
        self.largest = largest_state(self.layout.size)
        self._processes: dict[int, Process] = {}
        self.operations = CarOperations.of(self) if self.in_blocks else None

    def _allocate(self, extra: int) -> None:
        n = self.layout.size
        physical = self.vehicle.parameter_vector()
        jacobians = self.functions["linearize"].nnz_out()
        sizes = {
            "mean": n,
            "inputs": len(INPUTS),
            "covariance": n * n,
            "effects": self.car.internal_state.numel(),
            "linearization": jacobians,
            "parameters": len(physical),
            "extra": extra,
            "reversion_mean": n - _SLOW,
            "surveyed": SURVEYED,
        }
        self.memory = np.zeros(sum(sizes.values()))
        parts = dict(zip(sizes, np.split(self.memory, np.cumsum([*sizes.values()][:-1]).tolist()), strict=True))
        self.mean, self.inputs, self.effects = parts["mean"], parts["inputs"], parts["effects"]
        self.covariance = parts["covariance"].reshape(n, n)
        self.linearization, self.parameters, self.extra = parts["linearization"], parts["parameters"], parts["extra"]
        self.reversion_mean, self.surveyed = parts["reversion_mean"], parts["surveyed"]
        self.parameters[:] = physical
        self.reversion_mean[:] = self.prior.reversion_mean[_SLOW:]
        # What is made anew in every step, and need not be kept.
        self.inverse = np.zeros((COORDINATES, COORDINATES), order="F")  # (I - γ h J)⁻¹, which the model's step needs
        self.gain = np.zeros((COORDINATES, len(GAIN_COLUMNS)))  # errors of the velocities by those before the step
        self.error, self.h = np.zeros(n), np.zeros(1)
        self.roughness, self.levers = self.prior.roughness.copy(), self.prior.levers.copy()
        self.road_map = np.zeros((ROADS, len(FOLLOWED)))  # the road by how the car moves and by what it was before

    def _bind(self, car: Car, sensors: dict[str, SensorBase]) -> None:
        """The functions of the model and the sensors, to the arrays."""
        functions = self.functions
        q, u, force, around = (self.mean[part] for part in (Q, U, FORCE, DISTURB))
        self.arguments = [q, u, force, around, self.inputs, self.parameters, self.effects]
        self.linearized = Kernel(functions["linearize"], self.arguments, self.linearization)
        self.udot, self.by_q, self.by_u, self.by_disturbances, self.by_q_rates = self.linearized.results
        self.kinematics = Kernel(functions["kinematics"], [q, u, around])
        flat = [m.reshape(-1, order="F") for m in (self.inverse, self.by_q)]
        self.advanced = Kernel(functions["advance"], [*self.arguments, self.h, *flat])
        self.remembered = Kernel(functions["internal_state"], [*self.arguments, self.h]) if self.effects.size else None
        self.forces = Kernel(
            functions["force"], [q, self.inputs, around, self.parameters, self.effects, self.error[FORCE]]
        )
        self._present = Kernel(functions["dynamics"], self.arguments)
        self._wheel_forces = Kernel(compiled_wheel_forces(car), self.arguments)
        sensing = sensor_functions(car, self.sensor_list)
        self.sensed: dict[str, Sensed] = {}
        for i, (name, sensor, biases) in enumerate(
            zip(self.sensors, self.sensor_list, self.layout.biases, strict=True)
        ):
            if not sensor.is_input:
                mounting = np.asarray(sensor.mounting(), dtype=float)
                bound = [q, u, self.udot, around, self.inputs, self.mean[biases], mounting]
                kernel = Kernel(sensing[sensor.kind], bound)
                self.sensed[name] = Sensed(i, kernel, biases, sensor.uses_acceleration, mounting)
        names = car.parameter_names
        self.components: Mapping[str, int] = {
            name: len(self.sensor_list[one.index].deviations()) for name, one in self.sensed.items()
        }
        self._distances = np.array([names.index(f"chassis.cog_to_{axle}_axle") for axle in ("front", "rear")])

    def process(self, h: float) -> Process:
        """What happens within `h` [s] to the states behind the velocities.

        Kept for steps of equal length to 10 µs: a thousandth of a step changes less than the settings are known to.
        """
        length = max(round(h * 1e5), 1)
        known = self._processes.get(length)
        if known is None:
            h = length * 1e-5
            prior = self.prior
            decay = np.exp(-h * prior.rate[_SLOW:])
            noise = prior.deviation[_SLOW:] ** 2 * (1 - decay**2) + prior.density[_SLOW:] * h
            known = self._processes[length] = Process.of(decay, noise)
        return known

    # Beginning

    def forget(self) -> None:
        """All but mean and covariance as before any measurement."""
        self.reversion_mean[:] = self.prior.reversion_mean[_SLOW:]
        self.surveyed[:] = np.inf, np.inf, 0.0, 0.0
        self.parameters[:] = self.vehicle.parameter_vector()
        self.inputs[:] = 0.0
        self.effects[:] = 0.0

    def rolling(self, speed: float) -> Gaussian:
        """A car that rolls straight ahead at `speed` [m/s], known as little as before any measurement."""
        mean = np.concatenate([rolling_state(self.vehicle, speed), self.prior.reversion_mean[_SLOW:]])
        return Gaussian(mean, self.prior.covariance)

    def start(self, belief: Gaussian) -> None:
        """Begin at a mean and a covariance."""
        self.mean[:], self.covariance[:] = belief.mean, belief.covariance

    def follow_slopes(self, slopes: Array, changes: Array, along: Array) -> None:
        """From now on the slopes of the road along and across the car (2,), positive uphill and with the left side
        higher [rad], go back to these, and what they change by along the way [rad/m] to `changes` (2,); where `along`
        (2,) is 1 the car has come to them on a road that has them, and those that are estimated change as these do."""
        for part, target in ((SLOPES, slopes), (SLOPE_CHANGES, changes)):
            mean = self.reversion_mean[part.start - _SLOW : part.stop - _SLOW]
            self.mean[part] += along * (target - mean)
            mean[:] = target

    # One step and one correction with full matrices, of which `car_blocks.c` knows the blocks

    def linearize(self) -> None:
        self.linearized.call()

    def step(self, h: float) -> None:
        process = self.process(h)
        self.move_effects(h)
        self.respond(h)
        self.kinematics.call()
        self.advanced.call()
        noise = self.map_road(h, process)
        self.propagate(self.transition(h, process.decay), noise)
        coordinates, velocities = self.advanced.results
        self.move(coordinates[:, 0], velocities[:, 0], h, process)
        self.linearize()

    def move_effects(self, h: float) -> None:
        """What effects remember, after a step of `h` [s] that has not been made yet."""
        self.h[0] = h
        if self.remembered is not None:
            self.remembered.call()
            self.effects[:] = self.remembered.results[0][:, 0]

    def respond(self, h: float) -> None:
        """Fill `inverse` and `gain` for a step of `h` [s]: the stability function of ROS2, and its response to a
        constant force, applied to the linearised model."""
        slope = self.by_u + GAMMA * h * self.by_q_rates
        try:
            inverse = np.linalg.inv(_UNIT - GAMMA * h * slope)
        except np.linalg.LinAlgError:
            raise FloatingPointError(SINGULAR) from None
        self.inverse[:] = inverse
        response = inverse @ (h * _UNIT + h * (0.5 - GAMMA) / GAMMA * (inverse - _UNIT))
        self.gain[:] = response @ np.hstack([self.by_q, slope, _UNIT, self.by_disturbances])
        self.gain[:, len(DYNAMIC) : len(DYNAMIC) + COORDINATES] += _UNIT

    def map_road(self, h: float, process: Process) -> Array:
        """Fill `road_map` for a step of `h` [s], as the function of that name in C; returns the variances that the step
        adds to the states behind the velocities (n - 28,)."""
        *_, by_velocity, by_road = self.kinematics.results
        changing = [GRADE, BANK, ROAD_HEIGHT]
        self.road_map[:] = 0.0
        self.road_map[changing, : len(by_velocity.T)] = h * by_velocity
        self.road_map[changing, len(by_velocity.T) :] = h * by_road
        noise = process.noise.copy()
        way = h * abs(self.mean.item(FORWARD))
        for slope, change, (rate, variance, back) in zip(
            (GRADE, BANK), (GRADE_CHANGE, BANK_CHANGE), self.roughness, strict=True
        ):
            decay = 1 / (1 + way * rate)
            self.road_map[slope, TWIST_SIZE + slope] += 1.0
            self.road_map[change, TWIST_SIZE + change] = decay
            self.road_map[change, TWIST_SIZE + slope] = -decay * way * back
            noise[ROAD_STATES.start - _SLOW + change] += variance * (1 - decay**2)
        return noise

    def transition(self, h: float, decay: Array) -> Array:
        """F (n, n), the derivative of the errors after a step of `h` [s] by those before it: velocities first, then
        coordinates and the road, which follow the new velocities."""
        f = np.eye(self.layout.size)
        f[U] = 0.0
        f[U, GAIN_COLUMNS] = self.gain
        by_angles, by_velocity, by_road, *_ = self.kinematics.results
        f[POSE, ATTITUDE] += h * by_angles
        f[POSE, FORM] += h * by_road
        f[POSE] += h * by_velocity @ f[TWIST]
        f[POSE.stop : Q.stop] += h * f[TWIST.stop : U.stop]
        f[FORM, FORM] = 0.0
        road = f[ROAD_STATES]
        road[:, FORM] = self.road_map[:, TWIST_SIZE:]
        road += self.road_map[:, :TWIST_SIZE] @ f[TWIST]
        f[_SLOW:] *= decay[:, None]
        return f

    def propagate(self, f: Array, noise: Array) -> None:
        """Covariance after a step; `noise` (k,) are the variances that it adds to the last k states."""
        moved = f.dot(self.covariance).dot(f.T)
        np.multiply(0.5, moved + moved.T, out=self.covariance)
        self.add_noise(noise)

    def add_noise(self, noise: Array) -> None:
        """Add variances (k,) to those of the last k states, and what belongs beside them."""
        n = self.layout.size
        self.covariance.reshape(-1)[(n - len(noise)) * (n + 1) :: n + 1] += noise
        couple(self.covariance, noise, n - len(noise), self.levers)  # of the velocities, or of the forces

    def move(self, coordinates: Array, velocities: Array, h: float, process: Process) -> None:
        """Take the state after a step of `h` [s]; the slow states go back towards their means."""
        self.relax(self.mean[_SLOW:], h, velocities - self.mean[U], process)
        self.mean[Q], self.mean[U] = coordinates, velocities

    def relax(self, slow: Array, h: float, faster: Array, process: Process) -> None:
        """Let states behind the velocities (…, n - 28) go on for `h` [s]: the road as the car comes by, whose
        velocities (…, 14) are `faster` by so much at the end, the others back towards their means."""
        *_, rate, by_velocity, by_road = self.kinematics.results
        road, mean = slow[..., ROAD_SLOW], self.reversion_mean[ROAD_SLOW]
        changes, slopes = slice(GRADE_CHANGE, BANK_CHANGE + 1), slice(GRADE, BANK + 1)
        back = self.road_map[changes, TWIST_SIZE:]
        form = road[..., SURFACE] - self.mean[FORM]  # of sigma points
        road[..., changes] = (
            mean[changes]
            + (road[..., changes] - mean[changes]) @ back[:, changes].T
            + (road[..., slopes] - mean[slopes]) @ back[:, slopes].T
        )
        road[..., [GRADE, BANK, ROAD_HEIGHT]] += h * (
            rate[:, 0] + faster[..., :TWIST_SIZE] @ by_velocity.T + form @ by_road.T
        )
        mean[slopes] += h * self.mean[FORWARD] * mean[changes]
        slow -= self.reversion_mean
        slow *= process.decay
        slow += self.reversion_mean

    def through(self) -> Array:
        """Derivative of the accelerations by the errors, (14, n)."""
        through = np.zeros((COORDINATES, self.layout.size))
        through[:, DYNAMIC], through[:, U] = self.by_q, self.by_u
        through[:, FORCE], through[:, DISTURB] = _UNIT, self.by_disturbances
        return through

    def through_wheels(self) -> tuple[Array, Array]:
        """Derivatives by the errors: of force x, y, z and aligning moment of each wheel as the model has them, (16, n),
        and of the generalized forces along y and about z that it lacks, (2, n)."""
        self._wheel_forces.call()
        derivative, mass = self._wheel_forces.results
        by_error, lacking = np.zeros((len(derivative), self.layout.size)), np.zeros((2, self.layout.size))
        by_error[:, _OF_FORCES] = derivative
        lacking[:, FORCE] = mass
        return by_error, lacking

    def sense(self, sensor: str, value: Array) -> tuple[Array, Array]:
        known = self.sensed[sensor]
        known.kernel.call()
        expected, by_q, by_u, by_udot, by_disturbances = known.kernel.results
        h = by_udot.dot(self.through()) if known.uses_acceleration else np.zeros((len(expected), self.layout.size))
        h[:, Q] += by_q
        h[:, U] += by_u
        h[:, DISTURB] += by_disturbances
        biases = known.biases
        h[:, biases] += np.eye(len(h))[:, : biases.stop - biases.start]
        return value - expected[:, 0], h

    def retract(self, error: Array) -> None:
        self.error[:] = error
        self.forces.call()
        added = self.forces.results[0][:, 0]
        self.udot[:, 0] += self.through().dot(error)
        self.mean[: FORCE.start] += error[: FORCE.start]
        self.mean[FORCE] += added
        self.mean[FORCE.stop :] += error[FORCE.stop :]

    # What monitors ask

    def is_valid(self) -> bool:
        """True if the mean can be a car's."""
        within = np.count_nonzero(np.abs(self.mean) < self.largest)
        return bool(self.covariance.item(FORWARD, FORWARD) > 0 and within == len(self.mean))

    @property
    def axle_distances(self) -> Array:
        """Distances of the front and the rear axle from the centre of gravity, (2,) [m]."""
        return self.parameters.take(self._distances)

    def present(self) -> tuple[Array, Array]:
        """Derivatives of the velocities (14,), and forces and slips of the wheels as `Car.wheel_outputs` (7×4).

        They are computed at the present state, while corrections carry `udot` on from the last linearisation.
        """
        self._present.call()
        udot, wheels = self._present.results
        return udot[:, 0], wheels
