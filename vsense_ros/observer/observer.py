"""The observer: messages in, estimates out, whatever the order and the state of the messages.

It keeps a short history of the filter, so that a measurement that arrives late is used at the time it was made: the
filter goes back there and works its way forward again. It refuses what cannot be true, says so, and carries on.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np
import pymap3d
from numpy.typing import NDArray

from vsense_ros.diagnostic import Diagnostic, Level
from vsense_ros.errors import InputError
from vsense_ros.model.car import PITCH, ROLL, YAW, Z
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.steering import INPUT as STEERING_INPUT
from vsense_ros.model.sensors.wheel_torques import INPUT as TORQUE_INPUT
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.error_ekf import ErrorEkf
from vsense_ros.observer.estimate import Estimate, estimate_samples
from vsense_ros.observer.kalman import SURROUND, Q, U
from vsense_ros.recording import Sample

Array = NDArray[np.float64]

_INPUTS = {"steering": STEERING_INPUT, "wheel_torques": TORQUE_INPUT}
_ALIGNMENT_SPEED = 2.0  # [m/s] above it the course tells the heading
_PATIENCE = 50  # refusals in a row after which a sensor is listened to again, with a variance to match
_FUTURE = 1.0  # [s] a stamp this far ahead of its arrival is a clock fault
_LARGEST_VALUE = 1e7  # no quantity here is larger in SI units
_LONGEST_GAP = 5.0  # [s] without any measurement after which the filter starts anew


@dataclass(slots=True)
class _Event:
    """A measurement or input that belongs to a time."""

    sensor: int
    value: Array
    variance: Array


@dataclass(slots=True)
class _Instant:
    """The filter after all that happened at one time."""

    stamp: int
    state: Array
    covariance: Array
    inputs: Array
    events: list[_Event] = field(default_factory=list)


@dataclass
class _Health:
    """What became of one sensor's messages."""

    used: int = 0
    refused: int = 0  # by the gate
    refused_in_a_row: int = 0
    late: int = 0  # re-propagated
    too_late: int = 0
    invalid: int = 0
    last_stamp: int = 0
    last_received: int = 0
    problem: str = ""
    problem_at: int = 0
    innovation_ratio: float = 1.0  # smoothed NIS over its expectation
    frozen_rows: int = 0
    last_value: Array | None = None


class Observer:
    """errorEKF of one vehicle on a stream of messages.

    `vehicle` names the sensors; those whose messages do not come simply do not contribute. `map_origin` (latitude,
    longitude [deg], height [m]) fixes the map frame; by default it is where the first GNSS fix was made.

    Raises `InputError` if nothing in the sensor set could tell the car's speed, or its steering angle.
    """

    def __init__(self, vehicle: Vehicle, map_origin: tuple[float, float, float] | None = None) -> None:
        self.vehicle = vehicle
        self.sensors: dict[str, SensorBase] = {
            name: _completed(sensor, vehicle) for name, sensor in vehicle.sensors.items()
        }
        _require_observable(vehicle.name, self.sensors)
        self.filter = ErrorEkf(vehicle, self.sensors)
        self.names = tuple(self.sensors)
        self._list = tuple(self.sensors.values())
        self._by_topic: dict[str, list[int]] = {}
        for i, sensor in enumerate(self._list):
            self._by_topic.setdefault(sensor.topic, []).append(i)
        self.health = [_Health() for _ in self._list]
        self._variance = [sensor.deviations() ** 2 for sensor in self._list]
        self.map_origin = map_origin
        self.started = False
        self.heading_known = "gnss_velocity" not in {s.kind for s in self._list}
        self._history: list[_Instant] = []
        self._ahead: list[tuple[int, list[_Event]]] = []  # what is to be done again after a late measurement
        self._first: dict[int, _Event] = {}  # newest measurement of each sensor before the start
        self._first_stamp = 0
        self._newest_arrival = 0
        self._faults = 0
        self._restarts = 0
        self._started_at = 0
        settings = vehicle.observer
        self._merge = int(settings.merge_window * 1e9)
        self._reach = int(settings.history * 1e9)
        self._step = int(settings.longest_step * 1e9)

    @property
    def topics(self) -> dict[str, str]:
        """Topics to subscribe to, with their message types."""
        return {sensor.topic: sensor.message for sensor in self._list}

    @property
    def stamp(self) -> int:
        """Time of the newest state [ns]; 0 before the start."""
        if self._ahead:
            return self._ahead[-1][0]
        return self._history[-1].stamp if self._history else 0

    @property
    def converged(self) -> bool:
        """Whether velocity, yaw rate and side slip are known well enough to be used."""
        if not self.started or not self.heading_known:
            return False
        deviation = np.sqrt(np.diag(self.filter.covariance)[[14, 15, 19]])
        return bool(self.stamp - self._started_at > 1e9 and np.all(deviation < (0.5, 0.5, 0.02)))

    def add(self, sample: Sample) -> None:
        """Use a message of any topic; messages of unknown topics are ignored. Never raises for bad content."""
        for index in self._by_topic.get(sample.topic, ()):
            event = self._read(index, sample)
            if event is not None:
                stamp = sample.stamp - int(self._list[index].latency * 1e9)
                if self.started:
                    self._use(stamp, event)
                else:
                    self._gather(stamp, event)

    # Reading

    def _read(self, index: int, sample: Sample) -> _Event | None:
        sensor, health = self._list[index], self.health[index]
        received = sample.received if sample.received is not None else sample.stamp
        if sample.kind != sensor.message:
            return self._refuse(index, sample.stamp, f"message type {sample.kind}, expected {sensor.message}")
        if sensor.frame_id and sample.frame_id and sample.frame_id != sensor.frame_id:
            return self._refuse(index, sample.stamp, f"frame_id {sample.frame_id!r}, expected {sensor.frame_id!r}")
        if sample.stamp > received + _FUTURE * 1e9:
            ahead = (sample.stamp - received) * 1e-9
            return self._refuse(index, sample.stamp, f"stamp {ahead:.3g} s ahead of its arrival")
        if health.used and sample.stamp <= health.last_stamp:
            back = (health.last_stamp - sample.stamp) * 1e-9
            # A stream whose clock was set back for good must not be refused for ever.
            if health.refused_in_a_row < _PATIENCE or sample.stamp == health.last_stamp:
                health.refused_in_a_row += 1
                text = "stamp repeated" if back == 0 else f"stamp {back:.3g} s before the previous one"
                return self._refuse(index, sample.stamp, text)
        variance = self._variance[index].copy()
        value = np.empty(len(variance))
        values = sample.values
        if sensor.kind == "gnss_position":
            values = self._on_map(sample)
        try:
            sensor.read(sample.names, values, value, variance)
        except (KeyError, IndexError, ValueError) as error:
            return self._refuse(index, sample.stamp, f"unreadable: {error}")
        with np.errstate(invalid="ignore"):
            known = np.abs(value) < _LARGEST_VALUE
        if not known.all():
            value[~known] = np.nan
            if not known.any():
                return self._refuse(index, sample.stamp, "no usable number in the message")
        health.last_stamp, health.last_received = sample.stamp, received
        self._newest_arrival = max(self._newest_arrival, received)
        if self._frozen(health, value, sensor):
            return self._refuse(index, sample.stamp, "value frozen")
        return _Event(index, value, variance)

    @staticmethod
    def _frozen(health: _Health, value: Array, sensor: SensorBase) -> bool:
        """Noise makes two equal messages of an inertial sensor unlikely and fifty impossible."""
        if sensor.kind != "imu":
            return False
        same = health.last_value is not None and np.array_equal(value, health.last_value, equal_nan=True)
        health.frozen_rows = health.frozen_rows + 1 if same else 0
        health.last_value = value
        return health.frozen_rows > 50 and bool(np.nanmax(np.abs(value[:3]), initial=0.0) > 1e-3)

    def _refuse(self, index: int, stamp: int, why: str) -> None:
        health = self.health[index]
        health.invalid += 1
        health.problem, health.problem_at = why, stamp

    def _on_map(self, sample: Sample):
        values = dict(sample.values)
        latitude, longitude, height = (float(values[k][0]) for k in ("latitude", "longitude", "altitude"))
        if not (abs(latitude) <= 90 and abs(longitude) <= 360):
            values["east"] = values["north"] = np.array([np.nan])
            return values
        height = height if np.isfinite(height) else 0.0
        if self.map_origin is None:
            self.map_origin = (latitude, longitude, height)
        east, north, _ = pymap3d.geodetic2enu(latitude, longitude, self.map_origin[2], *self.map_origin)
        values["east"], values["north"] = np.array([float(east)]), np.array([float(north)])
        return values

    # Start

    def _gather(self, stamp: int, event: _Event) -> None:
        """Collect what came until it tells how the car moves, then start."""
        if not self._first_stamp:
            self._first_stamp = stamp
        self._first[event.sensor] = event
        kinds = {self._list[i].kind: e for i, e in self._first.items()}
        if "steering" in {s.kind for s in self._list} and "steering" not in kinds:
            return
        speed = _first_speed(kinds, self.vehicle)
        waited = (stamp - self._first_stamp) * 1e-9
        if speed is None and waited < 5.0:
            return
        if "gnss_velocity" in {s.kind for s in self._list} and "gnss_velocity" not in kinds and waited < 1.0:
            return
        self._start(stamp, speed or 0.0, kinds)

    def _start(self, stamp: int, speed: float, kinds: dict[str, _Event]) -> None:
        f = self.filter
        f.state[:] = 0.0
        f.state[Z] = self.vehicle.physics.chassis.cog_height
        f.state[14] = speed
        for i, axle in enumerate((self.vehicle.physics.front,) * 2 + (self.vehicle.physics.rear,) * 2):
            f.state[24 + i] = speed / (axle.unloaded_radius * 0.98)
        if (wheels := kinds.get("wheel_speeds")) is not None:
            f.state[24:28] = np.where(np.isfinite(wheels.value), wheels.value, f.state[24:28])
        if (imu := kinds.get("imu")) is not None and np.isfinite(imu.value[2]):
            f.state[19] = imu.value[2]
        f.inputs[:] = 0.0
        for kind, part in _INPUTS.items():
            if kind in kinds:
                f.inputs[part] = np.nan_to_num(kinds[kind].value)
        deviation = f.deviation.copy()
        deviation[Q] = [100.0, 100.0, 0.02, 0.02, 0.02, np.pi, *[0.01] * 4, *[1e-3] * 4]
        deviation[U] = [1.0, 0.3, 0.1, 0.05, 0.05, 0.1, *[0.1] * 4, *[2.0] * 4]
        f.covariance[:] = np.diag(deviation**2)
        if "gnss_velocity" not in {s.kind for s in self._list}:
            f.covariance[[0, 1, 5], [0, 1, 5]] = 1e-12
        self.heading_known = "gnss_velocity" not in {s.kind for s in self._list}
        self.started, self._started_at = True, stamp
        self._history.clear()
        self._ahead.clear()
        f.linearize()
        if (fix := kinds.get("gnss_position")) is not None:
            f.state[0:2] = np.where(np.isfinite(fix.value), fix.value, 0.0)
        if (velocity := kinds.get("gnss_velocity")) is not None:
            self._align(velocity)
        self._copy(self._remember(stamp))

    def _align(self, event: _Event) -> bool:
        """Take the heading from the course, once it is meaningful; True if that has just been done."""
        east, north = event.value
        speed = float(np.hypot(east, north))
        if not speed > _ALIGNMENT_SPEED:
            return False
        f = self.filter
        forward = f.state[14]
        f.state[YAW] = np.arctan2(north, east) - np.arctan2(f.state[15], max(forward, 0.1))
        deviation = np.hypot(0.05, np.sqrt(event.variance.max()) / speed)
        for i, d in ((YAW, deviation), (0, 100.0), (1, 100.0)):
            f.covariance[i, :] = f.covariance[:, i] = 0.0
            f.covariance[i, i] = d**2
        self.heading_known = True
        return True

    # Filtering

    def _use(self, stamp: int, event: _Event) -> None:
        """Put an event in its place and bring the filter up to the newest time again."""
        health = self.health[event.sensor]
        newest = self.stamp
        if stamp > newest + _LONGEST_GAP * 1e9:
            # Either everything was silent for long or this clock has jumped; the other sensors will tell.
            if not self._all_jumped(event.sensor, stamp):
                self._refuse(event.sensor, stamp, f"stamp {(stamp - newest) * 1e-9:.3g} s ahead of all others")
                return
            self._restart(stamp, event)
            return
        if stamp < newest - self._reach or stamp < self._history[0].stamp:
            if stamp < newest - _LONGEST_GAP * 1e9 and self._all_jumped(event.sensor, stamp):
                self._restart(stamp, event)
                return
            health.too_late += 1
            health.problem = f"measurement {(newest - stamp) * 1e-9:.3g} s old, history is {self._reach * 1e-9:g} s"
            health.problem_at = stamp
            return
        if stamp < newest - self._merge:
            health.late += 1
            self._insert(stamp, event)
        else:
            self._catch_up()
            self._occur(stamp, [event])

    def _occur(self, stamp: int, events: list[_Event], again: bool = False) -> None:
        """Let events happen at `stamp`, not before the newest instant of the history."""
        newest = self._history[-1]
        # An input holds from here on: the model need not be brought to the very time it was read.
        moves = any(not self._list[e.sensor].is_input for e in events)
        if moves and stamp > newest.stamp + self._merge:
            self._advance(newest.stamp, stamp)
            newest = self._remember(stamp)
        for event in events:
            self._happen(event, again)
        newest.events += events
        self._copy(newest)

    def _insert(self, stamp: int, event: _Event) -> None:
        """Put a late event in its place; what follows it is done again when the newest state is next needed."""
        position = bisect_right(self._history, stamp + self._merge, key=lambda i: i.stamp)
        if position < len(self._history):
            undone = self._history[position:]
            self._ahead[:0] = [(instant.stamp, instant.events) for instant in undone]
            del self._history[position:]
            self._restore(self._history[-1])
        before = bisect_right(self._ahead, stamp + self._merge, key=lambda a: a[0])
        if before == 0:
            self._occur(stamp, [event])
        else:
            self._ahead.insert(before, (stamp, [event]))

    def _catch_up(self) -> None:
        """Do again what came after a late measurement."""
        ahead, self._ahead = self._ahead, []
        for stamp, events in ahead:
            self._occur(stamp, events, again=True)

    def _all_jumped(self, sensor: int, stamp: int) -> bool:
        """Whether every other sensor that still sends does so on the new clock, or none has sent lately."""
        self._jumps = getattr(self, "_jumps", {})
        self._jumps[sensor] = stamp
        others = [
            i
            for i, h in enumerate(self.health)
            if h.used and i != sensor and self._newest_arrival - h.last_received < self._list[i].timeout * 1e9
        ]
        agreed = all(i in self._jumps and abs(self._jumps[i] - stamp) < _LONGEST_GAP * 1e9 for i in others)
        if agreed:
            self._jumps = {}
        return agreed

    def _restart(self, stamp: int, event: _Event) -> None:
        self._restarts += 1
        self.started = False
        self._history.clear()
        self._ahead.clear()
        self._first, self._first_stamp = {}, 0
        self._gather(stamp, event)

    def _advance(self, start: int, end: int) -> None:
        count = max(1, -(-(end - start) // self._step))
        h = (end - start) * 1e-9 / count
        for i in range(count):
            if i:
                self.filter.linearize()
            self.filter.predict(h)
        self.filter.linearize()

    def _happen(self, event: _Event, again: bool = False) -> None:
        """Let an event act on the filter at its present time."""
        f, sensor = self.filter, self._list[event.sensor]
        value = event.value
        if sensor.is_input:
            part = f.inputs[_INPUTS[sensor.kind]]
            np.copyto(part, value, where=np.isfinite(value))
            if not again:
                self.health[event.sensor].used += 1
            return
        if not self.heading_known:
            if sensor.kind == "gnss_velocity" and self._align(event):
                pass
            elif sensor.kind in ("gnss_velocity", "gnss_position"):
                if sensor.kind == "gnss_position" and not again:
                    f.state[0:2] = value
                return
        health = self.health[event.sensor]
        limit = sensor.gate**2 * len(value) ** 0.5
        nis = f.correct(event.sensor, value, event.variance, limit)
        if not nis <= limit:
            if not again:
                health.refused += 1
                health.refused_in_a_row += 1
                health.problem = f"innovation {abs(nis) ** 0.5:.1f} standard deviations, limit {limit**0.5:.1f}"
                health.problem_at = self._history[-1].stamp if self._history else 0
            if health.refused_in_a_row >= _PATIENCE and np.isfinite(nis):
                # Refused for so long, it may be the filter that is wrong: let the measurement pull at the gate's edge.
                f.correct(event.sensor, value, event.variance, 2 * limit, scale=nis / limit)
        elif not again:
            health.refused_in_a_row = 0
            health.used += 1
            health.innovation_ratio += 0.02 * (nis / len(value) - health.innovation_ratio)
        self._check()

    def _check(self) -> None:
        """Undo what must not be: a state that is no car's."""
        f = self.filter
        state = f.state
        sane = (
            abs(state[ROLL]) < 1.5
            and abs(state[PITCH]) < 1.4
            and abs(state[14]) < 150
            and abs(state[15]) < 150
            and abs(state[19]) < 20
            and f.covariance[14, 14] > 0
            and np.isfinite(state.sum())
        )
        if sane:
            return
        self._faults += 1
        good = next((i for i in reversed(self._history) if np.isfinite(i.state.sum())), None)
        if good is not None:
            self._restore(good)
            f.covariance[:] = np.diag(np.maximum(np.diag(good.covariance), 0) * 4 + 1e-12)
            f.linearize()

    def _remember(self, stamp: int) -> _Instant:
        """Begin a new instant with the filter's present state; the oldest beyond reach is reused."""
        f = self.filter
        if self._history and self._history[0].stamp < stamp - self._reach and len(self._history) > 2:
            instant = self._history.pop(0)
        else:
            n = len(f.state)
            instant = _Instant(0, np.empty(n), np.empty((n, n)), np.empty(5))
        instant.stamp, instant.events = stamp, []
        self._history.append(instant)
        return instant

    def _copy(self, instant: _Instant) -> None:
        f = self.filter
        instant.state[:], instant.covariance[:], instant.inputs[:] = f.state, f.covariance, f.inputs

    def _restore(self, instant: _Instant) -> None:
        f = self.filter
        f.state[:], f.covariance[:], f.inputs[:] = instant.state, instant.covariance, instant.inputs
        f.linearize()

    # Results

    def estimate(self) -> list[Sample]:
        """All output topics at the newest time; empty before the start."""
        return estimate_samples(self.snapshot()) if self.started else []

    def snapshot(self) -> Estimate:
        """The newest state in terms of the car."""
        self._catch_up()
        self.filter.linearize()
        return Estimate.of(self.stamp, self.filter)

    def parameters(self) -> dict[str, tuple[float, float]]:
        """Slow quantities by name: value and standard deviation."""
        f = self.filter
        deviation = np.sqrt(np.maximum(np.diag(f.covariance), 0))
        first = SURROUND.start
        return {
            name: (float(f.state[i]), float(deviation[i])) for i, name in enumerate(f.layout.names[first:], start=first)
        }

    def diagnostics(self, now: int | None = None) -> list[Diagnostic]:
        """One line for the observer and one for each sensor; `now` [ns] on the clock of arrivals."""
        now = self._newest_arrival if now is None else now
        lines = [self._own_diagnostic()]
        for name, sensor, health in zip(self.names, self._list, self.health, strict=True):
            lines.append(_sensor_diagnostic(name, sensor, health, now))
        return lines

    def _own_diagnostic(self) -> Diagnostic:
        values = {"faults": str(self._faults), "restarts": str(self._restarts)}
        if not self.started:
            missing = [n for n, s, h in zip(self.names, self._list, self.health, strict=True) if not h.last_stamp]
            text = "waiting for " + (", ".join(missing) if missing else "a speed")
            return Diagnostic("observer", Level.WARN, text, values)
        if not self.heading_known:
            return Diagnostic("observer", Level.WARN, "heading unknown until the car moves", values)
        level = Level.OK if self.converged else Level.WARN
        return Diagnostic("observer", level, "converged" if self.converged else "converging", values)


def _completed(sensor: SensorBase, vehicle: Vehicle) -> SensorBase:
    """A sensor with what it takes over from the vehicle."""
    if sensor.kind == "steering" and sensor.ratio is None:
        return sensor.model_copy(update={"ratio": vehicle.physics.steering.ratio})
    return sensor


def _require_observable(vehicle: str, sensors: dict[str, SensorBase]) -> None:
    kinds = {s.kind for s in sensors.values()}
    if not kinds & {"wheel_speeds", "gnss_velocity"}:
        raise InputError(
            f"{vehicle}: no sensor tells the car's speed; the vehicle file lists {sorted(kinds) or 'none'}, "
            "one of wheel_speeds or gnss_velocity is needed"
        )
    if "steering" not in kinds and "imu" not in kinds:
        raise InputError(
            f"{vehicle}: no sensor tells how the car turns; the vehicle file lists {sorted(kinds)}, "
            "one of steering or imu is needed"
        )


def _first_speed(kinds: dict[str, _Event], vehicle: Vehicle) -> float | None:
    if (wheels := kinds.get("wheel_speeds")) is not None:
        return float(np.nanmean(wheels.value) * vehicle.physics.rear.unloaded_radius * 0.98)
    if (velocity := kinds.get("gnss_velocity")) is not None:
        return float(np.hypot(*velocity.value))
    return None


def _sensor_diagnostic(name: str, sensor: SensorBase, health: _Health, now: int) -> Diagnostic:
    values = {
        "used": str(health.used),
        "refused": str(health.refused),
        "late": str(health.late),
        "too_late": str(health.too_late),
        "invalid": str(health.invalid),
        "innovation_ratio": f"{health.innovation_ratio:.2f}",
    }
    if not health.last_stamp:
        text = f"no message on {sensor.topic}" + (f": {health.problem}" if health.problem else "")
        return Diagnostic(name, Level.STALE, text, values)
    silent = (now - health.last_received) * 1e-9
    if silent > sensor.timeout:
        return Diagnostic(name, Level.STALE, f"silent for {silent:.1f} s on {sensor.topic}", values)
    recent = health.problem and abs(health.last_stamp - health.problem_at) < 2e9
    if recent:
        level = Level.ERROR if health.refused_in_a_row >= _PATIENCE else Level.WARN
        return Diagnostic(name, level, health.problem, values)
    return Diagnostic(name, Level.OK, "in use", values)
