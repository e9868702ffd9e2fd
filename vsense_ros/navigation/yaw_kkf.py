"""Heading and bias of the yaw gyro (Bevly et al. 2001; Leung 2010, section 4.2.1).

    ψ̇ = r_m - b_r,  ḃ_r = 0                                   process
    ν = ψ   where |r_m - b_r| < 1 °/s                          course: on the straight a car goes where it points

Corrections of the print (C5, C6): the noise of a step is (T σ_r)²; a bias has to be uncertain at start to be estimated;
the innovation of the angle itself is wrapped, where cosine and sine would have a singular covariance.

And of the gate: decided by b̂_r as if that were known, it shuts for good where b̂_r comes to be off by more than 1 °/s,
on a straight too, since what would correct it is refused. First fixes put it there, which lie close together, or a bias
that is larger than the gate is wide. So a drive is straight unless it turns for sure: |r_m - b̂_r| less twice the
standard deviation of b̂_r. Where course and heading are further apart than tyres slip, for longer than a receiver that
jumps, it is the heading that is wrong: for some seconds the course is believed, and the bias is as little known as at
the start.

A real car does not go quite where it points, on a banked straight either, and that angle stays for seconds. Taken for
white noise of the fixes, as here, it makes the standard deviation of the heading a fifth of its error on the road.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named, wrapped
from vsense_ros.navigation.readings import SLOWEST_COURSE
from vsense_ros.navigation.space import Definition, NavigationSpace, Remembered


@dataclass(frozen=True)
class YawSettings:
    """When the gate of the yaw filter opens again: decisions of this project."""

    sure: float = 2.0  # standard deviations of the gyro's bias
    largest_slip: float = 0.25  # [rad] between heading and course of cog, of tyres that slide
    # [m] from the rear axle to cog at most, which in a tight bend goes aside of where the car points
    reach: float = 2.0
    contradicted: float = 2.0  # [s] for which fixes have to show a heading that cannot be
    learning: float = 3.0  # [s] for which the course is then believed


SETTINGS = YawSettings()

BIAS = 0.02  # [rad/s], standard deviation at start


class YawKkf(NavigationSpace):
    """See the module. `bias_deviation` [rad/s] was that of the bias at the last fix; fixes have
    shown a heading that cannot be for `wrong` [s], and the course is still believed for `lost` [s]."""

    names = ("yaw", "gyro_bias")
    inputs = ("yaw_rate", "since_fix", "bias_deviation", "wrong", "lost")
    parameters = ("gyro_noise", "sample_time", "straight_rate")
    prior: Mapping[str, float] = {"yaw": 0.05, "gyro_bias": BIAS}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * (u.yaw_rate - x.gyro_bias), x.gyro_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        walk = ca.diag(ca.vertcat(0.0, 1e-10 + (u.lost > 0) * BIAS**2)) * h
        return self.sampled(x, u, theta, h, yaw_rate=theta.gyro_noise) + walk

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {"yaw": x.yaw, "yaw_rate": u.yaw_rate - x.gyro_bias}


def straight(x: Named, u: Named, theta: Named) -> ca.SX:
    """True if the car goes straight, by the gyro without its bias: with it, one of 1 °/s would decide (C5)."""
    return ca.fabs(u.yaw_rate - x.gyro_bias) < theta.straight_rate + SETTINGS.sure * u.bias_deviation


def at_fix(x: Named, u: Named, theta: Named, velocity: ca.SX, variance: Named) -> dict[str, ca.SX]:
    """Inputs to remember from a new fix: deviation of the bias, and for how long heading and course contradict."""
    speed = ca.fmax(ca.sqrt(velocity[0] ** 2 + velocity[1] ** 2), SLOWEST_COURSE)
    difference = ca.fabs(wrapped(ca.atan2(velocity[1], velocity[0]) - x.yaw))
    largest = SETTINGS.largest_slip + SETTINGS.reach * ca.fabs(u.yaw_rate - x.gyro_bias) / speed
    wrong = ca.if_else(difference > largest, u.wrong + ca.fmin(u.since_fix, 1.0), 0.0)
    return {
        "bias_deviation": ca.sqrt(ca.fmax(variance.gyro_bias, 0.0)),
        "wrong": wrong,
        "lost": ca.if_else(wrong >= SETTINGS.contradicted, SETTINGS.learning, ca.fmax(u.lost - u.since_fix, 0.0)),
    }


def remembered(part: str) -> Remembered:
    """Inputs that a filter with a `YawKkf` as this part has to remember."""
    return Remembered(part, "course", at_fix)


COURSE = Measurement(
    "course", lambda x, z, u, p: x.yaw, (0.01,), angles=(0,), when=lambda x, u, p: straight(x, u, p) + (u.lost > 0)
)
HEADING = Measurement("heading", lambda x, z, u, p: x.yaw, (0.1,), angles=(0,))  # two antennas, or a magnetometer

YAW_KKF = Definition.of(YawKkf(), COURSE, remembered=(remembered(""),))
YAW_KKF_WITH_HEADING = Definition.of(YawKkf(), COURSE, HEADING, remembered=(remembered(""),))
