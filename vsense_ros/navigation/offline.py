"""Planar motion of a car by all of its sensors, for smoothing a whole recording: a reference where none was driven.

    v̇_x = a_x - b_x + r v_y,  v̇_y = a_y / (1 + κ) - b_y - r v_x,  ψ̇ = r = (r_m - b_r) / (1 + k),  ṗ = R(ψ) v

Errors of sensors and of their mounting are states: bias and scale of the gyro, biases of the accelerometers, which
carry the grades of the road as well, lever arm and delay of the GNSS antenna, error of the heading of two antennas,
rolling radius and slip of the rear wheels. What holds the lateral velocity is that a rear axle slides by the slip of
its tyres alone,

    v_y = l r - v_x (e r v_x g - s),      g = 1 + f/3 + 5 f²/27 + 10 f³/81,   f = |r v_x| / a_max

where g is how much more slip a brush needs towards its limit than at small forces (Pacejka 2012, section 3.2; the
inverse of its cubic as a series), and s stays for a second. As in `inertial`, e and l are estimated, l from the place
of the rear axle in the vehicle file on; unlike there so is a_max, since a smoother sees the whole drive before it has
to believe anything. A car that spins is followed by GNSS and inertial sensors alone. Roads are taken to be banked by
some percent at most.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.car_numbers import ANTENNA_DEVIATION, GYRO_SCALE_DEVIATION
from vsense_ros.navigation.inertial import LINEAR, TYPICAL, turning
from vsense_ros.navigation.space import Definition, FirstReadings, NavigationSpace, drifting


@dataclass(frozen=True)
class OfflineSettings:
    """What tyres and roads leave undetermined in the smoother's equations: decisions of this project."""

    sliding: float = 0.3  # [m/s] by which the lateral velocity is off at each reading, besides s
    limit: tuple[float, float] = (10.0, 3.0)  # [m/s²] a_max of a car on a dry road, and its deviation
    # [m/s²/√s] by which the biases of the accelerometers drift: road along and across
    road: tuple[float, float] = (0.5, 0.3)
    # [rad] of slip of the rear axle, beyond which a car spins: neither axle nor wheels measure anything then
    spun: float = 0.1
    hard: float = 2.5  # [m/s²] along the car, beyond which wheels may lock or spin: they measure no speed then
    least_force: float = 0.1  # [m/s²] below which |r v_x| is rounded


SETTINGS = OfflineSettings()

ASIDE, ASIDE_TIME = 0.004, 1.0  # [rad], [s] of s where the car hardly slides: tyres and body need time to follow
WHEEL_SLIP, WHEEL_SLIP_TIME = 0.006, 4.0  # share and [s] of slip of the rear wheels, where a car drives and brakes

# Units of the states that are constants of sensors, road or car.
UNITS: Mapping[str, str] = {
    "gyro_bias": "rad/s", "gyro_scale": "-", "acceleration_bias_x": "m/s²", "acceleration_bias_y": "m/s²",
    "rear_distance": "m", "rear_slip": "s²/m", "limit": "m/s²", "roll_gain": "-", "lever_x": "m", "lever_y": "m",
    "delay": "s", "heading_offset": "rad", "rolling_radius": "m",
}  # fmt: skip


class Offline(NavigationSpace):
    """See the module."""

    names = (
        "forward_velocity", "lateral_velocity", "yaw", "east", "north", "gyro_bias", "gyro_scale",
        "acceleration_bias_x", "acceleration_bias_y", "rear_distance", "rear_slip", "limit", "roll_gain", "lever_x",
        "lever_y", "delay", "heading_offset", "rolling_radius", "wheel_slip", "aside",
    )  # fmt: skip
    inputs = ("acceleration_x", "acceleration_y", "yaw_rate")
    parameters = (
        "acceleration_noise", "gyro_noise", "sample_time", "antenna_x", "antenna_y", "rolling_radius",
        "pitching_noise", "shaking_noise", "leaning",
    )  # fmt: skip
    prior: Mapping[str, float] = {
        "forward_velocity": 0.3, "lateral_velocity": 0.3, "yaw": 0.05, "east": 10.0, "north": 10.0,
        "gyro_bias": 0.02, "gyro_scale": GYRO_SCALE_DEVIATION, "acceleration_bias_x": 1.0, "acceleration_bias_y": 1.0,
        **{name: own[1] for name, own in TYPICAL.items()}, "limit": SETTINGS.limit[1],
        "lever_x": ANTENNA_DEVIATION, "lever_y": ANTENNA_DEVIATION, "delay": 0.02, "heading_offset": 0.02,
        "rolling_radius": 0.02, "wheel_slip": WHEEL_SLIP, "aside": ASIDE,
    }  # fmt: skip

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        turn = h * turning(x, u)
        c, s = ca.cos(turn), ca.sin(turn)
        along = u.acceleration_x - x.acceleration_bias_x
        across = (u.acceleration_y - x.acceleration_bias_y) / (1 + x.roll_gain)
        forward = c * x.forward_velocity + s * x.lateral_velocity + h * along
        lateral = c * x.lateral_velocity - s * x.forward_velocity + h * across
        east, north = on_map(x.yaw + turn / 2, (x.forward_velocity + forward) / 2, (x.lateral_velocity + lateral) / 2)
        moving = [forward, lateral, x.yaw + turn, x.east + h * east, x.north + h * north]
        fading = [x.wheel_slip * ca.exp(-h / WHEEL_SLIP_TIME), x.aside * ca.exp(-h / ASIDE_TIME)]
        return ca.vertcat(*moving, x.vector[5:-2], *fading)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        force, rate = theta.acceleration_noise, theta.gyro_noise
        input_noise = self.sampled(x, u, theta, h, acceleration_x=force, acceleration_y=force, yaw_rate=rate)
        sideways = ASIDE * (1 + (u.acceleration_y / LINEAR) ** 2)
        strays = [
            WHEEL_SLIP**2 * (1 - ca.exp(-2 * h / WHEEL_SLIP_TIME)),
            sideways**2 * (1 - ca.exp(-2 * h / ASIDE_TIME)),
        ]
        body = (theta.pitching_noise, theta.shaking_noise, theta.leaning)
        walks = drifting(h, *body, 1e-3, 1e-3, 1e-5, 1e-6, *SETTINGS.road, *[0.0] * 9, 0.0, 0.0)
        return input_noise + walks + ca.diag(ca.vertcat(ca.SX.zeros(18), *strays))

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {**super().motion(x, u, theta), "yaw_rate": turning(x, u)}

    def begin(self, first_readings: FirstReadings) -> Mapping[str, float]:
        initial = {name: first_readings[name] for name in ("forward_velocity", "yaw", "east", "north", "rolling_radius")
                 if name in first_readings}  # fmt: skip
        typical = {name: own[0] for name, own in TYPICAL.items()}
        return {**initial, **typical, "limit": SETTINGS.limit[0], "rear_distance": first_readings["to_rear"]}


def on_map(yaw: Any, forward: Any, lateral: Any) -> tuple[ca.SX, ca.SX]:
    """A velocity or an arm in the axes of the car, to the east and to the north."""
    c, s = ca.cos(yaw), ca.sin(yaw)
    return c * forward - s * lateral, s * forward + c * lateral


def _velocity(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    rate = turning(x, u)
    forward = x.forward_velocity - rate * (p.antenna_y + x.lever_y)
    lateral = x.lateral_velocity + rate * (p.antenna_x + x.lever_x)
    return list(on_map(x.yaw - rate * x.delay, forward, lateral))


def _position(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    arm = on_map(x.yaw, p.antenna_x + x.lever_x, p.antenna_y + x.lever_y)
    travelled = on_map(x.yaw, x.delay * x.forward_velocity, x.delay * x.lateral_velocity)
    return [x.east + arm[0] - travelled[0], x.north + arm[1] - travelled[1]]


def _sliding(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    rate = turning(x, u)
    force = rate * x.forward_velocity
    f = ca.sqrt(force**2 + SETTINGS.least_force**2) / x.limit
    slip = x.rear_slip * force * (1 + f / 3 + 5 * f**2 / 27 + 10 * f**3 / 81)
    return x.lateral_velocity - x.rear_distance * rate + x.forward_velocity * (slip - x.aside)


def _rolls(x: Named, u: Named) -> ca.SX:
    """True unless the rear axle slides by more than `spun`."""
    return ca.fabs(x.lateral_velocity - x.rear_distance * turning(x, u)) <= SETTINGS.spun * ca.fabs(x.forward_velocity)


VELOCITY = Measurement("gnss_velocity", _velocity, (0.1, 0.1))
POSITION = Measurement("gnss_position", _position, (1.0, 1.0))
HEADING = Measurement("heading", lambda x, z, u, p: x.yaw + x.heading_offset, (0.01,), angles=(0,))
SPIN = Measurement(
    "rear_spin",
    lambda x, z, u, p: x.forward_velocity * (1 + x.wheel_slip) / x.rolling_radius,
    (0.3,),
    when=lambda x, u, p: (ca.fabs(u.acceleration_x - x.acceleration_bias_x) < SETTINGS.hard) * _rolls(x, u),
)
STEADY = Measurement("steady_state", _sliding, (SETTINGS.sliding,), when=lambda x, u, p: _rolls(x, u))

OFFLINE = Definition.of(Offline(), VELOCITY, POSITION, HEADING, SPIN, STEADY)
