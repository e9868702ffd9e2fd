"""Operations on `CarBlocks`, and whole stretches of them, as one call of C each (car_blocks.c, car_history.c)."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Entry, Kernel
from vsense_ros.estimation.filter import Kept
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.model.car.steps import GAMMA
from vsense_ros.observer.car_algebra import CarAlgebra, ModelStructure, SensedStructure

Array = NDArray[np.float64]

_EVENT = Struct("4P2d3q")  # `struct event` of car_history.c
_ADDRESS, _COUNT, _NUMBER = ctypes.c_void_p, ctypes.c_longlong, ctypes.c_double
_KERNELS = ("linearize", "kinematics", "advance", "force", "remember")
_KNOWN = ("estimates", "covariance", "sensitivity", "information")


class _Known(ctypes.Structure):
    """`struct known` of car_blocks.c."""

    _fields_ = [(name, _ADDRESS) for name in _KNOWN]

    @classmethod
    def of(cls, array: Array, count: int, size: int) -> _Known:
        """What is known of `count` parameters beside a state of `size`, all of it in one array, in this order."""
        ends = np.cumsum([0, count, count * count, size * count]) * array.itemsize
        return cls(*(array.ctypes.data + int(end) for end in ends))


class _Learning(ctypes.Structure):
    """`struct learning` of car_blocks.c."""

    _fields_ = [
        *(("count", _COUNT), ("drifts", _COUNT), ("columns", _ADDRESS), ("known", _Known)),
        *((name, _ADDRESS) for name in ("physical", "gain", "decay", "moved", "grown", "added")),
    ]


class _Filter(ctypes.Structure):
    """`struct filter` of car_blocks.c."""

    _fields_ = [
        *(("owner", _ADDRESS), ("model", ModelStructure)),
        *((name, _ADDRESS) for name in ("state", "effects", "reversion_mean")),
        *(("effects_size", _COUNT), ("gamma", _NUMBER)),
        *((name, _ADDRESS) for name in ("length", "coordinates", "velocities", "remembered", "added", "learning")),
    ]


class _Live(ctypes.Structure):
    """`struct live` of car_history.c."""

    _fields_ = [
        ("filter", _Filter),
        *((name, Entry) for name in (*_KERNELS, "effect", "spread")),
        *((name, _ADDRESS) for name in ("expect", "seen", "learn")),
        ("size", _COUNT),
        *((name, _ADDRESS) for name in ("memory", "inputs", "largest")),
    ]


class _Sensor(ctypes.Structure):
    """`struct sensor` of car_blocks.c."""

    _fields_ = [
        *(("index", _COUNT), ("sensed", SensedStructure), ("width", _COUNT)),
        *((name, _ADDRESS) for name in ("variance", "told_of", "gained", "told", "spread", "projected")),
        *(("found", _Known), ("change", _ADDRESS), ("accelerations", _ADDRESS)),
    ]


class _Call(NamedTuple):
    """`struct call` of car_history.c: where it stands, its limit, scale and result, and the measurement (m,)."""

    address: int
    numbers: Any  # a memoryview, in which single numbers are set at once
    value: Array
    variance: Array

    @classmethod
    def of(cls, live: int, sensor: _Sensor) -> _Call:
        """Of corrections by this sensor."""
        numbers, m = np.zeros(5 + 2 * COMPONENTS), sensor.sensed.components
        numbers[:2].view(np.int64)[:] = live, ctypes.addressof(sensor)
        values, variances = np.split(numbers[5:], 2)
        return cls(numbers.ctypes.data, numbers.data[2:5], values[:m], variances[:m])


class Process(NamedTuple):
    """Decay and added variance of the states behind the velocities (n - 28) within some time, and where they stand."""

    decay: Array
    noise: Array
    decay_address: int
    noise_address: int


class Replayed(NamedTuple):
    """What is to happen again: a measurement, or inputs, and the steps of `h` [s] that lead there.

    `kept` is where the filter is kept before these; 0 if it is there already.
    """

    sensor: int
    first_input: int | None  # of those that it sets
    value: Array
    variance: Array
    limit: float
    kept: int = 0
    steps: int = 0
    h: float = 0.0


@dataclass(frozen=True)
class Learned:
    """How one sensor tells of parameters: the functions of a parameter filter, and what they are bound to."""

    seen: Kernel
    variance: Array  # (m,)
    whitened: Array  # (m,) and
    factor: Array  # (m m,) as the errorEKF's correction leaves them
    told_of: Array  # Hᵀ R⁻¹ Y, (n, p)
    projected: Array  # P times that, (n, p)
    learn: Kernel
    learned: Array  # its results: what the parameter filter knows now,
    change: Array  # (n,) of the state, accelerations in place of the generalized forces,
    udot: Array  # (14,) and change of the accelerations


class CompiledStep:
    """Operations of one filter, whose arrays must stay where they are."""

    def __init__(
        self,
        algebra: CarAlgebra,
        live: _Live,
        sensors: Sequence[_Sensor | None],
        length: Array,
        keep: object,
    ) -> None:
        library, integer = algebra.library, ctypes.c_int
        self._predict, self._measure = library.vsense_predict, library.vsense_measure
        self._step, self._move, self._replay = library.vsense_step, library.vsense_move, library.vsense_replay
        self._linearize = library.vsense_linearize
        self._linearize.argtypes, self._linearize.restype = [_ADDRESS], None
        self._predict.argtypes = self._step.argtypes = [_ADDRESS] * 3
        self._measure.argtypes = [_ADDRESS]
        self._measure.restype = None
        self._move.argtypes = [_ADDRESS, _ADDRESS, integer, _NUMBER, _ADDRESS, _ADDRESS]
        self._replay.argtypes = [_ADDRESS, integer, ctypes.c_char_p, *[_ADDRESS] * 4]
        self._algebra = algebra
        self._structures = live, sensors
        self._kept = [keep]
        self._length: Any = length.data
        self._filter = ctypes.addressof(live)
        live.filter.owner = self._filter
        self._sensors = [None if sensor is None else ctypes.addressof(sensor) for sensor in sensors]
        self._calls = [None if sensor is None else _Call.of(self._filter, sensor) for sensor in sensors]

    @classmethod
    def of(
        cls,
        algebra: CarAlgebra,
        kernels: Mapping[str, Kernel | None],
        arrays: Mapping[str, Array],
        sensors: Sequence[tuple[Kernel | None, bool, slice]],
    ) -> CompiledStep | None:
        """`kernels` and `arrays` as in `struct live` and its filter; `sensors` have a kernel (None for inputs), use of
        accelerations, and biases. None if any of it is not compiled."""
        entries = {name: kernel.entry() for name, kernel in kernels.items() if kernel is not None}
        expect = _entries([kernel for kernel, _, _ in sensors])
        if expect is None or None in entries.values():
            return None
        bound = [
            None
            if kernel is None
            else _Sensor(index=i, sensed=algebra.bound(kernel.results, uses_acceleration, biases))
            for i, (kernel, uses_acceleration, biases) in enumerate(sensors)
        ]
        addresses = {name: array.ctypes.data for name, array in arrays.items()}
        outer = {name: addresses.pop(name) for name in ("memory", "inputs", "largest")}
        made = _Filter(model=algebra.structure, effects_size=arrays["effects"].size, gamma=GAMMA, **addresses)
        live = _Live(filter=made, expect=ctypes.addressof(expect), size=arrays["memory"].size, **entries, **outer)
        return cls(algebra, live, bound, arrays["length"], (arrays, expect))

    def learn(
        self,
        kernels: tuple[Kernel, Kernel],
        drifts: bool,
        columns: NDArray[np.int64],
        arrays: Mapping[str, Array],
        sensors: Sequence[Learned | None],
    ) -> bool:
        """Estimate parameters too: `kernels` are effect and spread, `columns` those of the parameters in `physical`,
        and `arrays` what is known of them, one after the other (`learned`), and as in `struct learning`.
        False, and of no use any more, if any of it is not compiled."""
        live, bound = self._structures
        effect, spread = (kernel.entry() for kernel in kernels)
        seen = _entries([None if one is None else one.seen for one in sensors])
        learn = _entries([None if one is None else one.learn for one in sensors])
        if effect is None or spread is None or seen is None or learn is None:
            return False
        count, size = len(columns), len(arrays["added"]) // len(columns)
        for sensor, learned in zip(bound, sensors, strict=True):
            if sensor is None or learned is None:
                continue
            sensor.width = learned.told_of.shape[1]
            for name in ("variance", "projected", "change", "told_of"):
                setattr(sensor, name, getattr(learned, name).ctypes.data)
            sensor.found, sensor.accelerations = _Known.of(learned.learned, count, size), learned.udot.ctypes.data
        names = ("physical", "decay", "moved", "grown", "added")
        made = _Learning(
            *(count, drifts, columns.ctypes.data, _Known.of(arrays["learned"], count, size)),
            gain=self._algebra.gain.ctypes.data,
            **{name: arrays[name].ctypes.data for name in names},
        )
        live.effect, live.spread = effect, spread
        live.seen, live.learn = ctypes.addressof(seen), ctypes.addressof(learn)
        live.filter.learning = ctypes.addressof(made)
        self._kept += [made, columns, arrays, sensors, seen, learn]
        return True

    def linearize(self) -> None:
        """At the present state."""
        self._linearize(self._filter)

    def predict(self, h: float, process: Process) -> None:
        """One step of `h` [s], from the last linearisation."""
        self._length[0] = h
        if not self._predict(self._filter, process.decay_address, process.noise_address):
            raise FloatingPointError("the model's Jacobian is singular")

    def step(self, h: float, process: Process) -> None:
        """`predict` and then linearize, which is one call less."""
        self._length[0] = h
        if not self._step(self._filter, process.decay_address, process.noise_address):
            raise FloatingPointError("the model's Jacobian is singular")

    def correct(self, index: int, value: Array, variance: Array, limit: float, scale: float) -> float:
        """As `Operations.correct`."""
        call = self._calls[index]
        assert call is not None, "inputs have no innovation"
        address, numbers, values, variances = call
        values[:], variances[:] = value, variance
        numbers[0], numbers[1] = limit, scale
        self._measure(address)
        return float(numbers[2])

    def move(self, kept: Kept, steps: int, h: float, process: Process) -> bool:
        """As `Operations.advance`, in steps of `h` [s]."""
        _, _, decay, noise = process
        return bool(self._move(self._filter, kept.address, steps, h, decay, noise))

    def replay(self, events: Sequence[Replayed], processes: Sequence[Process | None]) -> tuple[int, bool, Array]:
        """As `Operations.repeat`; `processes` belong to the steps of each event."""
        rows, values, variances = [], [], []
        for (index, inputs, value, variance, limit, kept, steps, h), process in zip(events, processes, strict=True):
            decay, noise = (0, 0) if process is None else process[2:]
            sensor, first = (self._sensors[index], 0) if inputs is None else (0, inputs)
            rows.append(_EVENT.pack(sensor, kept, decay, noise, h, limit, steps, first, len(value)))
            values.append(value)
            variances.append(variance)
        measured, moved, nis = np.concatenate(values + variances), ctypes.c_int(), np.zeros(len(events))
        address = measured.ctypes.data
        addresses = address, address + measured.nbytes // 2, nis.ctypes.data, ctypes.addressof(moved)
        return self._replay(self._filter, len(events), b"".join(rows), *addresses), bool(moved.value), nis


def _entries(kernels: Sequence[Kernel | None]) -> ctypes.Array[Entry] | None:
    """Of each sensor one, empty where it has none; None if one is not compiled."""
    entries = [Entry() if kernel is None else kernel.entry() for kernel in kernels]
    made = [entry for entry in entries if entry is not None]
    return (Entry * len(made))(*made) if len(made) == len(entries) else None
