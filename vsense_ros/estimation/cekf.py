"""The continuous extended Kalman filter (CEKF): state and covariance as differential equations.

    ẋ = f(x, u) + Σ P Hᵀ R_c⁻¹ (y - h(x)),    Ṗ = A P + P Aᵀ + Q_c - Σ P Hᵀ R_c⁻¹ H P

(Kalman & Bucy 1961, linearised; the CEKF of Rodríguez 2020 and of Sanjurjo et al. 2017). A measurement acts all the
time until the next one comes, R_c = R T with the period T of its sensor: as if it were continuous, which is true to
second order of T times the rates of the observer, and false where measurements are rare. It is a reference to compare
discrete filters with, not one to use: where T is long, the measurement that is held is of the past, and where the
equations are integrated at the sampling rate, the gain times T may leave what the method is stable for. f, A and Q_c
are what a state space does in a step that tends to nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.codegen import Kernel
from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import UNLIMITED, sensing
from vsense_ros.estimation.filter import Array, Gaussian, Innovation
from vsense_ros.estimation.gaussian import COMPONENTS, GaussianFilter, Whitened, check_variances, whiten
from vsense_ros.estimation.state_space import (
    Measurement,
    StateSpace,
    Symbols,
    by_name,
    parameter_values,
    title,
)

_SHARE = 0.5  # of the time in which measurements act, that a step may take


class Cekf(GaussianFilter):
    """Of a state space with ⊞ = +, measured by sensors with these `periods` [s], by name.

    The equations are integrated by the fourth-order method of Runge and Kutta in steps of at most `longest_step` [s],
    and with `adaptive` shorter ones where the covariance changes faster: after the first measurement of a state that is
    hardly known it falls like 1/t.
    `memory` holds mean, covariance, inputs, parameters, and of each sensor what it measured last, with its variances.
    """

    def __init__(
        self,
        system: StateSpace,
        measurements: Sequence[Measurement],
        parameters: Mapping[str, float] | Sequence[float] | Array = (),
        *,
        periods: Mapping[str, float],
        longest_step: float = 0.001,
        adaptive: bool = True,
    ) -> None:
        if not system.is_flat:
            raise InputError(f"{title(system)} is no vector space: the continuous filter has no ⊞")
        self.system, self.measurements = system, by_name(measurements, COMPONENTS)
        self.names, self.sensors = system.names, tuple(self.measurements)
        if missing := [name for name in self.sensors if not periods.get(name, 0.0) > 0]:
            raise InputError(f"the continuous filter needs the period [s] of {missing[0]!r}, greater than zero")
        self.periods, self.longest_step, self.adaptive = dict(periods), longest_step, adaptive
        self._lay_out([len(one.deviations) for one in measurements])
        self.parameters[:] = parameter_values(system, parameters)
        self._x = np.zeros(len(self.mean))  # where the functions are called
        self._flow, *sense = self._bound(rate_functions(system, measurements))
        self._sense = dict(zip(self.sensors, sense, strict=True))
        self._largest = np.array([system.largest.get(name, UNLIMITED) for name in self.names])

    def _lay_out(self, sizes: Sequence[int]) -> None:
        """Memory and its parts, of sensors with these numbers of components."""
        system = self.system
        n, k, p = len(system.names), len(system.inputs), len(system.parameters)
        lengths = [n, n * n, k, p, *np.repeat(sizes, 2).tolist()]
        self.memory = np.zeros(sum(lengths))
        self.mean, square, self.inputs, self.parameters, *held = np.split(self.memory, np.cumsum(lengths[:-1]).tolist())
        self.covariance = square.reshape(n, n)
        self._values = dict(zip(self.sensors, held[::2], strict=True))
        self._variances = dict(zip(self.sensors, held[1::2], strict=True))

    def _bound(self, functions: Sequence[ca.Function]) -> list[Kernel]:
        at = [self._x, self.inputs, self.parameters]
        flow = Kernel(functions[0], at)
        pairs = zip(functions[1:], self._values.values(), strict=True)
        return [flow, *(Kernel(function, [*at, value]) for function, value in pairs)]

    def start(self, belief: Gaussian) -> None:
        """As `GaussianFilter.start`; nothing has been measured yet."""
        super().start(belief)
        for value in self._values.values():
            value[:] = np.nan
        if not all(np.isfinite(part).all() for part in self._rates(self.mean, self.covariance)):
            raise InputError(f"{title(self.system)}: the state's rate of change is not finite at {belief.mean}")

    def _rates(self, mean: Array, covariance: Array) -> tuple[Array, Array]:
        """ẋ (n,) and Ṗ (n, n), with what was measured last."""
        self._x[:] = mean
        self._flow.call()
        flow, a, noise = self._flow.results
        rate = flow[:, 0].copy()
        grown = a @ covariance
        riccati = grown + grown.T + noise
        for name, kernel in self._sense.items():
            kernel.call()
            residual, by_error, used = kernel.results
            present = np.isfinite(residual[:, 0])
            if used[0, 0] == 0 or not present.any():
                continue
            across = covariance @ by_error[:, present]
            weighted = across / (self._variances[name][present] * self.periods[name])
            rate += weighted @ residual[present, 0]
            riccati -= weighted @ across.T
        return rate, riccati

    def predict(self, h: float) -> None:
        """Go on by `h` [s]. Raises `FloatingPointError` where the state leaves the finite."""
        left = h
        with np.errstate(all="ignore"):
            while left > 1e-12 * h:
                step = left / max(np.ceil(left / self._step() - 1e-9), 1)
                self._runge_kutta(step)
                left -= step
                if not (np.isfinite(self.mean).all() and np.isfinite(self.covariance).all()):
                    raise FloatingPointError(f"the continuous filter of {title(self.system)} left the finite")

    def _step(self) -> float:
        """What can be integrated at once [s]: a part of the time in which a measurement acts."""
        rate = 0.0
        if self.adaptive:
            self._x[:] = self.mean
            for name, kernel in self._sense.items():
                kernel.call()
                across = self.covariance @ kernel.results[1]
                power = np.einsum("ij,ij->j", kernel.results[1], across)
                present = np.isfinite(kernel.results[0][:, 0]) & (kernel.results[2][0, 0] != 0)
                rate += float(np.sum((power / self._variances[name])[present]) / self.periods[name])
        return min(self.longest_step, _SHARE / max(rate, 1e-300))

    def _runge_kutta(self, h: float) -> None:
        x, p = self.mean.copy(), self.covariance.copy()
        x1, p1 = self._rates(x, p)
        x2, p2 = self._rates(x + 0.5 * h * x1, p + 0.5 * h * p1)
        x3, p3 = self._rates(x + 0.5 * h * x2, p + 0.5 * h * p2)
        x4, p4 = self._rates(x + h * x3, p + h * p3)
        self.mean += h / 6 * (x1 + 2 * x2 + 2 * x3 + x4)
        self.covariance += h / 6 * (p1 + 2 * p2 + 2 * p3 + p4)
        self.covariance[:] = 0.5 * (self.covariance + self.covariance.T)

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """Take a measurement, which acts from now on; `scale` multiplies the covariance of its innovation.

        The innovation is told as a discrete filter would, with H P Hᵀ + R. One that is not believed leaves the sensor
        without a measurement.
        """
        if sensor not in self._sense:
            raise InputError(f"the filter has no sensor {sensor!r}; it has: {', '.join(self.sensors) or 'none'}")
        m = len(self._values[sensor])
        if len(value) != m:
            raise InputError(f"a measurement of {sensor!r} has {m} components, but got {len(value)}")
        check_variances(sensor, value, variance)
        self._values[sensor][:], self._variances[sensor][:] = value, np.asarray(variance) * scale
        found = self._innovation(sensor, variance, scale)
        if not found.nis <= limit:
            self._values[sensor][:] = np.nan
        if found.nis != found.nis:
            self.recover(sensor)
        factor = np.zeros((m, m))
        found.write(found.whitened, factor.reshape(-1))
        return Innovation(found.whitened, factor, found.nis, 0.0 <= found.nis <= limit)

    def _innovation(self, sensor: str, variance: Array, scale: float) -> Whitened:
        """Of what a sensor has just measured, as a discrete filter would have it."""
        self._x[:] = self.mean
        kernel = self._sense[sensor]
        kernel.call()
        residual, by_error, used = kernel.results
        present = residual[:, 0] if used[0, 0] else np.full(len(residual), np.nan)
        across = by_error.T @ self.covariance
        return whiten(present, scale * (across @ by_error + np.diag(variance)), across)

    def is_valid(self) -> bool:
        """Whether the mean is finite and within its bounds, and no variance below zero."""
        return bool((np.abs(self.mean) < self._largest).all() and (self.covariance.diagonal() >= 0).all())


def rate_functions(system: StateSpace, measurements: Sequence[Measurement]) -> list[ca.Function]:
    """ẋ (n,), A (n, n), Q_c (n, n) of (x, u, θ), and each sensor as `dense.sensing`, compiled together."""
    at = Symbols(system)
    flow, noise = (
        ca.substitute(ca.jacobian(part, at.h), at.h, 0.0) for part in (at.moved(), ca.densify(at.noise())[:])
    )
    n = len(system.names)
    results = [flow, ca.jacobian(flow, at.x.vector), ca.reshape(ca.densify(noise), n, n)]
    made = [codegen.function("flow", at.now, results, ("x", "u", "p"))]
    made += [sensing(at, one, i) for i, one in enumerate(measurements)]
    return codegen.compiled(f"rates_{title(system)}", made)
