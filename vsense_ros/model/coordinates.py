"""Coordinates, velocities, inputs and disturbances of the car, by name: the one place that knows their order."""

from __future__ import annotations

from vsense_ros.messages.topics import WHEELS

__all__ = [
    "COORDINATES",
    "DYNAMIC_COORDINATES",
    "INPUTS",
    "PITCH",
    "ROLL",
    "SPIN",
    "SURROUNDINGS",
    "TRAVEL",
    "WHEELS",
    "YAW",
    "X",
    "Y",
    "Z",
]

COORDINATES = 14
X, Y, Z, ROLL, PITCH, YAW = range(6)
TRAVEL = slice(6, 10)
SPIN = slice(10, 14)

# Inputs of the dynamics: road-wheel angle [rad], its slow error is a bias, and wheel torques, drive minus brake [N m].
INPUTS = ("steering", "torque_fl", "torque_fr", "torque_rl", "torque_rr")

# Slowly varying quantities that enter the dynamics: slope of the road along and across the car (positive uphill, and
# positive where the left side is higher) [rad], offset of the measured road-wheel angle [rad], relative error of the
# tyre radius [-].
SURROUNDINGS = ("grade", "bank", "steering_offset", "radius_error")

# Coordinates that the dynamics depend on: not where the car is, not its heading, not how far the wheels have turned.
DYNAMIC_COORDINATES = (Z, ROLL, PITCH, 6, 7, 8, 9)
