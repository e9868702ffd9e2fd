"""The covariance algebra of the car's blocks in C (car_blocks.py has it with full matrices), bound to arrays."""

from __future__ import annotations

import ctypes
from importlib import resources
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.model.car.steps import GAMMA
from vsense_ros.observer.state import U

Array = NDArray[np.float64]


class Blocks(Protocol):
    """Arrays that the algebra works on, column-major Jacobians as the model's functions write them."""

    udot: Array  # (14, 1) accelerations
    by_q: Array  # (14, 7) … by the dynamic coordinates
    by_u: Array  # (14, 14) … by the velocities
    by_disturbances: Array  # (14, 4)
    by_q_rates: Array  # (14, 14) by_q times the rates of the dynamic coordinates by u
    by_angles: Array  # (6, 3) rates of position and attitude by the attitude
    by_velocity: Array  # (6, 6) … by velocity and body rates
    covariance: Array  # (n, n)
    inverse: Array  # (14, 14) (I - γ h J)⁻¹
    gain: Array  # (14, 39) errors of the velocities by those before a step
    error: Array  # (n,) what a correction found


class ModelStructure(ctypes.Structure):
    """`struct model` of car_blocks.c."""

    _fields_ = [
        (name, ctypes.c_void_p)
        for name in (
            *("by_q", "by_u", "by_disturbances", "by_q_rates", "by_angles", "by_velocity"),
            *("inverse", "gain", "covariance", "error", "udot", "whitened", "factor"),
        )
    ]


class SensedStructure(ctypes.Structure):
    """`struct sensed` of car_blocks.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("components", "uses_acceleration", "first_bias", "biases")),
        *((name, ctypes.c_void_p) for name in ("value", "variance")),
        *((name, ctypes.c_void_p) for name in ("expected", "by_q", "by_u", "by_udot", "by_disturbances")),
    ]


class CarAlgebra:
    """The algebra on arrays that must stay where they are.

    Of the last measurement with m components `whitened` holds L⁻¹ r, the innovation r in independent units, NaN where
    absent, in the first m elements; and `factor` in the first m m, row-major, the Cholesky factor L of its covariance,
    in which absent components stand for themselves. C keeps the gain transposed and padded: that of the blocks is
    filled by `transition`, and by steps where parameters are learned.
    """

    def __init__(self, library: ctypes.CDLL, blocks: Blocks) -> None:
        self.library = library
        self.whitened, self.factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS * COMPONENTS)
        number, address = ctypes.c_double, ctypes.c_void_p
        self._transition, self._propagate = library.vsense_transition, library.vsense_propagate
        self._correct = library.vsense_correct
        self._transition.argtypes = [address, number, number]
        self._propagate.argtypes = [address, number, address, address]
        self._propagate.restype = None
        self._correct.argtypes = [address, address, number, number]
        self._correct.restype = number
        b = blocks
        self.gain, self._gain = b.gain, np.zeros((b.gain.shape[1], 16))
        self._kept = [b.by_q, b.by_u, b.by_disturbances, b.by_q_rates, b.by_angles, b.by_velocity, b.inverse]
        self._kept.append(self._gain)
        self._kept += [b.covariance, b.error, b.udot, self.whitened, self.factor]
        self.structure = ModelStructure(*(array.ctypes.data for array in self._kept))
        self._model = ctypes.byref(self.structure)
        # Copying into these is quicker than asking an array for its address.
        self.value, self.variance = np.zeros(COMPONENTS), np.zeros(COMPONENTS)
        self._decay, self._added = (np.zeros(len(b.covariance) - U.stop) for _ in range(2))
        self._process = self._decay.ctypes.data, self._added.ctypes.data
        # By identity; the arrays are kept with it, so that no other object can come to have the same.
        self._sensed: dict[tuple[int, bool, int, int], tuple[object, list[Array], SensedStructure]] = {}

    def transition(self, h: float) -> None:
        if not self._transition(self._model, h, GAMMA):
            raise FloatingPointError("the model's Jacobian is singular")
        self.gain[:] = self._gain[:, : len(self.gain)].T

    def propagate(self, h: float, decay: Array, noise: Array) -> None:
        self._decay[:], self._added[:] = decay, noise
        self._propagate(self._model, h, *self._process)

    def correct(
        self,
        sensed: list[Array],
        uses_acceleration: bool,
        biases: slice,
        value: Array,
        variance: Array,
        scale: float,
        limit: float,
    ) -> float:
        key = (id(sensed), uses_acceleration, biases.start, biases.stop)
        known = self._sensed.get(key)
        if known is None:
            structure = self.bound(sensed, uses_acceleration, biases)
            known = self._sensed[key] = (ctypes.byref(structure), sensed, structure)
        self.measured(value, variance)
        return self._correct(self._model, known[0], scale, limit)

    def bound(self, sensed: list[Array], uses_acceleration: bool, biases: slice) -> SensedStructure:
        """What C needs of a sensor's results, which must stay where they are; the measurement is that of `measured`."""
        return SensedStructure(
            *(len(sensed[0]), uses_acceleration, biases.start, biases.stop - biases.start),
            *(self.value.ctypes.data, self.variance.ctypes.data),
            *(a.ctypes.data for a in sensed),
        )

    def measured(self, value: Array, variance: Array) -> None:
        """Keep the measurement (m,) that comes next."""
        count = len(value)
        self.value[:count], self.variance[:count] = value, variance


def compiled_algebra(blocks: Blocks) -> CarAlgebra | None:
    """None where there is no compiler."""
    package = resources.files("vsense_ros")
    names = ("estimation/algebra.c", "observer/car_blocks.c", "observer/car_history.c")
    source = "\n".join(package.joinpath(name).read_text(encoding="utf-8") for name in names)
    library = codegen.library("car_algebra", f"#define STATES {len(blocks.covariance)}\n#define LEARNING 1\n{source}")
    return None if library is None else CarAlgebra(ctypes.CDLL(str(library)), blocks)
