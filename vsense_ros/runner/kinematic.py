"""Filters of GNSS and inertial sensors: the car's motion by its sensors, with few numbers of the car or none."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import isfinite

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
from vsense_ros.runner.adapter import Adapter, Judged, Move, adapter_of
from vsense_ros.runner.guard import Vitals

Array = NDArray[np.float64]

_MOVING = 1.0  # [m/s] below it an inertial sensor of coarse resolution may well repeat itself
_LONGEST_PERIOD = 50_000_000  # [ns] between readings of a sensor that holds between them
_SURE = 3.0  # standard deviations
_ELSEWHERE = 0.5  # [m] by which an antenna sits elsewhere than in the vehicle file, from which on that is reported
_DETERMINED = 0.87  # share of a standard deviation at start, above which the drive has not determined a state


class KinematicAdapter(Adapter):
    """A filter of GNSS and inertial sensors, whose inputs are readings."""

    filter: Aided

    def __init__(self, filter: Aided, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        super().__init__(vehicle)
        self.merge = vehicle.observer.merge_window
        self.filter, self.sensors = filter, {name: sensors[name] for name in filter.sensors}
        self._list = tuple(self.sensors.values())
        self._names = tuple(self.sensors)
        self._placed = [_placed(sensor) for sensor in self._list]
        self._holds = [_only_drives(sensor, filter) for sensor in self._list]
        self._last: dict[int, int] = {}  # stamps of the newest inertial readings [ns]
        self._beginning = Beginning(filter, car_numbers(vehicle, self._list), self.sensors)
        self._known: Mapping[str, float] = {}
        self._speed = 0.0  # newest over ground [m/s]
        self._of_car, self._of_sensor, self._order = self._axes_of_car()
        self.has_position = filter.measures("gnss_position") and {"east", "north"} <= set(filter.names)
        self.readout = Readout(filter)

    @property
    def name(self) -> str:
        return self.filter.name

    def _axes_of_car(self) -> tuple[list[int], list[int], Array | None]:
        """For each axis of the inertial sensor the nearest one of the car, the reverse of that, and the order in which
        components of an innovation by axes of the car are those of the sensor; None where nothing changes."""
        same = list(range(6))
        if self.filter.inertial is None:
            return same, same, None
        sensor = self.sensors[self.filter.inertial]
        of_car = []
        for axis in range(6):
            probe = np.zeros((1, 6))
            probe[0, axis] = np.nan
            absent = np.flatnonzero(np.isnan(sensor.in_axes_of_car(probe)[0]))
            of_car.append(int(absent[0]) if len(absent) == 1 else axis)
        if of_car == same or sorted(of_car) != same:
            return same, same, None
        order = np.array([*of_car, *range(6, 6 + len(self.filter.conditions))])
        return of_car, [of_car.index(axis) for axis in range(6)], order

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
            if 0 < period < _LONGEST_PERIOD:
                event.stamp -= period // 2
        return event

    @property
    def moving(self) -> bool:
        return self._speed > _MOVING

    # Start

    def gather(self, event: Event) -> int | None:
        begun = self._beginning.add(self._names[event.sensor], event.stamp, self._in_axes_of_car(event))
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
        return self.filter.correct(channel.name, self._in_axes_of_car(event), event.variance, channel.limit)

    def pull(self, channel: Channel, event: Event, nis: float) -> None:
        value = self._in_axes_of_car(event)
        self.filter.correct(channel.name, value, event.variance, 2 * channel.limit, nis / channel.limit)

    def _in_axes_of_car(self, event: Event) -> Array:
        """The reading in the axes of the car, at cog as far as rates alone determine it."""
        sensor, value = self._list[event.sensor], event.value
        if (placed := self._placed[event.sensor]) is not None:
            value = placed(value)
        elif "heading" in sensor.measures and (heading := sensor.heading(value, event.variance)) is not None:
            value = np.array([np.cos(heading[0]), np.sin(heading[0])])
        return value

    # Inertial sensors

    def axes(self) -> dict[int, Judged]:
        key = self.filter.inertial
        judged = tuple(self._of_sensor[axis] for axis in self.filter.judged)
        if key is None or not judged:
            return {}
        words = tuple(one.words for one in self.sensors[key].components)
        conditions = len(self.filter.conditions)
        return {self._names.index(key): Judged(words, judged, conditions, self.sensors[key].gate)}

    def correct_inertial(self, channel: Channel, event: Event, gate: float) -> Innovation:
        return self._in_axes_of_sensor(self.correct(channel, event))

    def correct_by_axis(self, channel: Channel, event: Event, gate: float) -> Iterator[tuple[int, Innovation]]:
        """The axes of the reading that the filter has just used or refused, and the conditions behind them."""
        refused = {self._of_sensor[axis] for axis in self.filter.refused}
        all_of_it = self._newest
        for place, far in enumerate(all_of_it.whitened.tolist()):
            if np.isfinite(far):
                alone = np.full_like(all_of_it.whitened, np.nan)
                alone[place] = far
                yield place, Innovation(alone, all_of_it.factor, far**2, place not in refused)

    def innovation_of_axis(self, channel: Channel, event: Event, axis: int) -> Innovation:
        innovation = self.filter.innovation_of_axis(self._of_car[axis], self._in_axes_of_car(event), event.variance)
        return self._in_axes_of_sensor(innovation)

    def _in_axes_of_sensor(self, innovation: Innovation) -> Innovation:
        """An innovation whose axes are those of the car, with those of the sensor that are nearest to them."""
        if self._order is not None:
            innovation = innovation._replace(
                whitened=innovation.whitened[self._order], factor=innovation.factor[self._order][:, self._order]
            )
        self._newest = innovation
        return innovation

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
        return not self._undetermined()

    def condition(self, converged: bool) -> str:
        return "converged" if converged else f"not determined so far: {', '.join(self._undetermined())}"

    def _undetermined(self) -> list[str]:
        """States of which the drive has determined less than half of what was unknown at start."""
        now = np.sqrt(self.filter.belief().covariance.diagonal().clip(min=0))
        prior, names = self.filter.definition.deviations, self.filter.definition.errors
        return [name for name, was, is_ in zip(names, prior, now, strict=True) if was > 0 and is_ > _DETERMINED * was]

    def snapshot(self, stamp: int) -> Snapshot:
        return self.readout.snapshot(stamp)

    def vitals(self, snapshot: Snapshot) -> Vitals:
        motions = self.readout.motions([snapshot])
        value, reported = motions.value[0], set(motions.estimated)
        tilts = [abs(value.item(MOTION.index(name))) for name in ("roll", "pitch") if name in reported]
        deviation = motions.twist_covariance[0, 0, 0] ** 0.5 if "forward_velocity" in reported else np.nan
        return Vitals(max(tilts, default=np.nan), np.nan, self._speed, float(deviation), value)

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
            if abs(ahead) > max(_ELSEWHERE, _SURE * deviation):
                where = "ahead of" if ahead > 0 else "behind"
                return [f"GNSS antenna {abs(ahead):.1f} ± {deviation:.1f} m {where} where the vehicle file says"]
        return []

    @property
    def details(self) -> Mapping[str, str]:
        return {"filter": self.name}


def _placed(sensor: SensorBase) -> Callable[[Array], Array] | None:
    """What brings a reading (6,) of an inertial sensor into the axes of the car and, as far as rates alone determine
    it, to cog; None of a sensor that is there, and of all others."""
    if "rates and forces" not in sensor.measures:
        return None
    arm = sensor.mounting()[:3]
    along, across, up = arm.tolist()
    turn = sensor.in_axes_of_car(np.eye(6)).T
    turned = not np.array_equal(turn, np.eye(6))

    def placed(value: Array) -> Array:
        if turned:
            value = turn @ value if isfinite(value.dot(value)) else sensor.in_axes_of_car(value[None])[0]
        if not at_cog:
            p, q, r = (rate if rate == rate else 0.0 for rate in value[:3].tolist())
            outward, square = p * along + q * across + r * up, p * p + q * q + r * r
            value = value - (  # ω × (ω × r)
                0.0, 0.0, 0.0, p * outward - along * square, q * outward - across * square, r * outward - up * square
            )  # fmt: skip
        return value

    at_cog = not arm.any()
    return placed if turned or not at_cog else None


def _only_drives(sensor: SensorBase, filter: Aided) -> bool:
    """True for an inertial sensor whose readings are inputs, and measure nothing."""
    if "rates and forces" not in sensor.measures or not filter.needs(sensor):
        return False
    names = (one.name for one in filter.definition.measurements)
    return not any(name in MEASUREMENTS and MEASUREMENTS[name].measures in sensor.measures for name in names)


adapter_of.register(Aided, KinematicAdapter)
