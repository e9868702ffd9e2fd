"""Filters of the multibody car: they know its forces, its road and the biases of its sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import exp, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Innovation, largest_nis
from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample
from vsense_ros.model.car.pose import tilt_on_map
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import PITCH, ROLL, SPIN, STEERING_OFFSET, YAW, X, Y
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.gnss import Antenna
from vsense_ros.model.vehicle import Vehicle, left_out_of_observer
from vsense_ros.observer.alignment import Alignment
from vsense_ros.observer.balance import Balance
from vsense_ros.observer.beginning import Beginning, Start
from vsense_ros.observer.error_ekf import CarFilter
from vsense_ros.observer.estimate import Block, Estimate, estimate_samples, stacked
from vsense_ros.observer.monitor import Limits, Monitor
from vsense_ros.observer.observable import needs, undetermined
from vsense_ros.observer.road_map import RoadMap
from vsense_ros.observer.sensors import check_sensors
from vsense_ros.observer.spi import Spi
from vsense_ros.observer.state import DISTURB, FORCE, FORWARD, LATERAL, SLOPES, YAW_RATE, U
from vsense_ros.observer.tilt import Tilt
from vsense_ros.runner.adapter import Adapter, Apart, Move, Placing, Report, Widening, adapter_of
from vsense_ros.runner.guard import GUARD, Vitals
from vsense_ros.runner.inertial_axes import InertialAxes, Judged
from vsense_ros.runner.lag_doubt import DOUBT
from vsense_ros.runner.velocity_witnesses import SETTINGS as DOUBTED

Array = NDArray[np.float64]

_SPINS = range(SPIN.start, SPIN.stop)


@dataclass(frozen=True)
class CarAdapterSettings:
    """When the filter of a car counts as converged, and its doubts after a jump: decisions of this project."""

    moving: float = 1.0  # [m/s] below it an inertial sensor of coarse resolution may well repeat itself
    spin_deviation: float = 2.0  # [rad/s] of the spin of a wheel once the speed has been moved
    settled: float = 1.0  # [s] from the start on before which nothing counts as converged
    bent: float = 0.06  # [rad] deviation of a heading from which on it bends a velocity; one by a course has 0.05
    turned: float = 0.2  # [rad] that an antenna elsewhere has turned the heading by, at most
    together: int = 256  # [-] estimates in one block, of some ten megabytes: of 64 each would take twice the time
    alike: float = 0.9  # correlation of the errors of two parameters that can hardly be told apart


SETTINGS = CarAdapterSettings()

# [m/s], [m/s], [rad/s] deviations of velocity and yaw rate below which they may be used, and up to which they stay so.
_CONVERGED = np.array([[0.5, 0.5, 0.02], [1.0, 1.0, 0.04]])
_TURNED_PLACE, _TURNED_YAW = 10.0, 0.1  # [m], [rad] deviations once the car has been turned around
_LATERAL_FORCE = FORCE.start + Y  # element of the state


class CarAxes(InertialAxes):
    """All axes of all inertial sensors, which correct the filter of a car."""

    def __init__(self, filter: CarFilter, sensors: Mapping[str, SensorBase]) -> None:
        super().__init__(filter)
        self._sensors = sensors

    def axes(self) -> dict[int, Judged]:
        judged = {}
        for i, sensor in enumerate(self._sensors.values()):
            if "rates and forces" in sensor.measures:
                words = tuple(one.words for one in sensor.components)
                judged[i] = Judged(words, tuple(range(len(words))), 0, sensor.gate)
        return judged


class CarAdapter(Adapter):
    """A filter of the multibody car.

    Raises `InputError` if no sensor measures the car's speed, or its steering angle.
    """

    filter: CarFilter
    knows_car = True

    def __init__(self, filter: CarFilter, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> None:
        check_sensors(vehicle, sensors)
        super().__init__(filter, vehicle, CarAxes(filter, sensors))
        self.car, self.sensors = filter.car, sensors
        self.merge = vehicle.observer.merge_window
        self.left_out = left_out_of_observer(vehicle)
        self._of_course = {i for i, sensor in enumerate(sensors.values()) if "course" in sensor.measures}
        self.has_position = any("position" in sensor.measures for sensor in sensors.values())
        self.balance = Balance(vehicle, sensors, forces_determined=self.car.prior.torques.determine_forces)
        self.tilt = Tilt(sensors, self.car)
        self.lateral_force_error = self.car.prior.deviation.item(_LATERAL_FORCE)
        self._block = Block(self.car, 0)
        self._start: Start | None = None
        self._settled = False  # it has converged
        self._bend, self._bent_at = 0.0, 0  # [1/m] largest curvature of late, and when that was looked at [ns]
        if any("steering" in sensor.measures for sensor in sensors.values()):
            self.steering_error = DISTURB.start + STEERING_OFFSET
        around = vehicle.observer.surroundings
        spread = GUARD.road_deviations * np.array([around.grade, around.bank])
        self._steepest = np.maximum(GUARD.steepest_road, spread)

    def attach(self, intake: Intake[SensorBase], timeline: Timeline) -> None:
        super().attach(intake, timeline)
        self._road_map = RoadMap.of(self.vehicle, intake.on_map)
        self.alignment = Alignment(self.filter, timeline, intake)
        self._beginning = Beginning(self.vehicle, intake, self.car.largest[FORWARD])

    def channels(self) -> list[Channel]:
        return [_channel(name, sensor) for name, sensor in self.sensors.items()]

    @property
    def forward_speed(self) -> float:
        return self.car.mean.item(FORWARD)

    @property
    def lateral_speed(self) -> float:
        return self.car.mean.item(LATERAL)

    @property
    def yaw_rate(self) -> float:
        return self.car.mean.item(YAW_RATE)

    @property
    def first_speeds_apart(self) -> float:
        return self._start.apart if self._start is not None else 0.0

    @property
    def velocity_deviations(self) -> tuple[float, float]:
        along, across, turned = self.car.covariance.diagonal()[[FORWARD, LATERAL, YAW]].tolist()
        return sqrt(max(along, 0.0)), sqrt(max(across + self.forward_speed**2 * turned, 0.0))

    @property
    def heading(self) -> float:
        return self.car.mean.item(YAW)

    @property
    def missing_lateral_force(self) -> float:
        return self.car.mean.item(_LATERAL_FORCE) / self.vehicle.physics.chassis.mass

    @property
    def moving(self) -> bool:
        return bool(abs(self.car.mean[FORWARD]) > SETTINGS.moving)

    @property
    def heading_known(self) -> bool:  # type: ignore[override]
        """False while the direction of the car on the map is not known."""
        return self.alignment.known

    @property
    def in_one_call(self) -> bool:  # type: ignore[override]
        """True once no reading has to be asked for the heading first, nor takes a variance from that."""
        return self.alignment.known and self.car.covariance.item(YAW, YAW) <= SETTINGS.bent**2

    # Start

    def gather(self, event: Event) -> int | None:
        self._start = self._beginning.add(event)
        return None if self._start is None else self._start.stamp

    def start(self, stamp: int) -> None:
        assert self._start is not None
        filter, mean, start = self.filter, self.car.mean, self._start
        self._settled, self._bend = False, 0.0
        filter.start_rolling(start.speed)
        self.balance.forget()
        self.tilt.forget()
        for event in start.events.values():
            sensor = self.intake.sensors[event.sensor]
            self.balance.measured(event)
            if sensor.inputs is not None:
                filter.inputs[sensor.inputs] = np.nan_to_num(event.value)
            for place, velocity in sensor.first_velocities(event.value).items():
                at = U.start + place
                at_rest = (
                    place in _SPINS and start.speed <= SETTINGS.moving
                )  # where the noise of the wheels would be slip
                if abs(velocity) < self.car.largest[at] and not at_rest:
                    mean[at] = velocity
        if self.monitor is not None:
            self.monitor.forget()
        filter.linearize()
        if start.apart:
            across = DOUBTED.sideways * min(start.apart, DOUBTED.doubted)
            for one in self.doubted_motion(Apart(start.apart, across), 0.0):
                self.widen(one)
        self.alignment.start(start.events)

    def stop(self, valid: bool) -> None:
        self._beginning.clear()
        if not valid:
            self.filter.start_rolling(0.0)  # whoever looks at it before it starts anew sees a car

    def waiting(self) -> str:
        health = self.intake.health
        missing = [name for name, one in zip(self.sensors, health, strict=True) if not one.last_stamp]
        text = "waiting for " + (", ".join(missing) if missing else "a speed")
        if missing and not self._beginning.measures_speed:
            able = (name for name, sensor in self.sensors.items() if sensor.measures_speed)
            text += f"; nothing measures the speed, which {' or '.join(able)} would"
        return text

    def contradicts_start(self, event: Event) -> bool:
        return self._beginning.doubts(event)

    # Readings

    def measured(self, event: Event) -> None:
        if event.sensor == self.balance.index:
            self.balance.measured(event)

    def correct(self, channel: Channel, event: Event) -> Innovation:
        variance = event.variance
        if event.sensor in self._of_course:
            variance = variance + self._bend_of_course()
        return self.filter.correct(channel.name, event.value, variance, channel.limit)

    def _bend_of_course(self) -> float:
        """Variance of a velocity over ground by an error of the heading to second order, which the linearised equation
        lacks: the mean square of v ε²/2 with ε normally distributed (Jazwinski 1970, section 9.3) [m²/s²]."""
        speed, turned = self.forward_speed, self.car.covariance.item(YAW, YAW)
        return 0.75 * (speed * turned) ** 2 if turned > SETTINGS.bent**2 else 0.0

    def accepts(self, event: Event) -> bool:
        return self.alignment.known or self.alignment.helps(event)

    def after_event(self) -> None:
        """Where the vehicle file knows the road from place to place, take it as it is where the car is."""
        if self._road_map is not None and self.alignment.known:
            self._road_map.follow(self.filter)

    def bias(self, sensor: int, axis: int, jump: float) -> tuple[int, float] | None:
        element = self.car.layout.biases[sensor].start + axis
        return element, float(np.hypot(self.car.prior.deviation[element], jump))

    def steering_offset(self) -> float:
        return self.car.mean.item(DISTURB.start + STEERING_OFFSET)

    def usual_deviation(self, element: int) -> float:
        return self.car.prior.deviation.item(element)

    def widen(self, widening: Widening) -> None:
        self.car.covariance[widening.element, widening.element] += widening.variance

    def doubted_motion(self, apart: Apart, way: float) -> list[Widening]:
        spin = apart.ahead / self.vehicle.physics.rear.unloaded_radius
        elements = [(FORWARD, apart.ahead), (LATERAL, apart.across), (X, way), (Y, way), (YAW, apart.heading)]
        elements += [(U.start + place, spin) for place in _SPINS]
        return [Widening(element, deviation**2) for element, deviation in elements]

    def place_antennas(self, ahead: float, bend: float) -> list[Widening]:
        moved = 0.0
        for sensed in self.car.sensed.values():
            sensor = self.car.sensor_list[sensed.index]
            if isinstance(sensor, Antenna):
                place = sensor.mounting().item(0) + ahead
                moved, sensed.mounting[0] = abs(place - sensed.mounting.item(0)), place
        turned = min(bend * moved, SETTINGS.turned)
        across = turned * abs(self.forward_speed)
        return [*self.doubted_motion(Apart(across=across), moved), Widening(YAW, turned**2)]

    # Resets

    def difference(self, event: Event, innovation: Innovation) -> tuple[Array, Array] | None:
        factor = innovation.factor
        return factor @ innovation.whitened, np.sqrt(np.sum(factor**2, axis=1))

    def moves(self, sensor: SensorBase, difference: Array, deviation: Array) -> list[Move]:
        if "position" in sensor.measures:
            return [Move(i, by, sd) for i, by, sd in zip((X, Y), difference.tolist(), deviation.tolist(), strict=True)]
        yaw, spread = self.car.mean.item(YAW), float(deviation.max())
        forward, left = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) @ difference
        moves = [Move(FORWARD, float(forward), spread), Move(LATERAL, float(left), spread)]
        speed = max(self.car.mean.item(FORWARD), 1.0)
        return moves + [
            Move(U.start + SPIN.start + i, float(forward) / speed * spin, SETTINGS.spin_deviation)
            for i, spin in enumerate(self.car.mean[U][SPIN].tolist())
        ]

    def move(self, move: Move) -> None:
        self.filter.set_element(move.element, float(self.car.mean[move.element]) + move.by, move.deviation)

    def place(self, placing: Placing) -> None:
        self.filter.set_element(placing.element, placing.value, placing.deviation)

    def turn_around(self, turned: bool) -> None:
        filter, mean = self.filter, self.car.mean
        place, yaw, inputs = mean[[X, Y]].tolist(), mean.item(YAW), filter.inputs.copy()
        filter.start_rolling(-mean.item(FORWARD))
        filter.inputs[:] = inputs
        for element, value in zip((X, Y), place, strict=True):
            filter.set_element(element, value, _TURNED_PLACE)
        if self.heading_known:
            filter.set_element(YAW, yaw + np.pi * turned, _TURNED_YAW)
        filter.linearize()
        self.timeline.forget_past()

    def begin_anew(self, event: Event) -> bool:
        return self.alignment.astray(event) and self.alignment.begin_anew(event)

    # Results

    def converged(self, seconds: float) -> bool:
        deviation = np.sqrt(self.filter.belief().covariance.diagonal()[[FORWARD, LATERAL, YAW_RATE]])
        self._settled = bool(seconds > SETTINGS.settled and np.all(deviation < _CONVERGED[int(self._settled)]))
        return self._settled

    def condition(self, converged: bool) -> str:
        if self.heading_known:
            return "converged" if converged else "converging"
        moving = any(sensor.measures & {"course", "position"} for sensor in self.sensors.values())
        silent = all(not self.intake.sends(i) for i, sensor in enumerate(self.sensors.values()) if sensor.on_map)
        until = "GNSS comes" if moving and silent else "the car moves" if moving else "two antennas measure it"
        return f"heading unknown until {until}"

    def snapshot(self, stamp: int) -> Estimate:
        if self._block.is_full:
            self._block = Block(self.car, SETTINGS.together)
        return Estimate.of(stamp, self.filter, self._block)

    def widen_published(self, snapshot: Estimate, apart: Apart) -> None:
        ahead, across, yaw_rate, place, heading, along = (deviation**2 for deviation in apart)
        snapshot.undecided[:] = ahead, across, 0.0, 0.0, 0.0, yaw_rate, place, heading, along

    def vitals(self, snapshot: Estimate) -> Vitals:
        state = snapshot.state
        roll, pitch, (grade, bank) = state.item(ROLL), state.item(PITCH), state[SLOPES].tolist()
        deviation = sqrt(max(snapshot.covariance.item(FORWARD, FORWARD), 0.0))
        steepness = float((np.abs(state[SLOPES]) / self._steepest).max())
        vertical = snapshot.model_wheels[2, :4]
        load = float(vertical.sum()) / (self.vehicle.physics.chassis.mass * GRAVITY)
        changing = np.concatenate([snapshot.udot, snapshot.model_wheels.ravel()]), vertical
        tilt = tilt_on_map(roll, pitch, grade, bank)
        return Vitals(tilt, steepness, state.item(FORWARD), deviation, load, changing)

    def aged(self, seconds: float) -> None:
        mean, deviation = self.car.mean, np.sqrt(self.filter.belief().covariance.diagonal())
        driven = float(np.hypot(mean[FORWARD], mean[LATERAL])) * seconds
        for element, change in ((X, driven), (Y, driven), (YAW, abs(float(mean[YAW_RATE])) * seconds)):
            self.filter.set_element(element, float(mean[element]), float(np.hypot(deviation[element], change)))

    def watch(self, snapshot: Any, converged: Callable[[], bool]) -> None:
        passed, self._bent_at = max(snapshot.stamp - self._bent_at, 0) * 1e-9, snapshot.stamp
        state = snapshot.state
        bend = abs(state.item(YAW_RATE)) / max(abs(state.item(FORWARD)), SETTINGS.moving)
        self._bend = max(bend, self._bend * exp(-passed / DOUBT.corrected))
        snapshot.bend[...] = self._bend
        self.balance.compare(snapshot)
        self.tilt.look(snapshot.stamp, converged)

    def complete(self) -> None:
        self.balance.settle()

    def messages(self, snapshot: Estimate) -> Iterator[Sample]:
        samples = estimate_samples(snapshot)
        yield next(samples)
        self.complete()  # which the odometry needs not wait for
        yield from samples

    def columns(self, snapshots: Sequence[Estimate]) -> list[Sample]:
        self.complete()
        return list(estimate_samples(stacked(snapshots)))

    def parameters(self, snapshot: Estimate) -> dict[str, tuple[float, float]]:
        values = zip(snapshot.parameters.tolist(), snapshot.parameter_deviations.tolist(), strict=True)
        return dict(zip(snapshot.parameter_names, values, strict=True))

    def monitored(
        self, gates: Sequence[float], ready: Callable[[], bool], limits: Limits | None, report: Report
    ) -> Monitor:
        if limits is not None and limits.vehicle != self.vehicle.name:
            raise InputError(
                f"the limits of the monitor are those of the vehicle {limits.vehicle!r}, this is {self.vehicle.name!r}"
            )
        self.monitor = Monitor(self.car, self.sensors, gates, ready, limits, report)
        return self.monitor

    def doubt(self, sensor: str) -> str:
        return self.tilt.sentence() if sensor == self.tilt.sensor else ""

    @property
    def doubts(self) -> list[str]:
        stuck = _at_bounds(self.filter) if isinstance(self.filter, Spi) else ""
        return [f"a number of the car is at its bound: {stuck}"] if stuck else []

    def diagnostics(self) -> list[Diagnostic]:
        lines = [Diagnostic("effects", Level.WARN, self.left_out)] if self.left_out else []
        if absent := needs(undetermined(self.car, self.filter.belief().covariance)):
            lines.append(Diagnostic("observability", Level.OK, absent))
        if isinstance(self.filter, Spi):
            lines.append(_parameters(self.filter))
        if self.monitor is not None and self.monitor.limits is not None:
            lines.append(self.monitor.diagnostic())
        if self.balance.sensor is not None:
            lines.append(self.balance.diagnostic())
        return lines

    @property
    def steering_angle(self) -> float:
        return float(self.filter.inputs[0])


def _channel(name: str, sensor: SensorBase) -> Channel:
    part = sensor.inputs
    limit = largest_nis(sensor.gate, len(sensor.deviations()))
    return Channel(name, limit, None if part is None else part.start)


def _at_bounds(spi: Spi) -> str:
    """Parameters that are at their bounds, with their values; empty for none."""
    value = dict(zip(spi.parameter_names, spi.values.tolist(), strict=True))
    return ", ".join(f"{name} = {value[name]:.4g}" for name in spi.at_bounds())


def _parameters(spi: Spi) -> Diagnostic:
    """One line about the parameters that an SPI estimates."""
    seen = spi.observability()
    values = {
        name: f"{value:.6g} ± {deviation:.2g}, {share:.0%} of the deviation at start"
        for name, value, deviation, share in zip(seen.names, spi.values, seen.deviation, seen.share, strict=True)
    }
    values["independent combinations determined"] = f"{seen.rank} of {len(seen.names)}"
    closest = np.abs(np.triu(seen.correlation, 1))
    if closest.max(initial=0.0) > SETTINGS.alike:
        i, j = np.unravel_index(closest.argmax(), closest.shape)
        values["hard to distinguish"] = f"{seen.names[i]} and {seen.names[j]} ({seen.correlation[i, j]:+.2f})"
    if words := _at_bounds(spi):
        return Diagnostic("parameters", Level.WARN, f"at its bound: {words}; something else differs; {seen}", values)
    return Diagnostic("parameters", Level.OK, str(seen), values)


adapter_of.register(CarFilter, CarAdapter)
