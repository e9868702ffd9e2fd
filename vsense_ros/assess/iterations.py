"""Iterations of an implicit observer in a step, counted on a short drive with and without an accelerator."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.client import Client, Direct
from vsense_ros.accelerator.device import Device
from vsense_ros.accelerator.kernels import KERNELS
from vsense_ros.manoeuvre import generate
from vsense_ros.manoeuvre.driver import DRIVER, ramp
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.manoeuvre.throttle_and_steer import COURSE, MANOEUVRES
from vsense_ros.model.schema.observer_settings import Disturbances
from vsense_ros.model.sensors import Imu, SensorBase, WheelSpeeds, WheelTorques
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight
from vsense_ros.model.simulation.full_car import simulate_full_car
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.full_car import FullCarBlocks
from vsense_ros.observer.implicit import ImplicitCar, accelerated
from vsense_ros.observer.state import Prior
from vsense_ros.runner import run

Array = NDArray[np.float64]

STEP = 4  # [ms] of the observer (Rodríguez 2020)
TOLERANCE = 1e-5  # of the iterations, his finest
FULL_SPEED, FULL_SECONDS, FULL_TURN = 10.0, 1.2, 0.2  # of the full car's drive: at the start [m/s]; whole, steering [s]
SHORT_DRIVE = 2.5  # [s] of the lane change on which iterations are counted
_LEVEL = Disturbances(
    grade=0.0, bank=0.0, steering_offset=0.0, steering_offset_drift=0.0, radius_error=0.0, radius_error_drift=0.0
)
_THROTTLE = WheelTorques(noise=1.0)


def with_thesis_sensors(vehicle: Vehicle) -> Vehicle:
    """Vehicle with the sensors of Rodríguez 2020: the throttle is an input, GNSS gives position but no velocity,
    inertial sensors have no biases, and wheel speeds are measured from rest on."""
    sensors = {name: s for name, s in vehicle.sensors.items() if s.kind != "gnss_velocity"} | {"throttle": _THROTTLE}
    for name, sensor in sensors.items():
        if isinstance(sensor, Imu):
            none = dict.fromkeys(("rate_bias", "rate_bias_drift", "force_bias", "force_bias_drift"), 0.0)
            sensors[name] = sensor.model_copy(update=none)
        elif isinstance(sensor, WheelSpeeds):
            sensors[name] = sensor.model_copy(update={"lowest": 0.0})
    return vehicle.model_copy(update={"sensors": sensors})


def on_level_road(model: Vehicle, step: int, **settings: object) -> Vehicle:
    """Model for an observer in steps of `step` [ms], with the sensors of Rodríguez 2020 on a level road; `settings`
    replace others of its observer section."""
    model = with_thesis_sensors(model)
    update = {"surroundings": _LEVEL, "longest_step": step * 1e-3, **settings}
    return model.model_copy(update={"observer": model.observer.model_copy(update=update)})


def drive_of_full(plant: Vehicle) -> tuple[Vehicle, Trajectory]:
    """Short drive of the full car, and that car: the second manoeuvre of Rodríguez 2020 from 10 m/s, with the steering
    at once."""
    friction = MANOEUVRES[1].friction
    assert friction is not None
    car = with_thesis_sensors(plant.with_parameters({"road.friction": friction}))

    def driver(t: float, q: Array, u: Array) -> Array:
        return np.array(
            [
                COURSE.angle * ramp(t, FULL_TURN, abs(COURSE.angle) / DRIVER.steering_rate),
                0.0,
                0.0,
                COURSE.torque,
                COURSE.torque,
            ]
        )

    q, u = rolling_straight(car, FULL_SPEED)
    return car, simulate_full_car(car, driver, FULL_SECONDS, step=1e-3, q=q, u=u)


class CountedFilter:
    """Maker of an implicit filter with some kernels on a mock device, which counts the steps, iterations and requests
    of the filter that it made last. `full`: the model is the full car; `spi`: SPI in place of errorEKF."""

    def __init__(self, full: bool, spi: bool, kernels: tuple[str, ...], tolerance: float) -> None:
        self._full, self._spi, self._tolerance = full, spi, tolerance
        self._kernels = kernels
        self.device = Device("mock")
        self._transport = Direct(self.device)
        self.client = Client(self._transport)
        self._car: ImplicitCar | FullCarBlocks | None = None
        self._before = (0, 0)
        self._requests: Counter[str] = Counter()

    def __call__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], prior: Prior | None = None) -> CarFilter:
        """Filter that knows where it starts."""
        names = [("solve56" if self._full else "solve14") if n == "solve" else n for n in self._kernels]
        name = f"{'full_' if self._full else ''}{'spi' if self._spi else 'error_ekf'}"
        make = accelerated(name, self.client, names, self._transport.at, self._tolerance)
        made = make(vehicle, sensors, Prior.of(vehicle, sensors).placed())
        assert isinstance(made.car, ImplicitCar | FullCarBlocks)
        self._car = made.car
        self._before, self._requests = self._count(), Counter(self.device.counts)
        return made

    def _count(self) -> tuple[int, int]:
        """Steps and iterations so far."""
        if isinstance(self._car, FullCarBlocks):
            return self._car.plant.integrator.steps, self._car.plant.integrator.calls
        assert self._car is not None
        return self._car.steps, self._car.iterations

    def counted(self) -> tuple[int, int, Counter[str]]:
        """Steps of the model and iterations since the filter was made, and requests of each kernel."""
        (steps, iterations), (steps_before, before) = self._count(), self._before
        requests = Counter({name: self.device.counts[name] - self._requests[name] for name in KERNELS})
        return steps - steps_before, iterations - before, requests


def count_iterations(vehicle: Vehicle, full: bool) -> tuple[float, float]:
    """Iterations of the errorEKF in a step of 4 ms on a short drive, in double precision; and the factor by which the
    solver on the accelerator, in single precision, changes them."""
    if full:
        car, trajectory = drive_of_full(vehicle)
        recording = record(trajectory, car, 0, name="turn", biased=False, every=STEP)
        model = on_level_road(vehicle, STEP)
    else:
        whole, model = generate("double_lane_change", vehicle), vehicle
        end = whole.first_stamp + round(1e9 * SHORT_DRIVE)
        recording = replace(whole, channels={c.topic: c.select(c.stamp < end) for c in whole.channels.values()})
    iterations = []
    for kernels in ((), ("solve",)):
        made = CountedFilter(full, False, kernels, TOLERANCE)
        run(recording, model, make=made)
        moves, iterated, _ = made.counted()
        iterations.append(iterated / max(moves, 1) * (STEP if full else 1))
    return iterations[0], iterations[1] / iterations[0]
