"""Velocity of the car in its own axes, and the biases of its accelerometers (Leung 2010, section 4.2.1, eq. 4.1).

    v̇_x = a_x - b_x + r v_y,  v̇_y = a_y - b_y - r v_x          process
    z = (V cos(ν - ψ), V sin(ν - ψ))                            velocity over ground, turned into the car's axes

The thesis holds z between fixes, with a standard deviation of 1 m/s: `HELD`. It is no measurement, its error is that of
the fix and of the time since; without it the filter goes on by its accelerometers alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import NavigationSpace, drifting

LONGEST_HOLD = 1.5  # [s] after the last fix, for which it is held


class VelocityKkf(NavigationSpace):
    """See the module. `yaw_rate` is that of the gyro without its bias, `yaw` the heading by which a fix is turned."""

    names: tuple[str, ...] = ("forward_velocity", "acceleration_bias_x", "lateral_velocity", "acceleration_bias_y")
    inputs = ("acceleration_x", "acceleration_y", "yaw_rate", "yaw", "held_east", "held_north", "since_fix")
    parameters: tuple[str, ...] = ("acceleration_noise", "sample_time", "antenna_x", "antenna_y")
    prior: Mapping[str, float] = {
        "forward_velocity": 0.3,
        "acceleration_bias_x": 2.0,
        "lateral_velocity": 0.3,
        "acceleration_bias_y": 2.0,
    }

    def acceleration(self, x: Named, u: Named) -> ca.SX:
        """Acceleration of the car (2,) in its axes."""
        return ca.vertcat(u.acceleration_x - x.acceleration_bias_x, u.acceleration_y - x.acceleration_bias_y)

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        along, across = ca.vertsplit(self.acceleration(x, u))
        return [
            x.forward_velocity + h * (along + u.yaw_rate * x.lateral_velocity),
            x.acceleration_bias_x,
            x.lateral_velocity + h * (across - u.yaw_rate * x.forward_velocity),
            x.acceleration_bias_y,
        ]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        noise = theta.acceleration_noise
        input_noise = self.sampled(x, u, theta, h, acceleration_x=noise, acceleration_y=noise)
        return input_noise + drifting(h, 0.0, 1e-5, 0.0, 1e-5)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        along, across = ca.vertsplit(self.acceleration(x, u))
        return {
            "forward_velocity": x.forward_velocity,
            "lateral_velocity": x.lateral_velocity,
            "forward_acceleration": along,
            "lateral_acceleration": across,
        }


def at_antenna(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    """Velocity of the antenna in the axes of the car."""
    return [x.forward_velocity - u.yaw_rate * p.antenna_y, x.lateral_velocity + u.yaw_rate * p.antenna_x]


def less_held(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    """Velocity at the antenna less that of the last fix, in the axes of the car."""
    c, s = ca.cos(u.yaw), ca.sin(u.yaw)
    held_velocity = [c * u.held_east + s * u.held_north, c * u.held_north - s * u.held_east]
    return [present - held for present, held in zip(at_antenna(x, z, u, p), held_velocity, strict=True)]


VELOCITY = Measurement("velocity", at_antenna, (0.1, 0.1))
HELD = Measurement("held_velocity", less_held, (1.0, 1.0), when=lambda x, u, p: u.since_fix < LONGEST_HOLD)
