"""Heading and bias of the yaw gyro (Bevly et al. 2001; Leung 2010, section 4.2.1).

    ψ̇ = r_m - b_r,  ḃ_r = 0                                   process
    ν = ψ   where |r_m - b_r| < 1 °/s                          course: on the straight a car goes where it points

Corrections of the print (C5, C6): the noise of a step is (T σ_r)²; a bias has to be uncertain at start to be learnt;
the innovation of the angle itself is wrapped, where cosine and sine would have a singular covariance.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition, NavigationSpace, drifting


class YawKkf(NavigationSpace):
    """See the module."""

    names = ("yaw", "gyro_bias")
    inputs = ("yaw_rate",)
    parameters = ("gyro_noise", "sample_time", "straight_rate")
    prior: Mapping[str, float] = {"yaw": 0.05, "gyro_bias": 0.02}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * (u.yaw_rate - x.gyro_bias), x.gyro_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.sampled(x, u, theta, h, yaw_rate=theta.gyro_noise) + drifting(h, 0.0, 1e-5)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {"yaw": x.yaw, "yaw_rate": u.yaw_rate - x.gyro_bias}


def straight(x: Named, u: Named, theta: Named) -> ca.SX:
    """Whether the car goes straight, by the gyro without its bias: with it, one of 1 °/s would decide (C5)."""
    return ca.fabs(u.yaw_rate - x.gyro_bias) < theta.straight_rate


def turning(x: Named, u: Named, theta: Named) -> ca.SX:
    """The opposite."""
    return 1 - straight(x, u, theta)


COURSE = Measurement("course", lambda x, z, u, p: x.yaw, (0.01,), angles=(0,), when=straight)
HEADING = Measurement("heading", lambda x, z, u, p: x.yaw, (0.1,), angles=(0,))  # two antennas, or a magnetometer

YAW_KKF = Definition.of(YawKkf(), COURSE)
YAW_KKF_WITH_HEADING = Definition.of(YawKkf(), COURSE, HEADING)
