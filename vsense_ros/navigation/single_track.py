"""The linear single-track model in side slip and yaw rate (Leung 2010, eq. 3.20, sign of b² C_R corrected).

    β̇ = (F_f + F_r) / (m V) - r,  ṙ = (a F_f - b F_r) / J
    F_f = C_f (δ - β - a r / V),  F_r = C_r (b r / V - β)

Stiffnesses are those of an axle, positive. A step is taken to second order in its length: the model is stiff at low
speeds, where the first order of the thesis is unstable.
"""

from __future__ import annotations

import casadi as ca

from vsense_ros.estimation.state_space import Named

PARAMETERS = ("mass", "yaw_inertia", "to_front", "to_rear", "front_stiffness", "rear_stiffness")
SLOWEST = 2.0  # [m/s] below it the model goes on as at this speed


def speed_of_model(speed: ca.SX) -> ca.SX:
    """With which equations that divide by it are evaluated [m/s]."""
    return ca.fmax(speed, SLOWEST)


def axle_forces(side_slip: ca.SX, yaw_rate: ca.SX, steer: ca.SX, speed: ca.SX, theta: Named) -> tuple[ca.SX, ca.SX]:
    """Of both wheels of the front and of the rear axle [N]."""
    front = theta.front_stiffness * (steer - side_slip - theta.to_front * yaw_rate / speed)
    return front, theta.rear_stiffness * (theta.to_rear * yaw_rate / speed - side_slip)


def rates(side_slip: ca.SX, yaw_rate: ca.SX, steer: ca.SX, speed: ca.SX, theta: Named) -> tuple[ca.SX, ca.SX]:
    """β̇ [rad/s] and ṙ [rad/s²]."""
    front, rear = axle_forces(side_slip, yaw_rate, steer, speed, theta)
    turning = (theta.to_front * front - theta.to_rear * rear) / theta.yaw_inertia
    return (front + rear) / (theta.mass * speed) - yaw_rate, turning


def second_order(x: ca.SX, rate: ca.SX, h: ca.SX) -> ca.SX:
    """x after `h` [s] with ẋ = `rate` (x): x + h f + h² / 2 (∂f/∂x) f."""
    return x + h * rate + h**2 / 2 * ca.jtimes(rate, x, rate)
