"""Side slip by a single-track model that GNSS and the gyro correct (Anderson & Bevly 2005; Leung 2010, section 5.3.1).

    β̇, ṙ by the model, ψ̇ = r, ḃ_r = 0, ḃ_δ = 0                process, by δ_m - b_δ and V (the sign of b_δ: C7)
    r_m = r + b_r,  ν = ψ + β                                  measurements

2a knows no offset of the steering sensor, 2b estimates it at all times, 2c holds in bends the mean of what it was on
the straight of the last ten seconds: in a bend a wrong stiffness looks like an offset, (K - K̂) a_y (C20).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.particle import ParticleFilter
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation import single_track
from vsense_ros.navigation.car_numbers import STRAIGHT
from vsense_ros.navigation.space import Definition, NavigationSpace, Remembered, drifting

NOISE = (3e-3, 2e-2)  # of side slip and yaw rate after a second [rad], [rad/s] (the thesis gives none)
WINDOW = 10.0  # [s] of the mean of 2c


class Mekf2a(NavigationSpace):
    """The modified EKF with the states β, r, ψ and b_r."""

    names: tuple[str, ...] = ("side_slip", "yaw_rate", "yaw", "gyro_bias")
    inputs: tuple[str, ...] = ("steer_angle", "speed")
    parameters: tuple[str, ...] = single_track.PARAMETERS
    prior: Mapping[str, float] = {"side_slip": 0.01, "yaw_rate": 0.05, "yaw": 0.05, "gyro_bias": 0.02}
    drifts: tuple[float, ...] = (*NOISE, 1e-5, 1e-6)

    def steer(self, x: Named, u: Named) -> ca.SX:
        """Angle of the front wheels."""
        return u.steer_angle

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        moving = single_track.rates(x.side_slip, x.yaw_rate, self.steer(x, u), u.speed, theta)
        still = ca.SX.zeros(len(self.names) - 3)
        return single_track.second_order(x.vector, ca.vertcat(*moving, x.yaw_rate, still), h)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return drifting(h, *self.drifts)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        across = u.speed * ca.sin(x.side_slip)
        motion = {"side_slip": x.side_slip, "yaw_rate": x.yaw_rate, "yaw": x.yaw}
        return {**motion, "forward_velocity": u.speed * ca.cos(x.side_slip), "lateral_velocity": across}


class Mekf2b(Mekf2a):
    """`Mekf2a` with the state b_δ, `steering_bias` [rad]."""

    names = (*Mekf2a.names, "steering_bias")
    prior: Mapping[str, float] = {**Mekf2a.prior, "steering_bias": 0.01}
    drifts = (*Mekf2a.drifts, 3e-5)

    def steer(self, x: Named, u: Named) -> ca.SX:
        return u.steer_angle - x.steering_bias


class Mekf2c(Mekf2b):
    """`Mekf2b` that takes in bends the mean `held_steering_bias` in place of b_δ."""

    inputs = (*Mekf2b.inputs, "held_steering_bias")
    parameters = (*Mekf2b.parameters, "sample_time")

    def steer(self, x: Named, u: Named) -> ca.SX:
        straight = ca.fabs(x.yaw_rate) < STRAIGHT
        return u.steer_angle - ca.if_else(straight, x.steering_bias, u.held_steering_bias)


GYRO = Measurement("gyro", lambda x, z, u, p: x.yaw_rate + x.gyro_bias, (0.003,))
COURSE = Measurement("course", lambda x, z, u, p: x.yaw + x.side_slip, (0.01,), angles=(0,))


def running_mean(x: Named, u: Named, theta: Named, value: ca.SX, variance: Named) -> dict[str, ca.SX]:
    """Running mean of b_δ on the straight."""
    towards = theta.sample_time / WINDOW * (x.steering_bias - u.held_steering_bias)
    return {"held_steering_bias": u.held_steering_bias + ca.if_else(ca.fabs(x.yaw_rate) < STRAIGHT, towards, 0.0)}


MEKF_2A = Definition.of(Mekf2a(), GYRO, COURSE)
MEKF_2B = Definition.of(Mekf2b(), GYRO, COURSE)
PARTICLES = Definition(  # Leung 2010, section 2.4.4
    {"": (Mekf2b(), (GYRO, COURSE))},
    make_part=lambda system, measurements, numbers: ParticleFilter(system, measurements, numbers),
)
MEAN_ON_STRAIGHT = Remembered("", "rates and forces", running_mean)
MEKF_2C = Definition({"": (Mekf2c(), (GYRO, COURSE))}, remembered=(MEAN_ON_STRAIGHT,))
