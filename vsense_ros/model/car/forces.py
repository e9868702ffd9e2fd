"""Forces on the bodies of a car: of springs, dampers and anti-roll bars, of the road, and of the air."""

from __future__ import annotations

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.car.suspension import HubMotion
from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import SPEED_X, TRAVEL
from vsense_ros.model.moving_car import Corner, MovingCar, TyreContact


def suspension_resistance(car: MovingCar, corner: Corner, hub: HubMotion, design: HubMotion) -> ca.SX:
    """Generalized force of spring, damper and anti-roll bar against the travel [N]; `design` is the motion of the hub
    in the design position."""
    a, i = corner.axle, corner.index
    upward = ca.cross(ca.SX([1, 0, 0]), design.axle)
    lift = design.subspace[5] + ca.cross(design.subspace[:3], -corner.loaded_radius * upward)[2]
    # In the design position the spring carries the load on the contact point, less the weight of hub and wheel.
    preload = corner.static_load * lift - (a.hub_mass + a.wheel_mass) * GRAVITY * design.subspace[5]
    spring = preload / design.spring_ratio + a.suspension_stiffness * hub.spring
    damper = a.suspension_damping * hub.spring_ratio * car.u[TRAVEL][i]
    bar = a.antiroll_stiffness * (car.q[TRAVEL][i] - car.q[TRAVEL][corner.opposite])
    return (spring + damper) * hub.spring_ratio + bar


def wheel_force(corner: Corner, hub: HubMotion, contact: TyreContact) -> ca.SX:
    """Force vector of the road on a wheel about its centre, 6×1."""
    touch, tyre = contact.touch, contact.tyre
    force = tyre.longitudinal * touch.ahead + tyre.lateral * touch.sideways + touch.load * touch.normal
    resistance = touch.rolling_resistance(corner.axle, contact.rolling_speed)
    moment = tyre.aligning_moment * touch.normal + resistance * hub.axle
    return spatial.force_at(touch.point - hub.centre, force, moment)


def air_drag(car: MovingCar) -> ca.SX:
    """Force vector of the air on the chassis about `cog`, 6×1."""
    speed = car.u[SPEED_X]
    drag = -0.5 * AIR_DENSITY * car.parameters.aerodynamics.drag_area * speed * ca.fabs(speed)
    return ca.vertcat(ca.SX(3, 1), drag, ca.SX(2, 1))
