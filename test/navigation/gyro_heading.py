"""Heading by the yaw gyro, whose bias a constant offset of the course reveals while the car hardly turns.

ψ̇ = r_m - b,  ḃ = 0                                       process
ν = ψ          where |r_m - b| < 0.02 rad/s                course of GNSS, on the straight
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition, NavigationSpace


class GyroHeading(NavigationSpace):
    """Yaw angle [rad] on the map and bias of the yaw gyro [rad/s]."""

    names = ("yaw", "gyro_bias")
    inputs = ("yaw_rate",)
    parameters = ("gyro_noise", "sample_time")
    prior: Mapping[str, float] = {"yaw": 0.05, "gyro_bias": 0.02}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * (u.yaw_rate - x.gyro_bias), x.gyro_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.sampled(x, u, theta, h, yaw_rate=theta.gyro_noise)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {"yaw": x.yaw, "yaw_rate": u.yaw_rate - x.gyro_bias}


COURSE = Measurement(
    "course",
    lambda x, z, u, p: x.yaw,
    (0.01,),
    angles=(0,),
    when=lambda x, u, p: ca.fabs(u.yaw_rate - x.gyro_bias) < 0.02,
)
GYRO_HEADING = Definition.of(GyroHeading(), COURSE)
