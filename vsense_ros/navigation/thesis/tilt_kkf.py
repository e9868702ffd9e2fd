"""Pitch, or roll, and the bias of its gyro by a base line between two antennas (Leung 2010, section 4.5).

    θ̇ = q_m - b_q,  ḃ_q = 0,  z = θ        by two antennas one behind the other
    φ̇ = p_m - b_p,  ḃ_p = 0,  z = φ        by two antennas side by side

θ is that of body and road together. The print lacks the sign of the bias (C17).

One axis by itself takes an angle's rate for that of the body, but θ̇ = q cos φ - r sin φ and φ̇ = p + r tan θ
(eq. 4.31): a car that leans by `LEVEL` while it turns errs by r times that, for as long as a bend lasts. This is part
of the noise here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Named
from vsense_ros.navigation.space import Definition, NavigationSpace, drifting
from vsense_ros.navigation.thesis.attitude_ekf import LEVEL, by_base_line

BEND = 2.0  # [s] for which the other angle keeps its sign, in a bend


class TiltKkf(NavigationSpace):
    """`angle` ("pitch" or "roll") [rad] and the bias of its gyro [rad/s]."""

    parameters = ("gyro_noise", "sample_time")

    def __init__(self, angle: str) -> None:
        self.angle, self.rate = angle, f"{angle}_rate"
        self.names = (angle, "gyro_bias")
        self.inputs = (self.rate, "yaw_rate")
        self.prior: Mapping[str, float] = {angle: LEVEL, "gyro_bias": 0.02}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x[self.angle] + h * (u[self.rate] - x.gyro_bias), x.gyro_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        leaning = LEVEL * ca.fabs(u.yaw_rate) * BEND**0.5
        return self.sampled(x, u, theta, h, **{self.rate: theta.gyro_noise}) + drifting(h, leaning, 1e-5)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {self.angle: x[self.angle], self.rate: u[self.rate] - x.gyro_bias}


def tilt_kkf(angle: str) -> Definition:
    """The filter of an angle, which two antennas measure."""
    return Definition.of(TiltKkf(angle), by_base_line(angle))


PITCH_KKF, ROLL_KKF = tilt_kkf("pitch"), tilt_kkf("roll")
