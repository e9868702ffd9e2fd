"""Attitude and gyro biases by three gyros and two GNSS antennas (Leung 2010, section 4.5).

    (φ̇, θ̇, ψ̇) = A(φ, θ) ((p, q, r)_m - b)                     eq. 4.31, Euler angles of ISO 8855 (nose up: θ < 0)

With two antennas one behind the other, heading and pitch are measured, beside one another heading and roll. `PitchKkf`
and `RollKkf` are the filters of one angle (eqs. 4.26, 4.28, sign of the bias corrected: C17). Frames: `to_earth` turns
vectors of the body (b) to the map (e), `to_vehicle` to axes that are level with the road (v).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.model import spatial
from vsense_ros.navigation.space import Definition, NavigationSpace, drifting

LEVEL = 0.05  # [rad] by which roll and pitch may be off zero where no antenna tells them


class AttitudeEkf(NavigationSpace):
    """See the module."""

    names = ("roll", "pitch", "yaw", "gyro_bias_x", "gyro_bias_y", "gyro_bias_z")
    inputs = ("roll_rate", "pitch_rate", "yaw_rate")
    parameters = ("gyro_noise", "sample_time")
    prior: Mapping[str, float] = {
        "roll": LEVEL, "pitch": LEVEL, "yaw": 0.05, "gyro_bias_x": 0.02, "gyro_bias_y": 0.02, "gyro_bias_z": 0.02,
    }  # fmt: skip
    largest: Mapping[str, float] = {"pitch": 1.4}

    def rates(self, x: Named, u: Named) -> ca.SX:
        """Of the body (3,)."""
        return u.vector[:3] - x.vector[3:6]

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return ca.vertcat(x.vector[:3] + h * angle_rates(x.roll, x.pitch, self.rates(x, u)), x.vector[3:])

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        noise = theta.gyro_noise
        felt = self.sampled(x, u, theta, h, roll_rate=noise, pitch_rate=noise, yaw_rate=noise)
        return felt + drifting(h, 0.0, 0.0, 0.0, 1e-5, 1e-5, 1e-5)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        p, q, r = ca.vertsplit(self.rates(x, u))
        return {**super().motion(x, u, theta), "roll_rate": p, "pitch_rate": q, "yaw_rate": r}


def angle_rates(roll: ca.SX, pitch: ca.SX, rates: ca.SX) -> ca.SX:
    """A(φ, θ) ω (3,). In a banked turn ψ̇ = r / cos φ (C3)."""
    p, q, r = ca.vertsplit(rates)
    across = ca.sin(roll) * q + ca.cos(roll) * r
    return ca.vertcat(p + across * ca.tan(pitch), ca.cos(roll) * q - ca.sin(roll) * r, across / ca.cos(pitch))


def to_earth(roll: Any, pitch: Any, yaw: Any) -> ca.SX:
    """C_b^e (3, 3), eq. 2.72."""
    return spatial.rotation_rpy(roll, pitch, yaw)


def to_vehicle(roll: Any, pitch: Any, velocity: Any) -> ca.SX:
    """A velocity of the body (3,) in axes level with the road, eq. 4.35, by angles of the body on the road."""
    return spatial.rotation_rpy(roll, pitch, ca.SX(0)) @ velocity


def pitch_on_road(roll: Any, velocity: Any) -> Any:
    """Angle of the body on the road of a car that does not leave it, from the velocity in its own axes: eq. 4.37 with
    its sign and numerator corrected (C2)."""
    return ca.atan2(ca.sin(roll) * velocity[1] + ca.cos(roll) * velocity[2], velocity[0])


def grade(velocity: Any) -> Any:
    """Pitch of the road from a velocity on the map (3,), uphill negative as ISO 8855 has it."""
    return -ca.atan2(velocity[2], ca.sqrt(velocity[0] ** 2 + velocity[1] ** 2))


class AngleKkf(NavigationSpace):
    """One angle and the bias of its gyro: θ̇ = q_m - b."""

    parameters = ("gyro_noise", "sample_time")

    def __init__(self, angle: str, rate: str) -> None:
        self.names, self.inputs = (angle, "gyro_bias"), (rate,)
        self.prior = {angle: LEVEL, "gyro_bias": 0.02}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.vector[0] + h * (u.vector[0] - x.gyro_bias), x.gyro_bias]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return self.sampled(x, u, theta, h, **{self.inputs[0]: theta.gyro_noise}) + drifting(h, 0.0, 1e-5)


HEADING = Measurement("heading", lambda x, z, u, p: x.yaw, (0.01,), angles=(0,))
UPRIGHT = Measurement("upright", lambda x, z, u, p: [x.roll, x.pitch], (10 * LEVEL, 10 * LEVEL))
ATTITUDE = Measurement("attitude", lambda x, z, u, p: x.vector[:3], (0.01, 0.01, 0.01), angles=(0, 1, 2))
ANGLE = Measurement("angle", lambda x, z, u, p: x.vector[0], (0.01,), angles=(0,))

ATTITUDE_EKF = Definition.of(AttitudeEkf(), HEADING, UPRIGHT)
ATTITUDE_EKF_TWO_ANTENNAS = Definition.of(AttitudeEkf(), ATTITUDE)  # of which no sensor of a vehicle file tells all
PITCH_KKF = Definition.of(AngleKkf("pitch", "pitch_rate"), ANGLE)
ROLL_KKF = Definition.of(AngleKkf("roll", "roll_rate"), ANGLE)
