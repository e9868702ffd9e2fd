"""Heading and rolling radius by the speeds of the rear wheels, without a gyro (Leung 2010, section 4.3).

    ψ̇ = (ω_R - ω_L) R / t                                      process (eqs. 4.12, 4.15, 4.16 with its missing T, C13)
    V = (ω_R + ω_L) R / 2                                      speed over ground, on the straight (b1)

a: the course on the straight alone, of which the radius is not observable there. b1: the speed over ground too. b2: the
last speed held between fixes on the straight. c: in bends the heading of a `YawKkf` beside it (eq. 4.21). The thesis
uses that a hundred times a second as if it were new each time, and so learns a wrong radius from one heading: its error
stays until a straight corrects it. What goes to and fro there is used twice (C24). The speed is measured, not the
radius 2 V / (ω_R + ω_L), which has no value at rest.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.cascade import PassedMeasurement
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition, NavigationSpace, drifting
from vsense_ros.navigation.yaw_kkf import COURSE, YawKkf, remembered

HEADING_REPEATS = 10_000  # uses of a heading, a hundred a second, from one straight to the next
HELD_NOISE = 0.3  # [m/s] of a speed that is held, a hundred times a second


class WheelSpeedEkf(NavigationSpace):
    """See the module."""

    names = ("yaw", "rolling_radius")
    inputs = ("spin_rear_left", "spin_rear_right", "held_east", "held_north", "since_fix")
    parameters = ("rear_track", "spin_noise", "sample_time", "straight_rate")
    prior: Mapping[str, float] = {"yaw": 0.05, "rolling_radius": 0.02}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * turning_rate(x, u, theta), x.rolling_radius]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        noise = theta.spin_noise
        return self.sampled(x, u, theta, h, spin_rear_left=noise, spin_rear_right=noise) + drifting(h, 0.0, 1e-5)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {"yaw": x.yaw, "yaw_rate": turning_rate(x, u, theta), "forward_velocity": rolling_speed(x, u, theta)}


def turning_rate(x: Named, u: Named, theta: Named) -> ca.SX:
    """Yaw rate by the speeds of the rear wheels (eq. 4.15)."""
    return (u.spin_rear_right - u.spin_rear_left) * x.rolling_radius / theta.rear_track


def rolling_speed(x: Named, u: Named, theta: Named) -> ca.SX:
    """Speed of the middle of the rear axle (eq. 4.14)."""
    return (u.spin_rear_left + u.spin_rear_right) / 2 * x.rolling_radius


def straight(x: Named, u: Named, theta: Named) -> ca.SX:
    """Condition that the car goes straight, as far as the noise of the wheels lets that be known."""
    noise = 2**0.5 * theta.spin_noise * x.rolling_radius / theta.rear_track
    return ca.fabs(turning_rate(x, u, theta)) < theta.straight_rate + noise


def _less_held(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    return rolling_speed(x, u, p) - ca.sqrt(u.held_east**2 + u.held_north**2 + 1e-12)


ON_STRAIGHT = Measurement("course", lambda x, z, u, p: x.yaw, (0.01,), angles=(0,), when=straight)
SPEED = Measurement("gnss_speed", lambda x, z, u, p: rolling_speed(x, u, p), (0.05,), when=straight)  # eq. 4.18
HELD_SPEED = Measurement(
    "held_speed", _less_held, (HELD_NOISE,), when=lambda x, u, p: straight(x, u, p) * (u.since_fix < 1.5)
)
YAW_OF_GYRO = Measurement(
    "yaw_of_gyro", lambda x, z, u, p: x.yaw, (0.0,), angles=(0,), when=lambda x, u, p: 1 - straight(x, u, p)
)
PASSED_YAW = PassedMeasurement(
    YAW_OF_GYRO, "heading", "wheels", "yaw_of_gyro", lambda x, nothing: x.yaw, HEADING_REPEATS
)
B2 = (ON_STRAIGHT, SPEED, HELD_SPEED)

WHEEL_SPEED_A = Definition.of(WheelSpeedEkf(), ON_STRAIGHT)
WHEEL_SPEED_B1 = Definition.of(WheelSpeedEkf(), ON_STRAIGHT, SPEED)
WHEEL_SPEED_B2 = Definition.of(WheelSpeedEkf(), *B2)
WHEEL_SPEED_C = Definition(
    {"heading": (YawKkf(), (COURSE,)), "wheels": (WheelSpeedEkf(), (*B2, YAW_OF_GYRO))},
    (),
    (PASSED_YAW,),
    (remembered("heading"),),
)
