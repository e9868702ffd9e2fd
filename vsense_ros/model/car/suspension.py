"""How a suspension guides its hub: along a straight line, or by smooth tables of its kinematics.

Either gives the pose of the hub as a function of the wheel's travel and of the steering, with its first and second
derivatives by the travel: what the joint between chassis and hub needs. Everything is in the axes of the chassis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.schema.suspension_tables import (
    Coefficients,
    Columns,
    SuspensionTables,
    TablePlace,
    columns_beyond,
    columns_within,
    place_in_tables,
)


@dataclass(frozen=True, eq=False)
class HubMotion:
    """Pose of a hub and its change with the travel, in the axes of the chassis."""

    centre: ca.SX  # of the wheel (3×1) [m]
    axle: ca.SX  # direction of the wheel's axle, to the left (3×1)
    subspace: ca.SX  # velocity [ω; v] of the hub about the wheel centre, per speed of travel (6×1)
    bend: ca.SX  # its derivative by the travel, as seen from the hub (6×1)
    spring: ca.SX  # compression of the spring over its ratio in the design position [m]
    spring_ratio: ca.SX  # the derivative of that by the travel, 1 in the design position

    def turned(self, toe: ca.SX) -> HubMotion:
        """The motion with the axle turned about the vertical by `toe` [rad], positive to the left."""
        return self if toe.is_zero() else replace(self, axle=spatial.rotation_z(toe) @ self.axle)


def straight_guide(design: ca.SX, direction: ca.SX, travel: ca.SX, toe: ca.SX) -> HubMotion:
    """A hub that travels from `design` (3×1) [m] along `direction` (3×1, unit) without turning; `toe` [rad] is the
    angle by which its wheel is steered to the left."""
    return HubMotion(
        centre=design + direction * travel,
        axle=ca.vertcat(-ca.sin(toe), ca.cos(toe), 0),
        subspace=ca.vertcat(ca.SX(3, 1), direction),
        bend=ca.SX(6, 1),
        spring=travel,
        spring_ratio=ca.SX(1),
    )


def ackermann_angle(angle: ca.SX, share: Scalar, wheelbase: Scalar, left: Scalar) -> ca.SX:
    """Angle of a steered wheel [rad] for a mean `angle` of the front wheels: from parallel wheels (`share` 0) to full
    Ackermann geometry (1), for a wheel so far to the `left` of the car's middle [m]."""
    tangent = ca.tan(angle)
    turning = ca.atan2(wheelbase * tangent, wheelbase - left * tangent)
    return (1 - share) * angle + share * turning


def table_guide(
    tables: SuspensionTables, axle: Coefficients, side: ca.SX, design: ca.SX, travel: ca.SX, steering: ca.SX
) -> HubMotion:
    """The hub of a wheel, `side` 1 on the left and -1 on the right, as the tables with the coefficients of its `axle`
    move it from `design` (3×1) [m]."""
    place = place_in_tables(tables, travel, side * steering)
    return hub_from_columns(columns_within(axle, place), place, side, design, travel)


def hub_from_columns(columns: Columns, place: TablePlace, side: ca.SX, design: ca.SX, travel: ca.SX) -> HubMotion:
    """The motion of a hub as `table_guide` gives it, from the columns that `columns_within` gives at a place of the
    tables."""
    extended = columns_beyond(columns, place)
    x, y = extended["x"], [side * v for v in extended["y"]]
    # The hub is turned by toe about z, lean about the horizontal line forwards, and pitch about the axle.
    toe, lean, pitch = (
        [side * v for v in extended["toe"]],
        [-side * v for v in extended["camber"]],
        [-v for v in extended["caster"]],
    )
    vertical = ca.SX([0, 0, 1])
    ahead = ca.vertcat(ca.cos(toe[0]), ca.sin(toe[0]), 0)
    left = ca.vertcat(-ca.sin(toe[0]), ca.cos(toe[0]), 0)
    direction = left * ca.cos(lean[0]) + vertical * ca.sin(lean[0])
    turn = vertical * toe[1] + ahead * lean[1] + direction * pitch[1]
    change = (
        vertical * toe[2]
        + ahead * lean[2]
        + direction * pitch[2]
        + left * (toe[1] * lean[1])
        + ca.cross(vertical * toe[1] + ahead * lean[1], direction) * pitch[1]
    )
    move = ca.vertcat(x[1], y[1], 1)
    return HubMotion(
        centre=design + ca.vertcat(x[0], y[0], travel),
        axle=direction,
        subspace=ca.vertcat(turn, move),
        bend=ca.vertcat(change, ca.vertcat(x[2], y[2], 0) - ca.cross(turn, move)),
        spring=extended["spring"][0],
        spring_ratio=extended["spring"][1],
    )
