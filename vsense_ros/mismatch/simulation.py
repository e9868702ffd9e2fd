"""What a car would have measured in the windows of the recordings, as a function of everything that may be wrong."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen.rows import OfRows
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.driving import Drives, Driving
from vsense_ros.mismatch.effect_parameters import effect_of, parameters_of, with_all_effects
from vsense_ros.mismatch.near import MotionsNear, Moved
from vsense_ros.mismatch.prediction_settings import PREDICTION
from vsense_ros.mismatch.road_in_windows import RoadsInWindows
from vsense_ros.mismatch.signals import Sensed, noise, signals
from vsense_ros.mismatch.windows import WINDOWS, Dataset, Readings, Window
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.car.kinematics import motion_of
from vsense_ros.model.coordinates import SPIN, X, Y
from vsense_ros.model.effects import EVERY
from vsense_ros.model.effects.base import role
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.simulation.open_loop import OpenLoop, Run, StateHistory
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


LOST = "the simulated car spins, or locks a wheel, where the real one did not"


class Predictor:
    """Simulates the windows; keeps the last motions, so that what concerns sensors alone costs little."""

    def __init__(self, vehicle: Vehicle, dataset: Dataset) -> None:
        self.vehicle = with_all_effects(vehicle)
        self.start = parameters_of(vehicle)
        self.dataset = dataset
        self.car = car_of(self.vehicle)
        self.names = self.car.parameter_names
        self._loop = OpenLoop(self.car, PREDICTION.keep_every, PREDICTION.renew_every)
        self._motions: list[dict[int, Moved]] = [{} for _ in dataset.windows]  # by key
        self._near = None if self._loop.library is None else MotionsNear(self._loop)
        # Parameter sets that are driven at once. Motions near a known one, of one window at a time, need as many as
        # there are lanes; with more, long recordings would only take more memory.
        self.ahead = _at_once(len(dataset.windows), self._loop.lanes)
        if self._near is not None:
            self.ahead = max(self.ahead, self._loop.lanes)
        self._asked: list[tuple[ParameterSet, Mapping[str, SensorBase], list[Driving]]] = []  # the last at the end
        self._kept = PREDICTION.remembered + self.ahead
        self._moving = _parameters_of_motion(self.car)
        self.drives = Drives(self.vehicle, dataset, self.names)
        self.radius = self.drives.radius
        self.roads = RoadsInWindows(self.vehicle, dataset, self.start, self._moving, self._kept)
        self._measuring_sensors = {name: sensor for name, sensor in dataset.sensors.items() if sensor.signals}
        self._sensing = _Sensing(self.car, self._measuring_sensors)

    @cached_property
    def measured(self) -> list[dict[str, Array]]:
        """Signals of each window."""
        return [signals(*window) for window in self._measuring()]

    @cached_property
    def noise(self) -> dict[str, float]:
        """White noise of the measured signals."""
        return noise(self._measuring())

    def _measuring(self) -> Iterator[Sensed]:
        for window in self.dataset.windows:
            readings = {name: rows for name, rows in window.readings.items() if name in self._measuring_sensors}
            yield window, readings, self.dataset.sensors, self.radius

    def simulated(self, parameter_set: ParameterSet) -> list[dict[str, Array]]:
        """Signals of each window as a car with these parameters would have them; empty where it left all bounds."""
        sensors, _ = self._ways(parameter_set)
        result = []
        reading = hash(tuple(sensors.items()))
        for window, (moved, way) in zip(self.dataset.windows, self._all_moved(parameter_set), strict=True):
            known = moved.signals
            if reading not in known:
                if len(known) > 3:
                    known.pop(next(iter(known)))
                known[reading] = self._signals(window, moved.motion, sensors, way)
            result.append(known[reading])
        return result

    def lost(self, parameter_set: ParameterSet) -> list[bool]:
        """True for each window in which the simulated car gets lost."""
        return [bool(np.isfinite(instant)) for instant in self.lost_from(parameter_set)]

    def lost_from(self, parameter_set: ParameterSet) -> list[float]:
        """When in each window the simulated car loses the road, or a wheel does, where the real one does not [s];
        infinite where it never does. What was steered and braked for another car does not hold one at its limit, and
        says no more than that."""
        return [moved.lost_from for moved, _ in self._all_moved(parameter_set)]

    def _moved(self, index: int, motion: StateHistory) -> Moved:
        return Moved(motion, self._lost_from(index, motion))

    def _lost_from(self, index: int, motion: StateHistory) -> float:
        """The instant from which the simulated car is lost in one window [s], as `lost_from`."""
        begin = self.dataset.windows[index].begin
        if not _in_bounds(motion):
            return begin
        lost = ~(np.abs(motion.u[:, Y]) < np.tan(PREDICTION.spun) * motion.u[:, X])  # spun is below a quarter turn
        if not self._slipped[index]:
            rolling = motion.u[:, SPIN] * self.radius - motion.u[:, [X]]
            lost |= np.any(
                np.abs(rolling) > PREDICTION.slipping_share * np.maximum(motion.u[:, [X]], WINDOWS.slowest), axis=1
            )
        return begin + float(motion.t[np.argmax(lost)]) if lost.any() else np.inf

    @cached_property
    def _slipped(self) -> list[bool]:
        """True for each window in which wheels locked or spun."""
        slipping = []
        for window in self.dataset.windows:
            slips = False
            for name, readings in window.readings.items():
                if "rolling speed" not in self.dataset.sensors[name].measures:
                    continue
                speed = readings.value[np.isfinite(readings.value).all(axis=1)] * self.radius
                usual = np.median(speed, axis=1, keepdims=True)
                slips |= bool(
                    np.any(np.abs(speed - usual) > PREDICTION.slipping_share * np.maximum(usual, WINDOWS.slowest))
                )
            slipping.append(slips)
        return slipping

    def foresee(self, parameter_sets: Sequence[ParameterSet]) -> None:
        """Drive the windows with up to `ahead` parameter sets side by side; what then is asked of them is known."""
        self._drive([self._ways(one)[1] for one in parameter_sets])

    def foresee_near(self, near: ParameterSet, parameter_sets: Sequence[ParameterSet]) -> None:
        """Drive the windows with up to `ahead` parameter sets by how far they are from one that is `near` them, for
        secants: what is then asked of these objects is known. Driven in full are windows in which a car gets lost, and
        all of them for parameter sets that `_in_full` is true of."""
        quick = [one for one in parameter_sets if not self._in_full(one)]
        if self._near is None or self._in_full(near) or not quick:
            return self.foresee(parameter_sets)
        self.foresee([one for one in parameter_sets if self._in_full(one)])
        every = [self._ways(one)[1] for one in quick]
        _, known = self._ways(near)
        moved = [one for one, _ in self._all_moved(near)]
        runs = [self.drives.run(i, way, self._remembered[i]) for i, way in enumerate(known)]
        on_the_road = [i for i, one in enumerate(moved) if np.isinf(one.lost_from)]
        self._near.begin({i: (known[i].key, runs[i], moved[i].motion) for i in on_the_road}, quick)
        for index in on_the_road:
            self._drive_near(self._near, index, [ways[index] for ways in every])

    def _drive_near(self, near: MotionsNear, index: int, ways: Sequence[Driving]) -> None:
        """Drive a window several times by how far it is from the motion that is known of it. Where the car gets lost
        the window stays to be driven in full."""
        new = {way.key: way for way in ways if way.key not in self._motions[index]}
        driven = near.drive(index, [self.drives.run(index, way, self._remembered[index]) for way in new.values()])
        for key, motion in zip(new, driven, strict=True):
            moved = self._moved(index, motion)
            if np.isinf(moved.lost_from):
                near.motions[index, key] = moved

    def _in_full(self, parameter_set: ParameterSet) -> bool:
        """True if a parameter set is not simulated by its distance from another: an effect has a size that remembers,
        or that is abrupt."""
        return any(parameter_set.values[name] for name in self._sizes_in_full)

    @cached_property
    def _sizes_in_full(self) -> list[str]:
        """Names of the sizes of effects that remember, or that are abrupt."""
        return [
            f"effects.{id}.{name}"
            for id, effect in EVERY.items()
            if id in self.car.internal_state_slices or effect.abrupt
            for name, field in effect.model_fields.items()
            if role(field) == "size"
        ]

    def _ways(self, parameter_set: ParameterSet) -> tuple[Mapping[str, SensorBase], list[Driving]]:
        """The sensors, and what the motion in each window depends on; of the sets that were asked for last known."""
        for known, sensors, ways in reversed(self._asked):
            if known is parameter_set:
                return sensors, ways
        sensors = self._sensors(parameter_set)
        parameters = np.array([parameter_set.values[name] for name in self.names])
        mechanical = [v for n, v in zip(self.names, parameters.tolist(), strict=True) if n in self._moving]
        ways = [
            self.drives.driving(index, parameter_set, sensors, road, parameters, mechanical)
            for index, road in enumerate(self.roads.roads(parameter_set))
        ]
        self._asked = [*self._asked[-self._kept :], (parameter_set, sensors, ways)]
        return sensors, ways

    def _drive(self, several: Sequence[Sequence[Driving]], near: Collection[tuple[int, int]] = ()) -> None:
        """Side by side what was not driven before; of windows and keys `near` a known motion it is known enough."""
        new = {
            (index, way.key): way
            for ways in several
            for index, way in enumerate(ways)
            if way.key not in self._motions[index] and (index, way.key) not in near
        }
        motions = self._loop.runs(
            [self.drives.run(index, way, self._remembered[index]) for (index, _), way in new.items()]
        )
        for (index, key), motion in zip(new, motions, strict=True):
            known = self._motions[index]
            if len(known) >= self._kept:
                known.pop(next(iter(known)))
            known[key] = self._moved(index, motion)

    def _all_moved(self, parameter_set: ParameterSet) -> list[tuple[Moved, Driving]]:
        """The motion in each window with what is known of it, and what it depends on."""
        _, ways = self._ways(parameter_set)
        near = {} if self._near is None else self._near.known_of(parameter_set)
        self._drive([ways], near)
        motions = []
        for index, (way, known) in enumerate(zip(ways, self._motions, strict=True)):
            if way.key in known:
                known[way.key] = known.pop(way.key)  # the last to be forgotten
                motions.append((known[way.key], way))
            else:
                motions.append((near[index, way.key], way))
        return motions

    def _sensors(self, parameter_set: ParameterSet) -> dict[str, SensorBase]:
        sensors = self._sensors_of_car
        for id in EVERY:
            sensors = effect_of(parameter_set, id).sensors(sensors)
        return sensors

    @cached_property
    def _sensors_of_car(self) -> dict[str, SensorBase]:
        """Those of the data set as they are without the effects of the vehicle file, which a parameter set has."""
        return {name: s for name, s in self.vehicle.sensors_of_car().items() if name in self.dataset.sensors}

    @cached_property
    def _remembered(self) -> list[Array]:
        """What lasts of what the effects remember where each window begins, (m,), of those before it in its recording:
        as the car of the vehicle file is driven through these, in which effects remember whatever their size. Nothing
        of what this car does in a window in which it gets lost."""
        windows = self.dataset.windows
        memories = [np.zeros(self.car.internal_state.numel()) for _ in windows]
        in_order = [sorted(of, key=lambda index: windows[index].begin) for of in self.dataset.places_by_recording()]
        _, ways = self._ways(self.start)
        for place in range(max(map(len, in_order), default=0) - 1):
            pairs = [of[place : place + 2] for of in in_order if len(of) > place + 1]
            runs = [
                self._until(windows[after].begin, before, ways[before], memories[before]) for before, after in pairs
            ]
            for (before, after), motion in zip(pairs, self._loop.runs(runs), strict=True):
                lost = np.isfinite(self._lost_from(before, motion)) or not np.isfinite(motion.internal_state).all()
                memory = memories[before] if lost else motion.internal_state
                memories[after] = self._rested(memory, max(0.0, windows[after].begin - windows[before].end))
        return memories

    def _until(self, end: float, index: int, way: Driving, memory: Array) -> Run:
        """The run of a window up to a time [s]."""
        run = self.drives.run(index, way, memory)
        return replace(run, inputs=run.inputs.first(round((end - self.dataset.windows[index].begin) / PREDICTION.step)))

    def _rested(self, memory: Array, duration: float) -> Array:
        """What lasts of the memory of all effects after a while [s] that no window shows."""
        rested = memory.copy()
        for id, part in self.car.internal_state_slices.items():
            rested[part] = effect_of(self.start, id).relaxed(memory[part], duration)
        return rested

    def _signals(
        self, window: Window, motion: StateHistory, sensors: Mapping[str, SensorBase], way: Driving
    ) -> dict[str, Array]:
        if not _in_bounds(motion):
            return {}
        readings = {}
        for name, sensed in self._sensing(motion, way.around[:: PREDICTION.keep_every], sensors):
            if name not in window.readings:
                continue
            stamps, base, now = window.readings[name].t, self.dataset.sensors[name], sensors[name]
            value = sensed + now.offsets() - base.offsets()
            older = now.ages() - base.ages()
            at = stamps - window.begin
            read = np.column_stack(
                [np.interp(at - age, motion.t, column) for age, column in zip(older, value.T, strict=True)]
            )
            read[~np.isfinite(window.readings[name].in_own_axes.value)] = np.nan
            readings[name] = Readings(stamps, base.in_axes_of_car(read))
        return signals(window, readings, self.dataset.sensors, self.radius)


def _at_once(windows: int, lanes: int) -> int:
    """How many parameter sets are driven at once: about `PREDICTION.side_by_side` runs, or up to twice as many if these
    leave fewer lanes of the vectors empty."""
    fewest = max(1, PREDICTION.side_by_side // max(windows, 1))

    def empty(count: int) -> float:
        """Share of the lanes."""
        runs = count * max(windows, 1)
        return 1 - runs / (-(-runs // lanes) * lanes)

    return min(range(fewest, 2 * fewest + 1), key=empty)


def _in_bounds(motion: StateHistory) -> bool:
    return bool(np.isfinite(motion.u[-1]).all())


def _parameters_of_motion(car: Car) -> frozenset[str]:
    """Names of the parameters that the motion of a car depends on; the others concern its sensors alone."""
    moving = ca.vertcat(car.dynamics, car.next_internal_state(ca.SX(PREDICTION.step)))
    used = {symbol.name() for symbol in ca.symvar(moving)}
    symbols = zip(car.parameter_names, ca.vertsplit(car.p), strict=True)
    return frozenset(name for name, symbol in symbols if symbol.name() in used)


class _Sensing:
    """What all sensors would measure at all instants of a motion."""

    def __init__(self, car: Car, sensors: Mapping[str, SensorBase]) -> None:
        udot = ca.SX.sym("udot", 14)
        motion = motion_of(car.q, car.u, udot, car.disturbances, ca.SX.zeros(car.inputs.numel()))
        mountings = {name: ca.SX.sym(name, len(sensor.mounting())) for name, sensor in sensors.items()}
        measured = [
            sensor.equation(motion, ca.SX.zeros(len(sensor.biases())), mountings[name])
            for name, sensor in sensors.items()
        ]
        ends = np.cumsum([values.numel() for values in measured], dtype=int)
        self._places = {name: slice(end - v.numel(), end) for name, end, v in zip(sensors, ends, measured, strict=True)}
        arguments = [car.q, car.u, udot, car.disturbances, ca.vertcat(*mountings.values())]
        names = ["q", "u", "udot", "g", "mountings"]
        function = ca.Function("sensing", arguments, [ca.densify(ca.vertcat(*measured))], names, ["measured"])
        self._of_rows = OfRows(function, constant={"mountings"})

    def __call__(
        self, motion: StateHistory, around: Array, sensors: Mapping[str, SensorBase]
    ) -> Iterator[tuple[str, Array]]:
        """The name of each sensor, as it is mounted now, with its measurements (rows, components)."""
        mountings = np.concatenate([np.zeros(0), *(sensors[name].mounting() for name in self._places)])
        measured = self._of_rows(motion.q, motion.u, motion.udot, around, mountings)
        return ((name, measured[:, place]) for name, place in self._places.items())
