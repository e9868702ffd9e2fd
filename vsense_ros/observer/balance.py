"""Do the estimated tyre forces add up to what the inertial sensor feels? Asked at every estimate, answered in words."""

from __future__ import annotations

from math import exp, isfinite, pi

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.model.car.balance import SHARES, CarBalance
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import PITCH, ROLL
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.imu import FORCES
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.estimate import Estimate, stacked
from vsense_ros.observer.state import FORWARD

Array = NDArray[np.float64]

CUTOFF = 2.0  # [Hz] above it a road shakes wheels and sensor each in its own way
MEMORY = 5.0  # [s] over which the root mean square of what is over is reported
LONGEST_GAP = 0.5  # [s] between estimates, or since the sensor was heard, after which all is forgotten
_AT_REST = np.array([0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY])  # what an axis that is absent would measure, about
_TIME_CONSTANT = np.sqrt(np.sqrt(2) - 1) / (2 * pi * CUTOFF)  # [s] of each of two, which together have this cutoff
# Root mean squares that are reported, as SHARES: beyond the errors that the inertial sensor of a car leaves.
LARGEST = np.array([0.08, 0.08, 0.08, 0.1, 0.1, 0.04])
DEVIATIONS = 2.0  # by which more may be over: standard deviations of what the filter states of both sides


class Balance:
    """Compares forces of estimates with the newest reading of the vehicle's first inertial sensor.

    Both are low-passed alike, so that what differs is not their delay. Readings count as they came, whether the filter
    believes them or not. Without such a sensor, while it is silent, and of a car that tows, whose forces at the hitch
    are none of tyres, the answer is NaN. Where the sensor lacks some of its six axes so are the sums that ask for
    these; for the others the car turns about the vertical alone, along which there is gravity. Longitudinal forces that
    no sensor gives to wheels (`forces_determined` is false) are absent, and add up to nothing.
    """

    def __init__(self, vehicle: Vehicle, sensors: dict[str, SensorBase], *, forces_determined: bool = True) -> None:
        able = [name for name, sensor in sensors.items() if "rates and forces" in sensor.measures]
        self._tows, self._forces_determined = vehicle.physics.trailer is not None, forces_determined
        self.sensor = able[0] if able and not self._tows else None
        self.index = -1
        self._car = CarBalance(vehicle.physics)
        if self.sensor is not None:
            self.index = list(sensors).index(self.sensor)
            mounting = sensors[self.sensor].mounting()
            self._arm = mounting[:3]
            self._by_turning = np.cross(self._arm, np.eye(3)).T  # r × ω̇
            self._to_car = Rotation.from_euler("xyz", mounting[3:6]).as_matrix()
        self._value: Array | None = None  # of the newest reading, as it came, and its stamp [ns]
        self._heard = 0
        self._has = np.zeros(6, dtype=bool)  # the axes that it has
        self._complete = False  # True: it has all of them
        self._measured = np.zeros(6, dtype=bool)  # the sums that these determine
        self._comparable = False  # True: there is any
        self._stamp = 0  # of the newest estimate [ns]
        self._once, self._twice = np.zeros(14), np.zeros(14)
        self._square, self._since = np.zeros(6), 0.0
        self._noise = np.zeros(3)  # [m²/s⁴] variances of what low-pass filters leave of the noise of accelerometers
        self._waiting: list[tuple[Estimate, Array]] = []  # estimates that are not compared yet, and readings
        self._newest: Estimate | None = None  # of those that were compared

    def forget(self) -> None:
        """The filter begins anew: no reading has come yet."""
        self.settle()
        self._value, self._stamp = None, 0

    def measured(self, event: Event) -> None:
        """A reading of any sensor, of which the newest of the inertial one counts."""
        if event.sensor != self.index or (self._value is not None and event.stamp < self._heard):
            return
        silent = self._value is None or event.stamp - self._heard > LONGEST_GAP * 1e9
        if self._complete and not silent and isfinite(event.value.dot(event.value)):
            self._heard, self._value = event.stamp, event.value  # which nobody changes in place
            return
        present = np.isfinite(event.value)
        same = present.tobytes() == self._has.tobytes()  # far quicker than a comparison of six elements
        if silent and not same:
            self.settle()
            self._has, self._measured, same = present, self._measured_by(present), True
            self._complete, self._comparable = bool(present.all()), bool(self._measured.any())
        if same or not (self._has & ~present).any():
            self._heard, self._value = event.stamp, np.where(self._has, event.value, _AT_REST)

    def _measured_by(self, present: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The sums that can be made of these axes (6,), each of which is for the most part one of the car."""
        nearest = np.abs(self._to_car).argmax(axis=1)
        rates, forces = present[:3][nearest], present[3:][nearest]
        moments = rates & [forces[1], forces[0], True]  # a force at cog makes a moment about the road
        forces = forces & [self._forces_determined, True, True]
        return np.concatenate([forces, moments])

    def compare(self, estimate: Estimate) -> None:
        """Compare an estimate with the newest reading; its `unbalanced` is filled by the next `settle`."""
        if self._value is None or not self._comparable or abs(estimate.stamp - self._heard) > LONGEST_GAP * 1e9:
            self.settle()
            self._stamp = 0
            return
        self._waiting.append((estimate, self._value))
        if estimate.block.is_full:
            self.settle()

    def settle(self) -> None:
        """Fill `unbalanced` of all estimates that wait for it, as `CarBalance` defines it.

        Many are compared for little more than one costs: only the low-pass filters go on from one to the next.
        """
        if not self._waiting:
            return
        estimates = [estimate for estimate, _ in self._waiting]
        readings = np.array([reading for _, reading in self._waiting])
        self._waiting.clear()
        self._newest = estimates[-1]
        # What a single one has computed need not be computed anew when it is published.
        together = stacked(estimates) if len(estimates) > 1 else estimates[0]
        state = together.state.reshape(len(estimates), -1)
        signals = self._signals(together, state, readings)
        passed, parts = self._stretches([e.stamp for e in estimates])
        once, low = self._low_passed(signals, passed, parts)
        rates, turning = low[:, :3], (once[:, :3] - low[:, :3]) / _TIME_CONSTANT
        # The lever arm's tangential and centripetal parts, ω × (ω × r) = ω (ω · r) - r ω².
        force = low[:, 3:6] + turning @ self._by_turning.T - rates * (rates @ self._arm)[:, None]
        force += self._arm * np.sum(rates**2, axis=1)[:, None]
        motion = self._car.of_motion(force, turning, low[:, 12], low[:, 13], state[:, FORWARD])
        residual = low[:, 6:12] - motion
        # Of white noise one filter leaves time / 2 τ of the variance, and two of them half of that.
        noise = (signals[:, 3:6] - low[:, 3:6]) ** 2 * np.minimum(passed / _TIME_CONSTANT, 1.0)[:, None] / 4
        self._average(np.concatenate([self._car.shares(residual) ** 2, noise], axis=1), passed, parts)
        residual[:, ~self._measured] = np.nan
        for estimate, row in zip(estimates, residual, strict=True):
            estimate.unbalanced[:] = row

    def _signals(self, estimates: Estimate, state: Array, readings: Array) -> Array:
        """What is low-passed of n estimates, their states and the readings beside them (n, 6): rates and specific force
        in the axes of the car, force and moment of the tyres, roll and pitch, (n, 14)."""
        wheels, steering = estimates.wheels.reshape(-1, 7, 4), estimates.steering.reshape(-1)
        signals = np.empty((len(readings), 14))
        signals[:, :3], signals[:, 3:6] = readings[:, :3] @ self._to_car.T, readings[:, 3:] @ self._to_car.T
        signals[:, 6:12] = self._car.of_tyres(wheels, steering)
        signals[:, 12], signals[:, 13] = state[:, ROLL], state[:, PITCH]
        return signals

    def _stretches(self, stamps: list[int], most: int = 64) -> tuple[Array, list[tuple[slice, bool]]]:
        """Times [s] between estimates with these stamps [ns], and the stretches of them that are low-passed together:
        each with whether the filters begin anew, and of so many at `most`, as the work of `_response` grows with their
        square."""
        times: list[float] = []
        begins: dict[int, bool] = {}
        for row, stamp in enumerate(stamps):
            passed = (stamp - self._stamp) * 1e-9
            self._stamp = stamp
            goes_on = 0 <= passed < LONGEST_GAP
            times.append(passed if goes_on else 0.0)
            if not goes_on or row % most == 0:
                begins[row] = not goes_on
        ends = [*list(begins)[1:], len(stamps)]
        parts = [(slice(row, end), anew) for (row, anew), end in zip(begins.items(), ends, strict=True)]
        return np.array(times), parts

    def _low_passed(self, signals: Array, passed: Array, parts: list[tuple[slice, bool]]) -> tuple[Array, Array]:
        """Signals (n, 14) after one and after both low-pass filters, at times (n,) after each other [s]."""
        once, twice = np.empty_like(signals), np.empty_like(signals)
        for part, anew in parts:
            if anew:
                self._once[:] = self._twice[:] = signals[part.start]
            decay, weights = _response(passed[part] / _TIME_CONSTANT)
            once[part] = weights @ signals[part] + decay * self._once
            twice[part] = weights @ once[part] + decay * self._twice
            self._once[:], self._twice[:] = once[part.stop - 1], twice[part.stop - 1]
        return once, twice

    def _average(self, squares: Array, passed: Array, parts: list[tuple[slice, bool]]) -> None:
        """Let squares of what is over (n, 6), and beside them of what noise leaves of it (n, 3), count in their
        means."""
        for part, anew in parts:
            if anew:
                self._square[:], self._noise[:], self._since = 0.0, 0.0, 0.0
            self._since += float(passed[part].sum())
            decay, weights = _response(passed[part] / MEMORY)
            mean = weights[-1] @ squares[part]
            self._square[:] = mean[:6] + decay.item(-1) * self._square
            self._noise[:] = mean[6:] + decay.item(-1) * self._noise

    def _deviations(self) -> Array:
        """Standard deviations of what is over, as `SHARES` (6,): those of the car's acceleration, which the tyres make,
        and of the biases of the accelerometers, by the newest estimate, and of the noise of these."""
        newest = self._newest
        if newest is None:
            return np.zeros(6)
        covariance, first = newest.acceleration_covariance.copy(), newest.car.layout.biases[self.index].start
        biases = slice(first + FORCES.start, first + FORCES.stop)
        covariance[:3, :3] += self._to_car @ newest.covariance[biases, biases] @ self._to_car.T
        covariance[:3, :3] += np.diag(self._noise) / (1 - exp(-self._since / MEMORY))
        return self._car.deviations(covariance)

    def diagnostic(self) -> Diagnostic:
        """One line on how well the forces have added up in the last `MEMORY`."""
        self.settle()
        if not self._stamp or not self._since:
            nothing = self._value is not None and not self._comparable
            text = f"not compared: {self.sensor} lacks the axes" if nothing else "nothing to compare yet"
            text = "not compared: the car tows a trailer" if self._tows else text
            return Diagnostic("balance of forces", Level.OK, text)
        # Until as much time has passed, the mean is of that time alone.
        mean = np.sqrt(self._square / (1 - exp(-self._since / MEMORY)))
        comparable = np.isfinite(self._car.shares(np.where(self._measured, 0.0, np.nan)))
        values = {f"{name} [%]": f"{100 * mean[i]:.1f}" for i, name in enumerate(SHARES) if comparable[i]}
        largest = np.hypot(LARGEST, DEVIATIONS * self._deviations())
        exceeded = [
            f"{name} {100 * mean[i]:.0f} %" for i, name in enumerate(SHARES) if comparable[i] and mean[i] > largest[i]
        ]
        if exceeded and self._since > MEMORY:
            text = f"tyre forces do not add up to what {self.sensor} feels: {', '.join(exceeded)} off"
            return Diagnostic("balance of forces", Level.WARN, text, values)
        worst = 100 * float(mean[comparable].max(initial=0.0))
        text = f"tyre forces add up to what {self.sensor} feels, to {worst:.0f} %"
        return Diagnostic("balance of forces", Level.OK, text, values)


def _response(steps: Array) -> tuple[Array, Array]:
    """How a low-pass filter answers at each of n steps, whose lengths (n,) are in time constants: how much is left of
    its value before them (n, 1), and how much of each input (n,) is in it (n, n)."""
    shares = -np.expm1(-steps)
    if len(steps) == 1:
        return 1.0 - shares[:, None], shares[:, None]
    ages = np.cumsum(steps)
    since = np.minimum(ages - ages[:, None], 0.0)
    return np.exp(-ages)[:, None], np.tril(np.exp(since)) * shares
