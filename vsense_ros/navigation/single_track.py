"""The single-track model in side slip and yaw rate, `model.handling.Bicycle2Dof`, as filters take it.

Stiffnesses are those of an axle, positive. A step is taken to second order in its length: the model is stiff at low
speeds, where the first order of Leung 2010 is unstable.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from vsense_ros.estimation.state_space import Named
from vsense_ros.model.handling.bicycle_2dof import SLOWEST, Bicycle2Dof
from vsense_ros.model.parameter import Scalar

_MODEL = Bicycle2Dof()
PARAMETERS = _MODEL.parameters


class _State(NamedTuple):
    side_slip: ca.SX
    yaw_rate: ca.SX


class _Inputs(NamedTuple):
    steering: ca.SX
    speed: ca.SX


def speed_of_model(speed: ca.SX) -> ca.SX:
    """Speed [m/s] with which the model evaluates equations that divide by it: not less than its slowest."""
    return ca.fmax(speed, SLOWEST)


def axle_forces(side_slip: ca.SX, yaw_rate: ca.SX, steer: ca.SX, speed: ca.SX, theta: Named) -> tuple[Scalar, Scalar]:
    """Lateral forces of both wheels of the front and of the rear axle [N]."""
    return _MODEL.axle_forces(_State(side_slip, yaw_rate), _Inputs(steer, speed), theta)


def rates(side_slip: ca.SX, yaw_rate: ca.SX, steer: ca.SX, speed: ca.SX, theta: Named) -> tuple[Scalar, Scalar]:
    """β̇ [rad/s] and ṙ [rad/s²]."""
    slipping, turning = _MODEL.rates(_State(side_slip, yaw_rate), _Inputs(steer, speed), theta)
    return slipping, turning


def second_order(x: ca.SX, rate: ca.SX, h: ca.SX) -> ca.SX:
    """x after `h` [s] with ẋ = `rate` (x): x + h f + h² / 2 (∂f/∂x) f."""
    return x + h * rate + h**2 / 2 * ca.jtimes(rate, x, rate)
