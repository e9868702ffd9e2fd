"""One filter of all: single-track model with a tyre that saturates, its stiffnesses as states, GNSS velocity and all
that the car measures; no gates for straight lines (beyond Leung 2010; Best et al. 2000 for the stiffness states).

    v̇_x = a_x - b_x + r v_y
    v̇_y = (F_f cos δ + F_r) / m - r v_x - g sin φ_road,  ṙ = (a F_f cos δ - b F_r) / J,  ψ̇ = r,  r_m = (1 + k_r) r + b_r
    F = μ F_z f(k C (α + e) / (μ F_z))   a brush tyre with a parabolic pressure (Pacejka 2012, section 3.2.1)
    φ̇ = p,  ṗ = ω² (κ (F_f cos δ + F_r) / (m g) - φ) - 2 ζ ω p

Where the body rolls, its centre of gravity moves aside of the wheels: they slip by v_y + h p, not by v_y. At the speed
at which a car's side slip changes its sign that is a fifth of all of it.

No axle is a brush: e is what its slip angle would have to be off by, for about a second, for the force to be right.
Near the limit it is larger, and at the front where the wheels are turned far: a steering has no constant ratio there,
and its wheels not one angle. Without e, the stated standard deviation of side slip on a real car is a quarter of its
error. A gyro has a scale, k_r, and leans with the road. An accelerometer feels a body that shakes on its springs:
believed a hundred times a second, it determines a wrong side slip and is sure of it.

An antenna may sit elsewhere than the vehicle file says: how far ahead, d, is a state, since in a turn at low speed one
metre of it makes as many degrees of side slip as tyres do. GNSS measures v_y + r (x_antenna + d) across the car.

ln k of each axle drifts as far as its slip angle lets it be seen: where a car goes straight, nothing is known of its
tyres, and nothing is forgotten. What GNSS, gyro, accelerometer and wheels say is weighted by covariances alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation import single_track
from vsense_ros.navigation.car_numbers import (
    ANTENNA_DEVIATION,
    GYRO_SCALE_DEVIATION,
    SLIP_ERROR,
    STIFFNESS_DEVIATION,
)
from vsense_ros.navigation.inertial import LINEAR
from vsense_ros.navigation.joint_kkf import velocity_of_antenna
from vsense_ros.navigation.space import Definition, FirstReadings, NavigationSpace, drifting


@dataclass(frozen=True)
class IntegratedSettings:
    """What the single-track model leaves out: decisions of this project."""

    stiffness_drift: float = 0.2  # of ln k after one second at a slip angle of `full_slip`, over its deviation at start
    full_slip: float = 0.05  # [rad]
    roll_noise: float = 0.002  # [rad/s²/√Hz] likewise, about the roll axis
    leaning: float = 0.01  # [1/√s] of heading over the road's bank, by a gyro whose axis leans with it
    slides: float = 3.0  # normalized slip from which a brush tyre slides


SETTINGS = IntegratedSettings()

FORCE_NOISE, MOMENT_NOISE = 0.006, 0.03  # [m/s²/√Hz], [rad/s²/√Hz] that the model lacks
SLIP_ERROR_TIME, SHAKING_TIME = 1.0, 0.03  # [s]
_KNOWN = "stiffness_deviation"


class Integrated(NavigationSpace):
    """See the module."""

    names = (
        "forward_velocity", "lateral_velocity", "yaw_rate", "yaw", "gyro_bias", "steering_bias",
        "acceleration_bias_x", "acceleration_bias_y", "front_ln_stiffness", "rear_ln_stiffness", "rolling_radius",
        "bank", "roll", "roll_rate", "gyro_scale", "antenna_ahead", "front_slip_error", "rear_slip_error", "shaking",
    )  # fmt: skip
    inputs = ("acceleration_x", "steer_angle")
    parameters = (
        *single_track.PARAMETERS, "friction", "roll_gain", "roll_frequency", "roll_damping", "roll_arm", _KNOWN,
        "slip_error", "steering_error", "shaking_noise", "gravity", "acceleration_noise", "sample_time",
        "antenna_x", "antenna_y", "road_bank", "road_bank_time",
    )  # fmt: skip
    auxiliaries = ("lateral_force",)
    prior: Mapping[str, float] = {
        "forward_velocity": 0.3, "lateral_velocity": 0.2, "yaw_rate": 0.05, "yaw": 0.05, "gyro_bias": 0.02,
        "steering_bias": 0.01, "acceleration_bias_x": 1.5, "acceleration_bias_y": 1.5,
        "front_ln_stiffness": STIFFNESS_DEVIATION, "rear_ln_stiffness": STIFFNESS_DEVIATION, "rolling_radius": 0.01,
        "bank": 0.05, "roll": 0.01, "roll_rate": 0.05, "gyro_scale": GYRO_SCALE_DEVIATION,
        "antenna_ahead": ANTENNA_DEVIATION,
        "front_slip_error": SLIP_ERROR, "rear_slip_error": SLIP_ERROR, "shaking": 0.1,
    }  # fmt: skip

    def slip_angles(self, x: Named, u: Named, theta: Named) -> tuple[ca.SX, ca.SX]:
        """Slip angles of both axles [rad], such that the force has their sign."""
        speed = single_track.speed_of_model(x.forward_velocity)
        across = x.lateral_velocity + theta.roll_arm * x.roll_rate
        front = u.steer_angle - x.steering_bias - (across + theta.to_front * x.yaw_rate) / speed
        rear = (theta.to_rear * x.yaw_rate - across) / speed
        return front + x.front_slip_error, rear + x.rear_slip_error

    def axle_forces(self, x: Named, u: Named, theta: Named) -> tuple[ca.SX, ca.SX]:
        """Forces of the axles across the car [N]."""
        length = theta.to_front + theta.to_rear
        friction_per_length = theta.friction * theta.mass * theta.gravity / length
        front, rear = self.slip_angles(x, u, theta)
        stiff_front = theta.front_stiffness * ca.exp(x.front_ln_stiffness)
        stiff_rear = theta.rear_stiffness * ca.exp(x.rear_ln_stiffness)
        steer = u.steer_angle - x.steering_bias
        return (
            brush(stiff_front * front, friction_per_length * theta.to_rear) * ca.cos(steer),
            brush(stiff_rear * rear, friction_per_length * theta.to_front),
        )

    def auxiliary(self, x: Named, u: Named, theta: Named) -> Any:
        front, rear = self.axle_forces(x, u, theta)
        return [(front + rear) / theta.mass]

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        front, rear = self.axle_forces(x, u, theta)
        along = u.acceleration_x - x.acceleration_bias_x + x.yaw_rate * x.lateral_velocity
        specific_force = (front + rear) / theta.mass
        across = specific_force - x.yaw_rate * x.forward_velocity - theta.gravity * ca.sin(x.bank)
        turning = (theta.to_front * front - theta.to_rear * rear) / theta.yaw_inertia
        still = ca.SX.zeros(7)
        levelling = theta.roll_gain * specific_force / theta.gravity - x.roll
        rolling = theta.roll_frequency**2 * levelling - 2 * theta.roll_damping * theta.roll_frequency * x.roll_rate
        bank = -x.bank / theta.road_bank_time
        fading = -x.vector[-3:] / ca.DM([SLIP_ERROR_TIME, SLIP_ERROR_TIME, SHAKING_TIME])
        rate = ca.vertcat(along, across, turning, x.yaw_rate, still, bank, x.roll_rate, rolling, 0.0, 0.0, fading)
        return single_track.second_order(x.vector, rate, h)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        input_noise = self.sampled(x, u, theta, h, acceleration_x=theta.acceleration_noise)
        drift = SETTINGS.stiffness_drift * theta.stiffness_deviation
        stiffness_walk: list[Any] = [
            drift * ca.fmin(ca.fabs(slip) / SETTINGS.full_slip, 1.0) for slip in self.slip_angles(x, u, theta)
        ]
        drifts: list[Any] = [0.0, FORCE_NOISE, MOMENT_NOISE, SETTINGS.leaning * theta.road_bank, 1e-5, 1e-5, 1e-4, 1e-4]
        sliding = 1 + (self.auxiliary(x, u, theta)[0] / LINEAR) ** 2
        slipping = theta.slip_error * sliding
        turned = theta.steering_error * (u.steer_angle - x.steering_bias) ** 2
        strays = [error * np.sqrt(2 / SLIP_ERROR_TIME) for error in (slipping + turned, slipping)]
        bank = theta.road_bank * ca.sqrt(2 / theta.road_bank_time)
        shaking = theta.shaking_noise / SHAKING_TIME
        walk = ca.vertcat(*drifts, *stiffness_walk, 1e-5, bank, 0.0, SETTINGS.roll_noise, 0.0, 0.0, *strays, shaking)
        return input_noise + ca.diag(walk**2) * h + drifting(h, *[1e-6] * 19)

    def begin(self, first_readings: FirstReadings) -> Mapping[str, float]:
        return {
            n: first_readings[n]
            for n in ("forward_velocity", "yaw", "yaw_rate", "rolling_radius")
            if n in first_readings
        }

    def uncertain(self, name: str, first_readings: FirstReadings) -> float:
        prior_numbers = {
            "bank": "road_bank", "gyro_scale": "gyro_scale_deviation", "antenna_ahead": "antenna_deviation",
            "front_ln_stiffness": _KNOWN, "rear_ln_stiffness": _KNOWN,
            "front_slip_error": "slip_error", "rear_slip_error": "slip_error",
        }  # fmt: skip
        return first_readings[prior_numbers[name]] if name in prior_numbers else super().uncertain(name, first_readings)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        along = u.acceleration_x - x.acceleration_bias_x
        lateral_acceleration = self.auxiliary(x, u, theta)[0] - theta.gravity * ca.sin(x.bank)
        upright = {"roll": x.roll + x.bank, "forward_acceleration": along, "lateral_acceleration": lateral_acceleration}
        return {**super().motion(x, u, theta), **upright}


def brush(linear: ca.SX, largest: ca.SX) -> ca.SX:
    """Force [N] of a tyre of which a linear one would give `linear`, and `largest` [N] is all that it carries."""
    t = ca.fmin(ca.fmax(linear / largest, -SETTINGS.slides), SETTINGS.slides)
    return largest * (t - t * ca.fabs(t) / 3 + t**3 / 27)


def _velocity(x: Named, z: Named, u: Named, p: Named) -> list[ca.SX]:
    return velocity_of_antenna(x, p, x.yaw_rate, x.antenna_ahead)


def _spin(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    return x.forward_velocity / x.rolling_radius


GYRO = Measurement("gyro", lambda x, z, u, p: (1 + x.gyro_scale) * x.yaw_rate + x.gyro_bias, (0.003,))
LATERAL_FORCE = Measurement(
    "lateral_force",
    lambda x, z, u, p: z.lateral_force + p.gravity * ca.sin(x.roll) + x.acceleration_bias_y + x.shaking,
    (0.5,),
)
VELOCITY = Measurement("gnss_velocity", _velocity, (0.1, 0.1))
HEADING = Measurement("heading", lambda x, z, u, p: x.yaw, (0.01,), angles=(0,))
# The mean of both wheels: in a bend the outer one is pressed down and the inner one lifted, and what their radii differ
# by would be taken for a yaw rate. Slip is of the size of some thousandths.
SPIN = Measurement("rear_spin", _spin, (0.3,))

INTEGRATED = Definition.of(Integrated(), GYRO, LATERAL_FORCE, VELOCITY, HEADING, SPIN)
