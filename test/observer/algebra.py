"""A random linear model of the car's structure, and the algebra of a filter on it: with full matrices, and in C."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros import codegen
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.gaussian import COMPONENTS
from vsense_ros.model.car.steps import GAMMA
from vsense_ros.observer.car_blocks import CarBlocks
from vsense_ros.observer.car_memory import Process, Sensed
from vsense_ros.observer.car_operations import ModelStructure, SensedStructure
from vsense_ros.observer.state import DISTURB, DYNAMIC, FORCE, FORWARD, GAIN_COLUMNS, Layout, Q, U

Array = NDArray[np.float64]
N = 55
BIASES = slice(49, 55)
SPEED = 12.0  # [m/s]


class _Returned:
    """A function that returns what it is given beforehand."""

    def __init__(self, results: list[Array]) -> None:
        self.results = results

    def call(self) -> None:
        pass


class RandomBlocks(CarBlocks):
    """`CarBlocks` of no car: linearisation and kinematics are given."""

    def __init__(
        self, jacobians: list[Array], kinematics: list[Array], levers: Array, roughness: Array, covariance: Array
    ) -> None:
        self.udot, self.by_q, self.by_u, self.by_disturbances, self.by_q_rates = jacobians
        self.kinematics: Any = _Returned(kinematics)
        self.levers, self.roughness, self.road_map = levers, roughness, np.zeros((5, 10))
        self.layout = Layout((BIASES,), ("",) * N, N)
        self.mean, self.covariance = np.zeros(N), covariance
        self.mean[FORWARD] = SPEED
        self.inverse, self.gain = np.zeros((14, 14), order="F"), np.zeros((14, len(GAIN_COLUMNS)))
        self.error = np.zeros(N)
        self.forces: Any = _Returned([np.zeros((14, 1))])
        self.sensed = {}
        self.names, self.sensors, self.memory, self.inputs = (), (), np.zeros(0), np.zeros(0)
        self.operations = None


class WithFullMatrices:
    """`CarBlocks` and `Ekf` without a compiler."""

    def __init__(self, blocks: RandomBlocks) -> None:
        self.blocks, self.model, self._ekf = blocks, blocks, Ekf(blocks)
        self.covariance, self.gain, self.inverse = blocks.covariance, blocks.gain, blocks.inverse
        self.error = blocks.error
        self.whitened, self.factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS * COMPONENTS)

    def transition(self, h: float) -> None:
        self.blocks.respond(h)

    def propagate(self, h: float, decay: Array, noise: Array) -> None:
        self.blocks.mean[FORWARD] = SPEED  # which corrections have changed
        more = self.blocks.map_road(h, Process(decay, noise[: len(decay)], noise[len(decay) :]))
        self.blocks.propagate(self.blocks.transition(h, decay), more)
        self.blocks.share_torques(noise[len(decay) :])

    def correct(
        self, sensed: list[Array], accelerations: bool, biases: slice, value: Array, variance: Array, scale: float,
        limit: float,
    ) -> float:  # fmt: skip
        kernel: Any = _Returned(sensed)
        self.blocks.sensed["one"] = Sensed(0, kernel, biases, accelerations, np.zeros(0))
        found = self._ekf.correct("one", value, variance, limit, scale)
        m = len(value)
        self.whitened[:m], self.factor[: m * m] = found.whitened, found.factor.reshape(-1)
        return found.nis


_CALLS = """
int transition_in(const struct model *model, double h, double gamma) { return transition(model, h, gamma); }
void propagate_in(const struct model *model, double h, double speed, const double *decay, const double *noise) {
    propagate(model, h, speed, decay, noise);
}
double correct_in(const struct model *model, const struct sensed *sensed, double scale, double limit) {
    return correct(model, sensed, scale, limit);
}
"""


class InC:
    """The algebra by car_blocks.c, operation by operation."""

    def __init__(self, blocks: RandomBlocks) -> None:
        self.model, self.covariance, self.inverse, self.error = blocks, blocks.covariance, blocks.inverse, blocks.error
        self.gain = blocks.gain
        self.whitened, self.factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS * COMPONENTS)
        self._padded = np.zeros((len(GAIN_COLUMNS), 16))
        self._arrays = [blocks.by_q, blocks.by_u, blocks.by_disturbances, blocks.by_q_rates]
        self._arrays += [*blocks.kinematics.results, blocks.levers, blocks.roughness, blocks.road_map]
        self._arrays += [blocks.inverse, self._padded, blocks.covariance, blocks.error, blocks.udot]
        self._arrays += [self.whitened, self.factor]
        self._structure = ModelStructure(*(array.ctypes.data for array in self._arrays))
        self._address = ctypes.byref(self._structure)
        self._library = _library()

    def transition(self, h: float) -> None:
        assert self._library.transition_in(self._address, h, GAMMA)
        self.gain[:] = self._padded[:, : len(self.gain)].T

    def propagate(self, h: float, decay: Array, noise: Array) -> None:
        self._library.propagate_in(self._address, h, SPEED, decay.ctypes.data, noise.ctypes.data)

    def correct(
        self, sensed: list[Array], accelerations: bool, biases: slice, value: Array, variance: Array, scale: float,
        limit: float,
    ) -> float:  # fmt: skip
        arrays = [np.ascontiguousarray(value), np.ascontiguousarray(variance), *sensed]
        numbers = len(value), accelerations, biases.start, biases.stop - biases.start
        structure = SensedStructure(*numbers, *(array.ctypes.data for array in arrays))
        return float(self._library.correct_in(self._address, ctypes.byref(structure), scale, limit))


def _library() -> ctypes.CDLL:
    names = "estimation/algebra.c", "codegen/kernel.c", "observer/car_blocks.c", "observer/car_live.c"
    parts = [resources.files("vsense_ros").joinpath(name).read_text(encoding="utf-8") for name in names]
    path = codegen.library("car_algebra", "\n".join([f"#define STATES {N}\n#define LEARNING 1", *parts, _CALLS]))
    assert path is not None
    library, number, address = ctypes.CDLL(str(path)), ctypes.c_double, ctypes.c_void_p
    library.transition_in.argtypes = [address, number, number]
    library.propagate_in.argtypes, library.propagate_in.restype = [address, number, number, address, address], None
    library.correct_in.argtypes, library.correct_in.restype = [address, address, number, number], number
    return library


@dataclass
class Problem:
    """A random linear model of the car's structure, and a covariance."""

    jacobians: list[Array]
    kinematics: list[Array]
    levers: Array
    roughness: Array
    covariance: Array
    random: np.random.Generator

    def build(self, kind: Any = WithFullMatrices) -> Any:
        return kind(RandomBlocks(self.jacobians, self.kinematics, self.levers, self.roughness, self.covariance.copy()))

    def sensed(self, m: int = 6, accelerations: bool = True) -> list[Array]:
        """What a sensor's function returns: expectation and Jacobians."""
        widths = (1, 14, 14, 14, 7, 1)
        parts = [np.asfortranarray(self.random.normal(size=(m, width))) for width in widths]
        if not accelerations:
            parts[3][:] = 0
        return parts

    def through(self) -> Array:
        """Dense (14, n) Jacobian of the accelerations by the state."""
        _, by_q, by_u, by_disturbances, _ = self.jacobians
        through = np.zeros((14, N))
        through[:, DYNAMIC], through[:, U] = by_q, by_u
        through[:, FORCE], through[:, DISTURB] = np.eye(14), by_disturbances
        return through

    def jacobian(self, sensed: list[Array], accelerations: bool = True, biased: bool = True) -> Array:
        """Dense (m, n) Jacobian of a sensor by the state, by the chain rule."""
        _, by_q, by_u, by_udot, by_disturbances, by_biases = sensed
        h = np.zeros((len(by_q), N))
        h[:, Q], h[:, U], h[:, DISTURB] = by_q, by_u, by_disturbances
        if accelerations:
            h += by_udot @ self.through()
        if biased:
            h[:, BIASES] += np.diag(by_biases[:, 0])
        return h


def problem(seed: int) -> Problem:
    random = np.random.default_rng(seed)
    jacobians = [np.asfortranarray(random.normal(size=(14, width)) * 5) for width in (1, 7, 14, 7, 14)]
    root = random.normal(size=(N, N)) * 10 ** random.uniform(-2, 1, N)[:, None]
    covariance = root @ root.T + 1e-4 * np.eye(N)
    covariance = 0.5 * (covariance + covariance.T)
    sizes = (6, 3), (6, 6), (6, 4), (3, 1), (3, 6), (3, 4)
    kinematics = [np.asfortranarray(random.normal(size=size)) for size in sizes]
    roughness = random.uniform(0.01, 1.0, (2, 3))
    return Problem(jacobians, kinematics, random.normal(size=2), roughness, covariance, random)
