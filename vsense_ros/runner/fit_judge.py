"""Is it the car of the vehicle file? Watched over minutes, and said with numbers where it surely is not; a steering
ratio that is grossly another one within seconds of driving, from which on the steering angle has the noise of that."""

from __future__ import annotations

from collections.abc import Callable
from math import nan

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter, Widening
from vsense_ros.runner.car_fit import CAR_FIT, CarFit
from vsense_ros.runner.judge import Judge, widening_event
from vsense_ros.runner.vote_settings import STEERING

_STEERED_FOR = 0.5  # [s] for which drivers hold an angle, before its error is another one


class FitJudge(Judge):
    """Compares the car with its vehicle file by gyro, course and steering, while `are_believed()` says that no sensor
    has been left out for long. It leaves nobody out. `shift` is the channel of events by hand."""

    def __init__(self, adapter: Adapter, are_believed: Callable[[], bool], shift: int) -> None:
        super().__init__()
        self._adapter, self._are_believed, self._shift = adapter, are_believed, shift
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
        return [f"does not drive as the vehicle file says: {differing}"] if differing else []

    def forget(self, stamp: int) -> None:
        self._fit.forget()

    def hear(self, event: Event) -> None:
        self._fit.travel(event.stamp, *event.value.tolist()[:2])

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        if not 0 <= stamp - self._asked < CAR_FIT.asked:
            self._asked, self._believed = stamp, self._are_believed()
        if self._believed:
            angle = self._adapter.steering_angle if self._steering >= 0 else nan
            self._fit.feel(stamp, h, felt[2], felt[4], self._adapter.forward_speed, angle)
        else:
            self._fit.forget()

    def settle(self, timeline: Timeline) -> None:
        gross, error, now = self._fit.gross_ratio, self._adapter.steering_error, timeline.stamp
        if gross is None or error is None:
            self._widened = now
        elif now - self._widened >= STEERING.period:
            spread = (gross.value - gross.file) * self._fit.largest_angle
            density = min(2 * spread**2 / _STEERED_FOR, STEERING.density)
            change = Widening(error, density * min(now - self._widened, STEERING.undecided) * 1e-9)
            timeline.add(widening_event(self._shift, now, change))
            self._widened = now
