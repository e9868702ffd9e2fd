"""Covariance algebra of the errorEKF, twice: readable in NumPy, and compiled from kalman.c where that is possible.

Both use the structure of the problem. The transition of the velocities' errors involves only the coordinates that
forces depend on, the velocities, the accelerations and the surroundings; the coordinates follow the velocities by a
nearly diagonal map; everything else decays on its own. That is about 40,000 multiplications for 52 states instead of
the 280,000 of F P Fᵀ.

A correction whitens the innovation with a Cholesky factor and subtracts outer products, P - Σ wᵢ wᵢᵀ, which needs no
re-symmetrisation: compiled it is symmetric to the last bit, by BLAS to a rounding that the next prediction takes away.
docs/covariance.md measures it beside other forms.
"""

from __future__ import annotations

import ctypes
from importlib import resources
from math import isfinite

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from vsense_ros import codegen
from vsense_ros.model.car.steps import GAMMA
from vsense_ros.model.coordinates import DYNAMIC_COORDINATES

Array = NDArray[np.float64]

DYNAMIC = np.array(DYNAMIC_COORDINATES)
Q, U, FORCE, SURROUND = slice(0, 14), slice(14, 28), slice(28, 42), slice(42, 46)
GAIN_COLUMNS = np.concatenate([DYNAMIC, np.arange(14, 46)])
_UNIT = np.asfortranarray(np.eye(14))
COMPONENTS = 16  # of a measurement, at most, in kalman.c


class Linearization:
    """Accelerations at one state and their Jacobians, column-major as the model's functions write them."""

    def __init__(self, udot: Array, by_q: Array, by_u: Array, by_surroundings: Array, by_q_rates: Array) -> None:
        self.udot = udot  # (14, 1)
        self.by_q = by_q  # (14, 7) accelerations by the dynamic coordinates
        self.by_u = by_u  # (14, 14) … by the velocities
        self.by_surroundings = by_surroundings  # (14, 4)
        self.by_q_rates = by_q_rates  # (14, 14) by_q times the rates of the dynamic coordinates by u


class Kalman:
    """The algebra in NumPy.

    Matrices are small: a call of NumPy costs as much as 10,000 multiplications. So blocks that stand side by side are
    multiplied together, zeros between them included, and what can be kept from one step to the next is kept. Of such
    matrices `a.dot(b)` takes half the time of `a @ b`.
    """

    def __init__(self, model: Linearization, by_angles: Array, by_velocity: Array, covariance: Array) -> None:
        self.model = model
        self.by_angles, self.by_velocity = by_angles, by_velocity  # (6, 3), (6, 6) rates of position and attitude
        self.covariance = covariance
        self._transposed = covariance.T  # the same numbers, in the order in which BLAS works in place
        self.inverse = np.zeros((14, 14), order="F")  # (I - γ h J)⁻¹, which the model's step needs
        self.gain = np.zeros((14, len(GAIN_COLUMNS)))  # new errors of the velocities by the old errors
        self.error = np.zeros(len(covariance))  # what a correction found
        # Of the last measurement with m components: L⁻¹ r, the innovation r in independent units, of which NaN are
        # absent, in the first m elements; and in the first m m, row-major, the Cholesky factor L of its covariance,
        # in which absent components stand for themselves. The diagonal of L are standard deviations of components
        # given those before them.
        self.whitened, self.factor = np.full(COMPONENTS, np.nan), np.zeros(COMPONENTS * COMPONENTS)
        # What the response is multiplied with; transition of coordinates and velocities; rates of the coordinates by
        # the velocities. The other names are parts of these and of the covariance.
        self._forced = np.zeros((14, len(GAIN_COLUMNS)), order="F")
        self._forced[:, 21:35] = _UNIT
        self._slope = self._forced[:, 7:21]
        self._share = np.zeros((14, 14), order="F")
        self._share_diagonal = self._share.reshape(-1, order="F")[::15]
        self._unchanged = self.gain.reshape(-1)[7 :: len(GAIN_COLUMNS) + 1]
        self._moves = moves = np.zeros((U.stop, SURROUND.stop))
        self._coordinates, self._velocities, self._by_attitude = moves[Q], moves[U], moves[:6, 3:6]
        self._unmoved = moves.reshape(-1)[: 14 * (SURROUND.stop + 1) : SURROUND.stop + 1]
        self._rates = np.eye(14)
        self._old, self._moving, self._slow = covariance[: SURROUND.stop], covariance[:28, :28], covariance[28:, 28:]
        self._across, self._below = covariance[:28, 28:], covariance[28:, :28]
        self._slow_variance = covariance.reshape(-1)[28 * (len(covariance) + 1) :: len(covariance) + 1]
        self._decay, self._decayed = np.zeros(0), np.zeros((0, 0))
        self._accelerations = through = np.zeros((14, len(covariance)))  # by the errors
        through[:, FORCE] = _UNIT
        self._through = through[:, 2:5], through[:, 6:10], through[:, U], through[:, SURROUND]

    def transition(self, h: float) -> None:
        """Fill `inverse` and `gain` for a step of `h` [s]: the stability function of ROS2, and its response to a
        constant force, applied to the linearised model."""
        model, forced, slope = self.model, self._forced, self._slope
        np.multiply(model.by_q_rates, GAMMA * h, out=slope)
        slope += model.by_u
        inverse = self.inverse
        np.multiply(slope, -GAMMA * h, out=inverse)
        inverse += _UNIT
        _, pivots, singular = lapack.dgetrf(inverse, overwrite_a=True)
        if singular:
            raise FloatingPointError("the model's Jacobian is singular")
        lapack.dgetri(inverse, pivots, overwrite_lu=True)
        # h [S + (½ - γ) W S] with W = (S - I) / γ: S times a multiple of itself and of the unit matrix
        np.multiply(inverse, (0.5 - GAMMA) / GAMMA * h, out=self._share)
        self._share_diagonal += (2 - 0.5 / GAMMA) * h
        response = inverse.dot(self._share)
        forced[:, :7], forced[:, 35:] = model.by_q, model.by_surroundings
        response.dot(forced, self.gain)
        self._unchanged += 1.0

    def propagate(self, h: float, decay: Array, noise: Array) -> None:
        """Covariance after the step; `decay` and `noise` (n - 28) belong to the states behind the velocities."""
        moves, gain, rates = self._moves, self.gain, self._rates
        if decay is not self._decay:
            self._decay, self._decayed = decay, 0.5 * decay[:, None] * decay
        moves[14:, 2:5], moves[14:, 6:10], moves[14:, 14:] = gain[:, :3], gain[:, 3:7], gain[:, 7:]
        rates[:6, :6] = self.by_velocity
        (h * rates).dot(self._velocities, self._coordinates)
        self._by_attitude += h * self.by_angles
        self._unmoved += 1.0
        rows = moves.dot(self._old)
        corner = rows[:, : SURROUND.stop].dot(moves.T)
        np.add(corner, corner.T, out=self._moving)
        self._moving *= 0.5
        np.multiply(rows[:, 28:], decay, out=self._across)
        self._below[:] = self._across.T
        halved = self._slow * self._decayed
        np.add(halved, halved.T, out=self._slow)
        self._slow_variance += noise

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
        model, count = self.model, len(value)
        innovation = value - expected[:, 0]
        size = count
        self.whitened[:size] = np.nan
        h = np.zeros((count, len(self.covariance)))
        h[:, Q], h[:, U], h[:, SURROUND] = by_q, by_u, by_surroundings
        heave, travel, velocities, surroundings = self._through
        heave[:], travel[:], velocities[:] = model.by_q[:, :3], model.by_q[:, 3:], model.by_u
        surroundings[:] = model.by_surroundings
        if uses_acceleration:
            h += by_udot.dot(self._accelerations)
        if biases.stop > biases.start:
            h.reshape(-1)[biases.start :: h.shape[1] + 1] = 1.0
        if not isfinite(sum(innovation.tolist())):
            present = np.isfinite(innovation)
            h, innovation, variance = h[present], innovation[present], variance[present]
            count = len(innovation)
            if not count:
                return -1.0
        across = h.dot(self.covariance)
        total = across.dot(h.T)
        diagonal = total.reshape(-1)[:: count + 1]
        diagonal += variance
        if scale != 1.0:
            total *= scale
        factor, failed = lapack.dpotrf(total, lower=True)
        if failed:
            return float("nan")
        whitening = lapack.dtrtri(factor, lower=True)[0]
        projected, weights = whitening.dot(across), whitening.dot(innovation)
        if count == size:
            self.whitened[:size], self.factor[: size * size] = weights, factor.ravel()
        else:
            whole = np.eye(size)
            whole[np.ix_(present, present)] = factor
            self.whitened[:size][present], self.factor[: size * size] = weights, whole.ravel()
        nis = float(weights.dot(weights))
        if not nis <= limit:
            return nis
        # A quarter of the time of `projected.T @ projected`, of which NumPy computes one triangle and copies it. BLAS
        # computes both triangles, which on some processors differ in the last bit until the next step.
        blas.dgemm(-1.0, projected.T, projected.T, 1.0, self._transposed, trans_b=True, overwrite_c=True)
        weights.dot(projected, self.error)
        self.model.udot[:, 0] += self._accelerations.dot(self.error)
        return nis


class ModelStructure(ctypes.Structure):
    """`struct model` of kalman.c."""

    _fields_ = [
        (name, ctypes.c_void_p)
        for name in (
            *("by_q", "by_u", "by_surroundings", "by_q_rates", "by_angles", "by_velocity"),
            *("inverse", "gain", "covariance", "error", "udot", "whitened", "factor"),
        )
    ]


class SensedStructure(ctypes.Structure):
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
        self.library = library
        number, address = ctypes.c_double, ctypes.c_void_p
        self._transition, self._propagate = library.vsense_transition, library.vsense_propagate
        self._correct = library.vsense_correct
        self._transition.argtypes = [address, number, number]
        self._propagate.argtypes = [address, number, address, address]
        self._propagate.restype = None
        self._correct.argtypes = [address, address, number, number]
        self._correct.restype = number
        self.structure = ModelStructure(
            *(a.ctypes.data for a in (model.by_q, model.by_u, model.by_surroundings, model.by_q_rates)),
            *(a.ctypes.data for a in (by_angles, by_velocity, self.inverse, self.gain, covariance, self.error)),
            *(a.ctypes.data for a in (model.udot, self.whitened, self.factor)),
        )
        self._model = ctypes.byref(self.structure)
        # Copying into these is quicker than asking an array for its address.
        self.value, self.variance = np.zeros(COMPONENTS), np.zeros(COMPONENTS)
        self._decay, self._added = np.zeros(len(covariance) - U.stop), np.zeros(len(covariance) - U.stop)
        self._process = self._decay.ctypes.data, self._added.ctypes.data
        # By identity; the arrays are kept with it, so that no other object can come to have the same.
        self._sensed: dict[tuple[int, bool, int, int], tuple[object, list[Array], SensedStructure]] = {}

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


def kalman(model: Linearization, by_angles: Array, by_velocity: Array, covariance: Array) -> Kalman:
    """The compiled algebra where there is a compiler, else NumPy's."""
    package = resources.files("vsense_ros")
    names = ("estimation/algebra.c", "observer/kalman.c", "observer/step.c")
    source = "\n".join(package.joinpath(name).read_text(encoding="utf-8") for name in names)
    library = codegen.library("kalman", f"#define STATES {len(covariance)}\n{source}")
    if library is None:
        return Kalman(model, by_angles, by_velocity, covariance)
    return CompiledKalman(ctypes.CDLL(str(library)), model, by_angles, by_velocity, covariance)
