"""Are the tyres' forces those of the vehicle file? Asked of the lateral force that the filter finds missing.

A mass, a steering ratio or tyres that are another car's make the force that the model lacks larger than the vehicle
file states (`observer.force_errors`), within seconds of cornering. Its mean square over its variance is one if they are
true (covariance matching, Mehra 1972). Where it is clearly more, the slip angles that follow from these tyres are wrong
by about what that force is worth, and the covariances that are published are widened by it; the filter itself stays as
it is: an error that lasts is no noise. Meanwhile no gyro is left out because of what the model alone says. An axis that
is wrong makes such a force, too: once one is left out, what was found in the seconds before is forgotten.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import exp, sqrt

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.runner.adapter import Adapter, Apart
from vsense_ros.runner.car_fit import axle_slips
from vsense_ros.runner.judge import Judge
from vsense_ros.runner.steering_judge import axis_of_yaw_rate


@dataclass(frozen=True)
class ForceSettings:
    """Times and limits: decisions of this project. Cars of the committed bags and recordings, with their own files,
    have 0.3 to 1.9 deviations, and 3 where tyres slide or a road leans more than the file says."""

    averaged: float = 1.0  # [s] over which the square of the missing force is averaged
    remembered: float = 60.0  # [s] in which a large one is forgotten, as is a heading that it has turned
    unusual: float = 2.0  # [-] root mean square, in deviations by the file, from which on it is not the file's
    drawn: float = 0.05  # [-] of what it turns the car by, that a gyro's bias may take up of it
    said: float = 1.0  # [m/s²] of it, from which on that is said, too
    slowest: float = 4.0  # [m/s] below which slip angles say little
    longest: float = 0.5  # [s] from one look to the next, beyond which nothing is averaged
    undone: int = 2_000_000_000  # [ns] before an axis is left out, in which it may have made the force: as of a vote


FORCES = ForceSettings()


class ForceJudge(Judge):
    """Watches the lateral force that the filter of one car finds missing, and leaves nobody out. `gyro_out()` says
    whether the yaw rate follows from the model, because a gyro is left out."""

    def __init__(self, adapter: Adapter, gyro_out: Callable[[], bool]) -> None:
        super().__init__()
        self._adapter, self._gyro_out = adapter, gyro_out
        self.hears: frozenset[int] = frozenset()
        self._yaw_rate = axis_of_yaw_rate(tuple(adapter.sensors.values()))
        self.judged = adapter.lateral_force_error > 0
        if self.judged:
            accelerations, _, rear = axle_slips(adapter.vehicle)
            self._slip = float(rear[1] / accelerations[1])  # [rad s²/m] of the rear axle
        self.forget(0)

    def forget(self, stamp: int) -> None:
        self._last = stamp
        self._square = self._largest = 0.0  # [m²/s⁴] mean square now, and the largest that is not forgotten
        self._before: deque[tuple[int, float, float]] = deque([(stamp, 0.0, 0.0)])  # these, with their times [ns]
        self._was_out = False

    @property
    def missing(self) -> float:
        """Lateral force that the model lacks beyond what is usual, over the mass [m/s²]; 0 for none."""
        return self._unusual(sqrt(self._largest))

    def _unusual(self, force: float) -> float:
        """A force over the mass [m/s²] where it is more than the vehicle file states; else 0."""
        return force if force > FORCES.unusual * self._adapter.lateral_force_error else 0.0

    @property
    def apart(self) -> Apart | None:
        # The mean is behind a force that grows, as where a gyro drifts away.
        missing = max(self.missing, self._unusual(abs(self._adapter.missing_lateral_force)))
        if not missing:
            return None
        speed = max(abs(self._adapter.forward_speed), FORCES.slowest)
        turned = missing / speed * (1.0 if self._gyro_out() else FORCES.drawn)
        return Apart(across=missing * self._slip * speed, yaw_rate=turned)

    @property
    def spares(self) -> frozenset[tuple[int, int]]:
        return self._yaw_rate if self.missing else frozenset()

    @property
    def doubts(self) -> list[str]:
        missing = self.missing
        if missing < FORCES.said:
            return []
        return [f"lateral tyre forces are not those of the vehicle file, by {missing:.1f} m/s² times the mass"]

    def hear(self, event: Event) -> None:
        """Nothing is heard."""

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        """Nothing is felt."""

    def settle(self, timeline: Timeline) -> None:
        h, self._last = (timeline.stamp - self._last) * 1e-9, timeline.stamp
        adapter = self._adapter
        if not 0 < h < FORCES.longest or not adapter.heading_known:
            return
        out = self._gyro_out()
        if out and not self._was_out:
            self._square, self._largest = self._before[0][1:]
        self._was_out = out
        if abs(adapter.forward_speed) > FORCES.slowest:
            self._square += (1 - exp(-h / FORCES.averaged)) * (adapter.missing_lateral_force**2 - self._square)
        self._largest = max(self._largest * exp(-2 * h / FORCES.remembered), self._square)
        self._before.append((timeline.stamp, self._square, self._largest))
        while len(self._before) > 1 and self._before[1][0] <= timeline.stamp - FORCES.undone:
            self._before.popleft()
