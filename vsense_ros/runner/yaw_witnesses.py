"""Direct witnesses of the yaw rate: who is wrong where the steering angle and the gyro contradict each other.

The filter predicts the gyro from the steering angle, so that a wrong angle looks like a wrong gyro to it. Without the
filter the yaw rate r is measured several times over, each time by an equation of its own (van Zanten 2000, "Bosch ESP
systems: 5 years of experience", SAE 2000-01-1633):

    gyro          r
    wheels        r = (v_rr - v_rl) / b                            of the rear axle with track b
    acceleration  r = a_y / v
    course        ∫ r dt = course over ground at the end - at the start
    steering      v̇_y = (F_f + F_r) / m - v r,   ṙ = (a F_f - b F_r) / J,   F = -C α   (Riekert & Schunck 1940)

Each is known within a margin. The yaw rate of the steering is an interval: tyres that slide follow it less, so that
where accelerations are large, the interval reaches to zero. What the gyro is outside of that interval adds up to an
angle (Page 1954, a cumulative sum); once it is large, and more of the other witnesses stand with the gyro than with the
steering, the steering is wrong.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from math import atan2, exp, hypot, isfinite, nan, pi, remainder

import numpy as np

from vsense_ros.estimation.timeline import Event
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.sensors import SensorBase, place_of
from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True)
class YawWitnessSettings:
    """Margins and times of the direct witnesses; they were chosen such that no healthy recording of ours has a
    contradiction, and are decisions of this project."""

    smoothing: float = 0.05  # [s] time constant of all witnesses, which arrive at different times
    settling: float = 10.0  # [s] in which a car comes to a steady turn
    slowest: float = 3.0  # [m/s] below which nothing is judged
    # Margins: a part of its own, and a share of the larger of the two yaw rates that are compared.
    share: float = 0.25  # [-]
    gyro: float = 0.02  # [rad/s] bias of a gyro
    steering: float = 0.03  # [rad/s] lag of the steering, road
    offsets: float = 2.0  # [-] standard deviations of the steering offset
    wheels: float = 0.03  # [rad/s] noise
    radii: float = 0.005  # [-] by which two radii of an axle differ
    acceleration: float = 0.8  # [m/s²] bank, roll, lateral velocity that changes
    course: float = 0.02  # [rad] noise, side slip that changes, and
    course_rate: float = 0.02  # [rad/s] bias of the gyro meanwhile
    course_time: float = 0.5  # [s] over which the course is compared
    course_apart: float = 0.019  # [s] between two courses that are kept
    confirming: float = 0.1  # [-] of the turn, by which the course may differ from a gyro that it confirms
    confirmed_for: float = 0.06  # [s] after a course
    # Tyres slide.
    linear: float = 4.0  # [m/s²] lateral acceleration up to which they do not
    remembered: float = 1.0  # [s] time constant with which the largest lateral acceleration is forgotten
    # A jump of the steering angle, which no driver can bring about: faster than this, by more than that.
    fastest: float = 2.0  # [rad/s] of the road wheels; drivers come to 1.2
    jump: float = 0.01  # [rad]
    # The cumulative sum.
    suspicious: float = 0.005  # [rad] from which on no inertial axis is left out before this is decided
    wrong: float = 0.015  # [rad] from which on the steering is wrong
    forgotten: float = 0.01  # [rad/s] by which the sum falls where there is no contradiction
    most: float = 0.05  # [rad] that it grows to at most
    agreed: float = 1.0  # [s] of agreement after which the steering is believed again; twice as long each time, up
    longest: float = 60.0  # [s] to this


WITNESSES = YawWitnessSettings()
_LEAST_BASE = 0.2  # [-] of the wheelbase, that is left of it and of an understeer that is none
_CRAWLING = 0.1  # [m/s] for a division by the speed, far below the slowest that is judged


class YawWitnesses:
    """The direct witnesses of one car's yaw rate; `hear` takes messages in order of arrival, of wheels the newest of a
    block, and `feel` what inertial sensors felt in it. `hears` are the places of the others.

    `since` is the stamp [ns] since when the gyro has contradicted the steering, `contradiction` by how much they have
    turned apart meanwhile beyond their margins, `apart_by` by how much the yaw rates of both differ; `wrong` is true
    once the steering is.
    """

    def __init__(self, vehicle: Vehicle, sensors: Mapping[str, SensorBase]) -> None:
        self._sensors = tuple(sensors.values())
        self.steering = place_of(self._sensors, "steering")
        self._wheels = place_of(self._sensors, "rolling speed")
        self._course = place_of(self._sensors, "course")
        self.hears = frozenset((self.steering, self._course))
        self._is_felt = place_of(self._sensors, "rates and forces") >= 0
        numbers = car_numbers(vehicle)
        self._offset_limit = WITNESSES.offsets * vehicle.observer.surroundings.steering_offset
        self._track, self._radius = 2 * numbers["rear_half_track"], numbers["rear_radius"]
        self._a, self._b = numbers["to_front"], numbers["to_rear"]
        self._front, self._rear = numbers["front_stiffness"], numbers["rear_stiffness"]
        self._mass, self._inertia = numbers["mass"], numbers["yaw_inertia"]
        self.forget()

    @property
    def possible(self) -> bool:
        """True if there is a steering angle, and a gyro that could contradict it."""
        return self._is_felt and self.steering >= 0

    def lateral_acceleration(self, speed: float) -> float:
        """Lateral acceleration per angle of the road wheels in steady cornering at a speed [m/s², per rad]."""
        base = self._a + self._b
        understeer = self._mass * (self._b / self._front - self._a / self._rear) / base
        return speed**2 / max(base + understeer * speed**2, _LEAST_BASE * base)

    def forget(self) -> None:
        """The filter begins anew."""
        self._spins = np.full(4, nan)  # of the wheels [rad/s]
        self._angle = self._gyro = self._lateral = self._turned = nan
        self._slip = self._rate = self._steered = nan  # lateral velocity and yaw rate of the single-track model
        self._largest = 0.0
        self._seen: deque[tuple[int, float, float, float, float]] = deque(maxlen=64)
        self._ways = [0.0, 0.0, 0.0]  # integrals of the yaw rates of gyro and steering, least and largest [rad]
        self._by_course = 0
        self._confirmed = self._felt = 0  # [ns]
        self.contradiction = self.apart_by = 0.0  # [rad], [rad/s]
        self.since = 0
        self.agreed = 0.0  # [s] for which steering and gyro have agreed while the car turned or went straight
        self._support = 0
        self._jumped = self._angle_at = 0  # [ns]

    @property
    def suspects_steering(self) -> bool:
        """True while the steering may be what contradicts the gyro: then the gyro is not left out."""
        return self.contradiction > WITNESSES.suspicious and self._support >= 0

    @property
    def wrong(self) -> bool:
        """True if the steering is wrong."""
        return self.contradiction > WITNESSES.wrong and self._support > 0

    @property
    def gyro_confirmed(self) -> int:
        """The stamp [ns] of the newest course that turns as the gyro says, and by so much that this is no chance; 0 if
        that is not so any more."""
        recent = abs(self._felt - self._confirmed) < WITNESSES.confirmed_for * 1e9
        return self._confirmed if recent else 0

    def hear(self, event: Event) -> None:
        """Take in a message of steering, wheels or course."""
        index = event.sensor
        if index == self.steering:
            self._steer(event.value.item(0), event.stamp)
        elif index == self._wheels:
            self._spins = event.value
        elif index == self._course:
            self._travel(event)

    def _steer(self, angle: float, stamp: int) -> None:
        """Take in a steering angle [rad], and note where it jumps."""
        if angle != angle:
            return
        passed = (stamp - self._angle_at) * 1e-9
        if abs(angle - self._angle) > WITNESSES.jump + WITNESSES.fastest * max(passed, 0.0):
            self._jumped = stamp
        self._angle, self._angle_at = angle, stamp

    def feel(self, stamp: int, h: float, felt: list[float], speed: float, offset: float) -> None:
        """Compare all witnesses after a block of `h` [s] up to a time [ns]: the mean of the inertial sensor (6) in the
        axes of the car, and the speed [m/s] and the steering offset [rad] of the filter."""
        _, _, gyro, _, lateral, _ = felt
        self._felt = stamp
        speed = max(speed, _CRAWLING)
        s = WITNESSES
        limit = self._offset_limit
        self._single_track(h, speed, self._angle - min(max(offset, -limit), limit))
        weight = 1.0 - exp(-h / s.smoothing)
        self._gyro = _smoothed(self._gyro, gyro, weight)
        self._lateral = _smoothed(self._lateral, lateral / speed, weight)
        rolled = self._radius * (self._spins.item(3) - self._spins.item(2)) / self._track
        self._turned = _smoothed(self._turned, rolled, weight)
        self._steered = _smoothed(self._steered, self._rate, weight)
        self._largest *= exp(-h / s.remembered)
        self._largest = max(self._largest, abs(lateral), abs(gyro) * speed, 0.0)
        gyro, steered = self._gyro, self._steered
        if not isfinite(gyro + steered) or speed < s.slowest:
            self.contradiction, self._support, self.since = 0.0, 0, 0
            self.agreed = 0.0
            return
        by_offset = limit * speed / (self._a + self._b)
        self.apart_by = abs(gyro - steered)
        margin = s.gyro + s.steering + by_offset + s.share * max(abs(gyro), abs(steered))
        least = largest = steered
        if self._largest > s.linear:
            least, largest = min(least, 0.0), max(largest, 0.0)
        for i, rate in enumerate((gyro, least, largest)):
            self._ways[i] += h * rate
        excess = max(gyro - largest, least - gyro) - margin
        if excess > 0:
            if not self.contradiction:
                self.since = stamp
            self.contradiction = min(self.contradiction + excess * h, s.most)
            self.agreed = 0.0
        else:
            self.contradiction = max(self.contradiction - s.forgotten * h, 0.0)
            self.since = self.since if self.contradiction else 0
            self.agreed += h
        if self.contradiction > s.suspicious:
            shares = s.share * max(abs(gyro), abs(steered))
            wheels = s.wheels + s.radii * speed / self._track + shares
            # The accelerometer is in one case with the gyro: without others it is believed where the steering jumped.
            others = _side(self._turned, gyro, least, largest, wheels) + self._by_course
            of_case = _side(self._lateral, gyro, least, largest, s.acceleration / speed + shares)
            alone = others <= 0 and stamp - self._jumped > s.remembered * 1e9
            self._support = min(others + of_case, 0) if alone else others + of_case

    def _single_track(self, h: float, speed: float, angle: float) -> None:
        """Let the single-track model go on for `h` [s], by the implicit Euler method."""
        v, a, b, front, rear = max(speed, WITNESSES.slowest), self._a, self._b, self._front, self._rear
        m, j = self._mass, self._inertia
        if not isfinite(self._rate):  # no angle so far: begin in a steady turn
            self._slip = self._rate = 0.0
            h = WITNESSES.settling
        # x = M⁻¹ (x₀ + h B δ), M = 1 - h A, x = (lateral velocity, yaw rate)
        m11 = 1.0 + h * (front + rear) / (m * v)
        m12 = h * (v - (b * rear - a * front) / (m * v))
        m21 = -h * (b * rear - a * front) / (j * v)
        m22 = 1.0 + h * (a * a * front + b * b * rear) / (j * v)
        y = self._slip + h * front / m * angle
        z = self._rate + h * a * front / j * angle
        determinant = m11 * m22 - m12 * m21
        self._slip = (m22 * y - m12 * z) / determinant
        self._rate = (m11 * z - m21 * y) / determinant

    def _travel(self, event: Event) -> None:
        """Compare a course over ground with one from some time before."""
        s = WITNESSES
        east, north = event.value.tolist()[:2]
        speed = hypot(east, north)
        if not speed > s.slowest:
            self._seen.clear()
            self._by_course = 0
            return
        seen = self._seen
        if seen and 0 <= event.stamp - seen[-1][0] < s.course_apart * 1e9:
            return
        gyro, least, largest = self._ways
        now = (event.stamp, atan2(north, east), gyro, least, largest)
        while len(seen) > 1 and event.stamp - seen[1][0] >= s.course_time * 1e9:
            seen.popleft()
        if seen and event.stamp - seen[0][0] >= s.course_time * 1e9:
            time = (event.stamp - seen[0][0]) * 1e-9
            turned, gyro, least, largest = (after - before for after, before in zip(now[1:], seen[0][1:], strict=True))
            noise = 3.0 * float(event.variance.max()) ** 0.5 / speed
            turned, own = remainder(turned, 2 * pi), s.course + s.course_rate * time + noise
            margin = own + s.share * max(abs(gyro), abs(least), abs(largest))
            self._by_course = _side(turned, gyro, least, largest, margin)
            confirming = own + s.confirming * abs(gyro)
            self._confirmed = event.stamp if abs(turned - gyro) < confirming < 0.5 * abs(turned) else 0
        seen.append(now)


def _side(witness: float, gyro: float, least: float, largest: float, margin: float) -> int:
    """1 if a witness stands with the gyro against the steering, whose interval goes from `least` to `largest`, -1 if
    with the steering against the gyro, 0 if with both or neither."""
    with_gyro = abs(witness - gyro) <= margin
    with_steering = least - margin <= witness <= largest + margin
    return with_gyro - with_steering


def _smoothed(old: float, new: float, weight: float) -> float:
    """A value that goes on towards another one; at once if it is not known yet."""
    return old + weight * (new - old) if isfinite(old) else new
