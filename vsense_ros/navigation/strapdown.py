"""Six-axis INS in error coordinates (Solà 2017; Groves 2013, chapter 14), with what a road vehicle adds.

    q̇ = q ⊗ (ω_m - b_g) / 2,  v̇ = R(q) (f_m - b_a) + g,  ṗ = v        in the map, east, north, up

GNSS velocity and position are those of the antenna, whose lever arm is estimated too, and of a time that is off by
`delay`: v(t - d) = v - d v̇, where v̇ is what turning does to v, which a gyro measures better than the accelerometers. A
wheel neither leaves the road nor slides (non-holonomic): in the axes of the car v_z = v_x z and, at the rear axle,
v_y = v_x s - e r v_x², with the slip of its tyres, e, and the angles s and z by which the car goes aside of its steady
state and its body pitches on its springs. These stay for seconds: taken for white noise, a hundred times a second, they
would make the filter ten times too sure. The rear wheels measure v_x, by a radius that is estimated; without GNSS that
keeps the position. A car that stands has no velocity and no rate.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, sin
from typing import Any

import casadi as ca

from vsense_ros.estimation import attitude
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.inertial import ASIDE, ASIDE_TIME, LINEAR, TYPICAL
from vsense_ros.navigation.space import Definition, FirstReadings, NavigationSpace, drifting

_AXES = ("x", "y", "z")
_Q, _V, _P, _G, _A, _L = (slice(0, 4), slice(4, 7), slice(7, 10), slice(10, 13), slice(13, 16), slice(16, 19))
SLIDING = (0.2, 0.3)  # [m/s] across and up, a hundred times a second, besides the states of it
SLIPPING = 5e-4  # [m/√s] by which the rolling radius changes where tyres are at `LINEAR`
PITCHING, PITCHING_TIME = 0.01, 1.0  # [rad], [s] of z: a body dives, squats and heaves
STANDING_SPEED, STANDING_NOISE = 0.15, (0.05, 0.05, 0.05)  # [m/s]


def _named(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{axis}" for axis in _AXES)


class Strapdown(NavigationSpace):
    """Attitude as a quaternion (scalar first), velocity and position in the map, biases, lever arm, delay."""

    names = (
        "q_w", "q_x", "q_y", "q_z", "velocity_east", "velocity_north", "velocity_up", "east", "north", "up",
        *_named("gyro_bias"), *_named("acceleration_bias"), *_named("lever"), "delay", "rolling_radius",
        "rear_slip", "aside", "pitching",
    )  # fmt: skip
    errors = (*_named("turn"), *names[4:])
    inputs = (
        "roll_rate", "pitch_rate", "yaw_rate", "acceleration_x", "acceleration_y", "acceleration_z", "held_east",
        "held_north", "since_fix",
    )  # fmt: skip
    parameters = ("gyro_noise", "acceleration_noise", "sample_time", "gravity", "antenna_x", "antenna_y", "to_rear")
    auxiliaries = tuple(f"{name}_{axis}" for name in ("antenna", "on_map", "in_car") for axis in _AXES)
    prior: Mapping[str, float] = {
        "turn_x": 0.05, "turn_y": 0.05, "turn_z": 0.05, **dict.fromkeys(names[4:7], 0.3),
        **dict.fromkeys(names[7:10], 10.0), **dict.fromkeys(_named("gyro_bias"), 0.02),
        "acceleration_bias_x": 1.0, "acceleration_bias_y": 1.0, "acceleration_bias_z": 1.0,
        **dict.fromkeys(_named("lever"), 0.3), "delay": 0.05, "rolling_radius": 0.01,
        "rear_slip": TYPICAL["rear_slip"][1], "aside": ASIDE, "pitching": PITCHING,
    }  # fmt: skip

    def rates(self, x: Named, u: Named) -> ca.SX:
        """Angular rates of the body (3,) [rad/s]."""
        return u.vector[0:3] - x.vector[_G]

    def acceleration(self, x: Named, u: Named, theta: Named) -> ca.SX:
        """Acceleration (3,) in the axes of the map."""
        specific_force = attitude.turned(x.vector[_Q], u.vector[3:6] - x.vector[_A])
        return specific_force - ca.vertcat(0, 0, theta.gravity)

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        q, v, p, moved = x.vector[_Q], x.vector[_V], x.vector[_P], self.acceleration(x, u, theta)
        turned = attitude.retract(q, h * self.rates(x, u))
        fading = [x.aside * ca.exp(-h / ASIDE_TIME), x.pitching * ca.exp(-h / PITCHING_TIME)]
        return ca.vertcat(turned, v + h * moved, p + h * v + h**2 / 2 * moved, x.vector[10:-2], *fading)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        rate, force = theta.gyro_noise, theta.acceleration_noise
        rates = dict.fromkeys(("roll_rate", "pitch_rate", "yaw_rate"), rate)
        forces = dict.fromkeys(("acceleration_x", "acceleration_y", "acceleration_z"), force)
        walk = (*[1e-5] * 3, *[1e-3] * 3, *[1e-5] * 3, 1e-6, 1e-5, 1e-5, 0.0, 0.0)
        strained = (u.acceleration_x**2 + u.acceleration_y**2) / LINEAR**2
        sideways = ASIDE * (1 + (u.acceleration_y / LINEAR) ** 2)
        strays: list[Any] = [
            (SLIPPING * strained) ** 2 * h,
            0.0,
            sideways**2 * (1 - ca.exp(-2 * h / ASIDE_TIME)),
            PITCHING**2 * (1 - ca.exp(-2 * h / PITCHING_TIME)),
        ]
        input_noise = self.sampled(x, u, theta, h, **rates, **forces)
        return input_noise + drifting(h, *[1e-6] * 9, *walk) + ca.diag(ca.vertcat(ca.SX.zeros(19), *strays))

    def auxiliary(self, x: Named, u: Named, theta: Named) -> Any:
        """Velocity and position of the antenna in the map, velocity of the car in its axes."""
        q, arm = x.vector[_Q], ca.vertcat(theta.antenna_x, theta.antenna_y, 0) + x.vector[_L]
        turning = ca.vertcat(0, 0, self.rates(x, u)[2])
        v = x.vector[_V] - x.delay * ca.cross(turning, x.vector[_V])
        antenna = v + attitude.turned(q, ca.cross(self.rates(x, u), arm))
        in_car = attitude.turned(attitude.inverse(q), x.vector[_V])
        return ca.vertcat(antenna, x.vector[_P] - x.delay * v + attitude.turned(q, arm), in_car)

    def retract(self, x: Named, delta: ca.SX) -> Any:
        return ca.vertcat(attitude.retract(x.vector[_Q], delta[:3]), x.vector[4:] + delta[3:])

    def difference(self, y: Named, x: Named) -> Any:
        turn = attitude.difference(y.vector[_Q], x.vector[_Q])
        return ca.vertcat(turn, y.vector[4:] - x.vector[4:])

    def begin(self, first_readings: FirstReadings) -> Mapping[str, float]:
        """Level, in the direction of travel."""
        half = first_readings.get("yaw", 0.0) / 2
        names = ("velocity_east", "velocity_north", "east", "north", "rolling_radius")
        initial = {name: first_readings[name] for name in names if name in first_readings}
        return {"q_w": cos(half), "q_z": sin(half), "rear_slip": TYPICAL["rear_slip"][0], **initial}

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        w, a, b, c = ca.vertsplit(x.vector[_Q])
        in_car = attitude.turned(attitude.inverse(x.vector[_Q]), ca.horzcat(x.vector[_V]))
        along, across, up = ca.vertsplit(
            attitude.turned(attitude.inverse(x.vector[_Q]), self.acceleration(x, u, theta))
        )
        p, q, r = ca.vertsplit(self.rates(x, u))
        return {
            "east": x.east, "north": x.north, "up": x.up,
            "roll": ca.atan2(2 * (w * a + b * c), 1 - 2 * (a * a + b * b)),
            "pitch": ca.asin(2 * (w * b - c * a)),
            "yaw": ca.atan2(2 * (w * c + a * b), 1 - 2 * (b * b + c * c)),
            "forward_velocity": in_car[0], "lateral_velocity": in_car[1], "vertical_velocity": in_car[2],
            "roll_rate": p, "pitch_rate": q, "yaw_rate": r,
            "forward_acceleration": along, "lateral_acceleration": across, "vertical_acceleration": up,
        }  # fmt: skip


def _stands(x: Named, u: Named, p: Named) -> ca.SX:
    return (ca.sqrt(u.held_east**2 + u.held_north**2) < STANDING_SPEED) * (u.since_fix < 1.5)


def _heading(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    w, a, b, c = ca.vertsplit(x.vector[_Q])
    return ca.atan2(2 * (w * c + a * b), 1 - 2 * (b * b + c * c))


def _sliding(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    rate = u.yaw_rate - x.gyro_bias_z
    steady = p.to_rear * rate - x.rear_slip * rate * z.in_car_x**2
    return [z.in_car_y - steady - z.in_car_x * x.aside, z.in_car_z - z.in_car_x * x.pitching]


VELOCITY = Measurement("gnss_velocity", lambda x, z, u, p: [z.antenna_x, z.antenna_y], (0.1, 0.1))
POSITION = Measurement("gnss_position", lambda x, z, u, p: [z.on_map_x, z.on_map_y], (1.0, 1.0))
HEADING = Measurement("heading", _heading, (0.01,), angles=(0,))
NON_HOLONOMIC = Measurement("non_holonomic", _sliding, SLIDING)
# The mean of both wheels, whose slip is of the size of some thousandths.
SPIN = Measurement("rear_spin", lambda x, z, u, p: z.in_car_x / x.rolling_radius, (0.3,))
STANDSTILL = Measurement("standstill", lambda x, z, u, p: x.vector[_V], STANDING_NOISE, when=_stands)
NO_TURNING = Measurement(
    "no_turning", lambda x, z, u, p: u.vector[0:3] - x.vector[_G], (0.005, 0.005, 0.005), when=_stands
)

STRAPDOWN = Definition.of(Strapdown(), VELOCITY, POSITION, HEADING, NON_HOLONOMIC, SPIN, STANDSTILL, NO_TURNING)
