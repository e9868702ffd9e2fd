"""The linear single-track model as matrices, and outputs of a handling model along a drive."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.handling.response import Response
from vsense_ros.model.parameter import Scalar

Array = NDArray[np.float64]


def system_matrices(p: Any, speed: Scalar) -> tuple[ca.SX, ca.SX]:
    """A (2, 2) and B (2, 1) of the linear model in side slip and yaw rate, driven by the road-wheel angle."""
    front, rear, a, b = p.front_stiffness, p.rear_stiffness, p.to_front, p.to_rear
    turning = b * rear - a * front
    damping = a * a * front + b * b * rear
    by_state = ca.vertcat(
        ca.horzcat(-(front + rear) / (p.mass * speed), turning / (p.mass * speed**2) - 1),
        ca.horzcat(turning / p.yaw_inertia, -damping / (p.yaw_inertia * speed)),
    )
    return ca.SX(by_state), ca.SX(ca.vertcat(front / (p.mass * speed), a * front / p.yaw_inertia))


def output_values(response: Response, states: Array, inputs: Array) -> Array:
    """Outputs (n, m) of states (n, states) with inputs (n, k)."""
    run = response.outputs.map(len(states))
    parameters = np.broadcast_to(response.parameters[:, None], (len(response.parameters), len(states)))
    return np.asarray(run(states.T, inputs.T, parameters)).T
