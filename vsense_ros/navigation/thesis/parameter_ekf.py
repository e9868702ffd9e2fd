"""openpilot's filter of a car's parameters, as a baseline (comma.ai, selfdrive/locationd/models/car_kf.py).

A single-track model in (u, v, r) whose stiffness and steering ratio are multiplied by states, with a slow and a fast
steering offset and the roll of the road; all nine states are random walks but v and r. Its drifts are those of the
source, per √s; its yaw rate and speed come from a localizer that we do not have: here they are the gyro and GNSS, which
is slower, so that the speed drifts by 1 m/s and not by 0.1 m/s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation import single_track
from vsense_ros.navigation.space import Definition, FirstReadings, NavigationSpace, drifting

_DEGREE = float(np.radians(1.0))


class ParameterEkf(NavigationSpace):
    """See the module; `ratio` multiplies the steering ratio of the vehicle file, where openpilot has it whole."""

    names = (
        "ratio", "stiffness", "steering_bias", "fast_steering_bias", "forward_velocity", "lateral_velocity", "yaw_rate",
        "steer_angle", "road_roll",
    )  # fmt: skip
    parameters = (*single_track.PARAMETERS, "gravity")
    drifts = (
        5e-4 / 15,
        0.01,
        0.02 * _DEGREE / 15,
        0.25 * _DEGREE / 15,
        1.0,
        0.01,
        0.1 * _DEGREE,
        0.1 * _DEGREE,
        _DEGREE,
    )
    prior: Mapping[str, float] = {
        "ratio": 0.1, "stiffness": 0.2, "steering_bias": 0.01, "fast_steering_bias": 0.003, "forward_velocity": 0.3,
        "lateral_velocity": 0.1, "yaw_rate": 0.02, "steer_angle": 0.01, "road_roll": 0.03,
    }  # fmt: skip

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        speed = single_track.speed_of_model(x.forward_velocity)
        steer = (x.steer_angle - x.steering_bias - x.fast_steering_bias) / x.ratio
        front, rear = single_track.axle_forces(x.lateral_velocity / speed, x.yaw_rate, steer, speed, theta)
        front, rear = x.stiffness * front, x.stiffness * rear
        across = (front + rear) / theta.mass - speed * x.yaw_rate - theta.gravity * x.road_roll
        turning = (theta.to_front * front - theta.to_rear * rear) / theta.yaw_inertia
        rate = ca.vertcat(ca.SX.zeros(5), across, turning, ca.SX.zeros(2))
        return single_track.second_order(x.vector, rate, h)

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return drifting(h, *self.drifts)

    def begin(self, first_readings: FirstReadings) -> Mapping[str, float]:
        return {"ratio": 1.0, "stiffness": 1.0, **super().begin(first_readings)}

    def motion(self, x: Named, u: Named, theta: Named) -> dict[str, Any]:
        return {name: x[name] for name in ("forward_velocity", "lateral_velocity", "yaw_rate")}


STEERING = Measurement("steering", lambda x, z, u, p: x.steer_angle, (0.05 * _DEGREE,))
GYRO = Measurement("gyro", lambda x, z, u, p: x.yaw_rate, (0.003,))
SPEED = Measurement("gnss_speed", lambda x, z, u, p: x.forward_velocity, (0.1,))
FAST_BIAS = Measurement("no_fast_steering_bias", lambda x, z, u, p: x.fast_steering_bias, (10 * _DEGREE / 15,))
ROLL = Measurement("level_road", lambda x, z, u, p: x.road_roll, (0.3,))

PARAMETER_EKF = Definition.of(ParameterEkf(), STEERING, GYRO, SPEED, FAST_BIAS, ROLL)
