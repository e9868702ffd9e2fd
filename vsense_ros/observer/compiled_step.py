"""Both operations of `ErrorEkf` as one call of C each (step.c), with no Python between the model and the algebra."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.codegen import Entry, Kernel
from vsense_ros.model.steps import GAMMA
from vsense_ros.observer.kalman import CompiledKalman, Kalman, ModelStructure, SensedStructure

Array = NDArray[np.float64]


class _Filter(ctypes.Structure):
    """`struct filter` of step.c."""

    _fields_ = [
        ("model", ModelStructure),
        *((name, Entry) for name in ("kinematics", "advance", "force")),
        *((name, ctypes.c_void_p) for name in ("state", "length", "coordinates", "velocities", "added")),
    ]


class _Sensor(ctypes.Structure):
    """`struct sensor` of step.c."""

    _fields_ = [("expect", Entry), ("sensed", SensedStructure)]


class CompiledStep:
    """Prediction and correction of one filter, whose arrays must stay where they are."""

    def __init__(
        self,
        kalman: CompiledKalman,
        entries: Sequence[Entry],
        addresses: Sequence[int],
        sensors: Sequence[_Sensor | None],
    ) -> None:
        library, number, address = kalman.library, ctypes.c_double, ctypes.c_void_p
        self._predict, self._measure = library.vsense_predict, library.vsense_measure
        self._predict.argtypes = [address, number, number, address, address]
        self._measure.argtypes = [address, address, number, number]
        self._measure.restype = number
        self._kalman = kalman
        self._structures = _Filter(kalman.structure, *entries, *addresses), sensors
        self._filter = ctypes.addressof(self._structures[0])
        self._sensors = [None if sensor is None else ctypes.addressof(sensor) for sensor in sensors]

    @classmethod
    def of(
        cls,
        kalman: Kalman,
        kernels: Sequence[Kernel],
        state: Array,
        length: Array,
        sensors: Sequence[tuple[Kernel | None, bool, slice]],
    ) -> CompiledStep | None:
        """`kernels` are kinematics, advance and force; `length` (1,) is the argument of the step's length; `sensors`
        have a kernel (None for inputs), use of accelerations, and biases. None if any of it is not compiled."""
        if not isinstance(kalman, CompiledKalman):
            return None
        entries = [kernel.entry() for kernel in kernels]
        bound: list[_Sensor | None] = []
        for kernel, uses_acceleration, biases in sensors:
            if kernel is None:
                bound.append(None)
                continue
            entry = kernel.entry()
            entries.append(entry)
            bound.append(_Sensor(entry, kalman.bound(kernel.results, uses_acceleration, biases)))
        if any(entry is None for entry in entries):
            return None
        _, advance, force = kernels
        outputs = [*advance.results, force.results[0]]
        addresses = [state.ctypes.data, length.ctypes.data, *(array.ctypes.data for array in outputs)]
        return cls(kalman, [entry for entry in entries[:3] if entry is not None], addresses, bound)

    def predict(self, h: float, decay: int, noise: int) -> None:
        """As `ErrorEkf.predict`; `decay` and `noise` are addresses."""
        if not self._predict(self._filter, h, GAMMA, decay, noise):
            raise FloatingPointError("the model's Jacobian is singular")

    def correct(self, index: int, value: Array, variance: Array, limit: float, scale: float) -> float:
        """As `ErrorEkf.correct`."""
        self._kalman.measured(value, variance)
        return self._measure(self._filter, self._sensors[index], scale, limit)
