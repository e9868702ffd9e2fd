"""Covariance algebra of the errorEKF, twice: readable in NumPy, and compiled from kalman.c where that is possible.

Both use the structure of the problem. The transition of the velocities' errors involves only the coordinates that
forces depend on, the velocities, the accelerations and the surroundings; the coordinates follow the velocities by a
nearly diagonal map; everything else decays on its own. That is about 40,000 multiplications for 52 states instead of
the 280,000 of F P Fᵀ.

A correction whitens the innovation with a Cholesky factor and subtracts outer products, P - Σ wᵢ wᵢᵀ, which is
symmetric to the last bit and needs no re-symmetrisation.
"""

from __future__ import annotations

import ctypes
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from vsense_ros.model import codegen
from vsense_ros.model.steps import DYNAMIC_COORDINATES, GAMMA

Array = NDArray[np.float64]

DYNAMIC = np.array(DYNAMIC_COORDINATES)
Q, U, FORCE, SURROUND = slice(0, 14), slice(14, 28), slice(28, 42), slice(42, 46)
GAIN_COLUMNS = np.concatenate([DYNAMIC, np.arange(14, 46)])
_COMPONENTS = 16  # of a measurement, at most, in kalman.c


class Linearization:
    """Accelerations at one state and their Jacobians, column-major as the model's functions write them."""

    def __init__(self, udot: Array, by_q: Array, by_u: Array, by_surroundings: Array, by_q_rates: Array) -> None:
        self.udot = udot  # (14, 1)
        self.by_q = by_q  # (14, 7) accelerations by the dynamic coordinates
        self.by_u = by_u  # (14, 14) … by the velocities
        self.by_surroundings = by_surroundings  # (14, 4)
        self.by_q_rates = by_q_rates  # (14, 14) by_q times the rates of the dynamic coordinates by u


class Kalman:
    """The algebra in NumPy."""

    def __init__(self, model: Linearization, by_angles: Array, by_velocity: Array, covariance: Array) -> None:
        self.model = model
        self.by_angles, self.by_velocity = by_angles, by_velocity  # (6, 3), (6, 6) rates of position and attitude
        self.covariance = covariance
        self.inverse = np.zeros((14, 14), order="F")  # (I - γ h J)⁻¹, which the model's step needs
        self.gain = np.zeros((14, len(GAIN_COLUMNS)))  # new errors of the velocities by the old errors
        self.error = np.zeros(len(covariance))  # what a correction found

    def transition(self, h: float) -> None:
        """Fill `inverse` and `gain` for a step of `h` [s]: the stability function of ROS2, and its response to a
        constant force, applied to the linearised model."""
        model, unit = self.model, np.eye(14)
        slope = model.by_u + (GAMMA * h) * model.by_q_rates
        self.inverse[:] = np.linalg.inv(unit - (GAMMA * h) * slope)
        w = (self.inverse - unit) / GAMMA
        response = h * (self.inverse + (0.5 - GAMMA) * (w @ self.inverse))
        self.gain[:, :7] = response @ model.by_q
        self.gain[:, 7:21] = unit + response @ slope
        self.gain[:, 21:35] = response
        self.gain[:, 35:] = response @ model.by_surroundings

    def propagate(self, h: float, decay: Array, noise: Array) -> None:
        """Covariance after the step; `decay` and `noise` (n - 28) belong to the states behind the velocities."""
        p = self.covariance
        rows = self.gain @ p[GAIN_COLUMNS]
        corner = rows[:, GAIN_COLUMNS] @ self.gain.T
        p[U, :], p[:, U] = rows, rows.T
        p[U, U] = 0.5 * (corner + corner.T)
        angles, velocity = h * self.by_angles, h * self.by_velocity
        rows = p[Q, :].copy()
        rows[:6] += angles @ p[3:6, :] + velocity @ p[14:20, :]
        rows[6:] += h * p[20:28, :]
        corner = rows[:, Q].copy()
        corner[:, :6] += rows[:, 3:6] @ angles.T + rows[:, 14:20] @ velocity.T
        corner[:, 6:] += h * rows[:, 20:28]
        p[Q, :], p[:, Q] = rows, rows.T
        p[Q, Q] = 0.5 * (corner + corner.T)
        p[28:, :28] *= decay[:, None]
        p[:28, 28:] *= decay
        p[28:, 28:] *= decay[:, None] * decay  # one product, so that the same rounding happens on both sides
        p.flat[28 * (len(p) + 1) :: len(p) + 1] += noise

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
        """Correct by a measurement `value` (m,), of which NaN are left out, if its normalized innovation squared is at
        most `limit`; fills `error`, and carries it on into the accelerations that the next sensor is compared with.

        `sensed` are the results of the sensor's function; `scale` multiplies the covariance of the innovation. Returns
        the normalized innovation squared, negative if nothing was measured.
        """
        expected, by_q, by_u, by_udot, by_surroundings = sensed
        innovation = value - expected[:, 0]
        present = np.isfinite(innovation)
        if not present.any():
            return -1.0
        h = np.zeros((len(value), len(self.covariance)))
        h[:, Q], h[:, U], h[:, SURROUND] = by_q, by_u, by_surroundings
        if uses_acceleration:
            h[:, DYNAMIC] += by_udot @ self.model.by_q
            h[:, U] += by_udot @ self.model.by_u
            h[:, FORCE] = by_udot
            h[:, SURROUND] += by_udot @ self.model.by_surroundings
        if biases.stop > biases.start:
            h[:, biases] = np.eye(len(value))
        if not present.all():
            h, innovation, variance = h[present], innovation[present], variance[present]
        count = len(innovation)
        right = np.empty((count, len(self.covariance) + 1))
        right[:, :-1], right[:, -1] = h @ self.covariance, innovation
        total = right[:, :-1] @ h.T
        total.flat[:: count + 1] += variance
        total *= scale
        try:
            factor = np.linalg.cholesky(total)
        except np.linalg.LinAlgError:
            return float("nan")
        whitened = np.linalg.solve(factor, right)
        projected, weights = whitened[:, :-1], whitened[:, -1]
        nis = float(weights @ weights)
        if not nis <= limit:
            return nis
        self.covariance -= projected.T @ projected
        self.error[:] = e = weights @ projected
        model = self.model
        by_state = model.by_q @ e[DYNAMIC] + model.by_u @ e[U] + model.by_surroundings @ e[SURROUND]
        model.udot[:, 0] += by_state + e[FORCE]
        return nis


class _Model(ctypes.Structure):
    """`struct model` of kalman.c."""

    _fields_ = [
        (name, ctypes.c_void_p)
        for name in (
            *("by_q", "by_u", "by_surroundings", "by_q_rates", "by_angles", "by_velocity"),
            *("inverse", "gain", "covariance", "error", "udot"),
        )
    ]


class _Sensed(ctypes.Structure):
    """`struct sensed` of kalman.c."""

    _fields_ = [
        *((name, ctypes.c_int) for name in ("components", "uses_acceleration", "first_bias", "biases")),
        *((name, ctypes.c_void_p) for name in ("value", "variance")),
        *((name, ctypes.c_void_p) for name in ("expected", "by_q", "by_u", "by_udot", "by_surroundings")),
    ]


class CompiledKalman(Kalman):
    """The same in C. The arrays it is given must stay where they are."""

    def __init__(
        self, library: ctypes.CDLL, model: Linearization, by_angles: Array, by_velocity: Array, covariance: Array
    ) -> None:
        super().__init__(model, by_angles, by_velocity, covariance)
        number, address = ctypes.c_double, ctypes.c_void_p
        self._transition, self._propagate = library.vsense_transition, library.vsense_propagate
        self._correct = library.vsense_correct
        self._transition.argtypes = [address, number, number]
        self._propagate.argtypes = [address, number, address, address]
        self._propagate.restype = None
        self._correct.argtypes = [address, address, number, number]
        self._correct.restype = number
        self._structure = _Model(
            *(a.ctypes.data for a in (model.by_q, model.by_u, model.by_surroundings, model.by_q_rates)),
            *(a.ctypes.data for a in (by_angles, by_velocity, self.inverse, self.gain, covariance, self.error)),
            model.udot.ctypes.data,
        )
        self._model = ctypes.byref(self._structure)
        # Copying into these is quicker than asking an array for its address.
        self._value, self._variance = np.zeros(_COMPONENTS), np.zeros(_COMPONENTS)
        self._decay, self._added = np.zeros(len(covariance) - U.stop), np.zeros(len(covariance) - U.stop)
        self._process = self._decay.ctypes.data, self._added.ctypes.data
        # By identity; the arrays are kept with it, so that no other object can come to have the same.
        self._sensed: dict[tuple[int, bool, int, int], tuple[object, list[Array], _Sensed]] = {}

    def transition(self, h: float) -> None:
        if not self._transition(self._model, h, GAMMA):
            raise FloatingPointError("the model's Jacobian is singular")

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
            structure = _Sensed(
                *(len(value), uses_acceleration, biases.start, biases.stop - biases.start),
                *(self._value.ctypes.data, self._variance.ctypes.data),
                *(a.ctypes.data for a in sensed),
            )
            known = self._sensed[key] = (ctypes.byref(structure), sensed, structure)
        count = len(value)
        self._value[:count], self._variance[:count] = value, variance
        return self._correct(self._model, known[0], scale, limit)


def kalman(model: Linearization, by_angles: Array, by_velocity: Array, covariance: Array) -> Kalman:
    """The compiled algebra where there is a compiler, else NumPy's."""
    source = resources.files("vsense_ros.observer").joinpath("kalman.c").read_text(encoding="utf-8")
    library = codegen.library("kalman", f"#define STATES {len(covariance)}\n{source}")
    if library is None:
        return Kalman(model, by_angles, by_velocity, covariance)
    return CompiledKalman(ctypes.CDLL(str(library)), model, by_angles, by_velocity, covariance)
