"""Three filters in a row: heading by gyro, rolling radius by wheels, velocity (Leung 2010, figure 4.14).

The speed of the wheels takes the place of the forward velocity between fixes; the lateral one is held, as in the dual
filter. Triple b (eq. 4.19) adds what the accelerometer along the car feels of body motion in bends, b_d: zero on the
straight, where a measurement says so. The thesis computes it from the difference of wheel and GNSS speed at each fix,
with the wrong sign (C16); here it is a state, which the same difference corrects.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.cascade import PassedMeasurement
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition, NavigationSpace
from vsense_ros.navigation.thesis.dual_kkf import RATE, TURNED
from vsense_ros.navigation.thesis.velocity_kkf import LONGEST_HOLD, VELOCITY, VelocityKkf, less_held
from vsense_ros.navigation.thesis.wheel_speed_ekf import B2, HEADING_REPEATS, PASSED_YAW, YAW_OF_GYRO, WheelSpeedEkf
from vsense_ros.navigation.yaw_kkf import COURSE, YawKkf, remembered

WHEELS = Measurement("rear_spins", lambda x, z, u, p: [0.0, 0.0], (0.05, 0.05))  # outside: left and right
ROLLING = Measurement("rolling_speed", lambda x, z, u, p: x.forward_velocity, (0.1,))  # of the velocity filter
HELD_LATERAL = Measurement(
    "held_velocity",
    lambda x, z, u, p: less_held(x, z, u, p)[1],
    (1.0,),
    when=lambda x, u, p: u.since_fix < LONGEST_HOLD,
)


OF_WHEELS = PassedMeasurement(
    WHEELS,
    "wheels",
    "velocity",
    "rolling_speed",
    lambda x, spins: (spins[0] + spins[1]) / 2 * x.rolling_radius,
    HEADING_REPEATS,  # the radius changes no faster than the heading that determines it
)


class VelocityKkfB(VelocityKkf):
    """The velocity filter with the state b_d, `dynamic_bias` [m/s²]."""

    names = (*VelocityKkf.names, "dynamic_bias")
    parameters = (*VelocityKkf.parameters, "straight_rate")
    prior: Mapping[str, float] = {**VelocityKkf.prior, "dynamic_bias": 0.1}

    def acceleration(self, x: Named, u: Named) -> ca.SX:
        along, across = ca.vertsplit(super().acceleration(x, u))
        return ca.vertcat(along - x.dynamic_bias, across)

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [*super().transition(x, u, theta, h), x.dynamic_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        noise = theta.acceleration_noise
        input_noise = self.sampled(x, u, theta, h, acceleration_x=noise, acceleration_y=noise)
        return input_noise + ca.diag(ca.DM([0.0, 1e-10, 0.0, 1e-10, 0.1**2])) * h


NO_DYNAMIC_BIAS = Measurement(
    "no_dynamic_bias",
    lambda x, z, u, p: x.dynamic_bias,
    (0.05,),
    when=lambda x, u, p: ca.fabs(u.yaw_rate) < p.straight_rate,
)


def triple(velocity: NavigationSpace, *further: Measurement) -> Definition:
    """The three filters with this velocity filter and further measurements of it."""
    parts = {
        "wheels": (WheelSpeedEkf(), (*B2, YAW_OF_GYRO)),
        "heading": (YawKkf(), (COURSE,)),
        "velocity": (velocity, (VELOCITY, HELD_LATERAL, ROLLING, *further)),
    }
    return Definition(parts, (RATE,), (PASSED_YAW, TURNED, OF_WHEELS), (remembered("heading"),))


TRIPLE_KKF = triple(VelocityKkf())
TRIPLE_KKF_B = triple(VelocityKkfB(), NO_DYNAMIC_BIAS)
