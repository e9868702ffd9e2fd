"""Side slip and yaw rate by a single-track model, and simple ways to correct it (Leung 2010, sections 2.4 and 2.5).

An observer with a constant gain is here a system that its measurement drives: ẋ = f(x, u) + l(r_m - r̂).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation import single_track
from vsense_ros.navigation.space import Definition, NavigationSpace, drifting

GAIN = (0.0, 20.0)  # of β̇ and ṙ by an error of the yaw rate [1/s]
SLIDING_GAIN, BOUNDARY = 2.0, 0.02  # of ṙ by the sign of that error [rad/s²], which is smoothed over so much [rad/s]
CROSSOVER = 2.0  # [s] below which the inertial sensor counts, above which the model (eq. 7.1)


class SingleTrack(NavigationSpace):
    """β and r by the model alone (eq. 3.20), nothing corrects it."""

    names: tuple[str, ...] = ("side_slip", "yaw_rate")
    inputs: tuple[str, ...] = ("steer_angle", "speed")
    parameters: tuple[str, ...] = single_track.PARAMETERS
    prior: Mapping[str, float] = {"side_slip": 0.02, "yaw_rate": 0.05}

    def correction(self, x: Named, u: Named) -> tuple[Any, Any]:
        """The correction that is added to β̇ and ṙ."""
        return 0.0, 0.0

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        model = single_track.rates(x.side_slip, x.yaw_rate, u.steer_angle, u.speed, theta)
        rate = ca.vertcat(
            *(change + correction for change, correction in zip(model, self.correction(x, u), strict=True))
        )
        return single_track.second_order(x.vector, rate, h)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return drifting(h, 5e-3, 3e-2)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        motion = {"side_slip": x.side_slip, "yaw_rate": x.yaw_rate, "forward_velocity": u.speed * ca.cos(x.side_slip)}
        return {**motion, "lateral_velocity": u.speed * ca.sin(x.side_slip)}


class Luenberger(SingleTrack):
    """The single-track observer with a linear gain (Stéphant et al. 2004)."""

    inputs = (*SingleTrack.inputs, "yaw_rate")

    def correction(self, x: Named, u: Named) -> tuple[Any, Any]:
        error = u.yaw_rate - x.yaw_rate
        return GAIN[0] * error, GAIN[1] * error


class SlidingMode(Luenberger):
    """With the sign of the error, smoothed near zero (Stéphant et al. 2004)."""

    def correction(self, x: Named, u: Named) -> tuple[Any, Any]:
        return 0.0, SLIDING_GAIN * ca.tanh((u.yaw_rate - x.yaw_rate) / BOUNDARY)


class ModelAndIns(SingleTrack):
    """β by the model at low frequencies, by the inertial sensor at high ones (Piyabongkarn et al. 2009; eq. 7.1):
    β̂̇ = a_y / V - r + (β_model - β̂) / τ."""

    names = ("side_slip", "model_slip", "model_rate")
    inputs = (*SingleTrack.inputs, "yaw_rate", "acceleration_y")
    prior: Mapping[str, float] = {"side_slip": 0.02, "model_slip": 0.02, "model_rate": 0.05}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        model = single_track.rates(x.model_slip, x.model_rate, u.steer_angle, u.speed, theta)
        slip_rate = u.acceleration_y / single_track.speed_of_model(u.speed) - u.yaw_rate
        rate = ca.vertcat(slip_rate + (x.model_slip - x.side_slip) / CROSSOVER, *model)
        return single_track.second_order(x.vector, rate, h)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return drifting(h, 5e-3, 5e-3, 3e-2)

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        motion = {"side_slip": x.side_slip, "yaw_rate": u.yaw_rate, "forward_velocity": u.speed * ca.cos(x.side_slip)}
        return {**motion, "lateral_velocity": u.speed * ca.sin(x.side_slip)}


def lateral_force(x: Named, z: Named, u: Named, p: Named) -> ca.SX:
    """What an accelerometer feels across the car: the axles' forces, and the body's roll."""
    front, rear = single_track.axle_forces(x.side_slip, x.yaw_rate, u.steer_angle, u.speed, p)
    return (1 + p.roll_gain) * (front + rear) / p.mass


class FeelsRoll(SingleTrack):
    """The single track whose accelerometer feels the roll of the body."""

    parameters = (*single_track.PARAMETERS, "roll_gain")


GYRO = Measurement("gyro", lambda x, z, u, p: x.yaw_rate, (0.003,))
LATERAL_FORCE = Measurement("lateral_force", lateral_force, (0.5,))

SINGLE_TRACK = Definition.of(SingleTrack())
LUENBERGER = Definition.of(Luenberger())
SLIDING_MODE = Definition.of(SlidingMode())
MODEL_AND_INS = Definition.of(ModelAndIns())
SINGLE_TRACK_KF = Definition.of(FeelsRoll(), GYRO, LATERAL_FORCE)  # Rock et al. 2005, eqs. 2.83 and 2.84
