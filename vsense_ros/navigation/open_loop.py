"""What nothing corrects, or the raw fix alone: rulers to measure filters by (Leung 2010, section 2.3)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Named, wrapped
from vsense_ros.navigation.space import Definition, NavigationSpace


class BodyIns(NavigationSpace):
    """v̇_x = a_x + r v_y, v̇_y = a_y - r v_x (eqs. 2.1 to 2.6): how fast an inertial sensor drifts."""

    names = ("forward_velocity", "lateral_velocity")
    inputs: tuple[str, ...] = ("acceleration_x", "acceleration_y", "yaw_rate")
    parameters: tuple[str, ...] = ("acceleration_noise", "sample_time")
    prior: Mapping[str, float] = {"forward_velocity": 0.1, "lateral_velocity": 0.1}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        along = u.acceleration_x + u.yaw_rate * x.lateral_velocity
        across = u.acceleration_y - u.yaw_rate * x.forward_velocity
        return [x.forward_velocity + h * along, x.lateral_velocity + h * across]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        noise = theta.acceleration_noise
        return self.sampled(x, u, theta, h, acceleration_x=noise, acceleration_y=noise)


class MapIns(NavigationSpace):
    """v̇_e = R(ψ) a, ψ̇ = r, β = ν - ψ (eqs. 2.7 to 2.10, 2.53)."""

    names: tuple[str, ...] = ("velocity_east", "velocity_north", "yaw")
    inputs = ("acceleration_x", "acceleration_y", "yaw_rate")
    parameters = ("acceleration_noise", "gyro_noise", "sample_time")
    prior: Mapping[str, float] = {"velocity_east": 0.1, "velocity_north": 0.1, "yaw": 0.05}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        c, s = ca.cos(x.yaw), ca.sin(x.yaw)
        east = c * u.acceleration_x - s * u.acceleration_y
        north = s * u.acceleration_x + c * u.acceleration_y
        return [x.velocity_east + h * east, x.velocity_north + h * north, x.yaw + h * u.yaw_rate]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        force, rate = theta.acceleration_noise, theta.gyro_noise
        return self.sampled(x, u, theta, h, acceleration_x=force, acceleration_y=force, yaw_rate=rate)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        c, s = ca.cos(x.yaw), ca.sin(x.yaw)
        forward = c * x.velocity_east + s * x.velocity_north
        lateral = c * x.velocity_north - s * x.velocity_east
        return {"forward_velocity": forward, "lateral_velocity": lateral, "yaw": x.yaw, "yaw_rate": u.yaw_rate}


class GyroAndCourse(NavigationSpace):
    """ψ̇ = r_m, β = ν - ψ with the course of the last fix (Bevly et al. 2006)."""

    names = ("yaw",)
    inputs = ("yaw_rate", "held_east", "held_north")
    parameters = ("gyro_noise", "sample_time")
    prior: Mapping[str, float] = {"yaw": 0.05}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * u.yaw_rate]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.sampled(x, u, theta, h, yaw_rate=theta.gyro_noise)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        course = ca.atan2(u.held_north, u.held_east + 1e-9)
        return {"yaw": x.yaw, "yaw_rate": u.yaw_rate, "side_slip": wrapped(course - x.yaw)}


BODY_INS = Definition.of(BodyIns())
MAP_INS = Definition.of(MapIns())
GYRO_AND_COURSE = Definition.of(GyroAndCourse())
