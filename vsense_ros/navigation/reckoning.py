"""What an inertial sensor should read, by all other sensors: for an axis that is left out, or to see that it jumped.

Where readings of a gyro or an accelerometer drive a filter, no innovation shows that they are wrong. Here each axis is
compared with itself: from one reading to the next it changes by no more than a car can move, and than it used to. An
axis that jumps is refused, and from then on it is what wheels, steering and GNSS say, with an error that is a
Gauss-Markov process (Gelb 1974, section 3.8) and begins with that of the last believed reading,

    x = target + e,  ė = -e / τ + w,  e ~ N(0, σ²) in the long run.

Readings are believed again once they agree with that. Meanwhile x drives the filter, and what x is off by is added to
its covariance: as white noise of density 2 τ σ², which moves an integral of x as far.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import atan2, exp, hypot, inf, isfinite, nan, pi, sqrt

from vsense_ros.estimation.filter import Array
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.sensors import SensorBase

AXES = ("roll_rate", "pitch_rate", "yaw_rate", "acceleration_x", "acceleration_y", "acceleration_z")
ROLL_RATE, PITCH_RATE, YAW_RATE, ALONG, ACROSS, UP = range(6)


@dataclass(frozen=True)
class ReckoningSettings:
    """How a car on a road moves, and how far that is from what its wheels, its steering and GNSS say of it.

    Changes are those after one second of a random walk that goes as far within some milliseconds as the quickest
    manoeuvres of the committed bags; deviations are those of these bags and of the recordings of a RAV4, rounded up.
    """

    rate_change: float = 0.5  # [rad/s] of roll and pitch rate
    yaw_rate_change: float = 0.2  # [rad/s]
    acceleration_change: float = 2.0  # [m/s²] along and across
    up_change: float = 8.0  # [m/s²]
    rate_deviation: float = 0.2  # [rad/s] of roll and pitch rate about zero, on rough roads
    yaw_rate_deviation: float = 0.12  # [rad/s] about the mean of what rear wheels and steering say, tyres sliding
    yaw_rate_deviation_by_course: float = 0.2  # [rad/s] about how GNSS says that the course turns
    yaw_rate_deviation_alone: float = 0.5  # [rad/s] where nothing says how the car turns
    along_deviation: float = 1.5  # [m/s²] about how the speed changes, slopes and shaking included
    across_deviation: float = 1.5  # [m/s²] about speed times yaw rate, banks and shaking included
    up_deviation: float = 3.0  # [m/s²] about gravity, on rough roads
    memory: float = 1.0  # [s] τ: for so long a car slides, or its wheels slip, alike
    usual_time: float = 5.0  # [s] over which the usual change from one reading to the next is averaged
    usual_noise: float = 0.5  # [m/s²] of accelerometers before it is known: a body shakes on its springs
    believed_again: float = 3.0  # [-] standard deviations within which a refused axis agrees again
    silent: float = 0.1  # [s] without any reading, after which the last one holds no more
    smoothing: float = 0.1  # [s] over which the change of the speed is averaged
    slowest: float = 2.0  # [m/s] of a car whose course means something
    oldest: float = 1.0  # [s] of what another sensor said last


class Reckoning:
    """The axes of one inertial sensor; all that changes stands in `memory` (`SIZE`,).

    `axes` are those that drive the filter, places in `AXES`. `numbers` are those of the car, of which it needs its
    axles, its rear track, tyres and wheels.
    """

    SIZE = 42
    NUMBERS = frozenset(
        ("to_front", "to_rear", "rear_track", "rolling_radius", "front_stiffness", "rear_stiffness", "mass")
    )

    def __init__(
        self,
        memory: Array,
        axes: Sequence[int],
        numbers: Mapping[str, float],
        settings: ReckoningSettings | None = None,
    ) -> None:
        self.axes, self._settings = tuple(axes), settings or ReckoningSettings()
        s = self._settings
        self.expected, self.variance, self.doubted = memory[0:6], memory[6:12], memory[12:18]
        self._error, self._usual = memory[18:24], memory[24:30]  # e where doubted, mean square of changes elsewhere
        # Time [s], that of the newest reading; speed [m/s], its time, its change [m/s²]; yaw rate of the wheels [rad/s]
        # and its time; steering angle [rad] and its time; course [rad], its time and its change [rad/s].
        self._others = memory[30:42]
        self._length = numbers["to_front"] + numbers["to_rear"]
        self._track, self._radius = numbers["rear_track"], numbers["rolling_radius"]
        compliance = numbers["to_rear"] / numbers["front_stiffness"] - numbers["to_front"] / numbers["rear_stiffness"]
        self._understeer = max(numbers["mass"] / self._length * compliance, 0.0)  # [rad/(m/s²)]
        rates, forces = [s.rate_change] * 2, [s.acceleration_change] * 2
        self._densities = [change**2 for change in (*rates, s.yaw_rate_change, *forces, s.up_change)]
        self._spread = [s.rate_deviation, s.rate_deviation, nan, s.along_deviation, s.across_deviation, s.up_deviation]

    def restart(self) -> None:
        """Forget all readings, as if none had come yet."""
        self.expected[:], self.doubted[:], self._error[:] = 0.0, 0.0, 0.0
        self.expected[UP] = GRAVITY
        self.variance[:] = inf
        self._usual[:3], self._usual[3:] = 0.0, self._settings.usual_noise**2
        self._others[:] = 0.0
        self._others[[3, 6, 8, 10]] = -inf

    def go_on(self, h: float) -> bool:
        """Time passes by `h` [s]; True if any axis has to be reckoned now."""
        others = self._others
        now = others.item(0) + h
        others[0] = now
        if now - others.item(1) > self._settings.silent and isfinite(self.variance.item(self.axes[0])):
            for axis in self.axes:
                self._doubt(axis)
        return 1.0 in self.doubted.tolist()

    def reckon(self, h: float) -> None:
        """Bring the axes that are doubted on by `h` [s]."""
        target, spread = self._target()
        decay = exp(-h / self._settings.memory)
        for i in self.axes:
            if self.doubted[i]:
                self._error[i] *= decay
                self.expected[i] = target[i] + self._error[i]
                self.variance[i] = spread[i] ** 2 + decay**2 * (min(self.variance[i], spread[i] ** 2) - spread[i] ** 2)

    def _doubt(self, axis: int) -> None:
        """An axis is not believed from now on."""
        if not self.doubted[axis]:
            self.doubted[axis] = 1.0
            self._error[axis] = self.expected[axis] - self._target()[0][axis] if isfinite(self.variance[axis]) else 0.0

    def spoils(self, axis: int) -> float:
        """Density [(rad/s)² s, (m/s²)² s] of the white noise that moves an integral as far as a reckoned axis does."""
        return 2 * self._settings.memory * float(self.variance[axis])

    def read(self, value: Array, variance: Array, gate: float) -> tuple[list[float], list[float], list[int]]:
        """Take in a reading (6,) with its variances (6,).

        Returns how far each axis is from what was expected, in standard deviations, NaN where absent; these standard
        deviations; and the axes that are not believed, because they are more than `gate` from it.
        """
        elapsed = self._others.item(0) - self._others.item(1)
        self._others[1] = self._others[0]
        share = min(elapsed / self._settings.usual_time, 1.0)
        gate_of_return = min(self._settings.believed_again, gate)
        readings, noises = value.tolist(), variance.tolist()
        expected, known_variances, doubted = self.expected.tolist(), self.variance.tolist(), self.doubted.tolist()
        whitened, deviations, refused = [nan] * 6, [1.0] * 6, []
        for i in self.axes:
            reading = readings[i]
            if reading != reading:
                self._doubt(i)
                continue
            change = reading - expected[i]
            if known_variances[i] == inf:  # the first
                deviation, distance = 1.0, 0.0
            else:
                usual = self._usual.item(i)
                deviation = sqrt(max(known_variances[i] + noises[i] + self._densities[i] * elapsed, usual))
                distance = change / deviation
            deviations[i], whitened[i] = deviation, distance
            if abs(distance) > (gate_of_return if doubted[i] else gate):
                self._doubt(i)
                refused.append(i)
                continue
            if not doubted[i] and known_variances[i] != inf:
                self._usual[i] += share * (change * change - usual)
            self.expected[i], self.variance[i], self.doubted[i] = reading, noises[i], 0.0
        return whitened, deviations, refused

    def innovation(self, axis: int, reading: float, variance: float) -> tuple[float, float]:
        """How far a reading of an axis is from what is expected, and its standard deviation."""
        return reading - self.expected.item(axis), sqrt(max(self.variance[axis] + variance, self._usual[axis]))

    # Other sensors

    def takes(self, sensor: SensorBase) -> Callable[[Array], None] | None:
        """What takes in a reading of a sensor that is not inertial; None where it says nothing of any axis."""
        if "rolling speed" in sensor.measures:
            return self._wheels
        if "steering" in sensor.measures:
            return self._steering
        return self._course if "course" in sensor.measures else None

    def _wheels(self, value: Array) -> None:
        left, right = value[2:4].tolist()
        if isfinite(left + right):
            now = self._others.item(0)
            self._others[5:7] = (right - left) * self._radius / self._track, now
            self._speed(0.5 * (left + right) * self._radius)

    def _steering(self, value: Array) -> None:
        if isfinite(angle := value.item(0)):
            self._others[7:9] = angle, self._others.item(0)

    def _course(self, value: Array) -> None:
        others, s = self._others, self._settings
        east, north = value.tolist()
        speed = hypot(east, north)
        if not isfinite(speed):
            return
        if others[0] - others[6] > s.oldest:  # of cars without wheel speeds
            self._speed(speed)
        elapsed, course = float(others[0] - others[10]), atan2(north, east)
        if speed > s.slowest:
            if 0 < elapsed < s.oldest:
                others[11] = ((course - others[9] + pi) % (2 * pi) - pi) / elapsed
            others[9:11] = course, others[0]

    def _speed(self, speed: float) -> None:
        s = self._settings
        now, _, before, then, change = self._others[:5].tolist()
        elapsed = now - then
        if elapsed <= 0:
            return
        if elapsed < s.oldest:
            change += (1 - exp(-elapsed / s.smoothing)) * ((speed - before) / elapsed - change)
        self._others[2:5] = speed, now, change

    def _target(self) -> tuple[list[float], list[float]]:
        """What the others say of the axes (6,), and how far the car may be from it."""
        s = self._settings
        now, _, speed, speed_at, along, wheel_rate, wheels_at, steer, steer_at, _, course_at, turn = (
            self._others.tolist()
        )
        rates = [wheel_rate] if now - wheels_at < s.oldest else []
        moves = now - speed_at < s.oldest
        if moves and now - steer_at < s.oldest:
            rates.append(speed * steer / (self._length + self._understeer * speed**2))
        if rates:
            rate, spread = sum(rates) / len(rates), s.yaw_rate_deviation
        elif now - course_at < s.oldest:
            rate, spread = turn, s.yaw_rate_deviation_by_course
        else:
            rate, spread = 0.0, s.yaw_rate_deviation_alone
        if not self.doubted[YAW_RATE] and isfinite(self.variance[YAW_RATE]):
            across = speed * float(self.expected[YAW_RATE])
        else:
            across = speed * rate
        spreads = list(self._spread)
        spreads[YAW_RATE] = spread
        return [0.0, 0.0, rate, along if moves else 0.0, across if moves else 0.0, GRAVITY], spreads
