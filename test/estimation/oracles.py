"""Systems of the tests written a second time, as matrices and in JAX, and other libraries' filters of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from systems import SALOON, Case
from vsense_ros.estimation.filter import Array

G = 9.81


@dataclass
class Matrices:
    """x⁺ = F x + b, and of each sensor y = H x + d, at inputs u."""

    f: Array
    b: Array
    h: dict[str, Array]
    d: dict[str, Array]


def heading(u: Array, h: float) -> Matrices:
    return Matrices(
        np.array([[1.0, -h], [0.0, 1.0]]), h * np.array([u[0], 0.0]), {"course": np.array([[1.0, 0.0]])}, {}
    )


def velocity(u: Array, h: float) -> Matrices:
    a_x, a_y, r = u
    f = np.eye(4) + h * np.array([[0, -1, r, 0], [0, 0, 0, 0], [-r, 0, 0, -1], [0, 0, 0, 0]])
    seen = {"velocity": np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]]), "speed": np.array([[1.0, 0, 0, 0]])}
    return Matrices(f, h * np.array([a_x, 0.0, a_y, 0.0]), seen, {})


def single_track(u: Array, h: float) -> Matrices:
    """Rajamani 2012, eq. 2.31, of lateral velocity and yaw rate."""
    m, j, a, b, cf, cr = SALOON.values()
    delta, v = u
    slip, turn = (cf + cr) / v, (a * cf - b * cr) / v
    rates = np.array([[-slip / m, -turn / m - v], [-turn / j, -(a * a * cf + b * b * cr) / (v * j)]])
    seen = np.array([[0.0, 1.0], [-slip / m, -turn / m]])
    pushed = delta * np.array([cf / m, a * cf / j])
    return Matrices(np.eye(2) + h * rates, h * pushed, {"imu": seen}, {"imu": np.array([0.0, delta * cf / m])})


MATRICES: dict[str, Callable[[Array, float], Matrices]] = {
    "heading": heading,
    "velocity": velocity,
    "single track": single_track,
}
DENSITY = {  # variance added in a second
    "heading": np.array([0.005**2, 1e-10]),
    "velocity": np.array([0.01, 1e-6, 0.01, 1e-6]),
    "single track": np.array([1e-4, 1e-6]),
}


def filterpy_of(name: str, case: Case, run: list[tuple[Array, list[Any]]]) -> tuple[Array, Array]:
    """Mean and covariance after a run, by filterpy's Kalman filter."""
    from filterpy.kalman import KalmanFilter

    n = len(case.mean)
    made = KalmanFilter(n, 1)
    made.x, made.P = case.start.mean[:, None].copy(), case.start.covariance.copy()
    made.Q = np.diag(DENSITY[name] * case.h)
    for u, values in run:
        now = MATRICES[name](u, case.h)
        made.F, made.B = now.f, np.eye(n)
        made.predict(now.b[:, None])
        for one in values:
            offset = now.d.get(one.sensor, np.zeros(len(one.value)))
            made.update((one.value - offset)[:, None], R=np.diag(one.variance), H=now.h[one.sensor])
    return made.x[:, 0], made.P


def pendulum_step(x: Array, length: float, damping: float, h: float) -> Array:
    rate = x[1] - h * (G / length * np.sin(x[0]) + damping * x[1])
    return np.array([x[0] + h * rate, rate])


def pendulum_matrix(x: Array, length: float, damping: float, h: float) -> Array:
    by_angle, by_rate = -h * G / length * np.cos(x[0]), 1 - h * damping
    return np.array([[1 + h * by_angle, h * by_rate], [by_angle, by_rate]])


def filterpy_pendulum(case: Case, run: list[tuple[Array, list[Any]]]) -> tuple[Array, Array]:
    """Mean and covariance after a run of the pendulum, by filterpy's extended Kalman filter."""
    from filterpy.kalman import ExtendedKalmanFilter

    made = ExtendedKalmanFilter(2, 2)
    made.x, made.P = case.start.mean.copy(), case.start.covariance.copy()
    made.Q = np.diag([1e-6 * case.h, 1e-2 * case.h])
    length, damping = case.parameters.values()
    for _, values in run:
        made.F = pendulum_matrix(made.x, length, damping, case.h)
        moved = pendulum_step(made.x, length, damping, case.h)
        made.predict()
        made.x = moved
        for one in values:
            made.R = np.diag(one.variance)
            made.update(
                one.value,
                lambda x: np.array([[np.cos(x[0]), 0.0], [-np.sin(x[0]), 0.0]]),
                lambda x: np.array([np.sin(x[0]), np.cos(x[0])]),
            )
    return made.x, made.P


@dataclass
class InJax:
    """A system for dynamax: step and measurement in JAX, noises, and which inputs it has."""

    step: Callable[[Any, Any], Any]
    measure: Callable[[Any, Any], Any]
    process: Array
    measurement: Array


def in_jax(name: str, case: Case) -> InJax:
    """Systems with one sensor."""
    import jax.numpy as jnp

    measurement = np.diag(case.measurements[0].variances)
    if name == "pendulum":
        length, damping = case.parameters.values()

        def step(x: Any, u: Any) -> Any:
            rate = x[1] - case.h * (G / length * jnp.sin(x[0]) + damping * x[1])
            return jnp.array([x[0] + case.h * rate, rate])

        return InJax(
            step,
            lambda x, u: jnp.array([jnp.sin(x[0]), jnp.cos(x[0])]),
            np.diag([1e-6, 1e-2]) * case.h,
            measurement,
        )
    if name == "heading":
        return InJax(
            lambda x, u: jnp.array([x[0] + case.h * (u[0] - x[1]), x[1]]),
            lambda x, u: x[:1],
            np.diag(DENSITY[name]) * case.h,
            measurement,
        )
    m, j, a, b, cf, cr = SALOON.values()

    def forces(x: Any, u: Any) -> tuple[Any, Any]:
        return cf * (u[0] - (x[0] + a * x[1]) / u[1]), cr * (b * x[1] - x[0]) / u[1]

    def move(x: Any, u: Any) -> Any:
        front, rear = forces(x, u)
        return x + case.h * jnp.array([(front + rear) / m - u[1] * x[1], (a * front - b * rear) / j])

    return InJax(
        move, lambda x, u: jnp.array([x[1], sum(forces(x, u)) / m]), np.diag(DENSITY[name]) * case.h, measurement
    )


def dynamax_of(
    name: str, case: Case, inputs: Array, values: Array, method: str = "extended_kalman_filter", **options: Any
) -> Any:
    """Posterior of dynamax, which first corrects at the start, then goes on by one step to each further value (t, m).

    dynamax adds 1e-9 to the diagonal of what it inverts; here it does not.
    """
    import jax
    import jax.numpy as jnp
    from dynamax.nonlinear_gaussian_ssm import inference_ekf, inference_ukf
    from dynamax.nonlinear_gaussian_ssm.models import ParamsNLGSSM

    jax.config.update("jax_enable_x64", True)
    system = in_jax(name, case)
    params = ParamsNLGSSM(
        initial_mean=jnp.array(case.start.mean),
        initial_covariance=jnp.array(case.start.covariance),
        dynamics_function=system.step,
        dynamics_covariance=jnp.array(system.process),
        emission_function=system.measure,
        emission_covariance=jnp.array(system.measurement),
    )
    module = inference_ekf if method.startswith("extended") else inference_ukf
    kept = module.psd_solve
    module.psd_solve = lambda a, b, **_: jnp.linalg.solve(a, b)
    try:
        return getattr(module, method)(params, jnp.array(values), inputs=jnp.array(inputs), **options)
    finally:
        module.psd_solve = kept
