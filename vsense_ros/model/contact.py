"""Contact of a wheel with a plane road: where it touches, how it slides there, and what the tyre then does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca

from vsense_ros.model.parameter import Scalar
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.tyres.slip import transport_speed


@dataclass(frozen=True, eq=False)
class Contact:
    """Where and how a wheel touches the road: vectors (3×1) in the axes of the car, the point from its origin; scalars
    in SI units."""

    point: ca.SX
    ahead: ca.SX
    sideways: ca.SX
    normal: ca.SX
    load: ca.SX
    speed_x: ca.SX
    speed_y: ca.SX
    inclination: ca.SX  # positive where the top leans to the right (ISO 8855) [rad]
    effective_radius: ca.SX

    def rolling_resistance(self, axle: Axle, rolling_speed: ca.SX) -> ca.SX:
        """Moment about the axle [N m] of a wheel whose tread moves at `rolling_speed` [m/s]; none at standstill."""
        direction = rolling_speed / transport_speed(rolling_speed, axle.tyre.standstill_speed)
        return -axle.rolling_resistance * self.load * self.effective_radius * direction


def contact(
    axle: Axle,
    radius: Scalar,
    centre: ca.SX,
    direction: ca.SX,
    normal: ca.SX,
    height: ca.SX,
    velocity_at: Callable[[ca.SX], ca.SX],
) -> Contact:
    """`axle` holds the symbols of an `Axle`, `radius` is that of its unloaded tyre; the wheel turns about `direction`
    (to the left) through `centre`; the road has the `normal`, and the origin of the axes is `height` above it;
    `velocity_at` gives the velocity (3×1) of a point that does not spin with the wheel."""
    ahead = ca.cross(direction, normal)
    ahead = ahead / ca.norm_2(ahead)
    upward = ca.cross(ahead, direction)
    loaded_radius = (height + normal.T @ centre) / (normal.T @ upward)
    point = centre - loaded_radius * upward
    sideways = ca.cross(normal, ahead)
    velocity = velocity_at(point)
    deflection = radius - loaded_radius
    load = axle.tyre_stiffness * deflection - axle.tyre_damping * (normal.T @ velocity)
    factor = axle.dynamic_radius_factor
    return Contact(
        point=point,
        ahead=ahead,
        sideways=sideways,
        normal=normal,
        load=ca.if_else(deflection > 0, ca.fmax(load, 0), 0),
        speed_x=ahead.T @ velocity,
        speed_y=sideways.T @ velocity,
        inclination=ca.asin(normal.T @ direction),
        effective_radius=factor * radius + (1 - factor) * loaded_radius,
    )
