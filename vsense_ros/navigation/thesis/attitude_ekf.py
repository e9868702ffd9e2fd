"""Attitude and gyro biases by three gyros and two GNSS antennas (Leung 2010, section 4.5).

    (φ̇, θ̇, ψ̇) = A(φ, θ) ((p, q, r)_m - b)                     eq. 4.31, Euler angles of ISO 8855 (nose up: θ < 0)

Two antennas measure the heading, and where the vehicle file says so (`gnss_tilt`) pitch or roll; without that, roll and
pitch are close to zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition, NavigationSpace, drifting

LEVEL = 0.05  # [rad] by which roll and pitch may be off zero where no antenna measures them


class AttitudeEkf(NavigationSpace):
    """See the module."""

    names = ("roll", "pitch", "yaw", "gyro_bias_x", "gyro_bias_y", "gyro_bias_z")
    inputs = ("roll_rate", "pitch_rate", "yaw_rate")
    parameters = ("gyro_noise", "sample_time")
    prior: Mapping[str, float] = {
        "roll": LEVEL, "pitch": LEVEL, "yaw": 0.05, "gyro_bias_x": 0.02, "gyro_bias_y": 0.02, "gyro_bias_z": 0.02,
    }  # fmt: skip
    largest: Mapping[str, float] = {"pitch": 1.4}

    def rates(self, x: Named, u: Named) -> ca.SX:
        """Angular velocity of the body (3,) [rad/s]."""
        return u.vector[:3] - x.vector[3:6]

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return ca.vertcat(x.vector[:3] + h * angle_rates(x.roll, x.pitch, self.rates(x, u)), x.vector[3:])

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        noise = theta.gyro_noise
        input_noise = self.sampled(x, u, theta, h, roll_rate=noise, pitch_rate=noise, yaw_rate=noise)
        return input_noise + drifting(h, 0.0, 0.0, 0.0, 1e-5, 1e-5, 1e-5)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        p, q, r = ca.vertsplit(self.rates(x, u))
        return {**super().motion(x, u, theta), "roll_rate": p, "pitch_rate": q, "yaw_rate": r}


def angle_rates(roll: ca.SX, pitch: ca.SX, rates: ca.SX) -> ca.SX:
    """A(φ, θ) ω (3,). In a banked turn ψ̇ = r / cos φ (C3)."""
    p, q, r = ca.vertsplit(rates)
    across = ca.sin(roll) * q + ca.cos(roll) * r
    return ca.vertcat(p + across * ca.tan(pitch), ca.cos(roll) * q - ca.sin(roll) * r, across / ca.cos(pitch))


def by_base_line(angle: str) -> Measurement:
    """An angle ("roll" or "pitch") as two antennas measure it."""
    return Measurement(angle, lambda x, z, u, p: x[angle], (0.01,), angles=(0,))


HEADING = Measurement("heading", lambda x, z, u, p: x.yaw, (0.01,), angles=(0,))
UPRIGHT = Measurement("upright", lambda x, z, u, p: [x.roll, x.pitch], (10 * LEVEL, 10 * LEVEL))
ATTITUDE_EKF = Definition.of(AttitudeEkf(), HEADING, by_base_line("roll"), by_base_line("pitch"), UPRIGHT)
