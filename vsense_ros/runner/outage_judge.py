"""What a car that does not hear GNSS does not know besides: what its inertial sensor gets wrong adds up.

A filter takes errors of inertial sensors for white noise and slow biases, and what GNSS has shown of these holds only
for a while. Scale, mounting and the squat of a car are in proportion to what it does, and the grade of a road that
nobody measures is felt as acceleration. So from a second and a half without GNSS on, the published covariances of
heading and place grow with the angle turned and the way gone, and where no sensor of the car measures its speed, as
wheels or an optical sensor do, or none is believed, that of the speed with time.
"""

from __future__ import annotations

from dataclasses import dataclass

from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.sensors import SensorBase, place_of
from vsense_ros.navigation.car_numbers import GYRO_SCALE_DEVIATION
from vsense_ros.runner.adapter import Adapter, Apart
from vsense_ros.runner.judge import Judge


@dataclass(frozen=True)
class OutageSettings:
    """Standard deviations of inertial sensors in cars: of the scale of a gyro that nobody has calibrated, as in data
    sheets, and of an acceleration that is felt and is none, as 0.6° of pitch and grade make it."""

    begins: float = 1.5  # [s] without GNSS
    scale: float = GYRO_SCALE_DEVIATION  # [-] of a gyro
    acceleration: float = 0.1  # [m/s²] along the car, while no sensor measures the speed


OUTAGE = OutageSettings()


class OutageJudge(Judge):
    """How long one car has gone without GNSS, how far it has turned and driven, and what that leaves unknown."""

    def __init__(self, adapter: Adapter, intake: Intake[SensorBase]) -> None:
        super().__init__()
        self._adapter, self._intake = adapter, intake
        sensors = tuple(adapter.sensors.values())
        self._speeds = [i for i, sensor in enumerate(sensors) if sensor.measures_speed and not sensor.on_map]
        self.hears = frozenset(i for i, sensor in enumerate(sensors) if sensor.on_map)
        self.judged = adapter.knows_car and bool(self.hears) and place_of(sensors, "rates and forces") >= 0
        self.forget(0)

    def forget(self, stamp: int) -> None:
        self._time = self._turned = self._way = 0.0  # [s], [rad], [m] since GNSS was heard
        self._unmeasured = 0.0  # [s] of it without a sensor of the speed

    @property
    def apart(self) -> Apart | None:
        if self._time < OUTAGE.begins:
            return None
        ahead, heading = OUTAGE.acceleration * self._unmeasured, OUTAGE.scale * abs(self._turned)
        return Apart(ahead, place=ahead * self._unmeasured / 2 + heading * self._way / 2, heading=heading)

    def hear(self, event: Event) -> None:
        if event.value[0] == event.value[0]:
            self.forget(event.stamp)

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        self._time += h
        self._turned += h * felt[2] if felt[2] == felt[2] else 0.0
        self._way += h * abs(self._adapter.forward_speed)
        if self._time > OUTAGE.begins and not any(map(self._measures, self._speeds)):
            self._unmeasured += h

    def _measures(self, index: int) -> bool:
        """True if a sensor of the speed sends and is believed."""
        return self._intake.sends(index) and not self._intake.health[index].refused_in_a_row

    def settle(self, timeline: Timeline) -> None:
        """Nothing follows."""
