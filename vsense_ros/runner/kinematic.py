"""Filters of GNSS and inertial sensors: the car's motion by its sensors, with few numbers of the car or none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation, largest_nis
from vsense_ros.estimation.timeline import Channel, Event
from vsense_ros.messages.recording import Sample
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.beginning import Beginning
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.motion import Readout, Snapshot
from vsense_ros.navigation.readings import MEASUREMENTS
from vsense_ros.navigation.space import MOTION
from vsense_ros.runner.adapter import Adapter, Move, adapter_of
from vsense_ros.runner.guard import Vitals
from vsense_ros.runner.kinematic_axes import KinematicAxes

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KinematicSettings:
    """What a filter of GNSS and inertial sensors reports and waits for: decisions of this project."""

    moving: float = 1.0  # [m/s] below it an inertial sensor of coarse resolution may well repeat itself
    longest_period: int = 50_000_000  # [ns] between readings of a sensor that holds between them
    sure: float = 3.0  # standard deviations
    # [m] by which an antenna sits elsewhere than in the vehicle file, from which on that is reported
    elsewhere: float = 0.5
    determined: float = 0.87  # share of a standard deviation at start, above which the drive has not determined a state


SETTINGS = KinematicSettings()


class KinematicAdapter(Adapter):
    """A filter of GNSS and inertial sensors, whose inputs are readings."""

    filter: Aided

    def __init__(self, filter: Aided, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        self.sensors = {name: sensors[name] for name in filter.sensors}
        self._axes = KinematicAxes(filter, self.sensors)
        super().__init__(filter, vehicle, self._axes)
        self.merge = vehicle.observer.merge_window
        self._list = tuple(self.sensors.values())
        self._names = tuple(self.sensors)
        self._holds = [_only_drives(sensor, filter) for sensor in self._list]
        self._last: dict[int, int] = {}  # stamps of the newest inertial readings [ns]
        self._beginning = Beginning(filter, car_numbers(vehicle, self._list), self.sensors)
        self._known: Mapping[str, float] = {}
        self._speed = 0.0  # newest over ground [m/s]
        if "yaw" in filter.names and not any("heading" in one.measures for one in self._list):
            self.heading_element = filter.names.index("yaw")
        self.has_position = filter.measures("gnss_position") and {"east", "north"} <= set(filter.names)
        self.readout = Readout(filter)

    def uses(self, sensor: str) -> bool:
        return self.filter.uses(sensor)

    def channels(self) -> list[Channel]:
        return [Channel(k, largest_nis(one.gate, len(one.deviations()))) for k, one in self.sensors.items()]

    def timed(self, event: Event) -> Event:
        """The reading of a sensor that only drives the filter, half a period earlier, so that the value which is held
        from then on is the mean."""
        if self._holds[event.sensor]:
            period = event.stamp - self._last.get(event.sensor, event.stamp)
            self._last[event.sensor] = event.stamp
            if 0 < period < SETTINGS.longest_period:
                event.stamp -= period // 2
        return event

    @property
    def moving(self) -> bool:
        return self._speed > SETTINGS.moving

    # Start

    def gather(self, event: Event) -> int | None:
        begun = self._beginning.add(self._names[event.sensor], event.stamp, self._axes.in_axes_of_car(event))
        if begun is None:
            return None
        stamp, self._known = begun
        return stamp

    def start(self, stamp: int) -> None:
        filter = self.filter
        filter.inputs[:] = 0.0
        for key, (_, value) in self._beginning.readings.items():
            filter.give_reading(key, value)
        filter.restart_clock()
        filter.start(filter.definition.start(self._known))
        self._speed = self._known.get("forward_velocity", 0.0)

    def stop(self, valid: bool) -> None:
        self._beginning.clear()

    def waiting(self) -> str:
        missing = self._beginning.missing()
        if missing:
            return f"waiting for a sensor that measures {', '.join(missing)}"
        return "heading unknown until the car moves"

    # Readings

    def measured(self, event: Event) -> None:
        if "course" in self._list[event.sensor].measures:
            self._speed = float(np.nan_to_num(np.hypot(*event.value)))

    def correct(self, channel: Channel, event: Event) -> Innovation:
        return self.filter.correct(channel.name, self._axes.in_axes_of_car(event), event.variance, channel.limit)

    def pull(self, channel: Channel, event: Event, nis: float) -> None:
        value = self._axes.in_axes_of_car(event)
        self.filter.correct(channel.name, value, event.variance, 2 * channel.limit, nis / channel.limit)

    # Resets

    def difference(self, event: Event, innovation: Innovation) -> tuple[Array, Array] | None:
        if not self.filter.compares_on_map(self._names[event.sensor]):
            return None
        factor = innovation.factor
        return factor @ innovation.whitened, np.sqrt(np.sum(factor**2, axis=1))

    def moves(self, sensor: SensorBase, difference: Array, deviation: Array) -> list[Move]:
        names, mean = self.filter.names, self.filter.belief().mean
        spread = float(deviation.max())
        wanted = ("east", "north") if "position" in sensor.measures else ("velocity_east", "velocity_north")
        if "course" in sensor.measures and {"forward_velocity", "lateral_velocity", "yaw"} <= set(names):
            wanted, yaw = ("forward_velocity", "lateral_velocity"), mean[names.index("yaw")]
            difference = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) @ difference
        if not set(wanted) <= set(names):
            return []
        return [Move(names.index(name), by, spread) for name, by in zip(wanted, difference.tolist(), strict=True)]

    def move(self, move: Move) -> None:
        self.filter.move(*move)

    # Results

    def converged(self, seconds: float) -> bool:
        return not _undetermined(self.filter)

    def condition(self, converged: bool) -> str:
        return "converged" if converged else f"not determined so far: {', '.join(_undetermined(self.filter))}"

    def snapshot(self, stamp: int) -> Snapshot:
        return self.readout.snapshot(stamp)

    def vitals(self, snapshot: Snapshot) -> Vitals:
        motions = self.readout.motions([snapshot])
        value, reported = motions.value[0], set(motions.estimated)
        tilts = [abs(value.item(MOTION.index(name))) for name in ("roll", "pitch") if name in reported]
        deviation = motions.twist_covariance[0, 0, 0] ** 0.5 if "forward_velocity" in reported else np.nan
        return Vitals(max(tilts, default=np.nan), np.nan, self._speed, float(deviation), np.nan, (value,))

    def messages(self, snapshot: Snapshot) -> list[Sample]:
        return self.readout.motions([snapshot]).samples()

    def columns(self, snapshots: Sequence[Snapshot]) -> list[Sample]:
        samples = self.readout.motions(snapshots).samples()
        if len(snapshots) > 1:
            return samples
        return [replace(sample, values={k: v[None] for k, v in sample.values.items()}) for sample in samples]

    def parameters(self, snapshot: Snapshot) -> dict[str, tuple[float, float]]:
        motions = self.readout.motions([snapshot])
        values = zip(motions.parameters[0].tolist(), motions.deviations[0].tolist(), strict=True)
        return dict(zip(motions.parameter_names, values, strict=True))

    @property
    def doubts(self) -> list[str]:
        """Where the antenna sits, if it is surely not where the vehicle file says."""
        names, belief = self.filter.names, self.filter.belief()
        if "antenna_ahead" in names:
            place = names.index("antenna_ahead")
            ahead, deviation = float(belief.mean[place]), float(belief.covariance[place, place]) ** 0.5
            if abs(ahead) > max(SETTINGS.elsewhere, SETTINGS.sure * deviation):
                where = "ahead of" if ahead > 0 else "behind"
                return [f"GNSS antenna {abs(ahead):.1f} ± {deviation:.1f} m {where} where the vehicle file says"]
        return []

    @property
    def details(self) -> Mapping[str, str]:
        return {"filter": self.name}


def _undetermined(filter: Aided) -> list[str]:
    """States of which the drive has determined less than half of what was unknown at start."""
    now = np.sqrt(filter.belief().covariance.diagonal().clip(min=0))
    prior, names = filter.definition.deviations, filter.definition.errors
    return [
        name for name, was, is_ in zip(names, prior, now, strict=True) if was > 0 and is_ > SETTINGS.determined * was
    ]


def _only_drives(sensor: SensorBase, filter: Aided) -> bool:
    """True for an inertial sensor whose readings are inputs, and measure nothing."""
    if "rates and forces" not in sensor.measures or not filter.needs(sensor):
        return False
    names = (one.name for one in filter.definition.measurements)
    return not any(name in MEASUREMENTS and MEASUREMENTS[name].measures in sensor.measures for name in names)


adapter_of.register(Aided, KinematicAdapter)
