"""Velocity by accelerometers that wheel speeds correct (Farrelly & Wellstead 1996; Chen & Hsieh 2008; Leung 2010, eqs.
2.95 and 2.96).

Where the car hardly turns, the wheels do not determine v_y: there a single-track model takes the accelerometer's place.
With the forward velocity alone the biases b_x and b_y are never observable together, so they are not estimated.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation import single_track
from vsense_ros.navigation.open_loop import BodyIns
from vsense_ros.navigation.space import Definition


class WheelSpeedObserver(BodyIns):
    """See the module."""

    inputs = (*BodyIns.inputs, "steer_angle")
    parameters = (*BodyIns.parameters, *single_track.PARAMETERS, "straight_rate", "rolling_radius")

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        speed = single_track.speed_of_model(x.forward_velocity)
        front, rear = single_track.axle_forces(x.lateral_velocity / speed, u.yaw_rate, u.steer_angle, speed, theta)
        straight = ca.fabs(u.yaw_rate) < theta.straight_rate
        across = ca.if_else(straight, (front + rear) / theta.mass, u.acceleration_y) - u.yaw_rate * x.forward_velocity
        along = u.acceleration_x + u.yaw_rate * x.lateral_velocity
        return single_track.second_order(x.vector, ca.vertcat(along, across), h)


SPINS = Measurement("rear_spins", lambda x, z, u, p: [x.forward_velocity / p.rolling_radius] * 2, (0.05, 0.05))
WHEEL_SPEED_OBSERVER = Definition.of(WheelSpeedObserver(), SPINS)
