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

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Gaussian
from vsense_ros.model.car.steps import GAMMA
from vsense_ros.model.coordinates import (
    ATTITUDE,
    BANK,
    BANK_CHANGE,
    COORDINATES,
    GRADE,
    GRADE_CHANGE,
    POSE,
    ROAD_HEIGHT,
    SURFACE,
)
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_memory import SLOW, CarMemory, Process
from vsense_ros.observer.car_operations import SINGULAR, CarOperations
from vsense_ros.observer.state import (
    DISTURB,
    DYNAMIC,
    FORCE,
    FORM,
    FORWARD,
    GAIN_COLUMNS,
    ROAD_STATES,
    SLOPE_CHANGES,
    SLOPES,
    SPIN_FORCES,
    TWIST,
    Prior,
    Q,
    U,
    couple,
    rolling_state,
)
from vsense_ros.observer.wheel_torques import PAIRS

Array = NDArray[np.float64]

_UNIT = np.eye(COORDINATES)
TORQUE_PAIRS = tuple(np.array(PAIRS).T)
_OF_FORCES = np.concatenate([DYNAMIC, np.arange(U.start, U.stop), np.arange(DISTURB.start, DISTURB.stop)])
TWIST_SIZE = TWIST.stop - TWIST.start
ROAD_SLOW = slice(ROAD_STATES.start - SLOW, ROAD_STATES.stop - SLOW)  # of the states behind the velocities


def accelerations_by_error(by_q: Array, by_u: Array, by_disturbances: Array, size: int) -> Array:
    """Derivative of the first r accelerations by the errors of a state of this size (…, r, n), from that by the
    dynamic coordinates (…, r, 7), velocities (…, r, 14) and disturbances (…, r, 7)."""
    by_error = np.zeros((*by_u.shape[:-1], size))
    by_error[..., DYNAMIC], by_error[..., U] = by_q, by_u
    by_error[..., FORCE], by_error[..., DISTURB] = _UNIT[: by_u.shape[-2]], by_disturbances
    return by_error


def wheels_by_error(derivative: Array, mass: Array, size: int) -> tuple[Array, Array]:
    """Derivatives (…, 16, n) and (…, 3, n) by the errors of a state of this size, of those in `CarBlocks.show`."""
    by_error, lacking = np.zeros((*derivative.shape[:-1], size)), np.zeros((*mass.shape[:-1], size))
    by_error[..., _OF_FORCES] = derivative
    lacking[..., FORCE] = mass
    return by_error, lacking


class CarBlocks(CarMemory):
    """One vehicle with one set of sensors, and the steps and corrections of its filter."""

    in_blocks: ClassVar[bool] = True  # C knows the step

    def __init__(
        self, vehicle: Vehicle, sensors: dict[str, SensorBase], *, extra: int = 0, prior: Prior | None = None
    ) -> None:
        super().__init__(vehicle, sensors, extra=extra, prior=prior)
        self.operations = CarOperations.of(self) if self.in_blocks else None

    # Beginning

    def forget(self) -> None:
        """All but mean and covariance as before any measurement."""
        self.reversion_mean[:] = self.prior.reversion_mean[SLOW:]
        self.surveyed[:] = np.inf, np.inf, 0.0, 0.0
        self.parameters[:] = self.vehicle.parameter_vector()
        self.inputs[:] = 0.0
        self.effects[:] = 0.0

    def rolling(self, speed: float) -> Gaussian:
        """A car that rolls straight ahead at `speed` [m/s], known as little as before any measurement."""
        mean = np.concatenate([rolling_state(self.vehicle, speed), self.prior.reversion_mean[SLOW:]])
        return Gaussian(mean, self.prior.covariance)

    def start(self, belief: Gaussian) -> None:
        """Begin at a mean and a covariance."""
        self.mean[:], self.covariance[:] = belief.mean, belief.covariance

    def follow_slopes(self, slopes: Array, changes: Array, along: Array) -> None:
        """From now on the slopes of the road along and across the car (2,), positive uphill and with the left side
        higher [rad], go back to these, and what they change by along the way [rad/m] to `changes` (2,); where `along`
        (2,) is 1 the car has come to them on a road that has them, and those that are estimated change as these do."""
        for part, target in ((SLOPES, slopes), (SLOPE_CHANGES, changes)):
            mean = self.reversion_mean[part.start - SLOW : part.stop - SLOW]
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
        self.share_torques(process.shared)
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
        distance = h * abs(self.mean.item(FORWARD))
        for slope, change, (rate, variance, reversion) in zip(
            (GRADE, BANK), (GRADE_CHANGE, BANK_CHANGE), self.roughness, strict=True
        ):
            decay = 1 / (1 + distance * rate)
            self.road_map[slope, TWIST_SIZE + slope] += 1.0
            self.road_map[change, TWIST_SIZE + change] = decay
            self.road_map[change, TWIST_SIZE + slope] = -decay * distance * reversion
            noise[ROAD_STATES.start - SLOW + change] += variance * (1 - decay**2)
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
        f[SLOW:] *= decay[:, None]
        return f

    def propagate(self, f: Array, noise: Array) -> None:
        """Covariance after a step; `noise` (k,) are the variances that it adds to the last k states."""
        moved = f.dot(self.covariance).dot(f.T)
        np.multiply(0.5, moved + moved.T, out=self.covariance)
        self.add_noise(noise)

    def share_torques(self, shared: Array) -> None:
        """Add covariances (6,) of the errors of two wheels' torques each, as `PAIRS`."""
        spin = self.covariance[SPIN_FORCES, SPIN_FORCES]
        spin[TORQUE_PAIRS] += shared
        spin.T[TORQUE_PAIRS] += shared

    def add_noise(self, noise: Array) -> None:
        """Add variances (k,) to those of the last k states, and what belongs beside them."""
        n = self.layout.size
        self.covariance.reshape(-1)[(n - len(noise)) * (n + 1) :: n + 1] += noise
        couple(self.covariance, noise, n - len(noise), self.levers)  # of the velocities, or of the forces

    def move(self, coordinates: Array, velocities: Array, h: float, process: Process) -> None:
        """Take the state after a step of `h` [s]; the slow states go back towards their means."""
        self.relax(self.mean[SLOW:], h, velocities - self.mean[U], process)
        self.mean[Q], self.mean[U] = coordinates, velocities

    def relax(self, slow: Array, h: float, faster: Array, process: Process) -> None:
        """Let states behind the velocities (…, n - 28) go on for `h` [s]: the road as the car comes by, whose
        velocities (…, 14) are `faster` by so much at the end, the others back towards their means."""
        *_, rate, by_velocity, by_road = self.kinematics.results
        road, mean = slow[..., ROAD_SLOW], self.reversion_mean[ROAD_SLOW]
        changes, slopes = slice(GRADE_CHANGE, BANK_CHANGE + 1), slice(GRADE, BANK + 1)
        reversion = self.road_map[changes, TWIST_SIZE:]
        form = road[..., SURFACE] - self.mean[FORM]  # of sigma points
        road[..., changes] = (
            mean[changes]
            + (road[..., changes] - mean[changes]) @ reversion[:, changes].T
            + (road[..., slopes] - mean[slopes]) @ reversion[:, slopes].T
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
        return accelerations_by_error(self.by_q, self.by_u, self.by_disturbances, self.layout.size)

    def sense(self, sensor: str, value: Array) -> tuple[Array, Array]:
        sensed = self.sensed[sensor]
        sensed.kernel.call()
        expected, by_q, by_u, by_udot, by_disturbances, by_biases = sensed.kernel.results
        h = by_udot.dot(self.through()) if sensed.uses_acceleration else np.zeros((len(expected), self.layout.size))
        h[:, Q] += by_q
        h[:, U] += by_u
        h[:, DISTURB] += by_disturbances
        biases = sensed.biases
        h[:, biases] += np.diag(by_biases[:, 0])[:, : biases.stop - biases.start]
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
        count_inside = np.count_nonzero(np.abs(self.mean) < self.largest)
        return bool(self.covariance.item(FORWARD, FORWARD) > 0 and count_inside == len(self.mean))

    def present(self) -> tuple[Array, Array]:
        """Derivatives of the velocities (14,), and forces and slips of the wheels as `Car.wheel_outputs` (7×4).

        They are computed at the present state, while corrections carry `udot` on from the last linearisation.
        """
        self._present.call()
        udot, wheels = self._present.results
        return udot[:, 0], wheels

    @property
    def shown_size(self) -> int:
        """How many numbers `show` fills."""
        return self._shown.size

    def show(self, into: Array) -> None:
        """What outputs need beside the `memory`: the results of `present`, then derivatives at the present state of
        which `wheels_by_error` makes those by the errors: of force x, y, z and aligning moment of each wheel as the
        model has them, (16, k), and of the generalized forces along x and y and about z that it lacks, (3, 14). All of
        them are column by column."""
        self._present.call()
        self._wheel_forces.call()
        into[:] = self._shown
