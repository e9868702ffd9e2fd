"""How late each sensor's stamps are, estimated while the car drives.

Sensors of one car measure one motion: gyro, rear wheels, course over ground and steering angle how it turns, the
accelerometer, wheels and speed over ground how it gains speed, and fixes where it is (`place_lag`). By how much one is
later than another is where the two correlate best (Knapp & Carter 1976, "The generalized correlation method for
estimation of time delay", IEEE Trans. ASSP 24), and its variance follows from the curvature of the correlation there
and from what is left unexplained,

    σ² = ((1 - ρ²) / n + e²) / (ρ |ρ''|)    with n independent values and a share e of the motion that is distorted.

A steering angle leads the turn that answers it by the mean delay of the single-track model, and the course of an
antenna ahead of the rear axle leads the heading by the time it takes to drive that far, less what the rear tyres slip;
both are taken off, of turns alone: a speed needs neither. All pairs of sensors are adjusted together by least squares,
relative to the inertial sensor, and those are in time that most agree with. A reading of one that is late for certain
is taken to be as old as that says: the filter uses it at its time, or, where that is beyond what it remembers, refuses
it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, product
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.lags import lag_curve, refined
from vsense_ros.estimation.timeline import Event
from vsense_ros.model.handling.base import car_numbers, rear_slip
from vsense_ros.model.sensors import SensorBase, place_of
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.lag_doubt import GAIN, TURN, LagDoubt
from vsense_ros.runner.place_lag import PlaceLag

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LatencySettings:
    """How lags are estimated, and when one is used: decisions of this project."""

    period: int = 3_000_000_000  # [ns] from one estimate to the next
    most_heard: int = 10_000  # [-] readings of a sensor kept until then: three periods of 1 kHz
    window: float = 40.0  # [s] of the newest readings that are compared
    longest: float = 1.6  # [s] lag that is sought
    step: float = 0.04  # [s] between the values that are compared
    span: float = 0.4  # [s] of their means, or two periods of the slower of both sensors
    longest_gap: float = 1.3  # [s] between two readings
    most_delayed: float = 3.0  # [s] by which a body turns later than an axle steers, or an antenna ahead goes
    silence: float = 4.0  # [s] after which a sensor is compared no more, above `longest` and a gap
    usual_speed: float = 15.0  # [m/s] where none is known yet
    slowest: float = 3.0  # [m/s] below which neither course nor steering says how a car turns
    least_compared: float = 5.0  # [s] in which both are there
    independent: float = 0.5  # [s] from one independent value to the next
    least_turning: float = 0.03  # [rad/s] standard deviation of a yaw rate that shows a lag
    least_acceleration: float = 0.4  # [m/s²] standard deviation of an acceleration that shows a lag
    least_correlation: float = 0.85  # [-] at the best lag
    clear: float = 1.5  # [-] unexplained variance at any other lag, `apart` from it, over that
    apart: float = 0.4  # [s]
    form: float = 0.02  # [-] of a motion, that a sensor gets wrong in a way that looks like a lag
    # [s] standard deviations of what these formulae leave out: suspension, tyres, compliance, pitch.
    turning_error: float = 0.01
    acceleration_error: float = 0.02
    pitch_error: float = 0.05
    wheel_error: float = 0.02
    course_error: float = 0.02
    antenna_place: float = 0.7  # [m] along the car: an antenna elsewhere shifts its course as a lag does
    steering_error: float = 0.05
    significant: float = 3.0  # [-] standard deviations of a lag that is used
    least_used: float = 0.04  # [s]
    agreeing: float = 0.1  # [s] within which two sensors are equally late


LATENCY = LatencySettings()


class Late(NamedTuple):
    """By how much the stamps of a sensor are later than its measurements, with the standard deviation of that [s]."""

    seconds: float
    deviation: float

    def __str__(self) -> str:
        return f"{1e3 * self.seconds:+.0f} ± {1e3 * self.deviation:.0f} ms"


class _Motion:
    """Turn [rad] and gain of speed [m/s] since the beginning, by one sensor: rows of time [s], both of these, and by
    how much the body turns later than the row says [s]."""

    def __init__(self) -> None:
        self.rows = np.zeros((0, 4))
        self.newest = np.zeros((0, 4))  # the newest row as it was given

    def integrate(self, rows: Array, oldest: float, integrals: list[bool]) -> None:
        """Append rows (n, 4) in the order of their times, of which turn and gain are rates, where they are not
        `integrals` already, and forget what is older than a time [s]."""
        rows = np.concatenate([self.newest, rows])
        goes_on = np.ones(len(rows), dtype=bool)
        goes_on[1:] = rows[1:, 0] > rows[:-1, 0]
        if not goes_on.all():
            rows = rows[goes_on]
        if len(rows) < 2:
            return
        steps = rows[1:, :1] - rows[:-1, :1]
        values = rows[:, 1:3]
        changes = np.where(integrals, values[1:] - values[:-1], 0.5 * (values[1:] + values[:-1]) * steps)
        begin = self.rows[-1:, 1:3] if len(self.rows) else np.where(integrals, values[:1], 0.0)
        more = rows[1:].copy()
        more[:, 1:3] = begin + np.cumsum(changes, axis=0)
        self.newest = rows[-1:]
        joined = np.concatenate([self.rows, more])
        self.rows = joined[np.searchsorted(joined[:, 0], oldest) :]

    @property
    def period(self) -> float:
        """Time between two rows [s]."""
        times = self.rows[:, 0]
        return float(times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else np.inf

    def rates(self, times: Array, span: float) -> Array:
        """Mean rates of turn and of gain of speed (2, n) around times [s], NaN where they are not known."""
        ends = times - span / 2, times + span / 2
        since = np.searchsorted(self.rows[:, 0], ends[0][0] - LATENCY.most_delayed)
        rows = self.rows[max(int(since) - 1, 0) :]
        turned = np.maximum.accumulate(rows[:, 0] + rows[:, 3])
        rates = []
        for t, values in ((turned, rows[:, 1]), (rows[:, 0], rows[:, 2])):
            known = (ends[0] >= t[0]) & (ends[1] <= t[-1])
            for end in ends:
                after = np.minimum(np.maximum(np.searchsorted(t, end), 1), len(t) - 1)
                known &= t[after] - t[after - 1] < LATENCY.longest_gap
            early, late = (np.interp(end, t, values) for end in ends)
            rates.append(np.where(known, (late - early) / span, np.nan))
        return np.array(rates)


class Latencies:
    """The lags of one car's sensors; `hear` takes every reading with the stamp of its message, `late` are those that
    are late for certain, by their places, and by how much."""

    def __init__(self, vehicle: Vehicle, sensors: Mapping[str, SensorBase]) -> None:
        every = tuple(sensors.values())
        self._inertial, self._wheels, self._course, self._steering = (
            place_of(every, what) for what in ("rates and forces", "rolling speed", "course", "steering")
        )
        places = self._inertial, self._wheels, self._course, self._steering
        self._motions = {i: _Motion() for i in places if i >= 0}
        # Before the filter starts nobody looks at them, which may last for hours: the newest are kept.
        self._heard: dict[int, deque[tuple[int, Array]]] = {i: deque(maxlen=LATENCY.most_heard) for i in self._motions}
        self.possible = self._inertial >= 0 and len(self._motions) > 1
        self._sensors = every
        self._car = car_numbers(vehicle)
        antenna = every[self._course] if self._course >= 0 else None
        ahead = float(np.asarray(getattr(antenna, "position", np.zeros(3)))[0])
        self._ahead = self._car["to_rear"] + ahead  # [m] of the antenna, of the rear axle
        self.late: dict[int, Late] = {}
        self.by_sensor: dict[int, Late] = {}
        self._position, self._fixes = place_of(every, "position"), PlaceLag()
        pairs = [pair for pair in combinations(self._motions, 2) if self._steering not in pair]
        keys = product(pairs, (TURN, GAIN))
        usual = {(pair, motion): self._unmodelled(pair, motion, LATENCY.usual_speed) for pair, motion in keys}
        # Course and wheels go by the gyro.
        compared = {key: s for key, s in usual.items() if key[1] == GAIN or self._inertial in key[0]}
        self.doubt = LagDoubt(compared, self._wheels)
        self._before: dict[int, Late] = {}  # the estimate before that
        self._due = self._begun = self._taken = 0  # [ns]

    def hear(self, event: Event) -> None:
        """Take in a reading, with the stamp that its message says."""
        heard = self._heard.get(event.sensor)
        if heard is not None:
            heard.append((event.stamp, event.value))
        if self._position >= 0 <= self._course and event.sensor in (self._position, self._course):
            self._fixes.hear(event, is_place=event.sensor == self._position)

    def look(self, now: int) -> bool:
        """Estimate all lags anew if it is time [ns]; True if others are late now."""
        if 0 <= now - self._due < LATENCY.period:
            if now - self._taken >= self.doubt.period:
                self._taken = now
                self._take_in(now, besides=self._steering)
            return False
        jumped = not 0 <= now - self._due < 3 * LATENCY.period
        self._due = self._taken = now
        if jumped:
            self._begin(now)
            return False
        self._take_in(now)
        self._before, self.by_sensor = self.by_sensor, self._adjusted(now)
        self._compare_fixes()
        return self._decide()

    def _begin(self, now: int) -> None:
        """Forget everything; times count from now on [ns]."""
        self._begun = now
        for i in self._motions:
            self._motions[i] = _Motion()
            self._heard[i].clear()
        self.by_sensor, self._before = {}, {}
        self.doubt.forget()
        self._fixes.forget()

    def _take_in(self, now: int, besides: int = -1) -> None:
        """Make motions of what was heard, besides one sensor."""
        oldest = (now - self._begun) * 1e-9 - LATENCY.window - 2 * LATENCY.longest
        for i, motion in self._motions.items():
            heard = self._heard[i]
            if not heard or i == besides:
                continue
            stamps, values = np.array([stamp for stamp, _ in heard]), np.array([value for _, value in heard])
            heard.clear()
            order = np.argsort(stamps, kind="stable")
            rows = self._rows(i, (stamps[order] - self._begun) * 1e-9, values[order])
            known = np.isfinite(rows)
            if not known.all():
                rows = rows[known.all(axis=1)]
            if i == self._course:
                rows[:, 1] = _unwrapped(np.concatenate([motion.newest[:, 1], rows[:, 1]]))[len(motion.newest) :]
            motion.integrate(rows, oldest, [i == self._course, i in (self._course, self._wheels)])
        self.doubt.compare(self._motions, {i: late.seconds for i, late in self.late.items()})

    def _rows(self, index: int, times: Array, values: Array) -> Array:
        """Times, rates of turn and of gain of speed, or of a course the angle, and of course and wheels the speed, and
        by how much the turn is later [s], (n, 4) of the readings of a sensor."""
        if index == self._inertial:
            values = self._sensors[index].in_axes_of_car(values)
            return _table(times, values[:, 2], values[:, 3])
        if index == self._wheels:
            speeds, track = self._car["rear_radius"] * values, 2 * self._car["rear_half_track"]
            turning = (speeds[:, 3] - speeds[:, 2]) / track
            return _table(times, turning, _middle_of_four(speeds))
        if index == self._course:
            speed = np.hypot(values[:, 0], values[:, 1])
            later = self._ahead / np.maximum(speed, LATENCY.slowest) - rear_slip(self._car) * speed
            course = np.where(speed > LATENCY.slowest, np.arctan2(values[:, 1], values[:, 0]), np.nan)
            return _table(times, course, speed, later)
        speed = self._speed_at(times)
        gain, delay = self._single_track(np.maximum(speed, LATENCY.slowest))
        turning = np.where(speed > LATENCY.slowest, gain * values[:, 0], np.nan)
        return _table(times, turning, 0.0, delay)

    def _speed_at(self, times: Array) -> Array:
        """Speed of the car at times [s], by wheels or GNSS; NaN where neither is heard."""
        for i in (self._wheels, self._course):
            rows = self._motions[i].rows if i in self._motions else np.zeros((0, 4))
            if len(rows) > 1:
                return np.asarray(np.abs(np.interp(times, rows[:, 0], rows[:, 2])))
        return np.full(len(times), np.nan)

    def _single_track(self, speed: Array) -> tuple[Array, Array]:
        """Yaw rate per steering angle [1/s] and the mean delay of it [s] by the linear single-track model at speeds
        (n,): of ẋ = A x + B δ, the last elements of -A⁻¹ B and of -A⁻² B over that (Mitschke 1990)."""
        car = self._car
        a, b, m, j = car["to_front"], car["to_rear"], car["mass"], car["yaw_inertia"]
        front, rear = car["front_stiffness"], car["rear_stiffness"]
        a11 = -(front + rear) / (m * speed)
        a12 = (b * rear - a * front) / (m * speed) - speed
        a21 = (b * rear - a * front) / (j * speed)
        a22 = -(a**2 * front + b**2 * rear) / (j * speed)
        determinant = a11 * a22 - a12 * a21

        def solved(one: Array, other: Array) -> tuple[Array, Array]:
            return (a22 * one - a12 * other) / determinant, (a11 * other - a21 * one) / determinant

        first = solved(np.full(len(speed), front / m), np.full(len(speed), a * front / j))
        return -first[1], -solved(*first)[1] / first[1]

    # Lags

    def _adjusted(self, now: int) -> dict[int, Late]:
        """How late each sensor is, those that are not late being as many as possible."""
        pairs = self._pairs(now)
        places = list(dict.fromkeys(i for pair in pairs for i in pair))
        others = [i for i in places if i != self._inertial]
        if self._inertial not in places:
            return {}
        column = {place: k for k, place in enumerate(others)}
        rows, right = np.zeros((len(pairs), len(others))), np.zeros(len(pairs))
        for k, ((one, other), late) in enumerate(pairs.items()):
            for place, sign in ((one, 1.0), (other, -1.0)):
                if place in column:
                    rows[k, column[place]] = sign / late.deviation
            right[k] = late.seconds / late.deviation
        information = rows.T @ rows
        if np.linalg.matrix_rank(information) < len(others):
            return {}
        covariance = np.linalg.inv(information)
        lags = covariance @ rows.T @ right
        spread = float(np.sum((rows @ lags - right) ** 2)) / max(len(pairs) - len(others), 1)
        covariance *= max(spread, 1.0)  # pairs that contradict each other know less than they say
        values = {self._inertial: 0.0, **dict(zip(others, lags.tolist(), strict=True))}
        deviations = dict(zip(others, np.sqrt(covariance.diagonal()).tolist(), strict=True))
        deviations[self._inertial] = min(deviations.values())
        in_time = self._in_time(values)
        return {i: Late(values[i] - values[in_time], deviations[i]) for i in values}

    def _compare_fixes(self) -> None:
        """Find how late fixes are, once it is known that the velocities they are compared with are used in time."""
        course = self.by_sensor.get(self._course)
        if course is None or self._position < 0:
            return
        used = self.late[self._course].seconds if self._course in self.late else 0.0
        later = self._fixes.lag() if abs(course.seconds - used) < LATENCY.agreeing else None
        if later is not None:
            self.by_sensor[self._position] = Late(used + later[0], later[1])

    def _in_time(self, lags: Mapping[int, float]) -> int:
        """The place of the sensor that most others agree with: of equally many the inertial one, as it is the one that
        all others are compared with."""

        def agreeing(place: int) -> tuple[int, bool]:
            near = sum(abs(lag - lags[place]) < LATENCY.agreeing for lag in lags.values())
            return near, place == self._inertial

        return max(lags, key=agreeing)

    def _pairs(self, now: int) -> dict[tuple[int, int], Late]:
        """By how much the first of two sensors is later than the other, where the drive shows it."""
        since = (now - self._begun) * 1e-9 - LATENCY.silence
        there = [i for i, motion in self._motions.items() if len(motion.rows) > 2 and motion.rows[-1, 0] > since]
        end = min(((self._motions[i].rows[-1, 0]) for i in there), default=0.0)
        begin = max(end - LATENCY.window, 0.0)
        times = np.arange(begin, end + LATENCY.longest, LATENCY.step)
        agreed = {}
        if end - begin < LATENCY.least_compared:
            return {}
        rates: dict[tuple[int, float], list[Array | None]] = {}
        speed = self._usual_speed(times)
        for one, other in combinations(there, 2):
            slower = max(self._motions[i].period for i in (one, other))
            span = 2 * slower if slower > LATENCY.span / 2 else LATENCY.span
            for i in (one, other):
                if (i, span) not in rates:
                    rates[i, span] = _that_show_lags(self._motions[i].rates(times, span))
            lags = []
            for motion, (earlier, later) in enumerate(zip(rates[one, span], rates[other, span], strict=True)):
                if earlier is None or later is None or (motion == 0 and self._inertial not in (one, other)):
                    continue  # course, wheels and steering go by the gyro: their errors are in its comparisons already
                late = _lag(earlier, later, span)
                if late is not None:
                    more = self._unmodelled((one, other), motion, speed)
                    lags.append(Late(late.seconds, hypot(late.deviation, more)))
            if lags:
                agreed[one, other] = _agreed(lags)
        return agreed

    def _usual_speed(self, times: Array) -> float:
        """Mean speed of the car at times [m/s], of what is fast enough to be compared."""
        speed = self._speed_at(times)
        fast = speed[speed > LATENCY.slowest]
        return float(fast.mean()) if len(fast) else LATENCY.slowest

    def _unmodelled(self, pair: tuple[int, int], motion: int, speed: float) -> float:
        """Deviation of a lag by what the formulae leave out [s], of two sensors by their turn or gain of speed, at a
        speed [m/s]."""
        s = LATENCY
        if motion == 1:
            return s.acceleration_error + s.pitch_error * (self._inertial in pair)
        more = s.wheel_error * (self._wheels in pair) + s.steering_error * (self._steering in pair)
        if self._course in pair:
            more += s.course_error + s.antenna_place / speed
        return s.turning_error + more

    def _decide(self) -> bool:
        """Note the lags that are certain in two estimates; True if that changes anything."""
        changed = False
        for i, late in self.by_sensor.items():
            before = self._before.get(i)
            if before is None or abs(before.seconds - late.seconds) > LATENCY.agreeing:
                continue
            least = max(LATENCY.significant * late.deviation, LATENCY.least_used)
            known = self.late.get(i, Late(0.0, 0.0))
            if abs(late.seconds - known.seconds) <= least:
                continue
            changed = True
            self.doubt.changed(i, late.deviation)
            if abs(late.seconds) > least:
                self.late[i] = late
            else:
                del self.late[i]
        return changed


def _table(times: Array, turn: Array, gain: Array | float, later: Array | float = 0.0) -> Array:
    """Rows (n, 4) of a motion."""
    rows = np.empty((len(times), 4))
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = times, turn, gain, later
    return rows


def _unwrapped(angles: Array) -> Array:
    """Angles (n,) [rad] without jumps of a turn."""
    jumps = np.abs(angles[1:] - angles[:-1]) >= np.pi
    return np.unwrap(angles) if jumps.any() else angles


def _middle_of_four(speeds: Array) -> Array:
    """Median of each row (n, 4), NaN where any is NaN."""
    in_order = np.sort(speeds, axis=1)  # NaN comes last
    return np.where(np.isnan(in_order[:, 3]), np.nan, 0.5 * (in_order[:, 1] + in_order[:, 2]))


def _agreed(lags: list[Late]) -> Late:
    """The more certain of the lags by turn and by gain of speed. Where they contradict each other, one of them is none
    of time, as of an antenna that sits elsewhere, and neither is more certain than they are apart."""
    best = min(lags, key=lambda late: late.deviation)
    apart = abs(lags[0].seconds - lags[-1].seconds)
    contradict = apart > hypot(lags[0].deviation, lags[-1].deviation)
    return Late(best.seconds, apart) if contradict else best


def _that_show_lags(rates: Array) -> list[Array | None]:
    """Those of the rates of turn and of gain of speed (2, n) that change enough to show a lag."""
    signals: list[Array | None] = []
    for signal, least in zip(rates, (LATENCY.least_turning, LATENCY.least_acceleration), strict=True):
        there = signal[np.isfinite(signal)]
        enough = len(there) * LATENCY.step > LATENCY.least_compared and there.std() > least
        signals.append(signal if enough else None)
    return signals


def _lag(one: Array, other: Array, span: float) -> Late | None:
    """By how much the first of two signals (n,) on the grid is the later one; None where that is not clear."""
    s = LATENCY
    longest = round(s.longest / s.step)
    curve = lag_curve(one, other, longest, s.least_compared / s.step)
    correlation = curve.correlation
    correlation[np.isnan(correlation)] = -1.0
    at = int(np.argmax(correlation))
    best = correlation.item(at)
    lags = curve.shifts * s.step
    elsewhere = float(np.max(correlation[np.abs(lags - lags[at]) > s.apart], initial=-1.0))
    clear = 1 - max(elsewhere, 0.0) ** 2 > s.clear * (1 - best**2)
    if best < s.least_correlation or not clear or not 0 < at < len(lags) - 1:
        return None
    bend = -(correlation[at - 1] - 2 * best + correlation[at + 1]) / s.step**2
    if not bend > 0:
        return None
    count = curve.count.item(at) * s.step / max(s.independent, span)
    variance = (max(1 - best**2, 1e-6) / count + s.form**2) / (best * bend)
    return Late((refined(correlation, at) - longest) * s.step, sqrt(variance))
