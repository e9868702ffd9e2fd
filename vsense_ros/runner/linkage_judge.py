"""What a steering linkage does at large angles, of which a vehicle file knows one ratio.

Rack, rods and joints turn wheels in proportion to the angle that is measured as long as that is small. Sine, angle and
tangent, which a linkage may follow, differ by δ³/6 and more (compare Reimpell, Stoll & Betzler 2001, "The Automotive
Chassis", section 4.7): nothing at all on a road, and two degrees at the stop. There, at low speed, tyres turn a car as
it is steered, whatever a gyro says. So the error of the steering angle has that standard deviation, and its variance
grows by what the square of it changes: outwards to that of the angle, and back to where the offset was known.
"""

from __future__ import annotations

from dataclasses import dataclass

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter, Widening
from vsense_ros.runner.judge import Judge, widening_event


@dataclass(frozen=True)
class LinkageSettings:
    """What is not known of a linkage: decisions of this project."""

    bend: float = 1 / 6  # [1/rad²] error of the road-wheel angle over the cube of it
    least: float = 5e-6  # [rad²] of a change of variance that is worth an event: of angles below 0.24 rad none is


LINKAGE = LinkageSettings()


class LinkageJudge(Judge):
    """Widens the error of the steering as the driver turns the wheels far. `shift` is the channel of events by hand."""

    def __init__(self, adapter: Adapter, shift: int) -> None:
        super().__init__()
        self._adapter, self._shift = adapter, shift
        self.hears = frozenset()
        self.judged = adapter.steering_error is not None and place_of(tuple(adapter.sensors.values()), "steering") >= 0
        self._variance = 0.0  # [rad²] at the angle at which it was widened last

    def forget(self, stamp: int) -> None:
        self._variance = 0.0

    def hear(self, event: Event) -> None:
        """The angle is what the filter is driven by."""

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        """Nothing is compared."""

    def _at(self, angle: float) -> float:
        """Variance of the error at an angle [rad²]."""
        return (LINKAGE.bend * angle**3) ** 2

    def settle(self, timeline: Timeline) -> None:
        error, variance = self._adapter.steering_error, self._at(self._adapter.steering_angle)
        change = abs(variance - self._variance)
        if error is not None and change > LINKAGE.least:
            self._variance = variance
            timeline.add(widening_event(self._shift, timeline.stamp, Widening(error, change)))
