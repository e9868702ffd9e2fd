"""The numbers of a multibody car in a filter, and the functions of its model and sensors that are bound to them.

Everything that a filter of the car has to keep from one step to the next stands in one array, so that it can be copied,
compared and handed to C at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Kernel
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.car.steps import compiled_wheel_forces, model_functions, sensor_functions
from vsense_ros.model.coordinates import COORDINATES, INPUTS, ROAD, SPIN
from vsense_ros.model.handling.base import car_numbers, rear_slip
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.state import (
    DISTURB,
    FOLLOWED,
    FORCE,
    GAIN_COLUMNS,
    Prior,
    Q,
    U,
    largest_state,
    layout,
)
from vsense_ros.observer.unseen import receiver_noise
from vsense_ros.observer.wheel_torques import BRAKING, PAIRS, RELEASED

Array = NDArray[np.float64]

SURVEYED = 4  # numbers: where the road was last looked up, and what was known of it there
SLOW = U.stop  # states from here on decay by themselves, towards a mean
ROADS = ROAD.stop  # states of the road under the car


@dataclass(frozen=True)
class Sensed:
    """What the filter needs of a sensor: its function, bound to the state, and where its biases stand."""

    index: int
    kernel: Kernel  # results: expected (m, 1), Jacobians by q, u, udot, disturbances, and by its own bias
    biases: slice
    uses_acceleration: bool
    mounting: Array


class Process(NamedTuple):
    """Decay of the states behind the velocities within some time and variance that it adds to them, (n - 28,) each;
    covariances that it adds to the errors of the torques of two wheels each (6,), as `PAIRS`."""

    decay: Array
    noise: Array
    shared: Array

    @classmethod
    def of(cls, numbers: Array) -> Process:
        """A process from its numbers one after the other, as C reads them."""
        size = (len(numbers) - len(PAIRS)) // 2
        return cls(numbers[:size], numbers[size : 2 * size], numbers[2 * size :])


def step_length(h: float) -> int:
    """Length of a step of `h` [s] in units of 10 µs, 1 at least, by which processes are kept: a thousandth of a step
    changes less than the settings are known to."""
    return round(h * 1e5) or 1


class CarMemory:
    """The state, covariance and last linearisation of one vehicle with one set of sensors.

    `mean` (n,) holds coordinates, velocities, generalized forces, disturbances and biases; `covariance` (n, n) belongs
    to the errors of the same elements, with accelerations [m/s², rad/s²] in place of the forces. `inputs` (6,) drive
    the model, `surveyed` (4,) is where the road was last looked up, east and north [m], and for each of its slopes 1
    where it was known. All this and the last linearisation stand in `memory`. A filter that is built upon this one may
    keep `extra` numbers of its own there.
    """

    def __init__(
        self, vehicle: Vehicle, sensors: dict[str, SensorBase], *, extra: int = 0, prior: Prior | None = None
    ) -> None:
        self.vehicle, self.sensor_list = vehicle, tuple(sensors.values())
        self.layout = layout(sensors)
        self.names, self.sensors = self.layout.names, tuple(sensors)
        self.prior = Prior.of(vehicle, sensors) if prior is None else prior
        self.receiver_noise = receiver_noise(self.sensor_list)
        self.car = car_of(vehicle)
        self.functions = model_functions(self.car)
        self._allocate(extra)
        self._bind(self.car, sensors)
        self.largest = largest_state(self.layout.size)
        self._processes: dict[int, Array] = {}

    @cached_property
    def rear_slip(self) -> float:
        """Slip angle of the rear axle per lateral acceleration [rad s²/m]."""
        return rear_slip(car_numbers(self.vehicle))

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
            "reversion_mean": n - SLOW,
            "surveyed": SURVEYED,
        }
        self.memory = np.zeros(sum(sizes.values()))
        ends = np.cumsum([*sizes.values()]).tolist()
        self.places = {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}
        parts = {name: self.memory[place] for name, place in self.places.items()}
        self.mean, self.inputs, self.effects = parts["mean"], parts["inputs"], parts["effects"]
        self.covariance = parts["covariance"].reshape(n, n)
        self.linearization, self.parameters, self.extra = parts["linearization"], parts["parameters"], parts["extra"]
        self.reversion_mean, self.surveyed = parts["reversion_mean"], parts["surveyed"]
        self.parameters[:] = physical
        self.reversion_mean[:] = self.prior.reversion_mean[SLOW:]
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
        shown = functions["dynamics"], compiled_wheel_forces(car)
        ends = np.cumsum([function.nnz_out() for function in shown]).tolist()
        self._shown = np.zeros(ends[-1])
        present, slopes = np.split(self._shown, ends[:1])
        self._present, self._wheel_forces = (
            Kernel(function, self.arguments, part) for function, part in zip(shown, (present, slopes), strict=True)
        )
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
            name: len(self.sensor_list[sensed.index].deviations()) for name, sensed in self.sensed.items()
        }
        self.distances = np.array([names.index(f"chassis.cog_to_{axle}_axle") for axle in ("front", "rear")])

    def process(self, h: float) -> Process:
        """What happens within `h` [s] to the states behind the velocities, with brakes as they are now."""
        return Process.of(self.processes(h)[self.brakes])

    def processes(self, h: float) -> Array:
        """The numbers of the process within `h` [s] with brakes that are released, and that may act, (2, size), kept
        for steps of equal length."""
        length = step_length(h)
        processes = self._processes.get(length)
        if processes is None:
            processes = np.array([self._numbers(length * 1e-5, brakes) for brakes in (RELEASED, BRAKING)])
            self._processes[length] = processes
        return processes

    @property
    def brakes(self) -> int:
        """`BRAKING` while the car decelerates as if it were braked or stands, else `RELEASED`."""
        return self.prior.torques.mode(self.udot, self.mean[U], self.mean[DISTURB])

    @property
    def longitudinal_shares(self) -> Array:
        """Share of each wheel in the longitudinal force that the model lacks, (4,); as `TorqueErrors.shares`."""
        torques = self.prior.torques
        return torques.shares[self.brakes if torques.shares_known else BRAKING]

    def _numbers(self, h: float, brakes: int) -> Array:
        """The numbers of the process within `h` [s] with brakes like these."""
        prior, torques = self.prior, self.prior.torques
        rate, deviation = prior.rate[SLOW:].copy(), prior.deviation[SLOW:].copy()
        rate[SPIN], deviation[SPIN] = torques.rate[brakes], np.sqrt(torques.covariance[brakes].diagonal())
        decay = np.exp(-h * rate)
        noise = deviation**2 * (1 - decay**2) + prior.density[SLOW:] * h
        spin = decay[SPIN]
        shared = [torques.covariance[brakes, i, j] * (1 - spin[i] * spin[j]) for i, j in PAIRS]
        return np.concatenate([decay, noise, shared])
