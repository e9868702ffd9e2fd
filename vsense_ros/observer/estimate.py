"""An estimate in the terms of the car, and as messages."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Gaussian
from vsense_ros.messages import estimates as messages
from vsense_ros.messages.recording import Sample
from vsense_ros.model.car.pose import angles, orientation_on_map, position_on_map
from vsense_ros.model.coordinates import (
    BANK,
    COORDINATES,
    DISTURBANCES,
    FORCE_X,
    GRADE,
    GRADE_CHANGE,
    RATES,
    ROAD_HEIGHT,
    SLIP,
    SPIN,
    STEERING_OFFSET,
    TORQUES,
    VELOCITY,
    WHEELS,
    YAW,
    X,
    Y,
)
from vsense_ros.model.sensors.wheel_speeds import NAMES as WHEEL_NAMES
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks, accelerations_by_error, wheels_by_error
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.observable import undetermined
from vsense_ros.observer.state import DISTURB, DYNAMIC, FORCE, TWIST
from vsense_ros.observer.unseen import add_drift, add_tilt, add_unseen, outer, unlikely_bias

Array = NDArray[np.float64]

BALANCE = "vsense/balance"
_MASS = "chassis.mass"
_NEXT, _AFTER_NEXT = [1, 2, 0], [2, 0, 1]  # of three axes
_POSE_AND_ROAD = np.ix_(*[[*range(6), *(DISTURB.start + i for i in (ROAD_HEIGHT, BANK, GRADE))]] * 2)
_OVER_AND_OF_ROAD = np.column_stack([np.eye(6), [0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, -1, 0]])
_VELOCITY, _RATES = (slice(TWIST.start + part.start, TWIST.start + part.stop) for part in (slice(0, 3), slice(3, 6)))
_LONGITUDINAL_FORCES, _LATERAL_FORCES = (slice(i, None, 4) for i in (0, 1))  # of force x, y, z, moment of each wheel
_WHEELS_SHOWN = slice(COORDINATES, COORDINATES + 7 * len(WHEELS))  # of `CarBlocks.show`
_PLACE, _YAW_OF_POSE = [0, 1], 5  # of position and attitude
_SLOW = 4.0  # [m/s] below it a course says little of the heading
_SMALLEST_SPEED = 0.5  # [m/s] below it a side-slip angle has no meaning


class Block:
    """Room for as many estimates of one filter as `size`: their arrays are rows of its own, so that what is computed of
    all of them at once needs no copies."""

    def __init__(self, car: CarBlocks, size: int) -> None:
        self.memory = np.empty((size, car.places["parameters"].stop))
        self.shown = np.empty((size, car.shown_size))
        self.longitudinal_shares = np.empty((size, len(WHEELS)))
        self.unbalanced = np.full((size, 6), np.nan)
        self.undecided = np.zeros((size, 9))
        self.bend = np.zeros(size)
        self.used = 0

    @property
    def is_full(self) -> bool:
        """True if there is no room left."""
        return self.used == len(self.bend)


_ARRAYS = ("memory", "shown", "longitudinal_shares", "unbalanced", "undecided", "bend")


@dataclass(eq=False)
class Estimate:
    """State of the car at one time, or at many: then all arrays have one more axis in front (`stacked`).

    It holds copies of what the filter has, in as few pieces as it has them in, and what follows from these is computed
    when it is asked for: of many estimates at once, for a fraction of what each would cost.
    """

    stamp: int  # [ns]
    memory: Array  # (s,) of the car, as `CarMemory.places`, at least up to its parameters
    shown: Array  # (k,) as `CarBlocks.show`
    longitudinal_shares: Array  # (4,) as `CarMemory`
    # Force [N] and moment [N m] of the tyres beyond what the inertial sensor feels, as `model.car.balance` and
    # low-passed; NaN while it is not heard.
    unbalanced: Array  # (6,)
    # Variances of velocity, rates, place, heading and place along the car that contradictions between sensors add,
    # until it is decided who is wrong, or that nobody measures.
    undecided: Array  # (9,)
    bend: Array  # () [1/m] largest curvature of the way of late
    belief: Gaussian | None  # None where it is in the memory
    names: tuple[str, ...]  # of the state
    car: CarBlocks  # of the filter, whose settings do not change
    vehicle: Vehicle
    block: Block  # and
    row: int  # of it, where the arrays are

    @classmethod
    def of(cls, stamp: int, filter: CarFilter, block: Block | None = None) -> Estimate:
        """Read a filter, and leave it as it is; the arrays are in the next row of a block."""
        car, belief = filter.car, None if filter.in_car else filter.belief()
        block = Block(car, 1) if block is None else block
        row, block.used = block.used, block.used + 1
        memory, shown, shares = block.memory[row], block.shown[row], block.longitudinal_shares[row]
        memory[:], shares[:] = car.memory[: len(memory)], car.longitudinal_shares
        car.show(shown)
        added = block.unbalanced[row], block.undecided[row], block.bend[row, ...]
        return cls(stamp, memory, shown, shares, *added, belief, filter.names, car, car.vehicle, block, row)

    def _part(self, name: str) -> Array:
        return self.memory[..., self.car.places[name]]

    @property
    def state(self) -> Array:
        """All that the filter estimates, (n,)."""
        return self._part("mean") if self.belief is None else self.belief.mean

    @property
    def covariance(self) -> Array:
        """Covariance of the errors of the state, (n, n)."""
        if self.belief is not None:
            return self.belief.covariance
        numbers, n = self._part("covariance"), self.car.layout.size
        return numbers.reshape(*numbers.shape[:-1], n, n)

    @property
    def inputs(self) -> Array:
        """What drives the model, (6,) as model.coordinates.INPUTS."""
        return self._part("inputs")

    @property
    def udot(self) -> Array:
        """Derivatives of the velocities, (14,)."""
        return self.shown[..., :COORDINATES]

    @property
    def model_wheels(self) -> Array:
        """Forces and slips as Car.wheel_outputs, (7, 4)."""
        return _by_columns(self.shown[..., _WHEELS_SHOWN], 7)

    @property
    def acceleration_slopes(self) -> tuple[Array, Array, Array]:
        """Derivatives (6, k) as `accelerations_by_error` takes them."""
        every = _by_columns(self._part("linearization")[..., COORDINATES:], COORDINATES)[..., :6, :]
        q, u, around = len(DYNAMIC), COORDINATES, len(DISTURBANCES)
        return every[..., :q], every[..., q : q + u], every[..., q + u : q + u + around]

    @property
    def wheel_slopes(self) -> tuple[Array, Array]:
        """Derivatives (16, k) and (3, 14), as `wheels_by_error` takes them."""
        end = self.shown.shape[-1] - 3 * COORDINATES
        derivative, mass = self.shown[..., _WHEELS_SHOWN.stop : end], self.shown[..., end:]
        return _by_columns(derivative, 16), _by_columns(mass, 3)

    @property
    def axle_distances(self) -> Array:
        """Distances of the front and the rear axle from cog, (2,) [m]."""
        return self._part("parameters").take(self.car.distances, axis=-1)

    @property
    def undetermined(self) -> Array:
        """Flags (2,) of what was not determined, as `observable.undetermined`."""
        return undetermined(self.car, self.covariance)

    @property
    def variance(self) -> Array:
        """Variances (n,) of the errors of the state."""
        return self.covariance.diagonal(axis1=-2, axis2=-1)

    @property
    def pose_covariance(self) -> Array:
        """Covariance of position and attitude on the map (6, 6), with what innovations do not show (`unseen`)."""
        return self._motion_covariances[0]

    @property
    def twist_covariance(self) -> Array:
        """Covariance of velocity and rates (6, 6), with what innovations do not show and what is `undecided`."""
        return self._motion_covariances[1]

    @cached_property
    def _motion_covariances(self) -> tuple[Array, Array]:
        pose, twist = _on_map(self.covariance), self.covariance[..., TWIST, TWIST].copy()
        unseen, noise = self.vehicle.observer.unseen, self.car.receiver_noise
        add_unseen(pose, twist, self, unseen, noise, self.axle_distances[..., 1])
        car = self.car
        added = unlikely_bias(self.state, car.sensor_list, car.layout.biases, car.prior.deviation)
        add_tilt(pose, self, added, self.vehicle.observer.surroundings.change_length, self.bend)
        add_drift(pose, twist, self, added, car.rear_slip)
        twist[..., range(6), range(6)] += self.undecided[..., :6]
        pose[..., _PLACE, _PLACE] += self.undecided[..., 6:7]
        ahead = np.stack([np.cos(self.state[..., YAW]), np.sin(self.state[..., YAW])], axis=-1)
        pose[..., :2, :2] += self.undecided[..., 8, None, None] * outer(ahead)
        # Where the car goes is measured: what it goes sideways too much, it points elsewhere.
        square = np.maximum(self.velocity[..., 0] ** 2, _SLOW**2)
        pose[..., _YAW_OF_POSE, _YAW_OF_POSE] += self.undecided[..., 1] / square + self.undecided[..., 7]
        return pose, twist

    @cached_property
    def _model_covariance(self) -> Array:
        """Covariance of the errors of the model's state (m, m), to which biases and parameters do not belong. A filter
        that has no errors of forces assumes some."""
        covariance = self.covariance[..., : DISTURB.stop, : DISTURB.stop]
        without = ~covariance[..., FORCE, FORCE].any(axis=(-2, -1))
        if without.any():
            covariance = covariance.copy()
            covariance[..., FORCE, FORCE][without] = np.diag(self.car.prior.deviation[FORCE] ** 2)
        return covariance

    @cached_property
    def acceleration_covariance(self) -> Array:
        """Covariance of acceleration and angular acceleration (6, 6), to first order."""
        by_error = accelerations_by_error(*self.acceleration_slopes, DISTURB.stop)
        by_error[..., :3, _VELOCITY] += _across(self.rates)
        by_error[..., :3, _RATES] -= _across(self.velocity)
        return by_error @ self._model_covariance @ by_error.swapaxes(-2, -1)

    @cached_property
    def wheel_variance(self) -> Array:
        """Variances of force x, y, z [N²] and aligning moment [N² m²] of each wheel (4, 4), to first order.

        Tyre forces are in proportion to the mass, of which the car's motion says next to nothing: what it may weigh
        beyond the file adds that share of each force, or what is left of it where the filter estimates the mass.
        """
        by_error, lacking = wheels_by_error(*self.wheel_slopes, DISTURB.stop)
        along, across, yawing = np.moveaxis(lacking, -2, 0)
        to_front, to_rear = self.axle_distances[..., 0, None], self.axle_distances[..., 1, None]
        front = (to_rear * across + yawing) / (to_front + to_rear)
        steering = self.steering
        # As in `with_lateral_error`.
        of_axles = np.stack([front / np.cos(steering)[..., None], across - front], axis=-2)
        part = longitudinal_part(self.longitudinal_shares, steering)
        by_error[..., _LONGITUDINAL_FORCES, :] += part[..., None] * along[..., None, :]
        of_wheels = _shares(self.model_wheels[..., 2, :])[..., None] * of_axles[..., None, :]
        by_error[..., _LATERAL_FORCES, :] += of_wheels.reshape(*of_wheels.shape[:-3], 4, -1)
        variance = np.einsum("...ij,...ij->...i", by_error @ self._model_covariance, by_error)
        variance = variance.reshape(*variance.shape[:-1], 4, 4).swapaxes(-2, -1)
        mass: Array | float = self.vehicle.physics.chassis.mass
        of_mass: Array | float = self.vehicle.observer.surroundings.load**2
        if _MASS in self.names:
            place = self.names.index(_MASS)
            mass, of_mass = self.state[..., place, None, None], self.covariance[..., place, place, None, None]
        return variance + (self.wheels[..., :4, :] / mass) ** 2 * of_mass

    @property
    def position(self) -> Array:
        """Position of cog in the map, (3,) [m]."""
        return position_on_map(self.state, self.state[..., DISTURB])

    @cached_property
    def orientation(self) -> Array:
        """Orientation of the body in the map, a quaternion x, y, z, w (4,)."""
        return orientation_on_map(self.state, self.state[..., DISTURB])

    @property
    def attitude(self) -> Array:
        """Roll, pitch, yaw of the body in the map, (3,) [rad]."""
        return angles(self.orientation)

    @property
    def road(self) -> Array:
        """Grade and bank [rad], and curvature along the way, positive where it bends upwards [1/m], (3,)."""
        return self.state[..., DISTURB][..., [GRADE, BANK, GRADE_CHANGE]]

    @property
    def velocity(self) -> Array:
        """Velocity of cog in body axes, (3,) [m/s]."""
        return self.state[..., TWIST][..., VELOCITY]

    @property
    def rates(self) -> Array:
        """Angular velocity of the body, (3,) [rad/s]."""
        return self.state[..., TWIST][..., RATES]

    @property
    def acceleration(self) -> Array:
        """Kinematic, of cog in body axes, (3,) [m/s²]."""
        return self.udot[..., VELOCITY] + _cross(self.rates, self.velocity)

    @property
    def angular_acceleration(self) -> Array:
        """Angular acceleration of the body, (3,) [rad/s²]."""
        return self.udot[..., RATES]

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the slowly varying quantities, (k,)."""
        return self.names[DISTURB.start :]

    @property
    def parameters(self) -> Array:
        """Slowly varying quantities, (k,)."""
        return self.state[..., DISTURB.start :]

    @property
    def parameter_deviations(self) -> Array:
        """Standard deviations of the parameters, (k,)."""
        return np.sqrt(np.maximum(self.variance[..., DISTURB.start :], 0))

    @cached_property
    def wheels(self) -> Array:
        """Forces and slips as Car.wheel_outputs, corrected by the longitudinal and lateral force that the model lacks,
        (7, 4)."""
        force, shares = self.state[..., FORCE], self.longitudinal_shares
        return with_missing_forces(self.model_wheels, force, self.steering, shares, self.axle_distances)

    @property
    def steering(self) -> Array:
        """Angle of the road wheels, without its offset, () [rad]."""
        return self.inputs[..., 0] - self.state[..., DISTURB.start + STEERING_OFFSET]

    @property
    def wheel_torques(self) -> Array:
        """Drive minus brake of each wheel, (4,) [N m]: what the inputs have, and what the wheels' spins showed to be
        missing. Where there are no such inputs, errors of tyre force and rolling resistance are among it."""
        return self.inputs[..., TORQUES] + self.state[..., FORCE][..., SPIN]

    @property
    def wheel_deviations(self) -> Array:
        """Standard deviations of force x, y, z [N] and aligning moment [N m], rows as those of `wheels`, (4, 4)."""
        return np.sqrt(np.maximum(self.wheel_variance, 0.0))

    @property
    def side_slip(self) -> Array:
        """Angle [rad], its standard deviation [rad] and its rate [rad/s], (3,); zero with an infinite deviation at
        rest."""
        forward, lateral, _ = self.velocity.T
        square = forward**2 + lateral**2
        rests = square < _SMALLEST_SPEED**2
        divisor = np.maximum(square, _SMALLEST_SPEED**2)
        by_forward, by_lateral = -lateral / divisor, forward / divisor
        covariance = self.twist_covariance
        variance = by_forward**2 * covariance[..., 0, 0] + by_lateral**2 * covariance[..., 1, 1]
        variance += 2 * by_forward * by_lateral * covariance[..., 0, 1]
        (along, across, _), yaw_rate = self.acceleration.T, self.rates[..., 2]
        rate = by_forward * (along + yaw_rate * lateral) + by_lateral * (across - yaw_rate * forward)
        result = np.empty((*np.shape(rests), 3))
        result[..., 0] = np.where(rests, 0.0, np.arctan2(lateral, forward))
        result[..., 1] = np.where(rests, np.inf, np.sqrt(np.maximum(variance, 0.0)))
        result[..., 2] = np.where(rests, 0.0, rate)
        return result


def _by_columns(numbers: Array, rows: int) -> Array:
    """Matrices (…, rows, k) that stand in the last axis of an array column by column."""
    return numbers.reshape(*numbers.shape[:-1], -1, rows).swapaxes(-2, -1)


def _on_map(covariance: Array) -> Array:
    """Covariance of position and attitude on the map (…, 6, 6), to first order: height, roll and pitch are those over
    the road and those of the road."""
    of_both = np.ascontiguousarray(covariance[(..., *_POSE_AND_ROAD)])
    return _OVER_AND_OF_ROAD @ of_both @ _OVER_AND_OF_ROAD.T


def _across(vector: Array) -> Array:
    """Matrices (…, 3, 3) that make a × b of b, for vectors a (…, 3)."""
    x, y, z = vector.T
    result = np.zeros((*vector.shape, 3))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -z, y, -x
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = z, -y, x
    return result


def _cross(a: Array, b: Array) -> Array:
    """Cross product of vectors along the last axis, in a fraction of the time that `numpy.cross` takes."""
    result = a[..., _NEXT] * b[..., _AFTER_NEXT]
    result -= a[..., _AFTER_NEXT] * b[..., _NEXT]
    return result


def stacked(estimates: Sequence[Estimate]) -> Estimate:
    """Many estimates of one filter as one, whose stamp is that of the first; without a copy where they are neighbours
    in one block."""
    first = estimates[0]
    block, rows = first.block, slice(first.row, first.row + len(estimates))
    neighbours = all(e.block is block and e.row == row for row, e in enumerate(estimates, first.row))
    arrays: dict[str, Array] = {}
    for name in _ARRAYS:
        parts, of_all = [getattr(e, name) for e in estimates], getattr(block, name)
        in_block = neighbours and all(part.base is of_all for part in parts)
        arrays[name] = of_all[rows] if in_block else np.array(parts)
    beliefs = [e.belief for e in estimates if e.belief is not None]
    belief = Gaussian(*map(np.array, zip(*beliefs, strict=True))) if beliefs else None
    names, car, row = first.names, first.car, first.row
    return Estimate(
        first.stamp, **arrays, belief=belief, names=names, car=car, vehicle=car.vehicle, block=block, row=row
    )


def with_missing_forces(
    wheels: Array, force: Array, steering: Array | float, shares: Array, axle_distances: Array
) -> Array:
    """Outputs of the wheels (…, 7, 4) as the model has them, with the longitudinal and the lateral force that it lacks:
    arguments as of `with_lateral_error` and `longitudinal_part`."""
    corrected = with_lateral_error(wheels, force, steering, axle_distances)
    corrected[..., FORCE_X, :] += longitudinal_part(shares, steering) * force[..., X, None]
    return corrected


def with_lateral_error(wheels: Array, force: Array, steering: Array | float, axle_distances: Array) -> Array:
    """Outputs of the wheels (7, 4) as the model has them, with its lateral force error given to the tyres.

    `force` (14) are the generalized forces that the filter found missing, `steering` is the road-wheel angle [rad],
    `axle_distances` (2) are those of the front and the rear axle from cog [m].

    The filter finds what the model's lateral force and yaw moment lack, but not which force element they belong to. Of
    all that acts across the car (tyres, wind, the road's slope) the tyres are by far the largest and the least known,
    so they get it: force and moment determine the sum of each axle, F_f + F_r = ΔQ_y and l_f F_f - l_r F_r = ΔQ_ψ,
    and its two tyres share it in proportion to their loads, as an error of the friction would be shared. With a
    friction of 0.6 or 0.8 where the model has 1.0 this takes more than half of the error of the lateral forces away.
    """
    to_front, to_rear = axle_distances[..., 0], axle_distances[..., 1]
    lateral, yaw = force[..., Y], force[..., YAW]
    front = (to_rear * lateral + yaw) / (to_front + to_rear)
    corrected, share = wheels.copy(), _shares(wheels[..., 2, :])
    corrected[..., 1, :2] += (front / np.cos(steering))[..., None] * share[..., 0, :]
    corrected[..., 1, 2:] += (lateral - front)[..., None] * share[..., 1, :]
    return corrected


def longitudinal_part(shares: Array, steering: Array | float) -> Array:
    """Longitudinal force of each wheel (…, 4) per longitudinal force that the model lacks, by `longitudinal_shares`
    (…, 4) and the road-wheel angle [rad] (…).

    What drives or brakes a car acts at its wheels. Slip determines the force of a wheel only as well as its radius and
    stiffness are known, while the inertial sensor determines the sum. Where it is not known which wheels are driven,
    the shares are zero: then a wrong guess would be worse than none. Where torques are measured they are zero too:
    torques determine the forces of the wheels, whatever the car's mass is.
    """
    part = shares.copy()
    part[..., :2] /= np.cos(steering)[..., None] if np.ndim(steering) else np.cos(steering)
    return part


def _shares(load: Array) -> Array:
    """Share of each wheel in its axle's vertical force (…, 2, 2), of forces (…, 4) [N]; zero where there is none."""
    load = load.reshape(*load.shape[:-1], 2, 2)
    total = load.sum(axis=-1, keepdims=True)
    return np.asarray(load / np.where(total > 0, total, np.inf))


def estimate_samples(e: Estimate) -> Iterator[Sample]:
    """An estimate as the messages of the output topics, each made when it is asked for, as a controller waits for the
    odometry alone; of `stacked` ones, fields have one row for each.

    What is not determined is NaN, with the variance `UNESTIMATED_VARIANCE` where the message has one.
    """
    rows = e.velocity.shape[:-1]
    absent = np.zeros((*rows, 0))
    forces_absent, height_absent = e.undetermined[..., 0, None], e.undetermined[..., 1]
    position, pose_covariance = e.position.copy(), e.pose_covariance.copy()
    position[..., 2] = np.where(height_absent, np.nan, position[..., 2])
    pose_covariance[height_absent, 2, :] = pose_covariance[height_absent, :, 2] = 0.0
    pose_covariance[height_absent, 2, 2] = messages.UNESTIMATED_VARIANCE
    yield messages.odometry(e.stamp, position, e.orientation, pose_covariance, e.velocity, e.rates, e.twist_covariance)
    covariance = e.acceleration_covariance.reshape(*rows, 36)
    yield messages.acceleration(e.stamp, e.acceleration, e.angular_acceleration, covariance)
    yield Sample("vsense/road", "geometry_msgs/msg/Vector3Stamped", e.stamp, {"vector": e.road}, "cog")
    unbalanced = {"force": e.unbalanced[..., :3], "torque": e.unbalanced[..., 3:]}
    yield Sample(BALANCE, "geometry_msgs/msg/WrenchStamped", e.stamp, unbalanced, "cog")
    yield messages.side_slip(e.stamp, e.side_slip)
    yield messages.parameters(e.stamp, e.parameter_names, e.parameters, e.parameter_deviations)
    torques = np.where(forces_absent, np.nan, e.wheel_torques)
    values = {"position": absent, "velocity": absent, "effort": torques}
    yield Sample("vsense/wheel_torques", "sensor_msgs/msg/JointState", e.stamp, values, names=WHEEL_NAMES)
    wheels, deviations = e.wheels.copy(), e.wheel_deviations
    for part in (wheels[..., FORCE_X, :], deviations[..., FORCE_X, :], wheels[..., SLIP, :]):
        part[:] = np.where(forces_absent, np.nan, part)
    for i, wheel in enumerate(WHEELS):
        frame = f"contact_{wheel}"
        for topic, wrench in (("wheel_force", wheels), ("wheel_force_deviation", deviations)):
            torque = np.zeros((*rows, 3))
            torque[..., 2] = wrench[..., 3, i]
            values = {"force": wrench[..., :3, i], "torque": torque}
            yield Sample(f"vsense/{topic}/{wheel}", "geometry_msgs/msg/WrenchStamped", e.stamp, values, frame)
        slips = {"vector": wheels[..., 4:, i]}
        yield Sample(f"vsense/wheel_slip/{wheel}", "geometry_msgs/msg/Vector3Stamped", e.stamp, slips, frame)
