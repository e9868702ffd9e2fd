"""The dual filter with a side slip that is extrapolated from the last fixes (Leung 2010, section 4.4.6).

    x = (ψ, b_r, β),  ψ̇ = r_m - b_r,  β̇ = 0
    bend, fix:      (ν, β_ext) = (ψ + β, β)      rule 1
    bend, no fix:   β_ext = β                    rule 2
    straight:       (ν, 0) = (ψ + β, β)          rule 3

    z = (V cos β̂, V sin β̂)                      velocity in the axes of the car, at a fix and between (figure 4.30)

with β_ext(t) the line (or parabola) through ν - ψ̂ of the last two (three) fixes. It is made of the same ν and ψ̂ that it
corrects: rule 1 counts a fix twice, and the covariance is too small (C24).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.cascade import PassedInput, PassedMeasurement
from vsense_ros.estimation.state_space import Measurement, Named, wrapped
from vsense_ros.navigation.space import Definition, NavigationSpace, Remembered, drifting
from vsense_ros.navigation.thesis.dual_kkf import GNSS
from vsense_ros.navigation.thesis.velocity_kkf import HELD, LONGEST_HOLD, VELOCITY, VelocityKkf
from vsense_ros.navigation.yaw_kkf import straight

# [rad] of β_ext, a hundred times a second. The thesis gives none: that of the fixes of its section 4.4, of which β_ext
# is made, 0.0224 m/s at 5 m/s.
EXTRAPOLATED_NOISE = 0.0045


class YawKkfB(NavigationSpace):
    """See the module; `order` 1 or 2."""

    names = ("yaw", "gyro_bias", "side_slip")
    inputs = ("yaw_rate", "since_fix", "last_slip", "slip_before", "slip_before_that", "fix_interval", "bias_deviation")
    parameters = ("gyro_noise", "sample_time", "straight_rate")
    prior: Mapping[str, float] = {"yaw": 0.05, "gyro_bias": 0.02, "side_slip": 0.02}

    def __init__(self, order: int) -> None:
        self.order = order

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * (u.yaw_rate - x.gyro_bias), x.gyro_bias, x.side_slip]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.sampled(x, u, theta, h, yaw_rate=theta.gyro_noise) + drifting(h, 0.0, 1e-5, 0.05)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {"yaw": x.yaw, "yaw_rate": u.yaw_rate - x.gyro_bias}

    def extrapolated(self, u: Named) -> ca.SX:
        """β_ext now, by Newton's formula."""
        interval = ca.fmax(u.fix_interval, 0.01)
        first = (u.last_slip - u.slip_before) / interval
        second = (u.last_slip - 2 * u.slip_before + u.slip_before_that) / (2 * interval**2)
        t = u.since_fix
        return u.last_slip + first * t + (second * t * (t + interval) if self.order == 2 else 0.0)


def fix(x: Named, u: Named, theta: Named, velocity: ca.SX, variance: Named) -> dict[str, ca.SX]:
    """The side slip of a new fix becomes the last one."""
    slip = wrapped(ca.atan2(velocity[1], velocity[0]) - x.yaw)
    return {
        "last_slip": slip,
        "slip_before": u.last_slip,
        "slip_before_that": u.slip_before,
        "fix_interval": ca.if_else(u.since_fix < LONGEST_HOLD, u.since_fix, 1e3),
        "bias_deviation": ca.sqrt(ca.fmax(variance.gyro_bias, 0.0)),
    }


COURSE = Measurement("course", lambda x, z, u, p: x.yaw + x.side_slip, (0.01,), angles=(0,))
NO_SIDE_SLIP = Measurement("no_side_slip", lambda x, z, u, p: x.side_slip, (0.01,), when=straight)


def _in_bend(x: Named, u: Named, p: Named) -> ca.SX:
    return (1 - straight(x, u, p)) * (u.since_fix < LONGEST_HOLD)


def _by_side_slip(x: Named, velocity: ca.SX) -> list[ca.SX]:
    """Velocity over ground (2,) [m/s] in the axes of the car, by the estimated side slip (Leung 2010, figure 4.30)."""
    speed = ca.sqrt(ca.sumsqr(velocity) + 1e-12)  # its derivative exists at standstill, too
    return [speed * ca.cos(x.side_slip), speed * ca.sin(x.side_slip)]


BY_SIDE_SLIP = PassedMeasurement(GNSS, "heading", "velocity", "velocity", _by_side_slip)


def side_slip_kkf(order: int, noise: float = EXTRAPOLATED_NOISE, held: Measurement = HELD) -> Definition:
    """The filter with extrapolation of this order, of a side slip with this noise [rad], and with what holds the
    velocity between fixes."""
    system = YawKkfB(order)
    extrapolated = Measurement(
        "extrapolated_slip",
        lambda x, z, u, p: x.side_slip - system.extrapolated(u),
        (noise,),
        when=_in_bend,
    )
    link = PassedInput(
        "heading",
        "velocity",
        lambda x, u: [u.yaw_rate - x.gyro_bias, ca.atan2(u.held_north, u.held_east + 1e-9) - x.side_slip],
        ("yaw_rate", "yaw"),
    )
    parts = {
        "heading": (system, (COURSE, extrapolated, NO_SIDE_SLIP)),
        "velocity": (VelocityKkf(), (VELOCITY, held)),
    }
    return Definition(parts, (link,), (BY_SIDE_SLIP,), remembered=(Remembered("heading", "course", fix),))


SIDE_SLIP_KKF_1 = side_slip_kkf(1)
SIDE_SLIP_KKF_2 = side_slip_kkf(2)
