"""Velocity, heading, biases and position in one filter (Travis & Bevly 2008; Leung 2010, eq. 2.79).

With the sensors of a cheap receiver it diverges where a car goes straight for long: heading and b_y are observable
only where it accelerates. `NonHolonomic` adds what the straight-line gates of the cascades hide, that a car hardly
slides: v_y = 0 within a standard deviation of its own (Dissanayake et al. 2001).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition, FirstReadings, NavigationSpace, drifting


class JointKkf(NavigationSpace):
    """v_x, v_y, ψ, b_r, b_x, b_y, and where the car is."""

    names: tuple[str, ...] = (
        "forward_velocity", "lateral_velocity", "yaw", "gyro_bias", "acceleration_bias_x", "acceleration_bias_y",
        "east", "north",
    )  # fmt: skip
    inputs = ("acceleration_x", "acceleration_y", "yaw_rate")
    parameters: tuple[str, ...] = ("acceleration_noise", "gyro_noise", "sample_time", "antenna_x", "antenna_y")
    prior: Mapping[str, float] = {
        "forward_velocity": 0.3, "lateral_velocity": 0.3, "yaw": 0.05, "gyro_bias": 0.02,
        "acceleration_bias_x": 2.0, "acceleration_bias_y": 2.0, "east": 10.0, "north": 10.0,
    }  # fmt: skip

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        rate, c, s = u.yaw_rate - x.gyro_bias, ca.cos(x.yaw), ca.sin(x.yaw)
        along = u.acceleration_x - x.acceleration_bias_x + rate * x.lateral_velocity
        across = u.acceleration_y - x.acceleration_bias_y - rate * x.forward_velocity
        return [
            x.forward_velocity + h * along,
            x.lateral_velocity + h * across,
            x.yaw + h * rate,
            x.gyro_bias,
            x.acceleration_bias_x,
            x.acceleration_bias_y,
            x.east + h * (c * x.forward_velocity - s * x.lateral_velocity),
            x.north + h * (s * x.forward_velocity + c * x.lateral_velocity),
        ]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        force, rate = theta.acceleration_noise, theta.gyro_noise
        input_noise = self.sampled(x, u, theta, h, acceleration_x=force, acceleration_y=force, yaw_rate=rate)
        return input_noise + drifting(h, 0.0, 0.0, 0.0, 1e-5, 1e-4, 1e-4, 0.0, 0.0)

    def begin(self, first_readings: FirstReadings) -> Mapping[str, float]:
        return {
            name: first_readings[name]
            for name in ("forward_velocity", "yaw", "east", "north")
            if name in first_readings
        }

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {**super().motion(x, u, theta), "yaw_rate": u.yaw_rate - x.gyro_bias}


def velocity_of_antenna(x: Named, p: Named, rate: ca.SX, ahead: ca.SX | float = 0.0) -> list[ca.SX]:
    """Velocity of the antenna to the east and to the north [m/s] of a car that turns at a `rate` [rad/s], with the
    antenna so far `ahead` [m] of its place in the vehicle file."""
    c, s = ca.cos(x.yaw), ca.sin(x.yaw)
    forward, lateral = x.forward_velocity - rate * p.antenna_y, x.lateral_velocity + rate * (p.antenna_x + ahead)
    return [c * forward - s * lateral, s * forward + c * lateral]


def velocity_on_map(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    """Velocity of the antenna to the east and to the north [m/s]."""
    return velocity_of_antenna(x, p, u.yaw_rate - x.gyro_bias)


def position_on_map(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    """Position of the antenna to the east and to the north [m]."""
    c, s = ca.cos(x.yaw), ca.sin(x.yaw)
    return [x.east + c * p.antenna_x - s * p.antenna_y, x.north + s * p.antenna_x + c * p.antenna_y]


VELOCITY = Measurement("gnss_velocity", velocity_on_map, (0.1, 0.1))
POSITION = Measurement("gnss_position", position_on_map, (1.0, 1.0))
HEADING = Measurement("heading", lambda x, z, u, p: x.yaw, (0.01,), angles=(0,))
NO_SLIDING = Measurement("no_sliding", lambda x, z, u, p: x.lateral_velocity, (2.0,))  # a hundred times a second

JOINT_KKF = Definition.of(JointKkf(), VELOCITY, POSITION, HEADING)
JOINT_KKF_NON_HOLONOMIC = Definition.of(JointKkf(), VELOCITY, POSITION, HEADING, NO_SLIDING)
