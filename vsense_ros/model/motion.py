"""The motion of a car at one instant, by name: what the equations of sensors refer to."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.constants import GRAVITY

_ANGLE, _VECTOR, _OF_EACH_WHEEL = (partial(ca.SX.zeros, rows) for rows in (1, 3, 4))


@dataclass(frozen=True)
class Motion:
    """Symbols of one instant. A model without some of these coordinates leaves them at zero.

    Axes: ISO 8855. The body leans over a road, which slopes on the map. `cog` is the centre of gravity in the design
    position.
    """

    position: ca.SX = field(default_factory=_VECTOR)  # (3,) of cog on the map [m]
    height: ca.SX = field(default_factory=_ANGLE)  # of cog over the road, along its normal [m]
    roll: ca.SX = field(default_factory=_ANGLE)  # of the body relative to the road [rad]
    pitch: ca.SX = field(default_factory=_ANGLE)  # the same, positive where the front goes down [rad]
    yaw: ca.SX = field(default_factory=_ANGLE)  # counter-clockwise from the map's x [rad]
    velocity: ca.SX = field(default_factory=_VECTOR)  # (3,) of cog in body axes [m/s]
    rates: ca.SX = field(default_factory=_VECTOR)  # (3,) of turning, in body axes [rad/s]
    acceleration: ca.SX = field(default_factory=_VECTOR)  # (3,) of cog over the map, in body axes [m/s²]
    angular_acceleration: ca.SX = field(default_factory=_VECTOR)  # (3,) derivatives of the rates [rad/s²]
    travel: ca.SX = field(default_factory=_OF_EACH_WHEEL)  # (4,) of suspensions: compression from the design [m]
    travel_rates: ca.SX = field(default_factory=_OF_EACH_WHEEL)  # (4,) [m/s]
    spin: ca.SX = field(default_factory=_OF_EACH_WHEEL)  # (4,) speed of each wheel about its axle [rad/s]
    spin_rates: ca.SX = field(default_factory=_OF_EACH_WHEEL)  # (4,) [rad/s²]
    gravity: ca.SX = field(default_factory=lambda: ca.SX([0.0, 0.0, -GRAVITY]))  # (3,) in body axes [m/s²]
    over_road: ca.SX = field(default_factory=lambda: ca.SX.eye(3))  # body to road axes, 3×3
    road: ca.SX = field(default_factory=lambda: ca.SX.eye(3))  # road axes to level ones with the same heading, 3×3
    steering: ca.SX = field(default_factory=_ANGLE)  # road-wheel angle as it is measured, positive to the left [rad]
    articulation: ca.SX = field(default_factory=_ANGLE)  # from the car's heading to its trailer's [rad]
    torques: ca.SX = field(default_factory=_OF_EACH_WHEEL)  # (4,) drive minus brake torque of each wheel [N m]

    @property
    def attitude(self) -> ca.SX:
        """Body to map, 3×3."""
        return spatial.rotation_z(self.yaw) @ self.road @ self.over_road
