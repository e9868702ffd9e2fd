"""Operations on `CarBlocks`, and whole stretches of them, as one call of C each (step.c): no Python in between."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from struct import Struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import Entry, Kernel
from vsense_ros.estimation.filter import Kept
from vsense_ros.model.car.steps import GAMMA
from vsense_ros.observer.kalman import CompiledKalman, ModelStructure, SensedStructure

Array = NDArray[np.float64]

_EVENT = Struct("4P2d3q")  # `struct event` of step.c
_ADDRESS, _COUNT, _NUMBER = ctypes.c_void_p, ctypes.c_longlong, ctypes.c_double
_KERNELS = ("linearize", "kinematics", "advance", "force", "remember")
_ARRAYS = (
    *("memory", "state", "inputs", "effects", "length"),
    *("coordinates", "velocities", "remembered", "added", "largest", "usual"),
)


class _Learning(ctypes.Structure):
    """`struct learning` of step.c."""

    _fields_ = [
        *((name, Entry) for name in ("effect", "spread")),
        *((name, _COUNT) for name in ("count", "drift", "numbers")),
        *((name, _ADDRESS) for name in ("columns", "learned", "sensitivity", "covariance", "decay", "physical")),
        *((name, _ADDRESS) for name in ("moved", "grown", "added")),
    ]


class _Filter(ctypes.Structure):
    """`struct filter` of step.c."""

    _fields_ = [
        ("model", ModelStructure),
        *((name, Entry) for name in _KERNELS),
        *(("size", _COUNT), ("effects_size", _COUNT), ("gamma", _NUMBER)),
        *((name, _ADDRESS) for name in _ARRAYS),
        ("learning", _ADDRESS),
    ]


class _Sensor(ctypes.Structure):
    """`struct sensor` of step.c."""

    _fields_ = [
        *(("expect", Entry), ("sensed", SensedStructure), ("seen", Entry), ("learn", Entry), ("width", _COUNT)),
        *((name, _ADDRESS) for name in ("variance", "projected", "change")),
        *((name, _ADDRESS) for name in ("told_of", "learned", "accelerations")),
    ]


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
        self, kalman: CompiledKalman, filter: _Filter, sensors: Sequence[_Sensor | None], arrays: Mapping[str, Array]
    ) -> None:
        library, integer = kalman.library, ctypes.c_int
        self._predict, self._measure = library.vsense_predict, library.vsense_measure
        self._move, self._replay = library.vsense_move, library.vsense_replay
        self._linearize = library.vsense_linearize
        self._linearize.argtypes, self._linearize.restype = [_ADDRESS], None
        self._predict.argtypes = [_ADDRESS, _NUMBER, _ADDRESS, _ADDRESS]
        self._measure.argtypes = [*[_ADDRESS] * 4, _NUMBER, _NUMBER]
        self._measure.restype = _NUMBER
        self._move.argtypes = [_ADDRESS, _ADDRESS, integer, _NUMBER, _ADDRESS, _ADDRESS]
        self._replay.argtypes = [_ADDRESS, integer, ctypes.c_char_p, *[_ADDRESS] * 4]
        self._kalman = kalman
        self._structures = filter, sensors
        self._kept: list[object] = [arrays]
        self._filter = ctypes.addressof(filter)
        self._sensors = [None if sensor is None else ctypes.addressof(sensor) for sensor in sensors]
        self._value, self._variance = (a.ctypes.data for a in (kalman.value, kalman.variance))

    @classmethod
    def of(
        cls,
        kalman: CompiledKalman,
        kernels: Mapping[str, Kernel | None],
        arrays: Mapping[str, Array],
        sensors: Sequence[tuple[Kernel | None, bool, slice]],
    ) -> CompiledStep | None:
        """`kernels` and `arrays` as in `struct filter`; `sensors` have a kernel (None for inputs), use of
        accelerations, and biases. None if any of it is not compiled."""
        entries = {name: kernel.entry() for name, kernel in kernels.items() if kernel is not None}
        bound: list[_Sensor | None] = []
        for i, (kernel, uses_acceleration, biases) in enumerate(sensors):
            if kernel is None:
                bound.append(None)
                continue
            entry = entries[f"sensor {i}"] = kernel.entry()
            if entry is not None:
                bound.append(_Sensor(entry, kalman.bound(kernel.results, uses_acceleration, biases)))
        if None in entries.values():
            return None
        made = _Filter(
            model=kalman.structure,
            size=arrays["memory"].size,
            effects_size=arrays["effects"].size,
            gamma=GAMMA,
            **{name: entries[name] for name in kernels if name in entries},
            **{name: array.ctypes.data for name, array in arrays.items()},
        )
        return cls(kalman, made, bound, arrays)

    def learn(
        self,
        kernels: tuple[Kernel, Kernel],
        drifts: bool,
        columns: NDArray[np.int64],
        arrays: Mapping[str, Array],
        sensors: Sequence[Learned | None],
    ) -> bool:
        """Estimate parameters too: `kernels` are effect and spread, `columns` and `arrays` as in `struct learning`.
        False, and of no use any more, if any of it is not compiled."""
        entries = [kernel.entry() for kernel in kernels]
        filter, bound = self._structures
        numbers = arrays["learned"].size
        addresses = {name: array.ctypes.data for name, array in arrays.items()}
        for sensor, learned in zip(bound, sensors, strict=True):
            if sensor is None or learned is None:
                continue
            for name in ("seen", "learn"):
                entry = getattr(learned, name).entry()
                entries.append(entry)
                if entry is not None:
                    setattr(sensor, name, entry)
            sensor.width = learned.told_of.shape[1]
            for name in ("variance", "projected", "change", "told_of", "learned"):
                setattr(sensor, name, getattr(learned, name).ctypes.data)
            sensor.accelerations = learned.udot.ctypes.data
        if any(entry is None for entry in entries):
            return False
        made = _Learning(*entries[:2], len(columns), drifts, numbers, columns.ctypes.data, **addresses)
        self._kept += [made, columns, arrays, sensors]
        filter.learning = ctypes.addressof(made)
        return True

    def linearize(self) -> None:
        """At the present state."""
        self._linearize(self._filter)

    def predict(self, h: float, process: Process) -> None:
        """One step of `h` [s], from the last linearisation."""
        if not self._predict(self._filter, h, process.decay_address, process.noise_address):
            raise FloatingPointError("the model's Jacobian is singular")

    def correct(self, index: int, value: Array, variance: Array, limit: float, scale: float) -> float:
        """As `Operations.correct`."""
        self._kalman.measured(value, variance)
        return self._measure(self._filter, self._sensors[index], self._value, self._variance, limit, scale)

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
