"""The dual kinematic Kalman filter: heading, then velocity (Bevly et al. 2001; Leung 2010, figure 4.1)."""

from __future__ import annotations

import casadi as ca

from vsense_ros.estimation.cascade import PassedInput, PassedMeasurement
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition
from vsense_ros.navigation.thesis.velocity_kkf import HELD, VELOCITY, VelocityKkf
from vsense_ros.navigation.yaw_kkf import COURSE, HEADING, YawKkf, remembered

GNSS = Measurement("gnss_velocity", lambda x, z, u, p: [0.0, 0.0], (0.1, 0.1))  # to the east and to the north


def in_axes_of_car(x: Named, velocity: ca.SX) -> list[ca.SX]:
    """Eq. 4.1: (V cos(ν - ψ), V sin(ν - ψ))."""
    c, s = ca.cos(x.yaw), ca.sin(x.yaw)
    return [c * velocity[0] + s * velocity[1], c * velocity[1] - s * velocity[0]]


RATE = PassedInput("heading", "velocity", lambda x, u: [u.yaw_rate - x.gyro_bias, x.yaw], ("yaw_rate", "yaw"))
TURNED = PassedMeasurement(GNSS, "heading", "velocity", "velocity", in_axes_of_car)


def dual(*of_heading: Measurement, held: Measurement | None = HELD) -> Definition:
    """With these measurements of the heading, and with what holds the last fix until the next."""
    velocity = (VELOCITY, held) if held else (VELOCITY,)
    parts = {"heading": (YawKkf(), of_heading), "velocity": (VelocityKkf(), velocity)}
    return Definition(parts, (RATE,), (TURNED,), (remembered("heading"),))


DUAL_KKF = dual(COURSE)
DUAL_KKF_WITHOUT_HOLD = dual(COURSE, held=None)
DUAL_KKF_WITH_HEADING = dual(COURSE, HEADING)
