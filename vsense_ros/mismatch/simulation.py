"""What a car would have measured in the windows of the recordings, as a function of everything that may be wrong."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.identify.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import TORQUE_SHARES, size_of
from vsense_ros.mismatch.road import bending, curvature, place_of, profile, profile_change
from vsense_ros.mismatch.signals import noise, signals
from vsense_ros.mismatch.windows import (
    HOLDING_TIME,
    INPUTS,
    RUN_IN,
    SLOWEST,
    SPEEDS,
    Dataset,
    Readings,
    Window,
)
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.car.kinematics import motion_of
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import (
    BANK,
    BANK_CHANGE,
    DISTURBANCES,
    GRADE,
    GRADE_CHANGE,
    SPIN,
    STEERING,
    TORQUES,
    YAW,
    X,
    Y,
)
from vsense_ros.model.coordinates import INPUTS as INPUT_NAMES
from vsense_ros.model.effects import BY_ID, EVERY, Effect, Effects
from vsense_ros.model.effects.base import AXLES, bounds
from vsense_ros.model.sensors import SensorBase, Tells, telling
from vsense_ros.model.simulation.closed_loop import rolling_radii, rolling_straight
from vsense_ros.model.simulation.open_loop import Inputs, OpenLoop, Run, StateHistory
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PredictionSettings:
    """Settings of the simulation of windows: decisions of this project."""

    step: float = 0.005  # [s] of the simulation
    keep_every: int = 2  # steps
    remembered: int = 3  # motions of each window, besides those that are foreseen
    spun: float = 0.5  # [rad] of side slip from which cars do not come back
    # [-] force over load per slip that is assumed of tyres to begin with; their own is fitted
    slip_stiffness: float = 20.0
    cornering_stiffness: float = 14.0  # [1/rad] lateral force over load per slip angle, where a window begins
    braked: float = 0.6  # [m/s²] of deceleration that needs brakes: less is drag and engine
    smoothing: float = 0.3  # [s] of the mean that separates driving from braking
    driving_torque: float = 1.0  # [N m] of torque that a driven wheel exceeds in a twentieth of the time, at least
    driving_percentile: float = 95.0  # [%] of the time below that torque
    not_driven_share: float = 0.15  # [-] of the torque, of all or of the other axle, below which an axle is not driven
    slipping_share: float = 0.5  # [-] of the speed, from where on a wheel that slips locks or spins


PREDICTION = PredictionSettings()

SIDE_BY_SIDE = (
    16  # runs that are given to the vectors at once, about: twice what the widest hold (AVX-512, eight lanes)
)
LOST = "the simulated car spins, or locks a wheel, where the real one did not"
_FIX = ("latitude", "longitude", "altitude")
_SLOPING = tuple(id for id, effect in BY_ID.items() if effect.slope is not Effect.slope)


def with_all_effects(vehicle: Vehicle) -> Vehicle:
    """The vehicle with every effect of the library present, of size zero where the file does not have it."""
    effects = vehicle.physics.effects
    every = {id: getattr(effects, id) or effect() for id, effect in EVERY.items()}
    return vehicle.model_copy(update={"physics": vehicle.physics.model_copy(update={"effects": Effects(**every)})})


def parameters_of(vehicle: Vehicle) -> ParameterSet:
    """One car on one road: physical parameters by name, effects that the vehicle file does not have with size zero, and
    what is assumed of unknown torques. A search adds by the names of `road.point` what a size is at places along the
    road, beyond what it is everywhere."""
    return ParameterSet({**with_all_effects(vehicle).values(), **TORQUE_SHARES})


def effect_of(parameter_set: ParameterSet, id: str, varying: Mapping[str, Array] | None = None) -> Effect:
    """An effect with its present parameters, some of which may be `varying`."""
    kind, known = EVERY[id], {**parameter_set.values, **(varying or {})}
    names = {field: f"effects.{id}.{field}" for field in kind.model_fields}
    return kind.model_construct(None, **{f: known[name] for f, name in names.items() if name in known})


Profiles = Mapping[str, Mapping[float, float]]  # values by abscissa [m], by the name of the size


def profiles_of(parameter_set: ParameterSet) -> Profiles:
    """What sizes are at places along the road, beyond what they are everywhere."""
    found: dict[str, dict[float, float]] = {}
    for name, value in parameter_set.values.items():
        if (at := place_of(name)) is not None:
            found.setdefault(at[0], {})[at[1]] = value
    return found


def varying_sizes(values: Mapping[str, float], profiles: Sequence[Profiles], place: Array) -> dict[str, Array]:
    """Sizes that are not constant along places with these abscissae [m], by name, where `values` are what they are
    everywhere and each of the `profiles` adds to that."""
    found: dict[str, Array] = {}
    for name, points in (pair for one in profiles for pair in one.items()):
        found[name] = found.get(name, 0.0) + profile(points, place)
    return {name: np.clip(values[name] + v, *_physical(name)) for name, v in found.items() if v.any()}


def _change(name: str, profiles: Sequence[Profiles], place: Array) -> Array:
    """What a size changes by per metre at places with these abscissae [m]."""
    return sum((profile_change(one[name], place) for one in profiles if name in one), np.zeros(len(place)))


@dataclass(frozen=True)
class _Driving:
    """What the motion in a window depends on."""

    key: int  # the same where all of it is
    parameters: Array
    shares: Sequence[float]  # as TORQUE_SHARES
    delays: tuple[float, float, float]  # of steering, torques and what gives the speed [s]
    around: Array  # (n, 7) as model.coordinates.DISTURBANCES
    varying: Mapping[str, Array]  # (n,) by name, of parameters that change along the road


@dataclass(frozen=True)
class _RoadInWindow:
    """The road that a car meets in a window; its arrays are shared and not to be changed."""

    key: int  # the same where all of it is
    around: Array  # (n, 7) as model.coordinates.DISTURBANCES
    felt: Mapping[str, Array]  # (n,) by name, of parameters of the motion that change along it


class Predictor:
    """Simulates the windows; keeps the last motions, so that what concerns sensors alone costs little."""

    def __init__(self, vehicle: Vehicle, dataset: Dataset) -> None:
        self.vehicle = with_all_effects(vehicle)
        self.start = parameters_of(vehicle)
        self.dataset = dataset
        self.car = car_of(self.vehicle)
        self.names = self.car.parameter_names
        self.radius = float(np.mean(rolling_radii(vehicle)))
        self._loop = OpenLoop(self.car, PREDICTION.keep_every)
        self._motions: list[dict[int, tuple[StateHistory, dict[int, dict[str, Array]]]]] = [{} for _ in dataset.windows]
        self.ahead = _at_once(len(dataset.windows), self._loop.lanes)  # parameter sets that are driven at once
        self._asked: list[tuple[ParameterSet, Mapping[str, SensorBase], list[_Driving]]] = []  # the last at the end
        self._roads_met: dict[tuple, list[_RoadInWindow]] = {}
        measuring = {name: sensor for name, sensor in dataset.sensors.items() if sensor.signals}
        functions = [_equation(self.car, f"sense_{i}", sensor) for i, sensor in enumerate(measuring.values())]
        compiled = codegen.compiled("sensing", functions) if functions else []
        self._sensing = {name: _Sensing(function) for name, function in zip(measuring, compiled, strict=True)}

    @cached_property
    def measured(self) -> list[dict[str, Array]]:
        """Signals of each window."""
        return [signals(*window) for window in self._measuring()]

    @cached_property
    def noise(self) -> list[dict[str, float]]:
        """White noise of the measured signals of each window."""
        return [noise(*window) for window in self._measuring()]

    def _measuring(self) -> Iterator[tuple[Window, dict[str, Readings], Mapping[str, SensorBase], float]]:
        for window in self.dataset.windows:
            readings = {name: found for name, found in window.readings.items() if name in self._sensing}
            yield window, readings, self.dataset.sensors, self.radius

    def simulated(self, parameter_set: ParameterSet) -> list[dict[str, Array]]:
        """Signals of each window as a car with these parameters would have them; empty where it left all bounds."""
        sensors, _ = self._ways(parameter_set)
        result = []
        for window, (motion, sensed, way) in zip(self.dataset.windows, self._all_moved(parameter_set), strict=True):
            reading = hash(tuple(sensors.items()))
            if reading not in sensed:
                if len(sensed) > 3:
                    sensed.pop(next(iter(sensed)))
                sensed[reading] = self._signals(window, motion, sensors, way)
            result.append(sensed[reading])
        return result

    def lost(self, parameter_set: ParameterSet) -> list[bool]:
        """True for each window in which the simulated car gets lost."""
        return [bool(np.isfinite(instant)) for instant in self.lost_from(parameter_set)]

    def lost_from(self, parameter_set: ParameterSet) -> list[float]:
        """When in each window the simulated car loses the road, or a wheel does, where the real one does not [s];
        infinite where it never does. What was steered and braked for another car does not hold one at its limit, and
        says no more than that."""
        moved = self._all_moved(parameter_set)
        return [self._lost_from(index, motion) for index, (motion, _, _) in enumerate(moved)]

    def _lost_from(self, index: int, motion: StateHistory) -> float:
        """The instant from which the simulated car is lost in one window [s], as `lost_from`."""
        begin = self.dataset.windows[index].begin
        if not _in_bounds(motion):
            return begin
        lost = ~(np.abs(np.arctan2(motion.u[:, Y], motion.u[:, X])) < PREDICTION.spun)
        if not self._slipped[index]:
            rolling = motion.u[:, SPIN] * self.radius - motion.u[:, [X]]
            lost |= np.any(np.abs(rolling) > PREDICTION.slipping_share * np.maximum(motion.u[:, [X]], SLOWEST), axis=1)
        return begin + float(motion.t[np.argmax(lost)]) if lost.any() else np.inf

    @cached_property
    def _slipped(self) -> list[bool]:
        """True for each window in which wheels locked or spun."""
        found = []
        for window in self.dataset.windows:
            slips = False
            for name, readings in window.readings.items():
                if "rolling speed" not in self.dataset.sensors[name].tells:
                    continue
                speed = readings.value[np.isfinite(readings.value).all(axis=1)] * self.radius
                usual = np.median(speed, axis=1, keepdims=True)
                slips |= bool(np.any(np.abs(speed - usual) > PREDICTION.slipping_share * np.maximum(usual, SLOWEST)))
            found.append(slips)
        return found

    def foresee(self, parameter_sets: Sequence[ParameterSet]) -> None:
        """Drive the windows with up to `ahead` parameter sets side by side; what then is asked of them is known."""
        self._drive([self._ways(one)[1] for one in parameter_sets])

    def driven_axles(self, parameter_set: ParameterSet) -> frozenset[str]:
        """The axles that are driven: by wheel torques where they are measured, else by what is assumed of unknown
        ones."""
        torques = [
            window.readings[name].value
            for window in self.dataset.windows
            if window.torques and (name := self._telling(window.readings, "torques"))
        ]
        if torques:
            with np.errstate(all="ignore"):
                most = (
                    np.nanpercentile(np.concatenate(torques), PREDICTION.driving_percentile, axis=0)
                    .reshape(2, 2)
                    .max(axis=1)
                )
            least = max(PREDICTION.driving_torque, PREDICTION.not_driven_share * float(most.max()))
            return frozenset(axle for axle, torque in zip(AXLES, most, strict=True) if torque > least)
        front = parameter_set.values[next(iter(TORQUE_SHARES))]
        return frozenset(
            axle for axle, share in zip(AXLES, (front, 1 - front), strict=True) if share > PREDICTION.not_driven_share
        )

    def _ways(self, parameter_set: ParameterSet) -> tuple[Mapping[str, SensorBase], list[_Driving]]:
        """The sensors, and what the motion in each window depends on; of the sets that were asked for last known."""
        for known, sensors, ways in reversed(self._asked):
            if known is parameter_set:
                return sensors, ways
        sensors = self._sensors(parameter_set)
        parameters = np.array([parameter_set.values[name] for name in self.names])
        mechanical = [v for n, v in zip(self.names, parameters.tolist(), strict=True) if n not in self._of_sensors]
        ways = [
            self._driving(index, parameter_set, sensors, road, parameters, mechanical)
            for index, road in enumerate(self._roads(parameter_set))
        ]
        self._asked = [*self._asked[-(PREDICTION.remembered + self.ahead) :], (parameter_set, sensors, ways)]
        return sensors, ways

    def _drive(self, several: Sequence[Sequence[_Driving]]) -> None:
        """Side by side what was not driven before."""
        new = {
            (index, way.key): way
            for ways in several
            for index, way in enumerate(ways)
            if way.key not in self._motions[index]
        }
        motions = self._loop.runs([self._run(index, way, self._remembered[index]) for (index, _), way in new.items()])
        for (index, key), motion in zip(new, motions, strict=True):
            known = self._motions[index]
            if len(known) >= PREDICTION.remembered + self.ahead:
                known.pop(next(iter(known)))
            known[key] = motion, {}

    def _all_moved(
        self, parameter_set: ParameterSet
    ) -> list[tuple[StateHistory, dict[int, dict[str, Array]], _Driving]]:
        """Motion in each window, what of its signals is known already, by the sensors, and what it depends on."""
        _, ways = self._ways(parameter_set)
        self._drive([ways])
        found = []
        for way, known in zip(ways, self._motions, strict=True):
            known[way.key] = known.pop(way.key)  # the last to be forgotten
            found.append((*known[way.key], way))
        return found

    @cached_property
    def _way(self) -> list[tuple[Array, Array]]:
        """By how much the car has turned [rad], and abscissa [m], in the middle of each step, by window."""
        return [
            tuple(np.interp(_middle(w), known.t, known.value[:, 0]) for known in (w.turned, w.place))  # type: ignore[misc]
            for w in self.dataset.windows
        ]

    @cached_property
    def _curvature(self) -> list[Array]:
        """Curvature of the road in the middle of each step [1/m], by window."""
        return [curvature(place, turned) for turned, place in self._way]

    @cached_property
    def _known(self) -> Profiles:
        """The profiles of the vehicle file, on the road of the data."""
        found: dict[str, dict[float, float]] = {}
        for id in BY_ID:
            rows = getattr(getattr(self.vehicle.physics.effects, id), "profile", ())
            for row, abscissa in zip(rows, abscissae(rows, self.dataset), strict=True):
                if abscissa is not None:
                    found.setdefault(size_of(id), {})[abscissa] = row[-1]
        return found

    def _sensors(self, parameter_set: ParameterSet) -> dict[str, SensorBase]:
        sensors = self._sensors_of_car
        for id in EVERY:
            sensors = effect_of(parameter_set, id).sensors(sensors)
        return sensors

    @cached_property
    def _sensors_of_car(self) -> dict[str, SensorBase]:
        """Those of the data set as they are without the effects of the vehicle file, which a parameter set has."""
        return {name: s for name, s in self.vehicle.sensors_of_car().items() if name in self.dataset.sensors}

    def _driving(
        self, index: int, parameter_set: ParameterSet, sensors: Mapping[str, SensorBase], road: _RoadInWindow,
        parameters: Array, mechanical: Sequence[float],
    ) -> _Driving:  # fmt: skip
        """What the motion in a window depends on."""
        late = {n: s.latency - self.dataset.sensors[n].latency for n, s in sensors.items()}
        speed = 0.0 if self.dataset.windows[index].torques else late.get(self._speedometer[index], 0.0)
        steering, torques = (self._telling(sensors, what) or "" for what in INPUTS)
        delays = late.get(steering, 0.0), late.get(torques, 0.0), speed
        shares = [parameter_set.values[name] for name in TORQUE_SHARES]
        key = hash((*mechanical, *shares, *delays, road.key))
        return _Driving(key, parameters, shares, delays, road.around, road.felt)

    def _roads(self, parameter_set: ParameterSet) -> list[_RoadInWindow]:
        """The road that the car meets in each window; those that it met last are known."""
        profiles = [self._known, profiles_of(parameter_set)]
        values = parameter_set.values
        points = tuple((name, values[name], *at.items()) for one in profiles for name, at in one.items())
        key = *(values[name] for name in self._sizes_of_slopes), points
        if key not in self._roads_met:
            if len(self._roads_met) >= PREDICTION.remembered + self.ahead:
                self._roads_met.pop(next(iter(self._roads_met)))
            windows = range(len(self.dataset.windows))
            self._roads_met[key] = [self._road(index, parameter_set, profiles) for index in windows]
        return self._roads_met[key]

    @cached_property
    def _sizes_of_slopes(self) -> list[str]:
        """Names of all that slopes depend on, but for what they are at places."""
        return [
            f"effects.{id}.{n}"
            for id in _SLOPING
            for n in BY_ID[id].model_fields
            if f"effects.{id}.{n}" in self.start.values
        ]

    def _road(self, index: int, parameter_set: ParameterSet, profiles: Sequence[Profiles]) -> _RoadInWindow:
        turned, place = self._way[index]
        varying = varying_sizes(parameter_set.values, profiles, place)
        around = np.zeros((len(place), len(DISTURBANCES)))
        for id in _SLOPING:
            effect = effect_of(parameter_set, id, varying)
            along, across = effect.slope(turned)
            around[:, GRADE] += along
            around[:, BANK] += across
            if not np.any([along, across]):
                continue
            change = {size_of(id): _change(size_of(id), profiles, place)}
            changes = effect_of(parameter_set, id, change).slope(turned)
            bend, twist = bending(effect.slope, changes, turned, self._curvature[index])
            around[:, GRADE_CHANGE] += bend
            around[:, BANK_CHANGE] += twist
        felt = {n: v for n, v in varying.items() if n in self.names and n not in self._of_sensors}
        key = hash((around.tobytes(), *((name, values.tobytes()) for name, values in felt.items())))
        return _RoadInWindow(key, around, felt)

    @cached_property
    def _of_sensors(self) -> frozenset[str]:
        """Names of parameters that the motion does not depend on."""
        moving = ca.vertcat(self.car.dynamics, self.car.next_internal_state(ca.SX(PREDICTION.step)))
        used = {symbol.name() for symbol in ca.symvar(moving)}
        return frozenset(
            name for name, symbol in zip(self.names, ca.vertsplit(self.car.p), strict=True) if symbol.name() not in used
        )

    @cached_property
    def _remembered(self) -> list[Array]:
        """What lasts of what the effects remember where each window begins, (m,), of those before it in its recording:
        as the car of the vehicle file is driven through these, in which effects remember whatever their size. Nothing
        of what this car does in a window in which it gets lost."""
        windows = self.dataset.windows
        found = [np.zeros(self.car.internal_state.numel()) for _ in windows]
        in_order = [sorted(of, key=lambda index: windows[index].begin) for of in self.dataset.places_by_recording()]
        _, ways = self._ways(self.start)
        for place in range(max(map(len, in_order), default=0) - 1):
            pairs = [of[place : place + 2] for of in in_order if len(of) > place + 1]
            runs = [self._until(windows[after].begin, before, ways[before], found[before]) for before, after in pairs]
            for (before, after), motion in zip(pairs, self._loop.runs(runs), strict=True):
                lost = np.isfinite(self._lost_from(before, motion)) or not np.isfinite(motion.internal_state).all()
                memory = found[before] if lost else motion.internal_state
                found[after] = self._rested(memory, max(0.0, windows[after].begin - windows[before].end))
        return found

    def _until(self, end: float, index: int, way: _Driving, memory: Array) -> Run:
        """The run of a window up to a time [s]."""
        run = self._run(index, way, memory)
        return replace(run, inputs=run.inputs.first(round((end - self.dataset.windows[index].begin) / PREDICTION.step)))

    def _rested(self, memory: Array, duration: float) -> Array:
        """What lasts of the memory of all effects after a while [s] that no window tells of."""
        found = memory.copy()
        for id, part in self.car.internal_state_slices.items():
            found[part] = effect_of(self.start, id).relaxed(memory[part], duration)
        return found

    def _run(self, index: int, way: _Driving, memory: Array) -> Run:
        steering_late, torques_late, speed_late = way.delays
        window = self.dataset.windows[index]
        middle = _middle(window)
        n = len(middle)
        inputs = np.zeros((n, len(INPUT_NAMES)))
        steering = window.readings[self._telling(window.readings, "steering") or ""]
        told = np.isfinite(steering.value[:, 0])
        inputs[:, STEERING] = np.interp(middle + steering_late, steering.t[told], steering.value[told, 0])
        speed, acceleration = self._rolling(index, speed_late) if speed_late else self._usual_rolling[index]
        mass = way.parameters[self.names.index("chassis.mass")]
        # Of each wheel, if all of them move the whole car alike.
        inertia = np.full((n, 4), mass * self.radius**2 / 4)
        if window.torques:
            torques = window.readings[self._telling(window.readings, "torques") or ""]
            known = np.isfinite(torques.value).all(axis=1)
            at = middle + torques_late
            for wheel, torque in enumerate(torques.value[known].T, TORQUES.start):
                inputs[:, wheel] = np.interp(at, torques.t[known], torque)
            inertia[middle > window.begin + RUN_IN - 0.5] = 0.0
        else:
            inertia *= 2 * _of_each_wheel(acceleration, *way.shares)
            inputs[:, TORQUES] = inertia / self.radius * acceleration[:, None]
        q, u = turning(self.vehicle, float(speed[0]), window.yaw_rate)
        q[YAW] += window.heading
        target, gain = speed / self.radius, inertia / HOLDING_TIME
        return Run(q, u, Inputs(PREDICTION.step, inputs, way.around, way.varying, target, gain), way.parameters, memory)

    @cached_property
    def _speedometer(self) -> list[str]:
        """The sensor that gives the speed, by window."""
        told = ((self._telling(window.readings, what) for what in SPEEDS) for window in self.dataset.windows)
        return [next(filter(None, names), "") for names in told]

    def _telling(self, names: Iterable[str], what: Tells) -> str | None:
        """Which of the sensors with these names tells something."""
        return telling(((name, self.dataset.sensors[name]) for name in names), what)

    @cached_property
    def _usual_rolling(self) -> list[tuple[Array, Array]]:
        return [self._rolling(index, 0.0) for index in range(len(self.dataset.windows))]

    def _rolling(self, index: int, late: float) -> tuple[Array, Array]:
        """At what speed [m/s] the wheels roll in the middle of each step of a window, and with what acceleration [m/s²]
        a car whose tyres slip then moves, where the speed is older than its stamps say [s]."""
        window = self.dataset.windows[index]
        speed = np.interp(_middle(window) + late, window.speed.t, window.speed.value[:, 0])
        if "rolling speed" in self.dataset.sensors[self._speedometer[index]].tells:
            return speed, _of_the_car(speed)
        acceleration = np.gradient(speed, PREDICTION.step)
        return speed * (1 + acceleration / (PREDICTION.slip_stiffness * GRAVITY)), acceleration

    def _signals(
        self, window: Window, motion: StateHistory, sensors: Mapping[str, SensorBase], way: _Driving
    ) -> dict[str, Array]:
        if not _in_bounds(motion):
            return {}
        readings = {}
        for name, sensing in self._sensing.items():
            if name not in window.readings:
                continue
            stamps, base, now = window.readings[name].t, self.dataset.sensors[name], sensors[name]
            value = (
                sensing(motion, way.around[:: PREDICTION.keep_every], now.mounting()) + now.offsets() - base.offsets()
            )
            older = now.ages() - base.ages()
            at = stamps - window.begin
            read = np.column_stack(
                [np.interp(at - age, motion.t, column) for age, column in zip(older, value.T, strict=True)]
            )
            read[~np.isfinite(window.readings[name].in_own_axes.value)] = np.nan
            readings[name] = Readings(stamps, base.in_axes_of_car(read))
        return signals(window, readings, self.dataset.sensors, self.radius)


@cache
def _physical(name: str) -> tuple[float, float]:
    """Least and largest value of a parameter of an effect, by its dotted name."""
    _, id, field = name.split(".")
    return bounds(EVERY[id].model_fields[field])


def _at_once(windows: int, lanes: int) -> int:
    """How many parameter sets are driven at once: about `SIDE_BY_SIDE` runs, or up to twice as many if these leave
    fewer lanes of the vectors empty."""
    fewest = max(1, SIDE_BY_SIDE // max(windows, 1))

    def empty(count: int) -> float:
        """Share of the lanes."""
        runs = count * max(windows, 1)
        return 1 - runs / (-(-runs // lanes) * lanes)

    return min(range(fewest, 2 * fewest + 1), key=empty)


def abscissae(rows: Sequence[tuple[float, float, float, float]], dataset: Dataset) -> list[float | None]:
    """Where on the road of the recordings the rows of a `RoadEffect.profile` are [m]; None where nobody has been."""
    found = []
    for latitude, longitude, heading, _ in rows:
        fix = {k: np.array([v]) for k, v in zip(_FIX, (latitude, longitude, 0.0), strict=True)}
        at = dataset.on_map.placed(fix)
        found.append(dataset.road.abscissa_of(float(at["east"][0]), float(at["north"][0]), heading))
    return found


def _middle(window: Window) -> Array:
    """Times in the middle of each step [s]."""
    return np.asarray(
        window.begin + (np.arange(np.ceil((window.end - window.begin) / PREDICTION.step)) + 0.5) * PREDICTION.step,
        dtype=float,
    )


def _of_the_car(rolling: Array) -> Array:
    """Acceleration [m/s²] of a car that follows its wheels, which roll at these speeds (n,) [m/s], by their slip."""
    speed, found = rolling[0], np.zeros(len(rolling))
    for i, wheels in enumerate(rolling):
        found[i] = (wheels - speed) / (PREDICTION.step + max(speed, SLOWEST) / (PREDICTION.slip_stiffness * GRAVITY))
        speed += found[i] * PREDICTION.step
    return found


def _of_each_wheel(acceleration: Array, driving: float, braking: float) -> Array:
    """Shares (n, 4) of the wheels of an axle in the torque that gives the car an acceleration (n,) [m/s²], from the
    shares of the front wheels where it drives and where it brakes."""
    smooth = uniform_filter1d(acceleration, round(PREDICTION.smoothing / PREDICTION.step))
    front = driving + (braking - driving) * np.clip(-smooth / PREDICTION.braked, 0.0, 1.0)
    return np.column_stack([front, front, 1 - front, 1 - front])


def turning(vehicle: Vehicle, speed: float, yaw_rate: float) -> tuple[Array, Array]:
    """Coordinates and velocities (14 each) of a car that goes along the map's x at a `speed` [m/s] and turns to the
    left by a `yaw_rate` [rad/s]: the single-track car in a steady bend, on tyres of a usual cornering stiffness. From
    there the simulation is sooner where the car is than from a car that goes straight, which enters a bend at its limit
    as no driver does.
    """
    physics = vehicle.physics
    q, u = rolling_straight(vehicle, speed)
    u[YAW] = yaw_rate
    u[Y] = yaw_rate * (physics.chassis.cog_to_rear_axle - speed**2 / (PREDICTION.cornering_stiffness * GRAVITY))
    q[YAW] = -np.arctan2(u[Y], speed)
    track = np.array([physics.front.track, physics.front.track, physics.rear.track, physics.rear.track])
    u[SPIN] *= 1 - yaw_rate / speed * track / 2 * np.array([1, -1, 1, -1])
    return q, u


def _in_bounds(motion: StateHistory) -> bool:
    return bool(np.isfinite(motion.u[-1]).all())


def _equation(car: Car, name: str, sensor: SensorBase) -> ca.Function:
    """(q, u, udot, disturbances, mounting) → measurement."""
    udot = ca.SX.sym("udot", 14)
    mounting = ca.SX.sym("mounting", len(sensor.mounting()))
    biases = ca.SX.zeros(len(sensor.biases()))
    motion = motion_of(car.q, car.u, udot, car.disturbances, ca.SX.zeros(car.inputs.numel()))
    arguments = [car.q, car.u, udot, car.disturbances, mounting]
    return codegen.function(name, arguments, [sensor.equation(motion, biases, mounting)], ["q", "u", "udot", "g", "m"])


class _Sensing:
    """What a sensor would measure at all instants of a motion; arrays for motions of each length are made once."""

    def __init__(self, equation: ca.Function) -> None:
        self._equation = equation
        self._kernels: dict[int, tuple[list[Array], Kernel]] = {}

    def __call__(self, motion: StateHistory, around: Array, mounting: Array) -> Array:
        """(rows, components)."""
        rows = len(motion.t)
        if rows not in self._kernels:
            arguments = [np.zeros((rows, self._equation.nnz_in(i))) for i in range(self._equation.n_in())]
            self._kernels[rows] = arguments, Kernel(self._equation.map(rows), [a.reshape(-1) for a in arguments])
        arguments, kernel = self._kernels[rows]
        for argument, value in zip(arguments, (motion.q, motion.u, motion.udot, around, mounting), strict=True):
            argument[:] = value
        kernel.call()
        return kernel.results[0].T.copy()
