"""Is the inertial sensor mounted as the vehicle file says? The unexplained acceleration on straight roads shows it.

On a straight road an accelerometer along or across the car feels what the speed changes by, and the slope of the road.
A sensor that leans feels a part of gravity besides, always the same. The filter explains that by a bias and by the
slope, whichever it knows less of; together they are the unexplained acceleration. Where a receiver's height gives
the slope along the way, the bias alone is. On average over a straight drive roads lean by a few per cent at most.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import asin, degrees, exp, hypot

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import ROAD_HEIGHT
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.imu import FORCES
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.state import DISTURB, FORWARD, SLOPES, YAW_RATE

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TiltSettings:
    """Settings of the check whether the inertial sensor leans: decisions of this project."""

    largest: float = 0.7  # [m/s²] unexplained on average, from which it is reported: 4.1° of gravity, a road of 7 %
    least_time: float = 20.0  # [s] of straight driving after which it is reported
    memory: float = 60.0  # [s] of straight driving over which is averaged
    straight: float = 0.05  # [rad/s] of yaw up to which a road is straight, and a side slip changes nothing
    moving: float = 3.0  # [m/s] from which the car drives
    longest_gap: float = 0.5  # [s] between two states that are looked at
    period: int = 100_000_000  # [ns] at least from one state to the next
    known_height: float = 10.0  # [m] standard deviation of the road's height, up to which a receiver reports it


TILT = TiltSettings()


class Tilt:
    """Watches the vehicle's first inertial sensor, whose name is `sensor`; None: there is none."""

    def __init__(self, sensors: dict[str, SensorBase], car: CarBlocks) -> None:
        able = [(i, name) for i, (name, sensor) in enumerate(sensors.items()) if "rates and forces" in sensor.measures]
        self.sensor = able[0][1] if able else None
        self._car = car
        self._stamp = 0
        self._mean, self.seconds = np.zeros(2), 0.0
        self._of_height = False  # what the slope along the way is known from
        if self.sensor is None:
            return
        first = car.layout.biases[able[0][0]].start + FORCES.start
        self._biases = slice(first, first + 3)
        self._to_car = Rotation.from_euler("xyz", sensors[self.sensor].mounting()[3:6]).as_matrix()[:2]

    def forget(self) -> None:
        """Forget all measurements, as the filter begins anew."""
        self._stamp, self.seconds = 0, 0.0
        self._mean[:] = 0.0

    def look(self, stamp: int, converged: Callable[[], bool]) -> None:
        """At the filter's newest state, at this time [ns]; what has not `converged` says nothing."""
        passed = stamp - self._stamp
        if self.sensor is None or 0 <= passed < TILT.period:
            return
        mean, time = self._car.mean, passed * 1e-9
        self._stamp = stamp
        if (
            not 0 < time < TILT.longest_gap
            or mean[FORWARD] < TILT.moving
            or abs(mean[YAW_RATE]) > TILT.straight
            or not converged()
        ):
            return
        unexplained = self._to_car @ mean[self._biases]
        slopes = GRAVITY * mean[SLOPES]
        height = DISTURB.start + ROAD_HEIGHT
        height_known = float(self._car.covariance[height, height]) < TILT.known_height**2
        unexplained[1] += slopes[1]
        if not height_known:
            unexplained[0] += slopes[0]
        self._of_height = height_known
        self.seconds += time
        share = (1 - exp(-time / TILT.memory)) / (1 - exp(-self.seconds / TILT.memory))
        self._mean += share * (unexplained - self._mean)

    @property
    def unexplained(self) -> Array:
        """Mean unexplained acceleration along and across the car (2,) [m/s²], NaN before it is known."""
        return self._mean.copy() if self.seconds > TILT.least_time else np.full(2, np.nan)

    def sentence(self) -> str:
        """What to say of the sensor; empty where nothing is wrong, or not known yet."""
        along, across = self.unexplained.tolist()
        if not hypot(along, across) > TILT.largest:
            return ""
        pitch, roll = (degrees(asin(max(-1.0, min(1.0, force / GRAVITY)))) for force in (-along, across))
        words = [
            f"{name} of {angle:+.1f}°"
            for name, angle, force in (("roll", roll, across), ("pitch", pitch, along))
            if abs(force) > TILT.largest / 2
        ]
        text = f"mounted tilted? Its attitude in the vehicle file lacks a {' and a '.join(words)}"
        roads = [
            f"{name} by {abs(100 * force / GRAVITY):.0f} %"
            for name, force, reported in (
                ("climbs" if along > 0 else "falls", along, self._of_height),
                ("leans", across, False),
            )
            if abs(force) > TILT.largest / 2 and not reported
        ]
        return f"{text}, or the road {' and '.join(roads)} all along" if roads else text
