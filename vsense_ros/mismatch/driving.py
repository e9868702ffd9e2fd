"""How a car is driven through the windows: from recorded inputs and parameters to runs of the simulation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, sosfiltfilt

from vsense_ros.checks.aligned import robust_deviation
from vsense_ros.errors import InputError
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import TORQUE_SHARES
from vsense_ros.mismatch.prediction_settings import PREDICTION, middle_of_steps
from vsense_ros.mismatch.road_in_windows import RoadInWindow
from vsense_ros.mismatch.signals import SIGNALS
from vsense_ros.mismatch.windows import INPUTS, SPEEDS, WINDOWS, Dataset, Readings
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import INPUTS as INPUT_NAMES
from vsense_ros.model.coordinates import SPIN, STEERING, TORQUES, YAW, Y
from vsense_ros.model.effects.base import AXLES
from vsense_ros.model.sensors import MeasuredQuantity, SensorBase, best_measuring
from vsense_ros.model.simulation.closed_loop import rolling_radii, rolling_straight
from vsense_ros.model.simulation.open_loop import Inputs, Run
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Driving:
    """What the motion in a window depends on."""

    key: int  # the same where all of it is
    parameters: Array
    shares: Sequence[float]  # as TORQUE_SHARES
    delays: tuple[float, float, float]  # of steering, torques and what gives the speed [s]
    around: Array  # (n, 7) as model.coordinates.DISTURBANCES
    varying: Mapping[str, Array]  # (n,) by name, of parameters that change along the road


@dataclass(frozen=True)
class _Recorded:
    """What was recorded in a window, in the middle of each step; not to be changed."""

    inputs: Array  # (n, 6) as model.coordinates.INPUTS; no torques where they are not measured
    speed: Array  # (n,) at which the wheels roll [m/s]
    acceleration: Array  # (n,) with which a car whose tyres slip then moves [m/s²]


class Drives:
    """The inputs of a car in each window of a data set; `names` are those of its parameters, in order."""

    def __init__(self, vehicle: Vehicle, dataset: Dataset, names: Sequence[str]) -> None:
        if vehicle.physics.steering.rear:
            raise InputError(
                f"{vehicle.name}: cars that steer their rear wheels (physics.steering.rear) are not explained"
            )
        if vehicle.physics.trailer is not None:
            raise InputError(f"{vehicle.name}: cars that tow a trailer (physics.trailer) are not explained")
        self.vehicle, self.dataset, self.names = vehicle, dataset, names
        self.radius = float(np.mean(rolling_radii(vehicle)))
        self._known: dict[tuple[int, tuple[float, float, float]], _Recorded] = {}  # by window and delays

    def driving(
        self, index: int, parameter_set: ParameterSet, sensors: Mapping[str, SensorBase], road: RoadInWindow,
        parameters: Array, mechanical: Sequence[float],
    ) -> Driving:  # fmt: skip
        """What the motion in a window depends on."""
        late = {n: s.latency - self.dataset.sensors[n].latency for n, s in sensors.items()}
        speed = 0.0 if self.dataset.windows[index].torques else late.get(self._speedometer[index], 0.0)
        steering, torques = (self.sensor_that_measures(sensors, what) or "" for what in INPUTS)
        delays = late.get(steering, 0.0), late.get(torques, 0.0), speed
        shares = [parameter_set.values[name] for name in TORQUE_SHARES]
        key = hash((*mechanical, *shares, *delays, road.key))
        return Driving(key, parameters, shares, delays, road.around, road.felt)

    def run(self, index: int, way: Driving, memory: Array) -> Run:
        window, recorded = self.dataset.windows[index], self._recorded(index, way.delays)
        inputs, speed, acceleration = recorded.inputs.copy(), recorded.speed, recorded.acceleration
        mass = way.parameters[self.names.index("chassis.mass")]
        # Of each wheel, if all of them move the whole car alike.
        inertia = np.full((len(inputs), 4), mass * self.radius**2 / 4)
        if window.torques:
            inertia[middle_of_steps(window) > window.begin + window.run_in - 0.5] = 0.0
        else:
            inertia *= 2 * _of_each_wheel(acceleration, *way.shares)
            inputs[:, TORQUES] = inertia / self.radius * acceleration[:, None]
        q, u = turning(self.vehicle, float(speed[0]), window.yaw_rate, window.lateral_velocity)
        q[YAW] += window.heading
        target, gain = speed / self.radius, inertia / WINDOWS.holding_time
        return Run(q, u, Inputs(PREDICTION.step, inputs, way.around, way.varying, target, gain), way.parameters, memory)

    def _recorded(self, index: int, delays: tuple[float, float, float]) -> _Recorded:
        """What was recorded in a window, of which that for the last delays is known."""
        if (key := (index, delays)) not in self._known:
            if len(self._known) >= 2 * len(self.dataset.windows):
                self._known.pop(next(iter(self._known)))
            self._known[key] = self._interpolated(index, *delays)
        self._known[key] = self._known.pop(key)  # the last to be forgotten
        return self._known[key]

    def _interpolated(self, index: int, steering_late: float, torques_late: float, speed_late: float) -> _Recorded:
        window = self.dataset.windows[index]
        middle = middle_of_steps(window)
        inputs = np.zeros((len(middle), len(INPUT_NAMES)))
        steering = window.readings[self.sensor_that_measures(window.readings, "steering") or ""]
        measured = np.isfinite(steering.value[:, 0])
        inputs[:, STEERING] = _means(middle + steering_late, steering.t[measured], steering.value[measured, 0])
        if window.torques:
            torques = window.readings[self.sensor_that_measures(window.readings, "torques") or ""]
            known = np.isfinite(torques.value).all(axis=1)
            for wheel, torque in enumerate(torques.value[known].T, TORQUES.start):
                inputs[:, wheel] = _means(middle + torques_late, torques.t[known], torque)
        return _Recorded(inputs, *self._rolling(index, speed_late))

    @cached_property
    def _speedometer(self) -> list[str]:
        """The sensor that gives the speed, by window."""
        candidates = (
            (self.sensor_that_measures(window.readings, what) for what in SPEEDS) for window in self.dataset.windows
        )
        return [next(filter(None, names), "") for names in candidates]

    def sensor_that_measures(self, names: Iterable[str], what: MeasuredQuantity) -> str | None:
        """Name of the one of these sensors that measures something; None if none does."""
        return best_measuring(((name, self.dataset.sensors[name]) for name in names), what)

    def _rolling(self, index: int, late: float) -> tuple[Array, Array]:
        """At what speed [m/s] the wheels roll in the middle of each step of a window, and with what acceleration [m/s²]
        a car whose tyres slip then moves, where the speed is older than its stamps say [s]."""
        window = self.dataset.windows[index]
        speed = np.interp(middle_of_steps(window) + late, window.speed.t, window.speed.value[:, 0])
        speed = _low_passed(speed, 1 / PREDICTION.step, self._cut_off[index])
        if "rolling speed" in self.dataset.sensors[self._speedometer[index]].measures:
            return speed, _of_the_car(speed)
        acceleration = np.gradient(speed, PREDICTION.step)
        return speed * (1 + acceleration / (PREDICTION.slip_stiffness * GRAVITY)), acceleration

    @cached_property
    def _cut_off(self) -> list[float]:
        """`cut_off` of the speed, by window."""
        return [cut_off(window.speed) for window in self.dataset.windows]

    def driven_axles(self, parameter_set: ParameterSet) -> frozenset[str]:
        """The axles that are driven: by wheel torques where they are measured, else by what is assumed of unknown
        ones."""
        torques = [
            window.readings[name].value
            for window in self.dataset.windows
            if window.torques and (name := self.sensor_that_measures(window.readings, "torques"))
        ]
        if torques:
            with np.errstate(all="ignore"):
                most = (
                    np.nanpercentile(np.concatenate(torques), PREDICTION.driving_percentile, axis=0)
                    .reshape(2, 2)
                    .max(axis=1)
                )
            least = max(PREDICTION.driving_torque, PREDICTION.not_driven_share * float(most.max()))
            return frozenset(axle for axle, torque in zip(AXLES, most, strict=True) if torque > least)
        front = parameter_set.values[TORQUE_SHARES[0]]
        return frozenset(
            axle for axle, share in zip(AXLES, (front, 1 - front), strict=True) if share > PREDICTION.not_driven_share
        )


def _means(middle: Array, t: Array, values: Array) -> Array:
    """Means of values (m,) at times `t` (m,) [s], between which they are linear, over steps with these middles (n,)
    [s], which may be closer together than the values."""
    parts = (np.arange(PREDICTION.parts) + 0.5) / PREDICTION.parts - 0.5
    return np.asarray(np.interp(middle[:, None] + parts * PREDICTION.step, t, values).mean(axis=1))


def cut_off(speed: Readings) -> float:
    """Frequency [Hz] up to which a car follows a measured speed (n, 1) [m/s]: the highest one below which the noise of
    the speed is an acceleration of no more than `PREDICTION.noise_acceleration`, within limits.

    White noise with a density of N gives the derivative below a frequency f a variance of (2π)² N f³ / 3. The density
    is that of what is left above `SIGNALS.cut_off`, where no driving is.
    """
    rate = 1 / float(np.median(np.diff(speed.t)))
    if rate < PREDICTION.least_sampling * SIGNALS.cut_off:
        return PREDICTION.highest_cut_off
    values = np.interp(np.arange(speed.t[0], speed.t[-1], 1 / rate), speed.t, speed.value[:, 0])
    fast = values - _low_passed(values, rate, SIGNALS.cut_off)
    density = robust_deviation(fast) ** 2 / (rate / 2 - SIGNALS.cut_off)
    highest = np.cbrt(3 * PREDICTION.noise_acceleration**2 / ((2 * np.pi) ** 2 * max(density, 1e-12)))
    return float(np.clip(highest, PREDICTION.lowest_cut_off, PREDICTION.highest_cut_off))


def _low_passed(values: Array, rate: float, frequency: float) -> Array:
    """Values (n,) sampled at a rate [Hz], without what is faster than a frequency [Hz]; nothing is late by it."""
    return np.asarray(sosfiltfilt(butter(2, frequency, fs=rate, output="sos"), values))


def _of_the_car(rolling: Array) -> Array:
    """Acceleration [m/s²] of a car that follows its wheels, which roll at these speeds (n,) [m/s], by their slip."""
    lag = PREDICTION.step + np.maximum(rolling, WINDOWS.slowest) / (PREDICTION.slip_stiffness * GRAVITY)
    share = PREDICTION.step / lag
    bands = np.ones((2, len(rolling)))  # of the matrix by which the car's speed follows, step after step
    bands[1] = share - 1
    speed = solve_banded((1, 0), bands, np.append(rolling[0], (share * rolling)[:-1]))
    return np.asarray((rolling - speed) / lag)


def _of_each_wheel(acceleration: Array, driving: float, braking: float) -> Array:
    """Shares (n, 4) of the wheels of an axle in the torque that gives the car an acceleration (n,) [m/s²], from the
    shares of the front wheels where it drives and where it brakes."""
    smooth = uniform_filter1d(acceleration, round(PREDICTION.smoothing / PREDICTION.step))
    front = driving + (braking - driving) * np.clip(-smooth / PREDICTION.braked, 0.0, 1.0)
    return np.column_stack([front, front, 1 - front, 1 - front])


def turning(
    vehicle: Vehicle, speed: float, yaw_rate: float, lateral_velocity: float | None = None
) -> tuple[Array, Array]:
    """Coordinates and velocities (14 each) of a car that goes along the map's x at a `speed` [m/s] and turns to the
    left by a `yaw_rate` [rad/s]. Where its `lateral_velocity` [m/s] is not known, it has that of the single-track car
    in a steady bend, on tyres of a usual cornering stiffness. From there the simulation is sooner where the car is than
    from a car that goes straight, which enters a bend at its limit as no driver does.
    """
    physics = vehicle.physics
    q, u = rolling_straight(vehicle, speed)
    u[YAW] = yaw_rate
    usual = yaw_rate * (physics.chassis.cog_to_rear_axle - speed**2 / (PREDICTION.cornering_stiffness * GRAVITY))
    u[Y] = usual if lateral_velocity is None else lateral_velocity
    q[YAW] = -np.arctan2(u[Y], speed)
    track = np.array([physics.front.track, physics.front.track, physics.rear.track, physics.rear.track])
    u[SPIN] *= 1 - yaw_rate / speed * track / 2 * np.array([1, -1, 1, -1])
    return q, u
