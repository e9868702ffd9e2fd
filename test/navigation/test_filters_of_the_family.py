"""Every filter of the room against filterpy with the same matrices, and against runs of the system it assumes."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.stats import chi2

from marks import exam_except
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.catalogue import DEFINITIONS
from vsense_ros.navigation.space import NavigationSpace

NUMBERS = {
    "mass": 1858.0, "yaw_inertia": 3515.0, "to_front": 1.36, "to_rear": 1.546, "front_stiffness": 154780.0,
    "rear_stiffness": 147540.0, "friction": 1.0, "roll_gain": 0.05, "roll_frequency": 11.8, "roll_damping": 0.1,
    "roll_arm": 0.49, "stiffness_deviation": 0.15, "gyro_scale_deviation": 0.01, "slip_error": 0.0015,
    "antenna_deviation": 0.5, "steering_error": 0.3, "shaking_noise": 0.1, "rolling_radius": 0.29, "rear_track": 1.536,
    "straight_rate": 0.0175, "sample_time": 0.01, "gyro_noise": 0.0018, "acceleration_noise": 0.5, "spin_noise": 0.04,
    "antenna_x": 0.3, "antenna_y": -0.1, "gravity": 9.81,
    "pitching_noise": 0.05, "leaning": 5e-4, "grade_drift": 0.02, "bank_drift": 0.3,
    "road_bank": 0.01, "road_bank_time": 20.0,
}  # fmt: skip
SEEN = {
    **NUMBERS,
    "yaw": 3.1,
    "forward_velocity": 15.0,
    "velocity_east": -14.98,
    "velocity_north": 0.6,
    "yaw_rate": 0.1,
}


def distinct_parts() -> dict[str, tuple[NavigationSpace, tuple[Measurement, ...]]]:
    """The filters that the definitions are made of, each once."""
    found: dict[str, tuple[NavigationSpace, tuple[Measurement, ...]]] = {}
    seen = set()
    for name, (_, definition, _) in DEFINITIONS.items():
        for part, (system, measurements) in definition.parts.items():
            key = (type(system), getattr(system, "order", 0), tuple(m.name for m in measurements), system.names)
            if key not in seen:
                seen.add(key)
                found[f"{name} {part}".strip()] = system, measurements
    return found


PARTS = distinct_parts()
CHOSEN = ("strapdown", "integrated", "integrated_kf_a model", "triple_kkf velocity", "side_slip_kkf_1 heading")


def inputs_at(system: NavigationSpace, time: float) -> Array:
    """Inputs of a car that turns now and then at 15 m/s."""
    turn = max(0.0, np.sin(0.8 * time)) * 0.3
    spin = 15.0 / 0.29
    at = {
        "yaw_rate": turn, "roll_rate": 0.02 * np.cos(time), "pitch_rate": 0.01 * np.sin(2 * time),
        "acceleration_x": 0.2 * np.sin(time), "acceleration_y": 15.0 * turn, "acceleration_z": 9.81,
        "steer_angle": 0.25 * turn, "speed": 15.0, "spin_rear_left": spin - turn, "spin_rear_right": spin + turn,
        "held_east": 14.0, "held_north": 4.0, "since_fix": time % 1.0, "yaw": 0.3 + turn, "fix_interval": 1.0,
    }  # fmt: skip
    return np.array([at.get(name, 0.0) for name in system.inputs])


class Written:
    """A system's equations evaluated anew by CasADi's virtual machine, with Jacobians by ⊞ and ⊟ written out."""

    def __init__(self, system: NavigationSpace, measurements: tuple[Measurement, ...]) -> None:
        n, e = len(system.names), len(system.error_names)
        x, u, p, h = (
            ca.SX.sym("x", n),
            ca.SX.sym("u", len(system.inputs)),
            ca.SX.sym("p", len(system.parameters)),
            ca.SX.sym("h"),
        )
        delta, y = ca.SX.sym("d", e), ca.SX.sym("y", n)
        named = [Named(x, system.names), Named(u, system.inputs), Named(p, system.parameters)]

        def listed(found: Any) -> ca.SX:
            return ca.vertcat(*found) if isinstance(found, (list, tuple)) else ca.SX(found)

        moved = listed(system.transition(*named, h))
        off = listed(system.retract(named[0], delta))
        away = listed(system.difference(Named(y, system.names), named[0]))
        added = listed(system.noise(*named, h))
        added = added if added.shape[1] == e and e > 1 else (ca.diag(added) if added.shape[1] == 1 and e > 1 else added)
        outer = ca.substitute(ca.substitute(ca.jacobian(away, y), y, x), x, moved)
        f = outer @ ca.jacobian(moved, x) @ ca.substitute(ca.jacobian(off, delta), delta, ca.DM.zeros(e))
        self.step = ca.Function("step", [x, u, p, h], [moved, f, added])
        self.off = ca.Function("off", [x, delta], [off])
        self.away = ca.Function("away", [y, x], [away])
        self.sense, self.angles, self.used = {}, {}, {}
        for one in measurements:
            z = Named(listed(system.auxiliary(*named)), system.auxiliaries)
            expected = listed(one.equation(named[0], z, named[1], named[2]))
            by_error = ca.jacobian(ca.substitute(expected, x, off), delta)
            by_error = ca.substitute(by_error, delta, ca.DM.zeros(e))
            when = ca.SX(1) if one.when is None else one.when(*named)
            self.sense[one.name] = ca.Function("sense", [x, u, p], [expected, by_error, when])
            self.angles[one.name] = one.angles


def full(matrix: Any) -> Array:
    return np.array(ca.DM(matrix).full())


@pytest.mark.parametrize("name", exam_except(PARTS, *CHOSEN))
def test_it_equals_filterpy_with_the_same_matrices_over_a_thousand_random_steps(name: str) -> None:
    kalman = pytest.importorskip("filterpy.kalman")
    system, measurements = PARTS[name]
    p = np.array([NUMBERS[key] for key in system.parameters])
    written, random = Written(system, measurements), np.random.default_rng(1)
    ours = Ekf(Dense(system, measurements, p))
    start = system.start(SEEN)
    ours.inputs[:] = inputs_at(system, 0.0)
    ours.start(start)
    e = len(system.error_names)
    other = kalman.KalmanFilter(e, 1)
    mean, other.P = start.mean.copy(), start.covariance.copy()
    for i in range(1000):
        u = inputs_at(system, 0.01 * i)
        ours.inputs[:] = u
        ours.predict(0.01)
        moved, f, q = (full(one) for one in written.step(mean, u, p, 0.01))
        mean, other.F, other.Q, other.x = moved[:, 0], f, q, np.zeros((e, 1))
        other.predict()
        for one in measurements:
            if random.random() < 0.7:
                continue
            expected, h, used = (full(found) for found in written.sense[one.name](mean, u, p))
            value = expected[:, 0] + random.normal(size=len(expected)) * one.deviations
            variances = np.maximum(one.variances, 1e-8) * (1 + random.random())
            ours.correct(one.name, value, variances)
            if not used[0, 0]:
                continue
            other.x = np.zeros((e, 1))
            residual = value - expected[:, 0]
            for k in one.angles:
                residual[k] = (residual[k] + np.pi) % (2 * np.pi) - np.pi
            other.update(residual[:, None], R=np.diag(variances), H=h)
            mean = full(written.off(mean, other.x))[:, 0]
    scale = np.sqrt(np.diag(other.P))
    error = full(written.away(ours.mean, mean))[:, 0]
    assert np.abs(error).max() < 1e-10 * max(1.0, np.abs(mean).max())
    assert np.abs((ours.covariance - other.P) / np.outer(scale, scale)).max() < 1e-8


RUNS, STEPS = 30, 150
# An observer with a constant gain, or without any measurement, has no covariance that means anything.
WITHOUT_COVARIANCE = {name for name, (_, measurements) in PARTS.items() if not measurements}


@pytest.mark.parametrize("name", exam_except([name for name in PARTS if name not in WITHOUT_COVARIANCE], *CHOSEN))
def test_errors_are_as_large_as_it_says_on_the_system_it_assumes(name: str) -> None:
    """Normalized errors squared of 30 runs, each from a start drawn from the prior, with the noise of the filter."""
    system, measurements = PARTS[name]
    p = np.array([NUMBERS[key] for key in system.parameters])
    dense = Dense(system, measurements, p)
    truth, filter = Dense(system, measurements, p), Ekf(dense)
    measurements = tuple(one for one in measurements if all(one.deviations))
    e, random, found = len(system.error_names), np.random.default_rng(5), []
    for _ in range(RUNS):
        start = system.start(SEEN)
        small = Gaussian(start.mean, 0.04 * start.covariance)  # where equations bend, an EKF is right for small errors
        truth.inputs[:] = filter.inputs[:] = inputs_at(system, 0.0)
        truth.start(small)
        truth.retract(0.2 * np.sqrt(np.diag(start.covariance)) * random.normal(size=e))
        filter.start(small)
        for i in range(STEPS):
            u = inputs_at(system, 0.01 * i)
            truth.inputs[:], filter.inputs[:] = u, u
            truth.covariance[:] = 0.0
            truth.step(0.01)
            low = np.linalg.eigh(truth.noise)
            truth.retract(low[1] @ (np.sqrt(low[0].clip(min=0)) * random.normal(size=e)))
            filter.predict(0.01)
            if i % 10:
                continue
            for one in measurements:
                residual, _ = truth.sense(one.name, np.zeros(len(one.deviations)))
                value = -residual + random.normal(size=len(residual)) * one.deviations
                filter.correct(one.name, value, one.variances)
        error = dense.difference(truth.mean, filter.mean)
        found.append(float(error @ np.linalg.solve(filter.covariance, error)))
    low, high = chi2.ppf([0.001, 0.999], e * RUNS) / RUNS
    assert low < np.mean(found) < high
