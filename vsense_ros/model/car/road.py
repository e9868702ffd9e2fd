"""The surface under the car, which every model of the car stands on.

Coordinates of the car are those over the road: the road's axes have their origin on the surface right below `cog`, z
along its normal, and x along the car. They move with the car and turn as the surface does. Near the car the surface is
z = κ x²/2 + τ x y in these axes, where κ is what the grade and τ what the bank changes by along the way.

A crown, the curvature across the road, is seen as a bank that changes with the place of the car on it: it bends nothing
else that a car feels, as its two wheels of an axle stand at the same height of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import BANK, BANK_CHANGE, GRADE, GRADE_CHANGE, PITCH, ROLL, Z


def bent(disturbances: Any, along: Any, across: Any) -> tuple[Any, Any, Any]:
    """Shape of the surface at a place (`along`, `across`) [m] in road axes: the distance by which its tangent plane
    passes below the axes' origin [m], and its slopes along and across [-]; for numbers and symbols alike."""
    bend, twist = disturbances[GRADE_CHANGE], disturbances[BANK_CHANGE]
    return (bend * along / 2 + twist * across) * along, bend * along + twist * across, twist * along


def turning(disturbances: Any, speed_x: Any, speed_y: Any) -> tuple[Any, Any]:
    """Rates of the road's axes about x and y [rad/s] under a car with a velocity in these axes [m/s]; for numbers and
    symbols alike."""
    bend, twist = disturbances[GRADE_CHANGE], disturbances[BANK_CHANGE]
    return twist * speed_x, -bend * speed_x - twist * speed_y


class Under(NamedTuple):
    """The road under a wheel: its normal in road axes (3), and the height of `cog` over its tangent plane [m]."""

    normal: ca.SX
    height: ca.SX


@dataclass(frozen=True)
class Road:
    """Form of the surface where the car is, from the disturbances (7)."""

    disturbances: ca.SX

    @property
    def upward(self) -> ca.SX:
        """The vertical in road axes (3): sines of grade and bank, and what is left along the normal."""
        along, across = ca.sin(self.disturbances[GRADE]), ca.sin(self.disturbances[BANK])
        return ca.vertcat(along, across, ca.sqrt(1 - along**2 - across**2))

    @property
    def gravity(self) -> ca.SX:
        """Acceleration of free fall in road axes (3) [m/s²]."""
        return -GRAVITY * self.upward

    @property
    def to_level(self) -> ca.SX:
        """Road axes to level ones with the same heading, 3×3: turned about y by the grade, then about x."""
        along, across, normal = ca.vertsplit(self.upward)
        level = ca.sqrt(1 - along**2)
        x = ca.vertcat(level, 0, along)
        y = ca.vertcat(-along * across / level, normal / level, across)
        z = ca.vertcat(-along * normal / level, -across / level, normal)
        return ca.horzcat(x, y, z)

    def under(self, along: ca.SX, across: ca.SX, height: ca.SX) -> Under:
        """At a place (`along`, `across`) [m] in road axes, for a car whose `cog` is `height` above the origin."""
        rise, slope_x, slope_y = bent(self.disturbances, along, across)
        normal = ca.vertcat(-slope_x, -slope_y, 1) / ca.sqrt(1 + slope_x**2 + slope_y**2)
        return Under(normal, normal[Z] * (height + rise))


def over_road(q: ca.SX) -> ca.SX:
    """Body axes to those of the road, 3×3."""
    return spatial.rotation_y(q[PITCH]) @ spatial.rotation_x(q[ROLL])
