"""Steps of a car in C, in one call each: car_blocks.c and car_live.c, bound to the arrays of `CarMemory`."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Entry, Kernel
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.estimation.operations import ADDRESS, Operations, library
from vsense_ros.model.car.steps import GAMMA
from vsense_ros.model.constants import GRAVITY
from vsense_ros.observer.car_memory import CarMemory, Sensed, step_length
from vsense_ros.observer.wheel_torques import STANDING

Array = NDArray[np.float64]

SINGULAR = "the model's Jacobian is singular"
_COUNT, _INTEGER = ctypes.c_longlong, ctypes.c_int
_KNOWN = ("estimates", "covariance", "sensitivity", "information")


class ModelStructure(ctypes.Structure):
    """`struct model` of car_blocks.c."""

    _fields_ = [
        (name, ADDRESS)
        for name in (
            *("by_q", "by_u", "by_disturbances", "by_q_rates", "by_angles", "by_velocity", "by_road"),
            *("road_rate", "road_by_velocity", "road_by_road", "levers", "roughness", "road_map"),
            *("inverse", "gain", "covariance", "error", "udot", "whitened", "factor"),
        )
    ]


class SensedStructure(ctypes.Structure):
    """`struct sensed` of car_blocks.c."""

    _fields_ = [
        *((name, _INTEGER) for name in ("components", "uses_acceleration", "first_bias", "biases")),
        *((name, ADDRESS) for name in ("value", "variance")),
        *((name, ADDRESS) for name in ("expected", "by_q", "by_u", "by_udot", "by_disturbances", "by_biases")),
    ]


class _Known(ctypes.Structure):
    """`struct known` of car_blocks.c."""

    _fields_ = [(name, ADDRESS) for name in _KNOWN]

    @classmethod
    def of(cls, array: Array, count: int, size: int) -> _Known:
        """What is known of `count` parameters beside a state of `size`, all of it in one array, in this order."""
        ends = np.cumsum([0, count, count * count, size * count]) * array.itemsize
        return cls(*(array.ctypes.data + int(end) for end in ends))


class _Learning(ctypes.Structure):
    """`struct learning` of car_blocks.c."""

    _fields_ = [
        *(("count", _COUNT), ("drifts", _COUNT), ("columns", ADDRESS), ("known", _Known)),
        *((name, ADDRESS) for name in ("physical", "gain", "decay", "moved", "grown", "added")),
    ]


class _Filter(ctypes.Structure):
    """`struct filter` of car_blocks.c."""

    _fields_ = [
        *(("owner", ADDRESS), ("model", ModelStructure)),
        *((name, ADDRESS) for name in ("state", "effects", "reversion_mean")),
        *(("effects_size", _COUNT), ("gamma", ctypes.c_double)),
        *((name, ADDRESS) for name in ("length", "coordinates", "velocities", "remembered", "added", "learning")),
    ]


class _Live(ctypes.Structure):
    """`struct live` of car_live.c."""

    _fields_ = [
        ("filter", _Filter),
        *((name, Entry) for name in ("linearize", "kinematics", "advance", "force", "remember", "effect", "spread")),
        *((name, ADDRESS) for name in ("expect", "seen", "learn")),
        ("size", _COUNT),
        *((name, ADDRESS) for name in ("memory", "inputs", "h", "largest", "brakes")),
    ]


class _Sensor(ctypes.Structure):
    """`struct sensor` of car_blocks.c."""

    _fields_ = [
        *(("index", _COUNT), ("sensed", SensedStructure), ("width", _COUNT)),
        *((name, ADDRESS) for name in ("variance", "weighted", "gained", "right", "spread", "projected")),
        *(("results", _Known), ("change", ADDRESS), ("accelerations", ADDRESS)),
    ]


@dataclass(frozen=True)
class Learned:
    """How one sensor corrects parameters: the functions of a parameter filter, and what they are bound to."""

    seen: Kernel
    variance: Array  # (m,)
    whitened: Array  # (m,) and
    factor: Array  # (m m,) as the errorEKF's correction leaves them
    weighted: Array  # Hᵀ R⁻¹ Y, (n, p)
    projected: Array  # P times that, (n, p)
    learn: Kernel
    learned: Array  # its results: what the parameter filter knows now,
    change: Array  # (n,) of the state, accelerations in place of the generalized forces,
    udot: Array  # (14,) and change of the accelerations


class CarOperations(Operations):
    """Operations of a car whose functions are compiled."""

    def __init__(
        self,
        compiled: ctypes.CDLL,
        car: CarMemory,
        live: _Live,
        sensors: Mapping[str, tuple[_Sensor, int]],
        outputs: tuple[Array, Array],
        kept_alive: Sequence[object],
    ) -> None:
        super().__init__(compiled, live, sensors, car.h, outputs, SINGULAR)
        self._car, self._bound, self._bound_sensors, self._kept = car, live, sensors, [*kept_alive]
        self._processes: dict[int, int] = {}  # addresses of the numbers of processes, by the length of the step [10 µs]

    @classmethod
    def of(cls, car: CarMemory) -> CarOperations | None:
        """None where there is no compiler."""
        kernels = {
            "linearize": car.linearized,
            "kinematics": car.kinematics,
            "advance": car.advanced,
            "force": car.forces,
            **({} if car.remembered is None else {"remember": car.remembered}),
        }
        entries = {name: kernel.entry() for name, kernel in kernels.items()}
        expect = _entries([car.sensed[name].kernel if name in car.sensed else None for name in car.sensors])
        if expect is None or None in entries.values():
            return None
        compiled = library("car", len(car.mean), "observer/car_blocks.c", "observer/car_live.c", LEARNING=1)
        if compiled is None:
            return None
        outputs = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS * COMPONENTS)
        filter_arrays, kept_alive = _filter(car, *outputs)
        torques = car.prior.torques
        brakes = np.array([STANDING, GRAVITY, torques.drag, torques.engine_braking])  # `struct brakes` of car_blocks.c
        live = _Live(
            filter=filter_arrays,
            **entries,
            expect=ctypes.addressof(expect),
            size=car.memory.size,
            **{name: getattr(car, name).ctypes.data for name in ("memory", "inputs", "h", "largest")},
            brakes=brakes.ctypes.data,
        )
        live.filter.owner = ctypes.addressof(live)
        sensors = {name: (_sensor(sensed), len(sensed.kernel.results[0])) for name, sensed in car.sensed.items()}
        return cls(compiled, car, live, sensors, outputs, [expect, brakes, *kept_alive])

    def process(self, h: float) -> int:
        length = step_length(h)
        address = self._processes.get(length)
        if address is None:
            address = self._processes[length] = int(self._car.processes(h).ctypes.data)
        return address

    def learn(
        self,
        kernels: tuple[Kernel, Kernel],
        drifts: bool,
        columns: NDArray[np.int64],
        arrays: Mapping[str, Array],
        sensors: Mapping[str, Learned],
    ) -> bool:
        """Estimate parameters too: `kernels` are effect and spread, `columns` those of the parameters in `physical`,
        and `arrays` what is known of them, one after the other (`learned`), and as in `struct learning`.
        False, and of no use any more, if any of it is not compiled."""
        effect, spread = (kernel.entry() for kernel in kernels)
        by_index = [sensors.get(name) for name in self._car.sensors]
        seen_entries = _entries([None if of_sensor is None else of_sensor.seen for of_sensor in by_index])
        learn_entries = _entries([None if of_sensor is None else of_sensor.learn for of_sensor in by_index])
        if effect is None or spread is None or seen_entries is None or learn_entries is None:
            return False
        count, size = len(columns), len(arrays["added"]) // len(columns)
        for name, learned in sensors.items():
            sensor, _ = self._bound_sensors[name]
            sensor.width = learned.weighted.shape[1]
            for part in ("variance", "projected", "change", "weighted"):
                setattr(sensor, part, getattr(learned, part).ctypes.data)
            sensor.results, sensor.accelerations = _Known.of(learned.learned, count, size), learned.udot.ctypes.data
        names = ("physical", "decay", "moved", "grown", "added")
        learning = _Learning(
            *(count, drifts, columns.ctypes.data, _Known.of(arrays["learned"], count, size)),
            gain=self._car.gain.ctypes.data,
            **{name: arrays[name].ctypes.data for name in names},
        )
        live = self._bound
        live.effect, live.spread = effect, spread
        live.seen, live.learn = ctypes.addressof(seen_entries), ctypes.addressof(learn_entries)
        live.filter.learning = ctypes.addressof(learning)
        self._kept += [learning, columns, arrays, sensors, seen_entries, learn_entries]
        return True


def _filter(car: CarMemory, whitened: Array, factor: Array) -> tuple[_Filter, list[Array]]:
    """The arrays of a car as C knows them, and those of them that live nowhere else."""
    coordinates, velocities = (r.reshape(-1, order="F") for r in car.advanced.results)
    kinematics = car.kinematics.results
    gain = np.zeros((car.gain.shape[1], 16))  # transposed and padded; that of the car is filled where it learns
    remembered = np.zeros(0) if car.remembered is None else car.remembered.results[0].reshape(-1, order="F")
    model: list[Array] = [
        car.by_q,
        car.by_u,
        car.by_disturbances,
        car.by_q_rates,
        *kinematics,
        car.levers,
        car.roughness,
        car.road_map,
        car.inverse,
        gain,
    ]
    model += [car.covariance, car.error, car.udot, whitened, factor]
    arrays = {
        "state": car.mean,
        "effects": car.effects,
        "reversion_mean": car.reversion_mean,
        "length": car.h,
        "coordinates": coordinates,
        "velocities": velocities,
        "remembered": remembered,
        "added": car.forces.results[0].reshape(-1, order="F"),
    }
    arrays_in_c = _Filter(
        model=ModelStructure(*(array.ctypes.data for array in model)),
        effects_size=car.effects.size,
        gamma=GAMMA,
        **{name: array.ctypes.data for name, array in arrays.items()},
    )
    return arrays_in_c, [*model, *arrays.values()]


def _sensor(sensed: Sensed) -> _Sensor:
    """What C needs of a sensor's results, which must stay where they are."""
    results, biases = sensed.kernel.results, sensed.biases
    numbers = len(results[0]), sensed.uses_acceleration, biases.start, biases.stop - biases.start
    return _Sensor(index=sensed.index, sensed=SensedStructure(*numbers, None, None, *(a.ctypes.data for a in results)))


def _entries(kernels: Sequence[Kernel | None]) -> ctypes.Array[Entry] | None:
    """Entries of the kernels, one for each sensor, empty where it has none; None if one is not compiled."""
    entries = [Entry() if kernel is None else kernel.entry() for kernel in kernels]
    compiled = [entry for entry in entries if entry is not None]
    return (Entry * len(compiled))(*compiled) if len(compiled) == len(entries) else None
