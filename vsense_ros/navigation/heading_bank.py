"""The heading of a car of which nothing is known at start: a bank of hypotheses (Gaussian sum, as PX4's EKF-GSF).

Filters of (v_east, v_north, ψ, b_r) begin at headings all around. Each goes on by gyro and accelerometers, a fix of the
velocity corrects each and weighs it by the likelihood of its innovation. A wrong heading turns accelerations into the
wrong direction: whoever accelerates or turns is recognised within seconds, without gates and before the course means
anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian, Innovation
from vsense_ros.estimation.gaussian import GaussianFilter
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.open_loop import MapIns
from vsense_ros.navigation.space import Definition, FirstReadings, drifting

HYPOTHESES = 8
TILT = 0.8  # [m/s²/√Hz] of body and road, and of biases, in the accelerometers
SLIDING = 3.0  # [m/s] of a car across itself, a hundred times a second


class Hypothesis(MapIns):
    """Velocity on the map, heading, bias of the gyro."""

    names = ("velocity_east", "velocity_north", "yaw", "gyro_bias")
    prior: Mapping[str, float] = {
        "velocity_east": 0.5, "velocity_north": 0.5, "yaw": np.pi / HYPOTHESES, "gyro_bias": 0.02,
    }  # fmt: skip

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        c, s = ca.cos(x.yaw), ca.sin(x.yaw)
        east = c * u.acceleration_x - s * u.acceleration_y
        north = s * u.acceleration_x + c * u.acceleration_y
        moved = [x.velocity_east + h * east, x.velocity_north + h * north]
        return [*moved, x.yaw + h * (u.yaw_rate - x.gyro_bias), x.gyro_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return super().noise(x, u, theta, h) + drifting(h, TILT, TILT, 0.0, 1e-5)

    def begin(self, first_readings: FirstReadings) -> Mapping[str, float]:
        return {name: first_readings[name] for name in ("velocity_east", "velocity_north") if name in first_readings}

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        motion = super().motion(x, u, theta)
        return {name: motion[name] for name in ("yaw", "forward_velocity", "lateral_velocity")} | {
            "yaw_rate": u.yaw_rate - x.gyro_bias
        }


class HeadingBank(GaussianFilter):
    """The filters side by side in one memory, behind their mixture's mean, covariance, its inputs and the logarithms of
    weights. `ekf` is such a filter; `memory` may be given, as a part of another's."""

    def __init__(self, ekf: Ekf, memory: Array | None = None) -> None:
        n, k, size = len(ekf.mean), len(ekf.inputs), len(ekf.memory)
        self.memory = np.zeros(n + n * n + k + HYPOTHESES * (1 + size)) if memory is None else memory
        bounds = np.cumsum([n, n * n, k, HYPOTHESES]).tolist()
        self.mean, covariance, self.inputs, self.log_weights, memory_of_bank = np.split(self.memory, bounds)
        self.covariance = covariance.reshape(n, n)
        self.bank = [ekf.at(part) for part in np.split(memory_of_bank, HYPOTHESES)]
        self.names, self.sensors, self.system = ekf.names, ekf.sensors, ekf.system
        self._yaw = ekf.names.index("yaw")

    def at(self, memory: Array) -> HeadingBank:
        """A copy of this bank whose memory is this array (s,)."""
        present = self.memory.copy()
        copy = HeadingBank(self.bank[0], memory)
        memory[:] = present
        return copy

    def start(self, belief: Gaussian) -> None:
        """Start the filters with headings all around that of the belief."""
        self.check(belief)
        self.log_weights[:] = -np.log(HYPOTHESES)
        for i, ekf in enumerate(self.bank):
            mean = np.array(belief.mean)
            mean[self._yaw] += 2 * np.pi * i / HYPOTHESES
            ekf.inputs[:] = self.inputs
            ekf.start(Gaussian(mean, belief.covariance))
        self.mix()

    def predict(self, h: float) -> None:
        """Predict each filter, with the inputs of the bank."""
        for ekf in self.bank:
            ekf.inputs[:] = self.inputs
            ekf.predict(h)
        self.mix()

    def correct(
        self, sensor: str, value: Array, variance: Array, limit: float = np.inf, scale: float = 1.0
    ) -> Innovation:
        """Each filter, and its weight by the likelihood of what it had expected; `limit` holds for the likeliest."""
        before = self.memory.copy()
        best, likeliest = int(np.argmax(self.log_weights)), _NOTHING
        for i, ekf in enumerate(self.bank):
            innovation = ekf.correct(sensor, value, variance, np.inf, scale)
            if i == best:
                likeliest = innovation
            if innovation.nis >= 0:
                factor = np.diag(innovation.factor)
                self.log_weights[i] -= 0.5 * innovation.nis + float(np.sum(np.log(factor)))
        if likeliest.nis > limit and self.log_weights[best] > np.log(0.9):
            self.memory[:] = before
            return likeliest._replace(accepted=False)
        self.log_weights -= self.log_weights.max()
        self.log_weights[:] = np.maximum(self.log_weights, -50.0)
        self.log_weights -= np.log(np.sum(np.exp(self.log_weights)))
        self.mix()
        return likeliest

    def mix(self) -> None:
        """Make mean and covariance those of the mixture; headings are averaged about the likeliest."""
        weights = np.exp(self.log_weights)
        means = np.array([ekf.mean for ekf in self.bank])
        around = means[int(np.argmax(weights)), self._yaw]
        means[:, self._yaw] = around + (means[:, self._yaw] - around + np.pi) % (2 * np.pi) - np.pi
        self.mean[:] = weights @ means
        deviations = means - self.mean
        inner = np.einsum("i,ijk->jk", weights, np.array([ekf.covariance for ekf in self.bank]))
        self.covariance[:] = inner + deviations.T @ (weights[:, None] * deviations)

    def is_valid(self) -> bool:
        """True if every filter of the bank is valid."""
        return all(ekf.is_valid() for ekf in self.bank)

    def inflate(self) -> None:
        """Inflate the covariance of each filter."""
        for ekf in self.bank:
            ekf.inflate()
        self.mix()


_NOTHING = Innovation(np.zeros(0), np.zeros((0, 0)), -1.0, True)


def _sliding(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    return ca.cos(x.yaw) * x.velocity_north - ca.sin(x.yaw) * x.velocity_east


def _rearward(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    """How fast the car goes backwards, which it hardly does."""
    return ca.fmin(ca.cos(x.yaw) * x.velocity_east + ca.sin(x.yaw) * x.velocity_north, 0.0)


VELOCITY = Measurement("gnss_velocity", lambda x, z, u, p: [x.velocity_east, x.velocity_north], (0.1, 0.1))
NO_SLIDING = Measurement("no_sliding", _sliding, (SLIDING,))
FORWARDS = Measurement("forwards", _rearward, (SLIDING,))

HEADING_BANK = Definition(
    {"": (Hypothesis(), (VELOCITY, NO_SLIDING, FORWARDS))},
    finds_heading=True,
    make_part=lambda system, measurements, numbers: HeadingBank(Ekf(Dense(system, measurements, numbers))),
)
