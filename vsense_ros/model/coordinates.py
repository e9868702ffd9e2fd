"""Coordinates, velocities, inputs and disturbances of the car, by name: the one place that knows their order.

Coordinates `q` are those of a chassis that moves freely, and of four wheels: position of `cog` in the map [m], z-y-x
angles of the attitude [rad], compression of the suspensions [m], spin angles of the wheels [rad]. Velocities `u` stand
beside them: velocity of `cog` in body axes [m/s], body rates [rad/s], compression rates [m/s], spin speeds [rad/s];
derivatives of `u` and generalized forces have the order of `u`. Wheels are fl, fr, rl, rr everywhere.
"""

from __future__ import annotations

from vsense_ros.messages.topics import WHEELS

__all__ = [
    "ATTITUDE",
    "BANK",
    "BANK_CHANGE",
    "COORDINATES",
    "DISTURBANCES",
    "DYNAMIC_COORDINATES",
    "FORCE_X",
    "FORCE_Y",
    "FORCE_Z",
    "GRADE",
    "GRADE_CHANGE",
    "INPUTS",
    "MOMENT",
    "PITCH",
    "PITCH_RATE",
    "POSE",
    "POSITION",
    "RADIUS_ERROR",
    "RATES",
    "REAR_STEERING",
    "ROAD",
    "ROAD_HEIGHT",
    "ROLL",
    "ROLL_RATE",
    "SPEED_X",
    "SPEED_Y",
    "SPEED_Z",
    "SPIN",
    "STEERING",
    "STEERING_OFFSET",
    "SURFACE",
    "TORQUES",
    "TRAVEL",
    "TWIST",
    "VELOCITY",
    "WHEELS",
    "WHEEL_FORCES",
    "WHEEL_OUTPUTS",
    "YAW",
    "YAW_RATE",
    "X",
    "Y",
    "Z",
]

COORDINATES = 14
X, Y, Z, ROLL, PITCH, YAW = range(6)
POSITION, ATTITUDE = slice(0, 3), slice(3, 6)
POSE = slice(0, 6)  # position and attitude
TRAVEL = slice(6, 10)  # of the velocities: how fast the suspensions are compressed
SPIN = slice(10, 14)  # of the velocities: spin speeds

# Of velocities, their derivatives and generalized forces.
SPEED_X, SPEED_Y, SPEED_Z, ROLL_RATE, PITCH_RATE, YAW_RATE = range(6)
VELOCITY, RATES = slice(0, 3), slice(3, 6)
TWIST = slice(0, 6)  # velocity and rates

# Inputs of the dynamics: road-wheel angle [rad], its slow error is a bias, wheel torques, drive minus brake [N m], and
# the angle of the rear wheels of a car that steers them, to the left [rad].
INPUTS = ("steering", *(f"torque_{wheel}" for wheel in WHEELS), "rear_steering")
STEERING = 0
TORQUES = slice(1, 5)
REAR_STEERING = 5

# Slowly varying quantities that enter the dynamics: slope of the road along and across the car (positive uphill, and
# positive where the left side is higher) [rad], what both change by along the way [rad/m], height of the road over the
# map's origin [m], offset of the measured road-wheel angle [rad], relative error of the tyre radius [-].
DISTURBANCES = ("grade", "bank", "grade_change", "bank_change", "road_height", "steering_offset", "radius_error")
GRADE, BANK, GRADE_CHANGE, BANK_CHANGE, ROAD_HEIGHT, STEERING_OFFSET, RADIUS_ERROR = range(7)
ROAD = slice(0, 5)  # those of the road under the car
SURFACE = slice(0, 4)  # its form: all but the height

# Coordinates that the dynamics depend on: not where the car is, not its heading, not how far the wheels have turned.
DYNAMIC_COORDINATES = (Z, ROLL, PITCH, *range(TRAVEL.start, TRAVEL.stop))

# What is estimated of each wheel: forces on the contact patch [N], aligning moment [N m], longitudinal slip [-], slip
# angle and inclination angle [rad].
WHEEL_OUTPUTS = ("force_x", "force_y", "force_z", "moment", "slip", "slip_angle", "inclination")
FORCE_X, FORCE_Y, FORCE_Z, MOMENT, SLIP = range(5)
WHEEL_FORCES = slice(0, 3)
