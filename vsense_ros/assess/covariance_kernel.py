"""What the kernel of the errorEKF's covariance gains: its clocks, beside the operations that it is in place of.

The programs are those that `AcceleratedCovariance` makes of a step and of corrections of the car, and the kernel's mock
counts their clocks, those of words among them. The covariance stays in the accelerator; after the last sensor it is
read for what is published.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.covariance import AcceleratedCovariance, Map
from vsense_ros.accelerator.kernels.row_combiner import RowCombiner
from vsense_ros.assess.flop import factored, flop_of_covariance
from vsense_ros.assess.partition import Device, profile
from vsense_ros.model.coordinates import ATTITUDE, COORDINATES, POSE, ROAD_HEIGHT
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import TWIST_SIZE, CarBlocks
from vsense_ros.observer.car_memory import SLOW
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.state import FORM, GAIN_COLUMNS, ROAD_STATES, TWIST, Q, U

Array = NDArray[np.float64]

STEP = 0.004  # [s] in which the moment is looked at whose programs are counted; their form is the same in every step
SPEED = 20.0  # [m/s]


@dataclass(frozen=True)
class AcceleratedStep:
    """A step with and without the kernel [µs]; `accelerator_us` is within the former, and `processor_us` the rest."""

    lanes: int
    alone_us: float
    processor_us: float
    accelerator_us: float
    covariance_us: float  # what the processor needs for the covariance, where it has no kernel
    clocks: int
    words: int
    requests: int

    @property
    def step_us(self) -> float:
        return self.processor_us + self.accelerator_us


def maps_of(car: CarBlocks, h: float, decay: Array) -> list[Map]:
    """The step of the covariance within `h` [s], one map after the other, as `propagate` of observer/car_blocks.c: the
    velocities, the coordinates that follow them, the road, and what decays (n - 28,). The car has made the step."""
    n = car.layout.size
    velocities, follow, road = (
        np.zeros((COORDINATES, n)),
        np.eye(n)[Q],
        np.zeros((ROAD_STATES.stop - ROAD_STATES.start, n)),
    )
    velocities[:, GAIN_COLUMNS] = car.gain
    by_angles, by_velocity, by_road, *_ = car.kinematics.results
    follow[POSE, ATTITUDE] += h * by_angles
    follow[POSE, TWIST] += h * by_velocity
    follow[POSE, FORM] += h * by_road
    follow[POSE.stop :, TWIST.stop : U.stop] += h * np.eye(Q.stop - POSE.stop)
    road[:, TWIST], road[:, FORM] = car.road_map[:, :TWIST_SIZE], car.road_map[:, TWIST_SIZE:]
    road[ROAD_HEIGHT, ROAD_STATES.start + ROAD_HEIGHT] = 1.0
    slow = SLOW + np.flatnonzero(decay != 1.0)
    maps = [Map.between(U.start, velocities), Map.between(Q.start, follow), Map.between(ROAD_STATES.start, road)]
    return [*maps, Map(slow, decay[slow - SLOW, None] * np.eye(n)[slow])]


def programs(vehicle: Vehicle, lanes: int) -> AcceleratedCovariance:
    """What has counted the clocks of a step with every sensor once."""
    sensors = sensors_of(vehicle)
    car = CarBlocks(vehicle, sensors)
    car.start(car.rolling(SPEED))
    car.linearize()
    car.step(STEP)
    covariance = AcceleratedCovariance(car.layout.size, RowCombiner(lanes).run, lanes)
    process = car.process(STEP)
    noisy = SLOW + np.flatnonzero(process.noise)
    covariance.predict(maps_of(car, STEP, process.decay), noisy, noisy, process.noise[noisy - SLOW])
    for name, sensor in sensors.items():
        if not sensor.is_input:
            _, jacobian = car.sense(name, np.zeros(len(sensor.deviations())))
            covariance.project(jacobian)
            covariance.subtract(np.eye(len(jacobian)))
    covariance.read()
    return covariance


def accelerated(vehicle: Vehicle, device: Device, iterations: float, lanes: int = 16) -> AcceleratedStep:
    """A step of the simplified car's observer with every sensor in it.

    The processor factors what each sensor is compared by, H P Hᵀ + R, with its inverse, and corrects the state. It
    never works at the same time as the kernel.
    """
    done = programs(vehicle, lanes)
    covariance = flop_of_covariance(vehicle)
    rest = profile(vehicle, False, iterations).flop - covariance + factored(vehicle)
    accelerator = done.requests * device.setup_us + done.clocks / device.clock_mhz
    processor, spent = device.processor_us(rest), device.processor_us(covariance)
    alone = device.processor_us(profile(vehicle, False, iterations).flop)
    return AcceleratedStep(lanes, alone, processor, accelerator, spent, done.clocks, done.words, done.requests)
