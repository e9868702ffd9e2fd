"""The errorEKF with its covariance in the accelerator, of binary32, beside the one with all in double precision.

The kernel's mock gives the bits of the hardware. After every step and every correction the covariance is read, as the
observer's monitors look at it; the clocks of the kernel are those of `vsense_ros/assess/covariance_kernel.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.covariance import AcceleratedCovariance, Map
from vsense_ros.accelerator.kernels.row_combiner import RowCombiner
from vsense_ros.assess.covariance_kernel import maps_of
from vsense_ros.estimation.gaussian import Whitened, whiten
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.state import FORCE
from vsense_ros.runner import Runner

Array = NDArray[Any]


class AcceleratedCar(CarBlocks):
    """The car with full matrices, but for the covariance."""

    in_blocks: ClassVar[bool] = False

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        super().__init__(vehicle, sensors)
        self.kernel = AcceleratedCovariance(self.layout.size, RowCombiner().run)
        self._maps: list[Map] = []
        self._noise = np.zeros(0)
        self._read = np.full_like(self.covariance, np.nan)

    def transition(self, h: float, decay: Array) -> Array:
        self._maps = maps_of(self, h, decay)
        return np.zeros((0, 0))  # no matrix is needed

    def propagate(self, f: Array, noise: Array) -> None:
        self._noise = noise

    def share_torques(self, shared: Array) -> None:
        """The step of the covariance, now that all of its noise is known."""
        self.send()
        self.covariance[:] = 0.0
        self.add_noise(self._noise)
        super().share_torques(shared)
        rows, columns = np.nonzero(self.covariance)
        self.kernel.predict(self._maps, rows, columns, self.covariance[rows, columns])
        self.receive()

    def send(self) -> None:
        """Load the covariance where the processor has changed it."""
        if not np.array_equal(self.covariance, self._read):
            self.kernel.load(self.covariance)

    def receive(self) -> None:
        self.covariance[:] = self.kernel.read()
        self._read[:] = self.covariance


class AcceleratedEkf(ErrorEkf):
    """The errorEKF of such a car."""

    car: AcceleratedCar

    def _innovation(self, sensor: str, value: Array, variance: Array, scale: float) -> Whitened:
        residual, jacobian = self.system.sense(sensor, value)
        self.car.send()
        across = self.car.kernel.project(jacobian)
        return whiten(residual, scale * (across @ jacobian.T + np.diag(variance)), across)

    def _correct(self, sensor: str, value: Array, variance: Array, limit: float, scale: float) -> float:
        innovation = self._innovation(sensor, value, variance, scale)
        innovation.write(self._whitened, self._factor)
        if 0.0 <= innovation.nis <= limit:
            whitening = np.zeros((innovation.present.sum(), len(innovation.present)))
            whitening[:, innovation.present] = np.linalg.inv(innovation.factor)
            self.car.kernel.subtract(whitening)
            self.car.receive()
            self.system.retract(innovation.error)
        return innovation.nis


@dataclass(frozen=True)
class Comparison:
    """The largest difference of a state, but a force, from that in double precision, in standard deviations, and of a
    standard deviation, relative; over so many moments."""

    state: float
    deviation: float
    moments: int


def compare(vehicle: Vehicle, recording: Recording, seconds: float, progress: Callable[[float], None]) -> Comparison:
    """Both observers on the first `seconds` of a recording."""
    sensors = sensors_of(vehicle)
    cars = AcceleratedCar(vehicle, sensors), CarBlocks(vehicle, sensors)
    runners = [
        Runner(vehicle, recording.map_origin, lambda *_, f=f: f) for f in (AcceleratedEkf(cars[0]), ErrorEkf(cars[1]))
    ]
    state = deviation = 0.0
    moments, end = 0, recording.start + round(seconds * 1e9)
    for sample in recording.samples(tuple(runners[0].topics)):
        if sample.stamp > end:
            break
        for runner in runners:
            runner.add(sample)
        if not all(runner.started for runner in runners):
            continue
        variance = [car.covariance.diagonal() for car in cars]
        known = np.sqrt(variance[1])
        apart = np.delete(np.abs(cars[0].mean - cars[1].mean) / known, FORCE)
        state = max(state, float(apart.max()))
        deviation = max(deviation, float(np.max(np.abs(np.sqrt(variance[0]) / known - 1.0))))
        moments += 1
        progress((sample.stamp - recording.start) / (end - recording.start))
    return Comparison(state, deviation, moments)
