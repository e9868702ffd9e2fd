"""What recordings say, in the form in which a simulation can be held against it: windows, inputs, measured signals.

A window is a stretch of a recording in which the car drives, short enough for a simulation from recorded inputs to stay
beside it. Its first seconds let the simulation find its state and are not compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfiltfilt

from vsense_ros.checks.aligned import stretches
from vsense_ros.checks.held import period_of_updates
from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.road import ROAD_SETTINGS, Road, points
from vsense_ros.model.sensors import MeasuredQuantity, SensorBase, best_measuring, unheard
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WindowSettings:
    """How recordings are cut into windows that are simulated: decisions of this project."""

    slowest: float = 4.0  # [m/s] below it slip angles say little and tyres creep
    longest: float = 25.0  # [s] of a window
    shortest: float = 6.0  # [s] of a window, run-in included
    beginning: float = 0.1  # [s] to either side of the instant at which a window begins, of which a mean is taken
    run_in: float = 2.5  # [s] at the beginning of a window that are not compared
    # [s] in which a wheel torque pulls the model to the measured speed where torques are unknown
    holding_time: float = 0.15
    slow_period: float = 0.05  # [s] between two speeds; if it is longer, the accelerometer is used in between
    crossover: float = 0.5  # [Hz] above which the accelerometer gives such a speed
    grid: float = 0.01  # [s] of such a speed, and of signals before they are filtered …
    several: float = 0.75  # [steps of the grid] … from one measurement to the next, below which means are taken
    largest_gap: float = 0.5  # [s] without a message that a window may contain


WINDOWS = WindowSettings()

LEFT_OUT = "the recording is left out"
SPEEDS: tuple[MeasuredQuantity, ...] = ("rolling speed", "ground speed")  # the best first
INPUTS: tuple[MeasuredQuantity, ...] = ("steering", "torques")


@dataclass(frozen=True)
class Readings:
    """All measurements of one sensor, in order of time: `t` (n,) [s] since the first stamp of its recording, latency
    taken off; `value` (n, m), NaN where a component is absent, vectors in the axes of the car. `as_mounted` (n, m) has
    them in the axes of the sensor, where the vehicle file says that these are others."""

    t: Array
    value: Array
    as_mounted: Array | None = None

    @property
    def in_own_axes(self) -> Readings:
        """The readings in the axes of the sensor, as it gave them."""
        return self if self.as_mounted is None else Readings(self.t, self.as_mounted)

    def rows(self, chosen: NDArray[np.bool_] | slice) -> Readings:
        """Some of the measurements."""
        mounted = None if self.as_mounted is None else self.as_mounted[chosen]
        return Readings(self.t[chosen], self.value[chosen], mounted)


@dataclass(frozen=True)
class Window:
    """A stretch of one recording."""

    recording: int
    name: str
    begin: float  # [s] since the recording's first stamp
    end: float
    readings: Mapping[str, Readings]  # by sensor, those inside the window with some margin
    speed: Readings  # (n, 1) over ground [m/s]
    # At the beginning the course over ground [rad], as far as it is known: else as if each recording set out eastwards.
    heading: float
    torques: bool  # True: wheel torques are measured
    # (n, 1) to the left of the way on which the first recording sets out that knows its course, else this one [rad].
    turned: Readings
    place: Readings  # (n, 1) abscissa along the road [m], the same for the same place on every lap
    yaw_rate: float = 0.0  # at the beginning [rad/s], as far as it is known
    lateral_velocity: float | None = None  # there [m/s]; None: that of usual tyres in a steady bend
    run_in: float = WINDOWS.run_in  # [s] at the beginning that are not compared

    def part(self, begin: float, end: float, *, run_in: float, yaw_rate: float, lateral_velocity: float) -> Window:
        """A part of it, which begins at another time [s] in a known state."""
        turned = np.interp([self.begin, begin], self.turned.t, self.turned.value[:, 0])
        return replace(
            self, begin=begin, end=end, run_in=run_in, yaw_rate=yaw_rate, lateral_velocity=lateral_velocity,
            readings=within(self.readings, begin - 1.0, end + 1.0),
            speed=_cut(self.speed, begin - 1.0, end + 1.0), heading=self.heading + float(turned[1] - turned[0]),
            turned=_spanning(self.turned, begin - 1.0, end + 1.0), place=_spanning(self.place, begin - 1.0, end + 1.0),
        )  # fmt: skip


@dataclass(frozen=True)
class Dataset:
    """Windows of one or several recordings of one car, and what could not be used."""

    windows: tuple[Window, ...]
    sensors: Mapping[str, SensorBase]  # those that gave measurements
    recordings: tuple[str, ...]
    remarks: tuple[str, ...]
    road: Road  # with all places where the car has been
    on_map: Map
    sets_out: float | None = None  # course of the first recording that knows its own, as it sets out [rad]
    dropped: tuple[Window, ...] = ()  # of which nothing can be said

    @property
    def driven(self) -> float:
        """Duration of all windows [s]; what two have in common, where one begins before the other ends, counts once."""
        until: dict[int, float] = {}
        whole = 0.0
        for w in self.windows:
            whole += w.end - max(w.begin, until.get(w.recording, w.begin))
            until[w.recording] = w.end
        return whole

    @property
    def points(self) -> list[float]:
        """Abscissae of the points that a profile of the road needs [m]."""
        places = (window.place for window in self.windows)
        return points([np.interp(np.arange(p.t[0], p.t[-1], WINDOWS.grid), p.t, p.value[:, 0]) for p in places])

    def by_recording(self) -> list[list[Window]]:
        """Windows of each recording that has some."""
        return [[self.windows[index] for index in of] for of in self.places_by_recording()]

    def places_by_recording(self) -> list[list[int]]:
        """Where among all windows those of each recording are that has some."""
        places: dict[int, list[int]] = {}
        for index, window in enumerate(self.windows):
            places.setdefault(window.recording, []).append(index)
        return [places[number] for number in sorted(places)]

    def joined(self, other: Dataset) -> Dataset:
        """The windows of both, whose recordings are different ones."""
        windows = (replace(w, recording=w.recording + len(self.recordings)) for w in other.windows)
        return replace(
            self, windows=(*self.windows, *windows), sensors={**other.sensors, **self.sensors},
            recordings=(*self.recordings, *other.recordings),
        )  # fmt: skip

    def without(self, drop: Sequence[bool], reason: str) -> Dataset:
        """The data set without some windows, and remarks that say why."""
        stay = tuple(w for w, out in zip(self.windows, drop, strict=True) if not out)
        gone = [w for w, out in zip(self.windows, drop, strict=True) if out]
        remarks = tuple(f"{w.name}: left out from {w.begin:.0f} to {w.end:.0f} s: {reason}" for w in gone)
        return replace(self, windows=stay, remarks=(*self.remarks, *remarks), dropped=(*self.dropped, *gone))


@dataclass(frozen=True)
class Spoilt:
    """A stretch of a recording that would spoil every figure, and why."""

    recording: int
    begin: float  # [s] since the recording's first stamp
    end: float
    reason: str  # with the name of the recording
    sensor: str = ""  # whose signal it is, where it is one alone
    components: tuple[int, ...] = ()  # of that sensor


def build_dataset(
    recordings: Sequence[Recording], vehicle: Vehicle, seen: Dataset | None = None, spoilt: Sequence[Spoilt] = ()
) -> Dataset:
    """Windows of all recordings in which the car drives and its steering angle and speed are known, outside of what is
    `spoilt`. Their places are those of `seen` where the car comes there again, and what they turn is counted from the
    same way."""
    road = Road() if seen is None else seen.road
    on_map = _map(recordings) if seen is None else seen.on_map
    sets_out = None if seen is None else seen.sets_out
    windows: list[Window] = []
    remarks: list[str] = []
    used: dict[str, SensorBase] = {}
    sensors = vehicle.sensing()
    for index, recording in enumerate(recordings):
        name = recording.name or f"recording {index + 1}"
        readings = _readings(recording, name, sensors, on_map, remarks)
        used |= {sensor: sensors[sensor] for sensor in readings}
        used_sensors = {sensor: sensors[sensor] for sensor in readings}
        silent = "; ".join(unheard(recording.channels, sensors.values(), vehicle.name))
        silent = f" ({silent})" if silent else ""
        if best_measuring(used_sensors.items(), "steering") is None:
            remarks.append(f"{name}: no steering angle, which drives the model{silent}; {LEFT_OUT}")
            continue
        speed = _speed(readings, used_sensors, vehicle)
        if speed is None:
            remarks.append(f"{name}: neither wheel speeds nor GNSS velocity{silent}; {LEFT_OUT}")
            continue
        place = _place(road, speed, _of(readings, used_sensors, "position"))
        headed, on_the_map = _headed(readings, used_sensors, speed)
        outset = float(np.median(headed.value[:5]))
        if on_the_map:
            outset = sets_out = outset if sets_out is None else sets_out
        turned = Readings(headed.t, headed.value - outset)
        inertial = _of(readings, used_sensors, "rates and forces")
        stretches = [
            replace(window, yaw_rate=_yaw_rate(inertial, window.begin) if inertial is not None else 0.0)
            for window in _windows(
                index, name, readings, used_sensors, speed, headed, turned, place,
                [(cut.begin, cut.end) for cut in spoilt if cut.recording == index],
            )
        ]  # fmt: skip
        if not stretches:
            seldom = _seldom(readings, used_sensors)
            remarks.append(
                f"{name}: nowhere {WINDOWS.shortest:g} s of driving above {WINDOWS.slowest:g} m/s without a gap"
                f"{seldom}{silent if seldom else ''}; {LEFT_OUT}"
            )
        windows += stretches
    return Dataset(tuple(windows), used, tuple(r.name for r in recordings), tuple(remarks), road, on_map, sets_out)


def _map(recordings: Iterable[Recording]) -> Map:
    """The map of the first recording that has an origin."""
    origins = [origin for recording in recordings if (origin := recording.map_origin) is not None]
    return Map(origins[0] if origins else None)


def _readings(
    recording: Recording, name: str, sensors: Mapping[str, SensorBase], on_map: Map, remarks: list[str]
) -> dict[str, Readings]:
    """The measurements of each sensor that has any; `remarks` gets why the messages of one cannot be used."""
    readings: dict[str, Readings] = {}
    for sensor, settings in sensors.items():
        read = _read(recording, settings, on_map)
        if isinstance(read, str):
            remarks.append(f"{name}: nothing of {settings.topic} can be used: {read}")
        elif read is not None:
            readings[sensor] = read
    return readings


def _read(recording: Recording, sensor: SensorBase, on_map: Map) -> Readings | str | None:
    """The measurements of a sensor; why there are none in its messages; nothing where there are no messages."""
    if sensor.topic not in recording or len(recording[sensor.topic]) < 2:
        return None
    channel = recording[sensor.topic]
    stamp, value, _, why = Reader(0, sensor, on_map).measurements(channel)
    if len(stamp) < 2:
        return why
    if not (np.diff(stamp) > 0).all():
        order = np.argsort(stamp, kind="stable")
        order = order[np.concatenate([[True], np.diff(stamp[order]) > 0])]
        stamp, value = stamp[order], value[order]
    t = np.asarray((stamp - recording.first_stamp) * 1e-9, dtype=np.float64)
    value = _at_one_time(t, value, sensor.ages() - sensor.latency)
    t, value = _averaged(t, value)
    of_car = sensor.in_axes_of_car(value)
    return Readings(t, of_car, None if of_car is value else value)


def _at_one_time(t: Array, value: Array, older: Array) -> Array:
    """Values (n, m) at times (n,), of which components were measured earlier than these say, by so much (m,) [s]."""
    if not older.any():
        return value
    interpolated = value.copy()
    for column in np.flatnonzero(older):
        present = np.isfinite(value[:, column])
        if present.sum() >= 2:
            at = t[present] - older[column]
            interpolated[:, column] = np.interp(t, at, value[present, column], np.nan, np.nan)
            interpolated[~present, column] = np.nan
    return interpolated


def _averaged(t: Array, value: Array) -> tuple[Array, Array]:
    """Measurements (n, m) at times (n,) as means of those in each step of the grid [s], where there are several: what
    is faster than the grid would be taken for something slower. A component is NaN where all of them are. Values that
    are held for longer than that stay, so that it is seen that they are."""
    if np.median(np.diff(t)) * (period_of_updates(value) or 1) > WINDOWS.several * WINDOWS.grid:
        return t, value
    cell = np.floor((t - t[0]) / WINDOWS.grid)
    first = np.flatnonzero(np.diff(cell, prepend=-1.0))
    present = np.isfinite(value)
    with np.errstate(invalid="ignore"):
        mean = np.add.reduceat(np.where(present, value, 0.0), first) / np.add.reduceat(present, first, dtype=float)
    return np.add.reduceat(t, first) / np.diff(first, append=len(t)), mean


def _of(readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], what: MeasuredQuantity) -> Readings | None:
    """The measurements of something, if there are any."""
    name = best_measuring(((name, sensors[name]) for name in readings), what)
    return None if name is None else readings[name]


def _speed(readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], vehicle: Vehicle) -> Readings | None:
    """Speed from the wheels, else over ground."""
    for what in SPEEDS:
        name = best_measuring(sensors.items(), what)
        if name is None:
            continue
        wheels = readings[name]
        value = sensors[name].speeds(wheels.value, rolling_radii(vehicle))
        present = np.isfinite(value)
        if present.sum() < 2:
            continue
        speed = Readings(wheels.t[present], value[present, None])
        inertial = _of(readings, sensors, "rates and forces")
        slow = what == "ground speed" and float(np.median(np.diff(speed.t))) > WINDOWS.slow_period
        return _between(speed, inertial) if slow and inertial is not None else speed
    return None


def _seldom(readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase]) -> str:
    """Which topics that a window needs always come with gaps, in words; empty where none does."""
    speeds = (name for what in SPEEDS if (name := best_measuring(sensors.items(), what)) is not None)
    inputs = (best_measuring(sensors.items(), what) for what in INPUTS)
    periods = {name: float(np.median(np.diff(readings[name].t))) for name in (next(speeds, None), *inputs) if name}
    slow = (f"{sensors[n].topic} comes every {p:.2g} s" for n, p in periods.items() if p > WINDOWS.largest_gap)
    return f" of {WINDOWS.largest_gap:g} s: {words}" if (words := ", ".join(slow)) else ""


def _between(speed: Readings, imu: Readings) -> Readings:
    """A speed that is measured now and then, (n, 1) [m/s], and between that as the accelerometer has it: what lasts is
    from the one, what changes within a second from the other (a complementary filter without delay). Gaps stay gaps."""
    present = np.isfinite(imu.value[:, 3])
    if present.sum() < 2:
        return speed
    at, force = imu.t[present], imu.value[present, 3]
    t = np.arange(max(speed.t[0], at[0]), min(speed.t[-1], at[-1]), WINDOWS.grid)
    if len(t) < WINDOWS.shortest / WINDOWS.grid:
        return speed
    felt = cumulative_trapezoid(np.interp(t, at, force), t, initial=0)
    lasting = butter(1, WINDOWS.crossover, fs=1 / WINDOWS.grid, output="sos")
    rest = sosfiltfilt(lasting, np.interp(t, speed.t, speed.value[:, 0]) - felt)
    known = _without_gaps(t, speed.t) & _without_gaps(t, at)
    return Readings(t[known], (felt + rest)[known, None]) if known.sum() >= 2 else speed


def _headed(
    readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], speed: Readings
) -> tuple[Readings, bool]:
    """Course over ground (n, 1) [rad], and whether that is the one on the map: without GNSS it is the heading, as if
    the recording set out eastwards."""
    if (velocity := _of(readings, sensors, "course")) is not None:
        moving = np.isfinite(velocity.value).all(axis=1) & (np.hypot(*velocity.value[:, :2].T) > WINDOWS.slowest)
        if moving.sum() >= 2:
            course = np.unwrap(np.arctan2(velocity.value[moving, 1], velocity.value[moving, 0]))
            return Readings(velocity.t[moving], course[:, None]), True
    if (imu := _of(readings, sensors, "rates and forces")) is not None:
        present = np.isfinite(imu.value[:, 2]) & (imu.t >= speed.t[0])
        if present.sum() >= 2:
            t, rate = imu.t[present], imu.value[present, 2]
            angle = cumulative_trapezoid(rate, t, initial=0)
            return Readings(t, angle[:, None]), False
    return Readings(speed.t, np.zeros((len(speed.t), 1))), False


def _yaw_rate(imu: Readings, at: float) -> float:
    """Mean yaw rate [rad/s] about a time [s], of an inertial sensor in the axes of the car; zero if it is not known."""
    near = imu.value[np.abs(imu.t - at) < WINDOWS.beginning, 2]
    near = near[np.isfinite(near)]
    return float(near.mean()) if len(near) else 0.0


def _place(road: Road, speed: Readings, position: Readings | None) -> Readings:
    """Abscissa of a whole recording, by time. Without positions it has a stretch of the road for itself."""
    t, v = speed.t, speed.value[:, 0]
    travelled = cumulative_trapezoid(v, t, initial=0)
    if position is not None:
        known = np.isfinite(position.value).all(axis=1) & (position.t >= t[0]) & (position.t <= t[-1])
        at = np.interp(position.t[known], t, travelled)
        apart = np.concatenate([[True], np.diff(at) > 0.0]) if len(at) else np.zeros(0, dtype=bool)
        if apart.sum() >= 2:
            east, north = position.value[known][apart].T
            distance, abscissa = road.follow(at[apart], east, north)
            if len(distance) >= 2:
                distance, abscissa = _to_both_ends(distance, abscissa, travelled)
                return _without_jumps(np.interp(distance, travelled, t), distance, abscissa)
    return Readings(t, (road.begin() + travelled)[:, None])


def _to_both_ends(distance: Array, abscissa: Array, travelled: Array) -> tuple[Array, Array]:
    """Positions extended to the beginning and the end of what was travelled."""
    before, after = travelled[travelled < distance[0]], travelled[travelled > distance[-1]]
    on = abscissa[0] + before - distance[0], abscissa, abscissa[-1] + after - distance[-1]
    return np.concatenate([before, distance, after]), np.concatenate(on)


def _without_jumps(t: Array, distance: Array, abscissa: Array) -> Readings:
    """Where the abscissa jumps it does so between two times that are as good as one, instead of on the way."""
    jumps = np.flatnonzero(np.abs(np.diff(abscissa) - np.diff(distance)) > ROAD_SETTINGS.along) + 1
    before = t[jumps] - 1e-6
    reached = abscissa[jumps - 1] + distance[jumps] - distance[jumps - 1]
    return Readings(np.insert(t, jumps, before), np.insert(abscissa, jumps, reached)[:, None])


def _windows(
    index: int,
    name: str,
    readings: Mapping[str, Readings],
    sensors: Mapping[str, SensorBase],
    speed: Readings,
    headed: Readings,
    turned: Readings,
    place: Readings,
    spoilt: Sequence[tuple[float, float]],
) -> Iterable[Window]:
    inputs = [_of(readings, sensors, what) for what in INPUTS]
    torques = _of(readings, sensors, "torques") is not None
    needed = [speed, *(driving for driving in inputs if driving is not None)]
    for begin, end in _driving(speed, needed, spoilt):
        parts = max(1, int(np.ceil((end - begin - WINDOWS.run_in) / (WINDOWS.longest - WINDOWS.run_in))))
        length = (end - begin - WINDOWS.run_in) / parts
        for part in range(parts):
            first, last = begin + part * length, begin + (part + 1) * length + WINDOWS.run_in
            inside = within(readings, first - 1.0, last + 1.0)
            yield Window(
                index, name, first, last, inside, _cut(speed, first - 1.0, last + 1.0),
                _course(inside, sensors, first, headed), torques, _spanning(turned, first - 1.0, last + 1.0),
                _spanning(place, first - 1.0, last + 1.0),
            )  # fmt: skip


def _driving(
    speed: Readings, needed: Sequence[Readings], spoilt: Sequence[tuple[float, float]]
) -> Iterable[tuple[float, float]]:
    """Stretches above the slowest speed, outside of what is spoilt, in which no needed signal has a gap."""
    grid = np.arange(speed.t[0], speed.t[-1], 0.05)
    good = np.interp(grid, speed.t, speed.value[:, 0]) > WINDOWS.slowest
    for rows in needed:
        t = rows.t[np.isfinite(rows.value).all(axis=1)]
        if len(t) < 2:
            return
        good &= (grid >= t[0]) & (grid <= t[-1]) & _without_gaps(grid, t)
    for first, last in spoilt:
        good &= (grid < first) | (grid > last)
    for row, behind in stretches(good):
        begin, end = float(grid[row]), float(grid[behind - 1])
        if end - begin >= WINDOWS.shortest:
            yield begin, end


def _without_gaps(t: Array, times: Array) -> NDArray[np.bool_]:
    """Which of the times (n,) are not within a gap between messages at other `times` (m,) [s]."""
    between = np.ones(len(t), dtype=bool)
    for gap in np.flatnonzero(np.diff(times) > WINDOWS.largest_gap):
        between &= (t <= times[gap]) | (t >= times[gap + 1])
    return between


def within(readings: Mapping[str, Readings], first: float, last: float) -> dict[str, Readings]:
    """Those from one time to another of each sensor that has two of them."""
    inside = {sensor: _cut(rows, first, last) for sensor, rows in readings.items()}
    return {sensor: rows for sensor, rows in inside.items() if len(rows.t) >= 2}


def _cut(readings: Readings, first: float, last: float) -> Readings:
    """Those from one time to another, of the same memory: a long recording has hundreds of windows."""
    return readings.rows(slice(np.searchsorted(readings.t, first), np.searchsorted(readings.t, last, "right")))


def _spanning(readings: Readings, first: float, last: float) -> Readings:
    """With the nearest before and after besides, so that there is always one, however long nothing was measured."""
    begin = max(int(np.searchsorted(readings.t, first, "right")) - 1, 0)
    end = int(np.searchsorted(readings.t, last, "left")) + 1
    return readings.rows(slice(begin, end))


def _course(readings: Mapping[str, Readings], sensors: Mapping[str, SensorBase], at: float, headed: Readings) -> float:
    velocity = _of(readings, sensors, "course")
    present = np.isfinite(velocity.value).all(axis=1) if velocity is not None else np.zeros(0, dtype=bool)
    if velocity is None or not present.any():
        return float(np.interp(at, headed.t, headed.value[:, 0]))
    nearest = np.flatnonzero(present)[np.argmin(np.abs(velocity.t[present] - at))]
    east, north = velocity.value[nearest, :2]
    return float(np.arctan2(north, east))
