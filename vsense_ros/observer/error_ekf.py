"""errorEKF with force estimation: the filter's state and its two operations, without messages, clocks or queues.

The multibody model runs on its own; the filter estimates the *errors* of its coordinates, velocities and accelerations,
x = [Δq, Δu, Δu̇], and of the slow quantities that surround the model (Sanjurjo, Dopico, Luaces & Naya 2018; Rodríguez
2020). A prediction is zero by construction, only the covariance moves. A correction is carried into coordinates,
velocities and, through the mass matrix, into generalized forces ΔQ = M Δu̇, which the model keeps until the next one.

Unlike the slides, which propagate errors as a triple integrator, the transition here is the exact linearisation of the
model step, so that the tyres' damping of side slip and yaw is known to the filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.car import SURROUNDINGS, WHEELS, car_of
from vsense_ros.model.codegen import Kernel
from vsense_ros.model.observer_settings import ObserverSettings
from vsense_ros.model.sensors import Bias, SensorBase
from vsense_ros.model.steps import DYNAMIC_COORDINATES, GAMMA, model_functions, sensor_functions
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

Q = slice(0, 14)
U = slice(14, 28)
FORCE = slice(28, 42)
SURROUND = slice(42, 46)
BIASES = 46  # the first of the sensors' biases

_DYNAMIC = np.array(DYNAMIC_COORDINATES)


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
    names = [*coordinates, *(f"{c}_rate" for c in coordinates), *(f"{c}_force" for c in coordinates), *SURROUNDINGS]
    slices = []
    for name, sensor in sensors.items():
        first = len(names)
        names += [f"{name}.{bias.name}" for bias in sensor.biases()]
        slices.append(slice(first, len(names)))
    return Layout(tuple(slices), tuple(names), len(names))


class ErrorEkf:
    """The filter of one vehicle with one set of sensors.

    `state` (n,) holds q, u, generalized forces, surroundings and biases; `covariance` (n, n) belongs to the errors of
    the same elements, with accelerations [m/s², rad/s²] in place of the generalized forces.
    """

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        self.vehicle = vehicle
        self.sensors = tuple(sensors.values())
        self.layout = layout(sensors)
        self.state = np.zeros(self.layout.size)
        self.covariance = np.zeros((self.layout.size, self.layout.size))
        self.inputs = np.zeros(5)
        car = car_of(vehicle)
        functions = model_functions(car)
        q, u, force, around = (self.state[s] for s in (Q, U, FORCE, SURROUND))
        arguments = [q, u, force, around, self.inputs, vehicle.parameter_vector()]
        self._h = np.zeros(1)
        self._inverse = np.zeros((14, 14), order="F")
        self._linearize = Kernel(functions["linearize"], arguments)
        self.udot, self._by_q, self._by_u, self._by_surroundings, self._by_q_rates = self._linearize.results
        flat = [self._h, self._inverse.reshape(-1, order="F"), self._by_q.reshape(-1, order="F")]
        self._advance = Kernel(functions["advance"], [*arguments, *flat])
        self._kinematics = Kernel(functions["kinematics"], [q, u])
        self._acceleration = np.zeros(14)
        self._force = Kernel(functions["force"], [q, self.inputs, around, arguments[-1], self._acceleration])
        self._wheels = Kernel(functions["dynamics"], arguments)
        sensing = sensor_functions(car, self.sensors)
        self._sense: list[Kernel | None] = [None] * len(self.sensors)
        for i, (sensor, where) in enumerate(zip(self.sensors, self.layout.biases, strict=True)):
            if not sensor.is_input:
                mounting = np.asarray(sensor.mounting(), dtype=float)
                bound = [q, u, self.udot, around, self.inputs, self.state[where], mounting]
                self._sense[i] = Kernel(sensing[sensor.kind], bound)
        self._noise(vehicle.observer)
        self._gain = np.zeros((14, self.layout.size))

    def _noise(self, settings: ObserverSettings) -> None:
        """Standard deviations at start, and the processes behind the forces, the surroundings and the biases."""
        n = self.layout.size
        errors, around = settings.force_errors, settings.surroundings
        kinds = {s.kind for s in self.sensors}
        spin = errors.wheel_spin if "wheel_speeds" in kinds else 0.0
        force = [errors.longitudinal, errors.lateral, errors.vertical, errors.roll, errors.pitch, errors.yaw]
        deviation = np.zeros(n)
        deviation[FORCE] = force + [errors.suspension] * 4 + [spin] * 4
        deviation[SURROUND] = [around.grade, around.bank, around.steering_offset, around.radius_error]
        time_constant = np.full(n, np.inf)
        time_constant[FORCE] = errors.time_constant
        time_constant[38:42] = errors.wheel_spin_time_constant
        time_constant[42:44] = around.grade_time_constant, around.bank_time_constant
        drift = np.zeros(n)
        drift[44:46] = around.steering_offset_drift, around.radius_error_drift
        for sensor, where in zip(self.sensors, self.layout.biases, strict=True):
            biases: tuple[Bias, ...] = sensor.biases()
            deviation[where] = [b.deviation for b in biases]
            drift[where] = [b.drift for b in biases]
            time_constant[where] = [b.time_constant for b in biases]
        self.deviation = deviation
        self._rate = 1 / time_constant
        self._density = np.where(np.isinf(time_constant), drift**2, 0.0)

    def linearize(self) -> None:
        """Evaluate accelerations and Jacobians at the present state; an acceleration sensor and the next step use them."""
        self._linearize.call()

    def predict(self, h: float) -> None:
        """Move model and covariance ahead by `h` [s], from the last linearisation."""
        by_q, by_u, by_s = self._by_q, self._by_u, self._by_surroundings
        slope = by_u + (GAMMA * h) * self._by_q_rates
        inverse = np.linalg.inv(np.eye(14) - (GAMMA * h) * slope)
        self._inverse[:] = inverse
        self._kinematics.call()
        by_angles, by_velocity = self._kinematics.results
        self._h[0] = h
        self._advance.call()
        self.state[Q], self.state[U] = self._advance.results[0][:, 0], self._advance.results[1][:, 0]

        # Transition of the velocities' errors: the stability function of ROS2 and its response to a constant force.
        w = (inverse - np.eye(14)) / GAMMA
        response = h * (inverse + (0.5 - GAMMA) * (w @ inverse))
        gain = self._gain
        gain[:, _DYNAMIC] = response @ by_q
        gain[:, U] = np.eye(14) + response @ slope
        gain[:, FORCE] = response
        gain[:, SURROUND] = response @ by_s
        p = self.covariance
        rows = gain @ p
        corner = rows @ gain.T
        p[U, :] = rows
        p[:, U] = rows.T
        p[U, U] = corner
        # Coordinates follow velocities: the position by the attitude and both by the map from velocities to rates.
        rows = p[Q, :].copy()
        rows[:6] += (h * by_angles) @ p[3:6, :] + (h * by_velocity) @ p[14:20, :]
        rows[6:] += h * p[20:28, :]
        corner = rows[:, Q].copy()
        corner[:, :6] += rows[:, 3:6] @ (h * by_angles).T + rows[:, 14:20] @ (h * by_velocity).T
        corner[:, 6:] += h * rows[:, 20:28]
        p[Q, :] = rows
        p[:, Q] = rows.T
        p[Q, Q] = 0.5 * (corner + corner.T)
        # Forces, surroundings and biases: first-order processes, independent of the motion.
        decay = np.exp(-h * self._rate[28:])
        p[28:, :] *= decay[:, None]
        p[:, 28:] *= decay
        noise = self.deviation[28:] ** 2 * (1 - decay**2) + self._density[28:] * h
        p[range(28, len(p)), range(28, len(p))] += noise
        self.state[28:44] *= decay[:16]

    def innovation(self, index: int, value: Array) -> tuple[Array, Array, Array]:
        """Of sensor `index` with measurement `value` (m,): innovation (m), H (m×n), H P Hᵀ (m×m)."""
        kernel = self._sense[index]
        assert kernel is not None, "inputs have no innovation"
        kernel.call()
        expected, by_q, by_u, by_udot, by_surroundings = kernel.results
        h = np.zeros((len(value), self.layout.size))
        h[:, Q], h[:, U], h[:, SURROUND] = by_q, by_u, by_surroundings
        if self.sensors[index].uses_acceleration:
            h[:, _DYNAMIC] += by_udot @ self._by_q
            h[:, U] += by_udot @ self._by_u
            h[:, FORCE] = by_udot
            h[:, SURROUND] += by_udot @ self._by_surroundings
        where = self.layout.biases[index]
        if where.stop > where.start:
            h[:, where] = np.eye(len(value))
        return value - expected[:, 0], h, h @ self.covariance @ h.T

    def correct(self, innovation: Array, h: Array, total: Array) -> None:
        """Carry an innovation with covariance `total` (m×m) into state, forces and covariance."""
        p = self.covariance
        projected = h @ p
        gain = np.linalg.solve(total, projected).T
        p -= gain @ projected
        # The plain form loses symmetry by rounding only; one averaging keeps it exactly symmetric.
        p += p.T
        p *= 0.5
        self._apply(gain @ innovation)

    def _apply(self, error: Array) -> None:
        self._acceleration[:] = error[FORCE]
        self._force.call()
        force = self._force.results[0][:, 0]
        self.state[Q] += error[Q]
        self.state[U] += error[U]
        self.state[FORCE] += force
        self.state[42:] += error[42:]

    def wheel_outputs(self) -> Array:
        """Forces and slips of the wheels at the present state, as `Car.wheel_outputs` (7×4)."""
        self._wheels.call()
        return self._wheels.results[1]

