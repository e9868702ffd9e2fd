"""Is it the car of the vehicle file? Watched over minutes, and said with numbers where it surely is not; a steering
ratio that is grossly another one within seconds of driving, from which on the steering angle has the noise of that.

An antenna that sits elsewhere shows in the first bend that is driven slowly, as its course turns by r x / V. Once that
is certain the filter takes it to be there. The place, the lateral velocity and the heading have the standard deviation
of it throughout: by the file, while no bend has shown it, and then what is left.
"""

from __future__ import annotations

from collections.abc import Callable
from math import exp, nan

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter, Apart, Widening
from vsense_ros.runner.car_fit import CAR_FIT, CarFit
from vsense_ros.runner.judge import Judge, widening_event
from vsense_ros.runner.lag_doubt import DOUBT
from vsense_ros.runner.latency_judge import LatencyJudge
from vsense_ros.runner.vote_settings import STEERING

_STEERED_FOR = 0.5  # [s] for which drivers hold an angle, before its error is another one


class FitJudge(Judge):
    """Compares the car with its vehicle file by gyro, course and steering, while `are_believed()` says that no sensor
    has been left out for long; `latency` knows whose stamps are late. It leaves nobody out. `shift` is the channel of
    events by hand."""

    def __init__(self, adapter: Adapter, are_believed: Callable[[], bool], latency: LatencyJudge, shift: int) -> None:
        super().__init__()
        self._adapter, self.are_believed, self._latency, self._shift = adapter, are_believed, latency, shift
        self._stamps_of = 0  # `changes` of the stamps that courses were compared with
        self._further = 0.0, 0.0  # [m] that the antenna is taken to sit further ahead, and its standard deviation
        self._doubted: tuple[float, float] | None = None  # `CarFit.further` of which `_place` follows
        self._place = 0.0  # [m] standard deviation of the antenna's place
        self._rate = 0.0  # [rad/s] of the last block
        self._bend = 0.0  # [1/m] curvature of the bends of late, for as long as the filter corrects a heading
        self._widened = 0  # when the steering's error was last given time to change [ns]
        sensors = tuple(adapter.sensors.values())
        self._steering, self._course = (place_of(sensors, what) for what in ("steering", "course"))
        self.hears = frozenset((self._course,))
        self._asked, self._believed = 0, False  # when [ns] that was asked last, and the answer
        self.judged = adapter.knows_car and self._course >= 0 and place_of(sensors, "rates and forces") >= 0
        if self.judged:
            antenna = float(sensors[self._course].mounting()[0])
            self._fit = CarFit(adapter.vehicle, adapter.vehicle.physics.chassis.cog_to_rear_axle + antenna)

    @property
    def doubts(self) -> list[str]:
        differing = "; ".join(one.sentence() for one in self._fit.differing)
        said = [f"does not drive as the vehicle file says: {differing}"] if differing else []
        ahead, deviation = self._further
        if ahead:
            where = "ahead of" if ahead > 0 else "behind"
            sits = f"GNSS antenna is taken to sit {abs(ahead):.1f} ± {deviation:.1f} m {where}"
            said.append(f"{sits} where the vehicle file says")
        return said

    @property
    def apart(self) -> Apart | None:
        if self._doubted != self._fit.further:
            self._doubted = self._fit.further
            self._place = self._fit.place_deviation(self._adapter.vehicle.observer.unseen.antenna)
        deviation = self._further[1] or self._place
        along = deviation if self._adapter.has_position else 0.0
        return Apart(across=DOUBT.sideways * abs(self._rate) * deviation, along=along) if deviation else None

    def forget(self, stamp: int) -> None:
        self._fit.forget()

    def hear(self, event: Event) -> None:
        self._fit.travel(event.stamp, *event.value.tolist()[:2])

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        self._rate, speed = felt[2], abs(self._adapter.forward_speed)
        bend = abs(felt[2]) / max(speed, CAR_FIT.slowest)
        self._bend = max(bend, self._bend * exp(-h / DOUBT.corrected))
        if not 0 <= stamp - self._asked < CAR_FIT.asked:
            self._asked, self._believed = stamp, self.are_believed()
        if self._believed:
            angle = self._adapter.steering_angle if self._steering >= 0 else nan
            self._fit.feel(stamp, h, felt[2], felt[4], self._adapter.forward_speed, angle)
        else:
            self._fit.forget()

    def _place_antenna(self, timeline: Timeline) -> None:
        """Take the antenna to sit where the courses say, if that is certain, and none of their stamps may be late."""
        if self._latency.changes != self._stamps_of:
            self._stamps_of = self._latency.changes
            self._fit.forget_places()
        ahead, deviation = self._fit.further
        sure = abs(ahead) > max(CAR_FIT.place_sure * deviation, CAR_FIT.place_far)
        if (ahead, deviation) == self._further or not sure or self._latency.seems_late:
            return
        self._further = ahead, deviation
        for change in self._adapter.place_antennas(ahead, self._bend):
            timeline.add(widening_event(self._shift, timeline.stamp, change))

    def settle(self, timeline: Timeline) -> None:
        self._place_antenna(timeline)
        gross, error, now = self._fit.gross_ratio, self._adapter.steering_error, timeline.stamp
        if gross is None or error is None:
            self._widened = now
        elif now - self._widened >= STEERING.period:
            spread = (gross.value - gross.file) * self._fit.largest_angle
            density = min(2 * spread**2 / _STEERED_FOR, STEERING.density)
            change = Widening(error, density * min(now - self._widened, STEERING.undecided) * 1e-9)
            timeline.add(widening_event(self._shift, now, change))
            self._widened = now
