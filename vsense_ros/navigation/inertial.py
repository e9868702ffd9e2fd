"""Planar INS that needs no number of the car, and learns on the way what keeps its lateral velocity from drifting.

    v̇_x = a_x - b_x + r v_y,  v̇_y = a_y / (1 + κ) - b_y - r v_x                      process
    ψ̇ = r = (r_m - b_r) / (1 + k)
    R(ψ) (v + r × (antenna + d)) = GNSS velocity                                       at a fix
    v_y = l r - e r v_x² + v_x s  ± σ                                                  at each inertial reading

A car at constant speed determines neither heading nor b_y by its fixes. What the straight-line gates of Bevly 2001 and
Leung 2010 assume there, β = 0, is here the steady state of any car that does not slide: rear wheels roll where they
point (l: distance of the rear axle) but for the slip of their tyres (e = m a / (L C_r)). Both are states, κ the body's
roll per lateral acceleration too; the fixes determine them wherever the car turns, so that no number of it has to be
known.

Two things that are no white noise have states of their own, or what is stated of side slip is twice its error. The
angle s by which a car goes aside of its steady state, on banks and in transients, stays for seconds; towards the limit
of its tyres it grows. And a gyro has a scale, k: of 0.6 %, as on the Genesis, a turn of 90° makes half a degree.

An antenna may sit elsewhere than the vehicle file says: how far ahead is a state, d. With one that sits 1.5 m behind
its place in the file, side slip was off by eight of its standard deviations in slow turns.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.car_numbers import ANTENNA_DEVIATION, GYRO_SCALE_DEVIATION
from vsense_ros.navigation.joint_kkf import HEADING, JointKkf, velocity_of_antenna
from vsense_ros.navigation.space import Definition, FirstReadings, drifting

TYPICAL = {"rear_distance": (1.4, 0.3), "rear_slip": (0.003, 0.002), "roll_gain": (0.1, 0.1)}  # value, deviation
ASIDE, ASIDE_TIME = 0.002, 3.0  # [rad], [s] of s where the car hardly slides
LINEAR = 4.0  # [m/s²] of lateral acceleration at which s is twice as large
_ANTENNA = "antenna_deviation"
SLIDING = 0.1  # [m/s] of the steady state besides, a hundred times a second


class Inertial(JointKkf):
    """See the module."""

    names = (
        "forward_velocity", "lateral_velocity", "yaw", "gyro_bias", "acceleration_bias_x", "acceleration_bias_y",
        "rear_distance", "rear_slip", "roll_gain", "gyro_scale", "antenna_ahead", "aside",
    )  # fmt: skip
    parameters = (
        *JointKkf.parameters, "pitching_noise", "shaking_noise", "leaning", "grade_drift", "bank_drift", _ANTENNA,
    )  # fmt: skip
    prior: Mapping[str, float] = {
        "forward_velocity": 0.3, "lateral_velocity": 0.1, "yaw": 0.05, "gyro_bias": 0.02,
        "acceleration_bias_x": 1.0, "acceleration_bias_y": 1.0, **{name: own[1] for name, own in TYPICAL.items()},
        "gyro_scale": GYRO_SCALE_DEVIATION, "antenna_ahead": 0.5 * ANTENNA_DEVIATION, "aside": ASIDE,
    }  # fmt: skip

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        rate = turning(x, u)
        along = u.acceleration_x - x.acceleration_bias_x + rate * x.lateral_velocity
        across = (u.acceleration_y - x.acceleration_bias_y) / (1 + x.roll_gain) - rate * x.forward_velocity
        moving = [x.forward_velocity + h * along, x.lateral_velocity + h * across, x.yaw + h * rate]
        return ca.vertcat(*moving, x.vector[3:-1], x.aside * ca.exp(-h / ASIDE_TIME))

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        force, rate = theta.acceleration_noise, theta.gyro_noise
        input_noise = self.sampled(x, u, theta, h, acceleration_x=force, acceleration_y=force, yaw_rate=rate)
        sideways = ASIDE * (1 + (u.acceleration_y / LINEAR) ** 2)
        strays = ca.diag(ca.vertcat(ca.SX.zeros(11), sideways**2 * (1 - ca.exp(-2 * h / ASIDE_TIME))))
        body = (theta.pitching_noise, theta.shaking_noise, theta.leaning)
        road = (theta.grade_drift, theta.bank_drift)
        return input_noise + drifting(h, *body, 1e-5, *road, 1e-4, 1e-5, 1e-4, 1e-6, 0.0, 0.0) + strays

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {**super().motion(x, u, theta), "yaw_rate": turning(x, u)}

    def begin(self, first_readings: FirstReadings) -> Mapping[str, float]:
        typical = {name: value[0] for name, value in TYPICAL.items()}
        return {**super().begin(first_readings), **typical}

    def uncertain(self, name: str, first_readings: FirstReadings) -> float:
        # Half of what other filters allow: without tyres a fix a second hardly tells a place from a slip.
        return 0.5 * first_readings[_ANTENNA] if name == "antenna_ahead" else super().uncertain(name, first_readings)


def turning(x: Named, u: Named) -> ca.SX:
    """Yaw rate of the car [rad/s], by the gyro without its bias and scale."""
    return (u.yaw_rate - x.gyro_bias) / (1 + x.gyro_scale)


def _sliding(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    rate = turning(x, u)
    steady = x.rear_distance * rate - x.rear_slip * rate * x.forward_velocity**2
    return x.lateral_velocity - steady - x.forward_velocity * x.aside


def _velocity(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    return velocity_of_antenna(x, p, turning(x, u), x.antenna_ahead)


STEADY = Measurement("steady_state", _sliding, (SLIDING,))
VELOCITY = Measurement("gnss_velocity", _velocity, (0.1, 0.1))

INERTIAL = Definition.of(Inertial(), VELOCITY, HEADING, STEADY)
