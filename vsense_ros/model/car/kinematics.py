"""Kinematics of a car over a road: derivatives of its coordinates and of the road under it, and its motion by name."""

from __future__ import annotations

import casadi as ca

from vsense_ros.model.car.road import Road, over_road, turning
from vsense_ros.model.coordinates import (
    BANK,
    GRADE,
    PITCH,
    PITCH_RATE,
    RATES,
    ROAD_HEIGHT,
    ROLL,
    ROLL_RATE,
    SPIN,
    STEERING,
    TORQUES,
    TRAVEL,
    VELOCITY,
    YAW,
    YAW_RATE,
    X,
    Y,
    Z,
)
from vsense_ros.model.motion import Motion


def motion_of(q: ca.SX, u: ca.SX, udot: ca.SX, disturbances: ca.SX, inputs: ca.SX) -> Motion:
    """The motion at one instant by name, from coordinates, velocities and derivatives of velocities (14 each),
    disturbances (4) and inputs (5)."""
    velocity, rates = u[VELOCITY], u[RATES]
    return Motion(
        position=ca.vertcat(q[X], q[Y], disturbances[ROAD_HEIGHT] + q[Z] * Road(disturbances).upward[Z]),
        height=q[Z],
        roll=q[ROLL],
        pitch=q[PITCH],
        yaw=q[YAW],
        velocity=velocity,
        rates=rates,
        acceleration=udot[VELOCITY] + ca.cross(rates, velocity),
        angular_acceleration=udot[RATES],
        travel=q[TRAVEL],
        travel_rates=u[TRAVEL],
        spin=u[SPIN],
        spin_rates=udot[SPIN],
        gravity=gravity_in_body(q, disturbances),
        over_road=over_road(q),
        road=Road(disturbances).to_level,
        steering=inputs[STEERING],
        torques=inputs[TORQUES],
    )


def gravity_in_body(q: ca.SX, disturbances: ca.SX) -> ca.SX:
    """Acceleration of free fall in body axes for a car on a sloping road, 3×1 [m/s²]."""
    return over_road(q).T @ Road(disturbances).gravity


def kinematics(q: ca.SX, u: ca.SX, disturbances: ca.SX) -> ca.SX:
    """Derivatives of the coordinates (14): x, y and yaw on the map, z, roll and pitch over the road, which turns as the
    car moves on; z-y-x angles, singular at a pitch of 90°."""
    road, (velocity, turn, rates) = Road(disturbances), _over_road(q, u, disturbances)
    heading = ca.vertcat(ca.cos(q[YAW]), ca.sin(q[YAW]))
    ahead, sideways, _ = ca.vertsplit(road.to_level @ velocity)
    east, north = heading[0] * ahead - heading[1] * sideways, heading[1] * ahead + heading[0] * sideways
    along, across, normal = ca.vertsplit(road.upward)
    yaw = (across * turn[1] + normal * rates[2]) / (1 - along**2)
    return ca.vertcat(east, north, velocity[Z], rates[0], rates[1], yaw, u[TRAVEL], u[SPIN])


def road_kinematics(q: ca.SX, u: ca.SX, disturbances: ca.SX) -> ca.SX:
    """Derivatives of grade, bank and height of the road under the car (3): the surface turns below it, and a car that
    turns on a slope changes one for the other."""
    velocity, turn, rates = _over_road(q, u, disturbances)
    along, across, normal = ca.vertsplit(Road(disturbances).upward)
    grade = (across * rates[2] - normal * turn[1]) / ca.cos(disturbances[GRADE])
    bank = (normal * turn[0] - along * rates[2]) / ca.cos(disturbances[BANK])
    return ca.vertcat(grade, bank, along * velocity[X] + across * velocity[Y])


def _over_road(q: ca.SX, u: ca.SX, disturbances: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Velocity in road axes (3); rates of the road about x and y (2); derivatives of roll and pitch, and the rate at
    which the car turns about the normal (3)."""
    roll, pitch = q[ROLL], q[PITCH]
    velocity = over_road(q) @ u[VELOCITY]
    turn = ca.vertcat(*turning(disturbances, velocity[X], velocity[Y]))
    s, c, t = ca.sin(roll), ca.cos(roll), ca.tan(pitch)
    level = s * u[PITCH_RATE] + c * u[YAW_RATE]
    rates = ca.vertcat(
        u[ROLL_RATE] + t * level - turn[0] / ca.cos(pitch),
        c * u[PITCH_RATE] - s * u[YAW_RATE] - turn[1],
        level / ca.cos(pitch) - turn[0] * t,
    )
    return velocity, turn, rates
