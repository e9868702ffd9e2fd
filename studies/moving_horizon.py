"""A moving-horizon estimator beside the extended Kalman filter, which Rodríguez 2020 names as future work.

Both have the handling model with four degrees of freedom of Best & Bogdanski 2016, and the same noise. The estimator
finds at each sample the N states before it and the present one that fit best,

    ‖x₀ - x̄₀‖²_P⁻¹ + Σ ‖x_k+1 - f(x_k)‖²_Q⁻¹ + Σ ‖z_k - h(x_k)‖²_R⁻¹        (Rao, Rawlings & Mayne 2003)

by Gauss-Newton from the solution before (1 or 3 iterations a sample), with all equations and slopes by CasADi; x̄₀ and
P are what the Kalman filter predicts for the beginning of the horizon. The car is driven to its limits, and the
estimators begin with a wrong speed or believe in other tyres. What linearising again along a horizon can gain shows
there, or nowhere.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import casadi as ca
import numpy as np
from rich.table import Table
from scipy.linalg import solveh_banded

from studies import best_twin
from vsense_ros import codegen
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.integrated import Integrated
from vsense_ros.estimation.state_space import Symbols
from vsense_ros.evaluate.terminal import plain_table
from vsense_ros.files.atomic import atomic_write
from vsense_ros.identification.best import DISTURBANCES
from vsense_ros.model.handling.best_4dof import PAPER, Best4Dof

H = best_twin.STEP
SENSOR, OUTPUT_NOISE = "outputs", (*best_twin.OUTPUT_NOISE, 0.005)  # the last of a gyro [rad/s]
START = (0.5, 0.3, 0.05, 0.02, 0.05, *(500.0,) * 8)  # standard deviations of the state at the start
ROLL_DISTURBANCE = 0.002  # [rad/√s], so that each state has a noise, which the sum divides by


@dataclass(frozen=True)
class Study:
    """What is compared: horizons [samples] with iterations of each, the length of the drive [s], by how much the speed
    at the start and the tyres of the estimators are wrong."""

    horizons: tuple[tuple[int, int], ...] = ((10, 1), (30, 3))
    seconds: float = 6.0
    speed_error: float = 1.0  # [m/s]
    front_peak: float = 0.85  # times that of the car
    front_stiffness: float = 1.15
    seed: int = 0


@dataclass(frozen=True)
class Row:
    """Errors of one estimator in one case: RMSE of side slip [rad], speed [m/s] and the lateral force of a wheel [N],
    and the time of a sample [µs]."""

    case: str
    estimator: str
    side_slip: float
    speed: float
    force: float
    microseconds: float


class MovingHorizon:
    """The estimator of a state space with diagonal noise; its horizon moves by one sample at each call of `go_on`."""

    def __init__(self, system: Integrated, parameters: Array, horizon: int, iterations: int) -> None:
        self.horizon, self.iterations, self.n = horizon, iterations, len(system.names)
        self.parameters = parameters
        at = Symbols(system)
        z, moved = ca.SX.sym("z", len(OUTPUT_NOISE)), at.moved()
        (sensor,) = [system.measurement(OUTPUT_NOISE, SENSOR)]
        residual = (z - at.measured(sensor)[0]) / ca.SX(np.array(OUTPUT_NOISE))
        results = [moved, ca.densify(ca.jacobian(moved, at.x.vector)), residual,
                   ca.densify(ca.jacobian(residual, at.x.vector))]  # fmt: skip
        made = codegen.function("horizon", [*at.now, at.h, z], results, ("x", "u", "p", "h", "z"))
        self.noise = np.sqrt(system.density * H)
        self._x, self._u, self._z = np.zeros(self.n), np.zeros(len(system.inputs)), np.zeros(len(OUTPUT_NOISE))
        function = codegen.compiled("moving_horizon", [made])[0]
        self._kernel = codegen.Kernel(function, [self._x, self._u, parameters, np.array([H]), self._z])
        self.states: list[Array] = []
        self.input_history: list[Array] = []
        self.measured: list[Array] = []

    def go_on(self, arrival: Gaussian, u: Array, z: Array) -> Array:
        """State (n,) now, from inputs and outputs of this sample, and what is known of the first state of the horizon
        before its outputs."""
        if self.states:
            self.states.append(self._at(self.states[-1], self.input_history[-1], z)[0])
        else:
            self.states.append(arrival.mean.copy())
        self.input_history.append(u.copy())
        self.measured.append(z.copy())
        if len(self.states) > self.horizon + 1:
            del self.states[0], self.input_history[0], self.measured[0]
        for _ in range(self.iterations):
            self._iterate(arrival)
        return self.states[-1]

    def _at(self, x: Array, u: Array, z: Array) -> tuple[Array, Array, Array, Array]:
        """State one step later, its slopes, whitened residuals of the outputs, and their slopes."""
        self._x[:], self._u[:], self._z[:] = x, u, z
        self._kernel.call()
        moved, f, residual, h = self._kernel.results
        return moved[:, 0].copy(), f.copy(), residual[:, 0].copy(), h.copy()

    def _iterate(self, arrival: Gaussian) -> None:
        """A step of Gauss and Newton; the normal equations have blocks on three diagonals."""
        n, count = self.n, len(self.states)
        information = np.linalg.inv(arrival.covariance)
        size = n * count
        matrix, right = np.zeros((size, size)), np.zeros(size)
        matrix[:n, :n] = information
        right[:n] = information @ (arrival.mean - self.states[0])
        weight = 1 / self.noise
        for k in range(count):
            here = slice(n * k, n * (k + 1))
            moved, f, residual, h = self._at(self.states[k], self.input_history[k], self.measured[k])
            matrix[here, here] += h.T @ h
            right[here] -= h.T @ residual
            if k == count - 1:
                break
            following = slice(n * (k + 1), n * (k + 2))
            gap, slope = weight * (self.states[k + 1] - moved), weight[:, None] * f
            matrix[here, here] += slope.T @ slope
            matrix[following, following] += np.diag(weight**2)
            matrix[here, following] -= slope.T * weight
            right[here] += slope.T @ gap
            right[following] -= weight * gap
        bands = np.zeros((2 * n, size))
        for above in range(min(2 * n, size)):
            bands[2 * n - 1 - above, above:] = np.diagonal(matrix, above)
        step = solveh_banded(bands, right, overwrite_ab=True, check_finite=False)
        for k in range(count):
            self.states[k] = self.states[k] + step[n * k : n * (k + 1)]


def compare(study: Study = Study(), progress: Callable[[float], None] = lambda share: None) -> list[Row]:
    """All estimators in all cases."""
    twin = best_twin.drive(best_twin.rich_driver(study.seed), study.seconds)
    random = np.random.default_rng(study.seed)
    inputs = twin.inputs + random.standard_normal(twin.inputs.shape) * best_twin.INPUT_NOISE
    outputs = np.hstack([twin.clean, twin.states[:, 2:3]])
    outputs += random.standard_normal(outputs.shape) * np.array(OUTPUT_NOISE)
    tyres = {"front_peak": study.front_peak, "front_stiffness": study.front_stiffness}
    wrong = PAPER | {name: PAPER[name] * factor for name, factor in tyres.items()}
    cases: dict[str, tuple[Mapping[str, float], float]] = {
        "the car as it is": (PAPER, 0.0),
        f"{study.speed_error:g} m/s off at the start": (PAPER, study.speed_error),
        "other front tyres": (wrong, 0.0),
    }
    rows, done, total = list[Row](), 0, len(cases) * len(study.horizons)
    for case, (values, off) in cases.items():
        beliefs, seconds = by_filter(values, inputs, outputs, twin.states[0], off)
        estimates = np.array([after.mean for _, after in beliefs])
        rows.append(_row(case, "EKF", twin.states, estimates, seconds))
        for horizon, iterations in study.horizons:
            one = MovingHorizon(_system(), _parameters(values), horizon, iterations)
            begun = time.perf_counter()
            found = [
                one.go_on(beliefs[max(k - horizon, 0)][0], inputs[k], outputs[k]).copy() for k in range(len(inputs))
            ]
            spent = (time.perf_counter() - begun) / len(inputs)
            label = f"moving horizon, {horizon * H:g} s, {iterations} ×"
            rows.append(_row(case, label, twin.states, np.array(found), seconds + spent))
            done += 1
            progress(done / total)
    return rows


def by_filter(
    values: Mapping[str, float], inputs: Array, outputs: Array, start: Array, off: float
) -> tuple[list[tuple[Gaussian, Gaussian]], float]:
    """Beliefs before and after the outputs of each sample by the Kalman filter, and the time of a sample [s]."""
    system = _system()
    numbers = dict(zip(system.parameters, _parameters(values).tolist(), strict=True))
    filter = Ekf(Dense(system, [system.measurement(OUTPUT_NOISE, SENSOR)], numbers))
    mean, deviations = start.copy(), np.array(START)
    mean[0] += off
    deviations[0] = max(deviations[0], abs(off))
    filter.inputs[:] = inputs[0, :]
    filter.start(Gaussian(mean, np.diag(deviations**2)))
    beliefs, spent = [], 0.0
    variance = np.square(OUTPUT_NOISE)
    for k in range(len(inputs)):
        begun = time.perf_counter()
        if k:
            filter.predict(H)
        spent += time.perf_counter() - begun
        before = filter.belief()
        filter.inputs[:] = inputs[k]
        begun = time.perf_counter()
        filter.correct(SENSOR, outputs[k], variance)
        spent += time.perf_counter() - begun
        beliefs.append((before, filter.belief()))
    return beliefs, spent / len(inputs)


def _system() -> Integrated:
    return Integrated(Best4Dof(yaw_rate=True), {**DISTURBANCES, "roll": ROLL_DISTURBANCE})


def _parameters(values: Mapping[str, float]) -> Array:
    return np.array([values[name] for name in Best4Dof.parameters])


def _row(case: str, estimator: str, truth: Array, found: Array, seconds: float) -> Row:
    """Errors of a run (N, 13)."""
    slips = [np.arctan2(x[:, 1], np.maximum(x[:, 0], 1.0)) for x in (truth, found)]
    forces = found[:, 9:] - truth[:, 9:]
    return Row(case, estimator, _rms(slips[1] - slips[0]), _rms(found[:, 0] - truth[:, 0]), _rms(forces), 1e6 * seconds)


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))


def write(rows: list[Row], path: Path) -> None:
    """Write the rows as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        file.write(json.dumps([asdict(row) for row in rows], indent=2) + "\n")


def table(rows: list[Row]) -> Table:
    """For the terminal."""
    heads = ("side slip [°]", "speed [m/s]", "lateral force of a wheel [N]", "time of a sample [µs]")
    found = plain_table("RMSE", "", *heads, right=heads)
    for row in rows:
        cells = (f"{np.degrees(row.side_slip):.3g}", f"{row.speed:.3g}", f"{row.force:.0f}", f"{row.microseconds:.0f}")
        found.add_row(row.case, row.estimator, *cells)
    return found
