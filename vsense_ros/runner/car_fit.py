"""Does the car drive as the vehicle file says? Two regressions on what sensors measure, without the filter's model.

The steering angle δ against the curvature r / V and the lateral acceleration a that the axles feel, with the wheelbase
L, the understeer angle U(a) of the file's tyres and the offset δ₀,

    δ = ρ L r / V + U(a) + Δ a + δ₀ + τ δ̇,

gives ρ, the steering ratio times the wheelbase over those of the file, and Δ, what the understeer gradient has beyond
the file's. The course of GNSS at an antenna against the integrated yaw rate,

    course - ∫ r dt = constant - b t + s ∫ r dt - τ r + x r / V - κ α(a),

gives x, the distance of the antenna from the rear axle, and κ, the slip angle of the rear axle over α(a), that of the
file's tyres; b and s are bias and scale error of the gyro, τ is a lag (compare Bevly et al. 2006, IEEE Trans. Vehicular
Technology 55(6)). A mass alone shows in neither: mass over cornering stiffness does, in κ and Δ.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import degrees, exp, hypot, isfinite, sqrt
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.regression import Posterior, posterior
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.handling.base import HANDLING, static_loads
from vsense_ros.model.tyres import TyreInput
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CarFitSettings:
    """Times, bounds and tolerances: decisions of this project, but where a source is named."""

    step: float = 0.1  # [s] over which signals are averaged
    block: float = 12.0  # [s] of driving within which residuals may be correlated
    shortest: float = 4.0  # [s] of a block that is used
    blocks: int = 40  # [-] that are remembered: 8 minutes
    least: int = 5  # [-] blocks before anything is concluded: a minute
    slowest: float = 4.0  # [m/s] below which a course says little
    linear: float = 4.0  # [m/s²] lateral acceleration up to which tyres are as a single track has them
    asked: int = 1_000_000_000  # [ns] from one look at whether all sensors are believed to the next
    apart: float = 0.095  # [s] between two courses
    faster: float = 2.0  # [-] times the car's speed beyond which a velocity over ground is none of the car
    unlike: float = 9.0  # [-] mean square of the residuals of a block over their median, that is left out
    quick_block: float = 4.0  # [s] of the blocks that tell a steering ratio which is grossly another one
    quick_least: int = 2  # [-] such blocks before that is concluded
    quick_confirmed: int = 2  # [-] times in a row
    grossly: float = 0.25  # [-] that a ratio differs by then
    together: int = 5  # [-] steps whose mean is one row of the regression of the steering
    # Standard deviations before the drive.
    ratio_spread: float = 0.3  # [-]
    understeer_spread: float = 0.01  # [rad s²/m] 6 °/g
    offset_spread: float = 0.05  # [rad]
    steering_lag: float = 0.15  # [s] that a car may answer its steering later
    bias_spread: float = 0.01  # [rad/s]
    scale_spread: float = 0.02  # [-]
    course_lag: float = 0.05  # [s] that a receiver or a bus may be late
    place_spread: float = 2.0  # [m]
    slip_spread: float = 0.5  # [-]
    # An antenna that is taken to sit elsewhere, by blocks of `quick_block`.
    place_blocks: int = 120  # [-] that are remembered: 8 minutes
    place_least: int = 3  # [-] blocks before
    place_sure: float = 4.0  # [-] standard deviations, and
    place_far: float = 0.5  # [m] that it sits off at least
    place_error: float = 0.1  # [m] by which tyres unlike the file's may shift it
    # What a file may differ by without a word, beside so many standard deviations of the estimate, and how often.
    sure: float = 3.0  # [-]
    confirmed: int = 3  # [-] times in a row
    ratio: float = 0.12  # [-] as in the check of a vehicle file
    understeer: float = 0.0053  # [rad s²/m] 3 °/g: banked roads and roll steer are worth 1.8 on shipped cars
    place: float = 0.1  # [m]
    slip: float = 0.4  # [-]


CAR_FIT = CarFitSettings()


@dataclass(frozen=True)
class Quantity:
    """One number of the car: the file's, and what the drive says, with its standard deviation; `tolerance` is by how
    much they may differ. Without a `unit` it is a share of the file's."""

    words: str
    unit: str
    file: float
    value: float
    deviation: float
    tolerance: float

    @property
    def differs(self) -> bool:
        """True if the car's is surely another one than the file's."""
        return abs(self.value - self.file) > hypot(self.tolerance, CAR_FIT.sure * self.deviation)

    def sentence(self) -> str:
        """The difference in words."""
        if self.unit:
            return f"{self.words} {self.value:.2f} ± {self.deviation:.2f} {self.unit}, {self.file:.2f} by the file"
        percent, spread = 100 * abs(self.value - self.file), 100 * self.deviation
        than = "larger" if self.value > self.file else "smaller"
        return f"{self.words} {percent:.0f} ± {spread:.0f} % {than} than by the file"


@dataclass
class _Step:
    """Means over one step: the middle and the end of it [s], the heading turned to at the end [rad], and signals."""

    time: float
    end: float
    heading: float
    rate: float
    felt: float
    speed: float
    angle: float


class CarFit:
    """Both regressions for one car. `arm` is the distance ahead of the rear axle, by the file, of the antenna whose
    courses `travel` takes [m]."""

    def __init__(self, vehicle: Vehicle, arm: float) -> None:
        chassis = vehicle.physics.chassis
        self._wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
        self._arm = arm
        self._accelerations, self._front, self._rear = axle_slips(vehicle)
        self._steering_blocks: deque[tuple[Array, Array]] = deque(maxlen=CAR_FIT.blocks)
        self._course_blocks: deque[tuple[Array, Array]] = deque(maxlen=CAR_FIT.blocks)
        self._quick_blocks: deque[tuple[Array, Array]] = deque(maxlen=CAR_FIT.blocks)
        self._place_blocks: deque[tuple[Array, Array]] = deque(maxlen=CAR_FIT.place_blocks)
        self.further = 0.0, 0.0  # [m] that the antenna sits further ahead than by the file, and the deviation of that
        self._gross: list[Quantity] = []  # estimates of the steering ratio that differ grossly, in a row
        self.largest_angle = 0.0  # [rad] largest root mean square of the steering angle over such a block
        self._streaks: dict[str, int] = {}  # how often in a row a quantity has differed, by its words
        self.quantities: tuple[Quantity, ...] = ()  # what is known of the car by now
        self.forget()

    def forget(self) -> None:
        """Begin a new block: what came before does not belong to what comes."""
        self._steps: list[_Step] = []
        self._courses: list[tuple[float, float, float]] = []  # time [s], velocity east and north [m/s]
        self._sums, self._time = [0.0] * 4, 0.0
        self._quick = 0  # the first step that no quick block has

    def travel(self, stamp: int, east: float, north: float) -> None:
        """Take in a velocity over ground [m/s] at a time [ns]."""
        time = stamp * 1e-9
        if not self._courses or time - self._courses[-1][0] > CAR_FIT.apart:
            self._courses.append((time, east, north))

    def feel(self, stamp: int, h: float, rate: float, felt: float, speed: float, angle: float) -> None:
        """Take in the means over `h` [s] up to a time [ns]: yaw rate [rad/s] and lateral acceleration [m/s²] as
        measured, the speed [m/s], and the steering angle at the road wheels [rad], NaN where there is none."""
        if not (speed > CAR_FIT.slowest and abs(felt) < CAR_FIT.linear and isfinite(rate)):
            self._end_block()
            return
        self._time += h
        sums = self._sums
        self._sums = [sums[0] + h * rate, sums[1] + h * felt, sums[2] + h * speed, sums[3] + h * angle]
        if self._time >= CAR_FIT.step:
            self._end_step(stamp * 1e-9)

    def _end_step(self, end: float) -> None:
        turned, time = self._sums[0], self._time
        means = [one / time for one in self._sums]
        steps = self._steps
        if steps and end - time - steps[-1].end > CAR_FIT.step:  # the sensor was silent meanwhile
            self._end_block()
            steps = self._steps
        before = steps[-1].heading if steps else 0.0
        steps.append(_Step(end - time / 2, end, before + turned, *means))
        self._sums, self._time = [0.0] * 4, 0.0
        if end - steps[self._quick].end >= CAR_FIT.quick_block:
            self._end_quick_block()
        if end - steps[0].end >= CAR_FIT.block:
            self._end_block()

    def _end_quick_block(self) -> None:
        """Ask whether the steering ratio is grossly another one, of the steps since that was asked last."""
        steps, self._quick = self._steps[self._quick :], len(self._steps)
        rows = self._course_rows(steps, self._courses)
        if rows is not None:
            self._place_blocks.append(rows)
            self.further = self._found_further()
        angles = np.array([one.angle for one in steps])
        if not np.isfinite(angles).all():
            return
        self._quick_blocks.append(self._steering_rows(steps))
        self.largest_angle = max(self.largest_angle, float(np.sqrt(np.mean(angles**2))))
        if len(self._quick_blocks) >= CAR_FIT.quick_least:
            ratio = next(self._of_steering(self._quick_blocks, CAR_FIT.grossly))
            self._gross = [*self._gross, ratio] if ratio.differs else []

    @property
    def gross_ratio(self) -> Quantity | None:
        """The steering ratio times the wheelbase where that is grossly another one than the file's."""
        return self._gross[-1] if len(self._gross) >= CAR_FIT.quick_confirmed else None

    def _end_block(self) -> None:
        """Make a block of regression rows of what came since the last one."""
        steps, courses = self._steps, self._courses
        if not steps and not courses:
            return
        self.forget()
        if not steps or steps[-1].end - steps[0].end < CAR_FIT.shortest:
            return
        if all(isfinite(one.angle) for one in steps):
            self._steering_blocks.append(self._steering_rows(steps))
        rows = self._course_rows(steps, courses)
        if rows is not None:
            self._course_blocks.append(rows)
        self.quantities = tuple(self._estimated())
        self._streaks = {one.words: self._streaks.get(one.words, 0) + 1 for one in self.quantities if one.differs}

    @property
    def differing(self) -> list[Quantity]:
        """What is surely not as in the file."""
        sure = [one for one in self.quantities if self._streaks.get(one.words, 0) >= CAR_FIT.confirmed]
        gross = self.gross_ratio
        return sure if gross is None or any(one.words == gross.words for one in sure) else [gross, *sure]

    def _steering_rows(self, steps: list[_Step]) -> tuple[Array, Array]:
        """Rows of the equation of the steering angle."""
        table = np.array([(one.rate, one.felt, one.speed, one.angle) for one in steps])
        count = len(table) // CAR_FIT.together
        rate, felt, speed, angle = table[: count * CAR_FIT.together].reshape(count, CAR_FIT.together, 4).mean(axis=1).T
        understeer = self._slips(felt, self._front) - self._slips(felt, self._rear)
        change = np.gradient(angle, CAR_FIT.together * (steps[-1].end - steps[0].end) / max(len(steps) - 1, 1))
        return np.column_stack([self._wheelbase * rate / speed, felt, np.ones(count), change]), angle - understeer

    def _course_rows(self, steps: list[_Step], courses: list[tuple[float, float, float]]) -> tuple[Array, Array] | None:
        """Rows of the equation of the course, their mean taken off, times the speed: a course errs by velocity over
        speed. None where there are too few."""
        ends, times = np.array([one.end for one in steps]), np.array([one.time for one in steps])
        inside = [one for one in courses if ends[0] <= one[0] <= times[-1]]
        if len(inside) < CAR_FIT.shortest:
            return None
        t, east, north = np.array(inside).T
        heading = np.interp(t, ends, [one.heading for one in steps])
        means = zip(*((one.rate, one.felt, one.speed) for one in steps), strict=True)
        rate, felt, own = (np.interp(t, times, values) for values in means)
        speed = np.hypot(east, north)
        if not (speed.min() > CAR_FIT.slowest and (speed < CAR_FIT.faster * own).all()):
            return None
        y = np.unwrap(np.arctan2(north, east)) - heading
        x = np.column_stack([t - t[0], heading, -rate, rate / speed, -self._slips(felt, self._rear)])
        centre = speed @ np.column_stack([x, y]) / speed.sum()
        return (x - centre[:-1]) * speed[:, None], (y - centre[-1]) * speed

    def _slips(self, felt: Array, of_axle: Array) -> Array:
        """Slip angles of an axle by the file at lateral accelerations [rad]."""
        return np.sign(felt) * np.interp(np.abs(felt), self._accelerations, of_axle)

    def _estimated(self) -> Iterator[Quantity]:
        """The numbers of the car as far as the drive says."""
        s = CAR_FIT
        if len(self._steering_blocks) >= s.least:
            yield from self._of_steering(self._steering_blocks, s.ratio)
        if len(self._course_blocks) >= s.least:
            course = _fitted(self._course_blocks, *self._before_courses())
            (*_, arm, slip), (*_, spread, spread_of_slip) = course.values.tolist(), course.deviations.tolist()
            yield Quantity("GNSS antenna ahead of the rear axle", "m", self._arm, arm, spread, s.place)
            words = "slip angle of the rear axle per lateral acceleration"
            yield Quantity(words, "", 1.0, slip, spread_of_slip, s.slip)

    def place_deviation(self, by_file: float) -> float:
        """Standard deviation of where the antenna sits less where the file has it [m], of courses and of what it is in
        all files, `by_file` [m].

        Most files are right, and some are off by meters: a share of (`by_file` over `place_spread`)² of them is off by
        `place_spread`. Courses speak for a file that is right by the ratio of densities at its place, after them over
        before (Dickey 1971, Annals of Mathematical Statistics 42(1)).
        """
        ahead, deviation = self.further if self.further[1] else (0.0, CAR_FIT.place_spread)
        share = min((by_file / CAR_FIT.place_spread) ** 2, 1.0)
        right = CAR_FIT.place_spread / deviation * exp(-0.5 * (ahead / deviation) ** 2)
        elsewhere = share / (share + (1.0 - share) * right) if share else 0.0
        return sqrt(elsewhere) * hypot(ahead, deviation)

    def forget_places(self) -> None:
        """Stamps were others than was believed, which looks like an antenna elsewhere: begin anew."""
        self._place_blocks.clear()
        self.further = 0.0, 0.0

    def _found_further(self) -> tuple[float, float]:
        """As `further`, once the newest blocks are enough; one bend at low speed is."""
        if len(self._place_blocks) < CAR_FIT.place_least:
            return 0.0, 0.0
        course = posterior(self._place_blocks, *self._before_courses())
        return course.values.item(3) - self._arm, hypot(course.deviations.item(3), CAR_FIT.place_error)

    def _before_courses(self) -> tuple[Array, Array]:
        """Means and standard deviations of the coefficients of the course before the drive."""
        s = CAR_FIT
        deviations = [s.bias_spread, s.scale_spread, s.course_lag, s.place_spread, s.slip_spread]
        return np.array([0.0, 0.0, 0.0, self._arm, 1.0]), np.array(deviations)

    def _of_steering(self, blocks: Sequence[tuple[Array, Array]], tolerance: float) -> Iterator[Quantity]:
        """The steering ratio, which may differ by a `tolerance` without a word, and the understeer gradient."""
        s = CAR_FIT
        prior = np.array([s.ratio_spread, s.understeer_spread, s.offset_spread, s.steering_lag])
        steering = _fitted(blocks, np.array([1.0, 0.0, 0.0, 0.0]), prior)
        (ratio, more, *_), (spread, spread_of_more, *_) = steering.values.tolist(), steering.deviations.tolist()
        yield Quantity("steering ratio times wheelbase", "", 1.0, ratio, spread, tolerance)
        per_g = degrees(GRAVITY)
        file = float(self._front[1] - self._rear[1]) / float(self._accelerations[1])
        figures = (per_g * one for one in (file, file + more, spread_of_more, s.understeer))
        yield Quantity("understeer gradient", "°/g", *figures)


def _fitted(blocks: Sequence[tuple[Array, Array]], mean: Array, prior: Array) -> Posterior:
    """Coefficients as of `posterior`, without blocks that are unlike the others: in these a sensor was wrong."""
    at = posterior(blocks, mean, prior).values
    squares = np.array([np.mean((y - x @ at) ** 2) for x, y in blocks])
    alike = squares <= CAR_FIT.unlike * np.median(squares)
    return posterior([block for block, good in zip(blocks, alike, strict=True) if good], mean, prior)


def axle_slips(vehicle: Vehicle) -> tuple[Array, Array, Array]:
    """Lateral accelerations (n,) [m/s²] in steady cornering, and the slip angles (n,) [rad] of the front and the rear
    axle at them, with the file's tyres under static loads."""
    road = vehicle.physics.road
    accelerations = np.linspace(0.0, CAR_FIT.linear, 9)
    speed, slips = HANDLING.slope_speed, []
    angles = np.linspace(0.0, 0.3, 61)
    for axle, load in zip((vehicle.physics.front, vehicle.physics.rear), static_loads(vehicle), strict=True):
        sideways: Any = ca.DM(axle.cornering_scale * speed * np.tan(angles))  # of all angles at once
        contact = TyreInput(load, speed, sideways, speed, road.friction * axle.grip_scale)
        felt = np.array(-axle.tyre.forces(contact).lateral).ravel() * GRAVITY / load
        rising = np.concatenate([[True], np.diff(np.maximum.accumulate(felt)) > 0])
        slips.append(np.interp(accelerations, felt[rising], angles[rising]))
    return accelerations, slips[0], slips[1]
