"""The heading of a car, and where it is on the map, until the filter knows them; and again when it is astray."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.coordinates import SPIN, YAW, X, Y
from vsense_ros.model.sensors import MeasuredQuantity, SensorBase
from vsense_ros.model.sensors.wheel_speeds import LOADED
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.standstill import Standstill
from vsense_ros.observer.state import FORWARD, LATERAL, U

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AlignmentSettings:
    """Settings of the heading at the start: decisions of this project."""

    course_speed: float = 2.0  # [m/s] above it the course is the heading
    speed_difference: float = 0.2  # [-] of a speed by which another may differ from it
    standing: float = 0.2  # [m/s] below it the car stands
    least_deviations: float = 2.0  # standard deviations of a velocity below which it may be none
    held: float = 1e-6  # [rad] deviation of a heading that a velocity of none must not change
    anywhere: float = 100.0  # [m] standard deviation of a position of which nothing is known


ALIGNMENT = AlignmentSettings()


class Alignment:
    """The heading of the filter on a timeline; `known` once it is."""

    def __init__(self, filter: CarFilter, timeline: Timeline, intake: Intake[SensorBase]) -> None:
        self._filter, self._timeline, self._intake = filter, timeline, intake
        self._mean = filter.car.mean
        self._sensors = intake.sensors
        self._standstill = Standstill()
        self.known = False

    def start(self, events: dict[str, Event]) -> None:
        """The filter has just started, with these measurements."""
        self.known = bool(self._filter.car.prior.deviation[YAW] < 1.0)  # where the map is laid by the start
        self._standstill = Standstill()
        for event in self._telling(events, "position"):
            self._stand(event)
        for event in (*self._telling(events, "heading"), *self._telling(events, "course")):
            if not self.known:
                self.align(event)

    def helps(self, event: Event) -> bool:
        """True if a measurement may correct a filter that does not know its heading, or has just determined it."""
        sensor = self._sensors[event.sensor]
        if not sensor.on_map:
            return True
        if "position" not in sensor.measures:
            if self.align(event):
                return True
            self._rest(event)
            return False
        if not self._velocity_comes() and self.align(event):
            return True
        self._stand(event)
        return False

    def astray(self, velocity: Event) -> bool:
        """True if the heading is wrong: the car, or its wheels, are as fast as GNSS says, yet all that is seen on the
        map is refused; a filter with a wrong heading does not keep its speed for long."""
        if "course" not in self._sensors[velocity.sensor].measures:
            return False
        speed = np.hypot(*velocity.value)
        radius = LOADED * self._filter.car.vehicle.physics.rear.unloaded_radius
        rolling = radius * float(np.mean(np.abs(self._mean[U][SPIN])))
        own_speeds = np.array([np.hypot(self._mean[FORWARD], self._mean[LATERAL]), rolling])
        same = np.any(np.abs(own_speeds - speed) < ALIGNMENT.speed_difference * speed)
        health = self._intake.health
        health_on_map = (h for i, h in enumerate(health) if self._sensors[i].on_map and self._intake.sends(i))
        return bool(same and all(h.contradicts for h in health_on_map))

    def align(self, event: Event) -> bool:
        """Take the heading from a measurement, if it has one; True if that has just been done."""
        measured = self._heading(event)
        if measured is None:
            return False
        f, (yaw, deviation) = self._filter, measured
        was, position, spread = self._mean[YAW], self._mean[[X, Y]], ALIGNMENT.anywhere
        if self._standstill.known:
            position, spread = self._standstill.place(position, was, yaw)
        f.set_element(YAW, yaw, deviation)
        for i, value in zip((X, Y), position, strict=True):
            f.set_element(i, value, spread)
        self.known, self._standstill = True, Standstill()
        self._timeline.forget_past()
        return True

    def begin_anew(self, velocity: Event) -> bool:
        """Start the filter at the speed and the course that GNSS measures, if they give a heading: one that was astray
        has found wrong slopes and forces to explain what it saw. True if that has been done."""
        if self._heading(velocity) is None:
            return False
        place, inputs = self._mean[[X, Y]].tolist(), self._filter.inputs.copy()
        self._filter.start_rolling(float(np.hypot(*velocity.value)))
        self._filter.inputs[:] = inputs
        self.align(velocity)
        for i, value in zip((X, Y), place, strict=True):
            self._filter.set_element(i, value, ALIGNMENT.anywhere)
        self._filter.linearize()
        return True

    def _heading(self, event: Event) -> tuple[float, float] | None:
        """Yaw by a measurement [rad] and its standard deviation: two antennas; the course once it means
        something; without velocities the way between positions."""
        mean, sensor = self._mean, self._sensors[event.sensor]
        if "heading" in sensor.measures:
            return sensor.heading(event.value, event.variance)
        if "position" in sensor.measures:
            return self._standstill.heading(mean[[X, Y]], mean[YAW], event.value, event.variance)
        east, north = event.value
        speed = float(np.hypot(east, north))
        if not ALIGNMENT.course_speed < speed < self._filter.car.largest[FORWARD]:
            return None
        forward = mean[FORWARD] if abs(mean[FORWARD]) > 0.1 else 0.1
        yaw = np.arctan2(north, east) - np.arctan2(mean[LATERAL], forward)
        return float(yaw), float(np.hypot(0.05, np.sqrt(event.variance.max()) / speed))

    def _rest(self, event: Event) -> None:
        """Correct the velocity of a car whose wheels tell no speed by one that cannot be distinguished from none.

        It is none in whatever direction the car stands, and determines no heading."""
        car = self._filter.car
        rolling = any("rolling speed" in s.measures and self._intake.sends(i) for i, s in enumerate(self._sensors))
        if rolling or "course" not in self._sensors[event.sensor].measures:
            return
        if not float(np.hypot(*event.value)) < ALIGNMENT.least_deviations * float(np.sqrt(event.variance.max())):
            return
        yaw = self._mean.item(YAW)
        self._filter.set_element(YAW, yaw, ALIGNMENT.held)
        self._filter.correct(car.sensors[event.sensor], event.value, event.variance, np.inf)
        self._filter.set_element(YAW, yaw, car.prior.deviation.item(YAW))

    def _stand(self, event: Event) -> None:
        """Take a position for where the car is, as long as its heading is not known: all while it stands."""
        mean = self._mean
        reading = event.value, event.variance, self._sensors[event.sensor].mounting(), mean[YAW]
        if abs(mean[FORWARD]) < ALIGNMENT.standing:
            if not event.counted:
                self._standstill.add(*reading)
            mean[[X, Y]] = self._standstill.antenna
        elif self._standstill.known:
            self._standstill.leave()
        else:
            np.copyto(mean[X : Y + 1], event.value, where=np.isfinite(event.value))
            if self._timeline.begun and not self._velocity_comes():
                self._standstill.add(*reading)  # the way from here will give the heading
                self._standstill.leave()
                self._timeline.forget_past()

    def _telling(self, events: dict[str, Event], quantity: MeasuredQuantity) -> list[Event]:
        return [event for event in events.values() if quantity in self._sensors[event.sensor].measures]

    def _velocity_comes(self) -> bool:
        return any("course" in s.measures and self._intake.sends(i) for i, s in enumerate(self._sensors))
