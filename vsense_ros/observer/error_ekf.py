"""errorEKF with force estimation: the filter's state and its two operations, without messages, clocks or queues.

The multibody model runs on its own; the filter estimates the *errors* of its coordinates, velocities and accelerations,
x = [Δq, Δu, Δu̇], and of the slow quantities that surround the model (Sanjurjo, Dopico, Luaces & Naya 2018; Rodríguez
2020). A prediction is zero by construction, only the covariance moves. A correction is carried into coordinates,
velocities and, through the mass matrix, into generalized forces ΔQ = M Δu̇, which the model keeps until the next one.

Unlike the slides, which propagate errors as a triple integrator, the transition here is the exact linearisation of the
model step, so that the tyres' damping of side slip and yaw is known to the filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Kernel
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import model_functions, sensor_functions
from vsense_ros.model.coordinates import DISTURBANCES, INPUTS, PITCH, ROLL, SPIN, WHEELS, YAW, X, Y, Z
from vsense_ros.model.effects.base import ON_MAP
from vsense_ros.model.sensors import Bias, SensorBase, WheelTorques
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.compiled_step import Backup, CompiledStep, Process, Replayed
from vsense_ros.observer.kalman import FORCE, SURROUND, Linearization, Q, U, kalman

Array = NDArray[np.float64]


_OPERATIONS = {"linearize", "predict", "correct"}
_SLOPES = slice(SURROUND.start - U.stop, SURROUND.start - U.stop + 2)  # among the states behind the velocities
SURVEYED = 4  # numbers that tell where the road was last looked up, and what was known of it there


@dataclass(frozen=True)
class Layout:
    """Where the biases of each sensor stand in the state."""

    biases: tuple[slice, ...]  # of each sensor
    names: tuple[str, ...]  # of all elements of the state
    size: int


def layout(sensors: dict[str, SensorBase]) -> Layout:
    """State of a vehicle with these sensors."""
    coordinates = ["x", "y", "z", "roll", "pitch", "yaw"] + [f"travel_{w}" for w in WHEELS]
    coordinates += [f"spin_{w}" for w in WHEELS]
    names = [*coordinates, *(f"{c}_rate" for c in coordinates), *(f"{c}_force" for c in coordinates), *DISTURBANCES]
    slices = []
    for name, sensor in sensors.items():
        first = len(names)
        names += [f"{name}.{bias.name}" for bias in sensor.biases()]
        slices.append(slice(first, len(names)))
    return Layout(tuple(slices), tuple(names), len(names))


@dataclass(frozen=True)
class Prior:
    """What is known of the state before any measurement, and how fast that is forgotten."""

    deviation: Array  # (n,) standard deviations of the errors at start
    rate: Array  # (n,) [1/s] at which errors decay, 0: not at all
    density: Array  # (n,) variance added in one second where they do not
    usual: Array  # (n,) what the state goes back to, and where that behind the velocities starts

    @classmethod
    def of(cls, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> Prior:
        """Of a vehicle with these sensors."""
        where, kinds = layout(sensors), {sensor.kind for sensor in sensors.values()}
        errors, around = vehicle.observer.force_errors, vehicle.observer.surroundings
        spin = [errors.wheel_spin if "wheel_speeds" in kinds else 0.0] * 4
        for sensor in sensors.values():
            if isinstance(sensor, WheelTorques):
                axles = (vehicle.physics.front, vehicle.physics.rear)
                spin = [sensor.noise / axle.wheel_spin_inertia for axle in axles for _ in range(2)]
        body = [errors.longitudinal, errors.lateral, errors.vertical, errors.roll, errors.pitch, errors.yaw]
        deviation = np.zeros(where.size)
        deviation[Q] = [100.0, 100.0, 0.02, 0.02, 0.02, np.pi, *[0.01] * 4, *[1e-3] * 4]
        deviation[U] = [1.0, 0.3, 0.1, 0.05, 0.05, 0.1, *[0.1] * 4, *[2.0] * 4]
        if not kinds & ON_MAP:
            deviation[[X, Y, YAW]] = 1e-6  # the map is laid by where the car is at start
        deviation[FORCE] = body + [errors.suspension] * 4 + spin
        deviation[SURROUND] = [around.grade, around.bank, around.steering_offset, around.radius_error]
        time_constant = np.full(where.size, np.inf)
        time_constant[FORCE] = errors.time_constant
        time_constant[FORCE.stop - 4 : FORCE.stop] = errors.wheel_spin_time_constant
        time_constant[SURROUND] = [around.grade_time_constant, around.bank_time_constant, np.inf, np.inf]
        drift = np.zeros(where.size)
        drift[SURROUND] = [0.0, 0.0, around.steering_offset_drift, around.radius_error_drift]
        for sensor, part in zip(sensors.values(), where.biases, strict=True):
            biases: tuple[Bias, ...] = sensor.biases()
            deviation[part] = [b.deviation for b in biases]
            drift[part] = [b.drift for b in biases]
            time_constant[part] = [b.time_constant for b in biases]
        usual = np.zeros(where.size)
        usual[SURROUND][:2] = np.sum([effect.mean_slope for effect in vehicle.physics.effects.present()], axis=0)
        return cls(deviation, 1 / time_constant, np.where(np.isinf(time_constant), drift**2, 0.0), usual)


def rolling_state(vehicle: Vehicle, speed: float) -> Array:
    """Coordinates and velocities (28,) of a car that rolls straight ahead at `speed` [m/s] on level ground."""
    physics = vehicle.physics
    state = np.zeros(U.stop)
    state[Z] = physics.chassis.cog_height
    state[U.start] = speed
    for i, axle in enumerate((physics.front, physics.front, physics.rear, physics.rear)):
        state[U][SPIN][i] = speed / (axle.unloaded_radius * 0.98)
    return state


def largest_state(size: int) -> Array:
    """Amounts (n,) beyond which no car's state is."""
    largest = np.full(size, 1e15)
    largest[[ROLL, PITCH]] = 1.5, 1.4
    velocities = largest[U]
    velocities[[X, Y, YAW]] = 150.0, 150.0, 20.0
    return largest


class ErrorEkf:
    """The filter of one vehicle with one set of sensors.

    `state` (n,) holds q, u, generalized forces, surroundings and biases; `covariance` (n, n) belongs to the errors of
    the same elements, with accelerations [m/s², rad/s²] in place of the generalized forces. `inputs` (5,) drive the
    model, `surveyed` (4,) is where the road was last looked up (`Survey`), east and north [m], and for each of its
    slopes 1 where it was known. All this and the last linearisation stand in `memory`: who copies it and puts it back
    has the filter as it was, to the last bit. A filter that is built upon this one may keep `extra` numbers of its own
    there.
    """

    at_once: ClassVar[bool] = True  # several operations may be done by one call of C

    def __init_subclass__(cls) -> None:
        """A filter that changes an operation is led through each of them, unless it says itself that C knows it."""
        cls.at_once = vars(cls).get("at_once", cls.at_once and not vars(cls).keys() & _OPERATIONS)

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], extra: int = 0) -> None:
        self.vehicle = vehicle
        self.sensors = tuple(sensors.values())
        self.layout = layout(sensors)
        n = self.layout.size
        car = car_of(vehicle)
        functions = model_functions(car)
        inputs, jacobians = len(INPUTS), functions["linearize"].nnz_out()
        physical = vehicle.parameter_vector()
        lengths = [n, inputs, n * n, car.internal_state.numel(), jacobians, len(physical), extra, n - U.stop, SURVEYED]
        self.memory = np.zeros(sum(lengths))
        parts = np.split(self.memory, np.cumsum(lengths[:-1]).tolist())
        self.state, self.inputs, covariance, self._effects, linearization, *parts = parts
        self.parameters, self.extra, self._usual, self.surveyed = parts
        self.covariance = covariance.reshape(n, n)
        self.parameters[:] = physical
        names = car.parameter_names
        self._distances = np.array([names.index(f"chassis.cog_to_{axle}_axle") for axle in ("front", "rear")])
        q, u, force, around = (self.state[s] for s in (Q, U, FORCE, SURROUND))
        arguments = [q, u, force, around, self.inputs, self.parameters, self._effects]
        self._linearize = Kernel(functions["linearize"], arguments, linearization)
        self.udot, by_q, by_u, by_surroundings, by_q_rates = self._linearize.results
        self._kinematics = Kernel(functions["kinematics"], [q, u])
        by_angles, by_velocity = self._kinematics.results
        model = Linearization(self.udot, by_q, by_u, by_surroundings, by_q_rates)
        self._kalman = kalman(model, by_angles, by_velocity, self.covariance)
        self._h = np.zeros(1)
        flat = [m.reshape(-1, order="F") for m in (self._kalman.inverse, by_q)]
        self._advance = Kernel(functions["advance"], [*arguments, self._h, *flat])
        self._remember = Kernel(functions["internal_state"], [*arguments, self._h]) if self._effects.size else None
        self._error = self._kalman.error
        self._force = Kernel(
            functions["force"], [q, self.inputs, around, self.parameters, self._effects, self._error[FORCE]]
        )
        error, slow = self._error, slice(FORCE.stop, None)
        self._corrections = (
            (self.state[: FORCE.start], error[: FORCE.start]),
            (self.state[FORCE], self._force.results[0][:, 0]),
            (self.state[slow], error[slow]),
        )
        self._uses_acceleration = tuple(sensor.uses_acceleration for sensor in self.sensors)
        self._present = Kernel(functions["dynamics"], arguments)
        sensing = sensor_functions(car, self.sensors)
        self._sense: list[Kernel | None] = [None] * len(self.sensors)
        for i, (sensor, where) in enumerate(zip(self.sensors, self.layout.biases, strict=True)):
            if not sensor.is_input:
                mounting = np.asarray(sensor.mounting(), dtype=float)
                bound = [q, u, self.udot, around, self.inputs, self.state[where], mounting]
                self._sense[i] = Kernel(sensing[sensor.kind], bound)
        self.prior = Prior.of(vehicle, sensors)
        self._usual[:] = self.prior.usual[U.stop :]
        self.largest = largest_state(n)
        coordinates, velocities = (r.reshape(-1, order="F") for r in self._advance.results)
        remembered = np.zeros(0) if self._remember is None else self._remember.results[0].reshape(-1, order="F")
        self._in_c = CompiledStep.of(
            self._kalman,
            {name: getattr(self, f"_{name}") for name in ("linearize", "kinematics", "advance", "force", "remember")},
            {
                **{name: getattr(self, name) for name in ("memory", "state", "inputs", "largest")},
                "effects": self._effects,
                "usual": self._usual,
                "length": self._h,
                "remembered": remembered,
                "coordinates": coordinates,
                "velocities": velocities,
                "added": self._force.results[0].reshape(-1, order="F"),
            },
            list(zip(self._sense, self._uses_acceleration, self.layout.biases, strict=True)),
        )
        self._processes: dict[int, Process] = {}

    def _process(self, h: float) -> Process:
        """What happens within `h` [s] to the states behind the velocities.

        Kept for steps of equal length to 10 µs: a thousandth of a step changes less than the settings are known to.
        """
        length = max(round(h * 1e5), 1)
        known = self._processes.get(length)
        if known is None:
            h = length * 1e-5
            prior = self.prior
            decay = np.exp(-h * prior.rate[28:])
            noise = prior.deviation[28:] ** 2 * (1 - decay**2) + prior.density[28:] * h
            known = self._processes[length] = Process(decay, noise, decay.ctypes.data, noise.ctypes.data)
        return known

    def start(self, speed: float) -> None:
        """Begin as a car that rolls straight ahead at `speed` [m/s], known as little as before any measurement."""
        self.state[: U.stop] = rolling_state(self.vehicle, speed)
        self._usual[:] = self.prior.usual[U.stop :]
        self.surveyed[:] = np.inf, np.inf, 0.0, 0.0
        self.parameters[:] = self.vehicle.parameter_vector()
        self.state[U.stop :] = self._usual
        self.inputs[:] = 0.0
        self._effects[:] = 0.0
        self.covariance[:] = np.diag(self.prior.deviation**2)

    def place(self, index: int, value: float, deviation: float) -> None:
        """Set one element of the state, whose error then has this standard deviation and no correlation."""
        self.state[index] = value
        self.covariance[index, :] = self.covariance[:, index] = 0.0
        self.covariance[index, index] = deviation**2

    def slope_usually(self, slopes: Array, along: Array) -> None:
        """From now on the slopes of the road along and across the car (2,), positive uphill and with the left side
        higher [rad], go back to these; where `along` (2,) is 1 the car has come to them on a road that has them, and
        those that are estimated change as these do."""
        usual = self._usual[_SLOPES]
        self.state[U.stop :][_SLOPES] += along * (slopes - usual)
        usual[:] = slopes

    def linearize(self) -> None:
        """Accelerations and Jacobians at the present state, which acceleration sensors and the next step use."""
        self._linearize.call()

    def predict(self, h: float) -> None:
        """Move model and covariance ahead by `h` [s], from the last linearisation."""
        process = self._process(h)
        if self._in_c is not None:
            self._in_c.predict(h, process)
            return
        self._move_effects(h)
        self._kalman.transition(h)
        self._kinematics.call()
        self._advance.call()
        self._kalman.propagate(h, process.decay, process.noise)
        state = self.state
        state[Q], state[U] = self._advance.results[0][:, 0], self._advance.results[1][:, 0]
        self._relax(state[U.stop :], process)

    def _relax(self, slow: Array, process: Process) -> None:
        """Let states behind the velocities (…, n - 28) go back to what they usually are."""
        slow -= self._usual
        slow *= process.decay
        slow += self._usual

    def _move_effects(self, h: float) -> None:
        """What effects remember, after a step of `h` [s] that has not been made yet."""
        self._h[0] = h
        if self._remember is not None:
            self._remember.call()
            self._effects[:] = self._remember.results[0][:, 0]

    def correct(self, index: int, value: Array, variance: Array, limit: float, scale: float = 1.0) -> float:
        """Correct by a measurement of sensor `index` unless its normalized innovation squared exceeds `limit`.

        `value` and `variance` (m,); NaN components are left out; `scale` multiplies the covariance of the innovation.
        Returns the normalized innovation squared, negative where no component was present. The correction of the
        accelerations becomes one of the generalized forces, ΔQ = M Δu̇ (Rodríguez 2020, step 4 of the errorEKF).
        """
        if self._in_c is not None:
            return self._in_c.correct(index, value, variance, limit, scale)
        kernel = self._sense[index]
        assert kernel is not None, "inputs have no innovation"
        kernel.call()
        where = self.layout.biases[index]
        nis = self._kalman.correct(kernel.results, self._uses_acceleration[index], where, value, variance, scale, limit)
        if 0 <= nis <= limit:
            self._force.call()
            for part, by in self._corrections:
                part += by
        return nis

    @property
    def names(self) -> tuple[str, ...]:
        """Of all that is estimated: of the state, and of what a filter built upon this one adds."""
        return self.layout.names

    def estimated(self) -> tuple[Array, Array]:
        """Values of all that is estimated (m,), and the covariance of their errors (m, m)."""
        return self.state, self.covariance

    @property
    def whitened(self) -> Array:
        """Innovation of the last correction by component, (16,): white and of unit deviation if the filter is right,
        NaN where nothing was measured. The array stays the same."""
        return self._kalman.whitened

    @property
    def axle_distances(self) -> Array:
        """Of the front and the rear axle from cog, (2,) [m]."""
        return self.parameters.take(self._distances)

    def sane(self) -> bool:
        """Whether the state is a car's."""
        within = np.count_nonzero(np.abs(self.state) < self.largest)
        return bool(self.covariance.item(14, 14) > 0 and within == len(self.state))

    def backup(self) -> Backup:
        """A place where the filter may be kept."""
        memory = np.empty_like(self.memory)
        return Backup(memory, memory.ctypes.data)

    def move(self, kept: Backup, steps: int, h: float) -> bool:
        """Keep the filter as it is, then move it ahead by `steps` steps of `h` [s], linearised after each.

        False, and the filter is as it was, if its state is not a car's or cannot be moved.
        """
        if self._in_c is not None and self.at_once:
            return self._in_c.move(kept, steps, h, self._process(h))
        if not self.sane():
            return False
        kept.memory[:] = self.memory
        try:
            for _ in range(steps):
                self.predict(h)
                self.linearize()
        except (FloatingPointError, np.linalg.LinAlgError):
            self.memory[:] = kept.memory
            return False
        return True

    def replay(self, events: Sequence[Replayed]) -> tuple[int, bool, Array]:
        """Let events happen again, up to one that the filter could not move to or that its gate refused.

        Returns how many happened, whether the filter moved to the one that did not, and the normalized innovations
        squared of the measurements (those of inputs mean nothing). Without a compiler none happens.
        """
        if self._in_c is None or not self.at_once:
            return 0, False, np.zeros(0)
        return self._in_c.replay(events, [self._process(event.h) if event.steps else None for event in events])

    def lose_trust(self) -> None:
        """Forget how errors belong together, and double their standard deviations."""
        self.covariance[:] = np.diag(np.clip(np.diag(self.covariance), 1e-12, 1e8) * 4)

    def present(self) -> tuple[Array, Array]:
        """Derivatives of the velocities (14,), and forces and slips of the wheels as `Car.wheel_outputs` (7×4).

        They are computed at the present state, while corrections carry `udot` on from the last linearisation.
        """
        self._present.call()
        udot, wheels = self._present.results
        return udot[:, 0], wheels
