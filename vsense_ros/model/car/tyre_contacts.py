"""Contacts of a car's tyres with the road, and the forces there."""

from __future__ import annotations

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.car.present_effects import PresentEffects
from vsense_ros.model.car.road import Road, over_road
from vsense_ros.model.car.suspension import HubMotion
from vsense_ros.model.contact import Contact, contact
from vsense_ros.model.coordinates import RADIUS_ERROR, RATES, SPIN, TRAVEL, VELOCITY, X, Y, Z
from vsense_ros.model.moving_car import Corner, MovingCar, TyreContact
from vsense_ros.model.tyres import TyreForces, TyreInput
from vsense_ros.model.tyres.slip import transport_speed

LEAST_STIFFNESS = 1.0  # [N/rad] of a tyre that has left the road: keeps the slip of its thrust finite


def tyre_contact(car: MovingCar, effects: PresentEffects, corner: Corner, hub: HubMotion) -> TyreContact:
    """The contact of one tyre with the road, and the forces there."""
    a = corner.axle
    # Where the wheel stands in the design position: what it moves by changes little on a surface that bends little.
    road = Road(car.disturbances).under(corner.centre[X], corner.centre[Y], car.q[Z])
    normal = over_road(car.q).T @ road.normal
    angular, linear = car.u[RATES], car.u[VELOCITY]
    travelling = hub.subspace * car.u[TRAVEL][corner.index]
    turning = angular + travelling[spatial.ANGULAR]
    velocity = linear + ca.cross(angular, hub.centre) + travelling[spatial.LINEAR]
    touch = contact(
        a,
        a.unloaded_radius * (1 + car.disturbances[RADIUS_ERROR]),
        hub.centre,
        hub.axle,
        normal,
        road.height,
        lambda point: velocity + ca.cross(turning, point - hub.centre),
    )
    rolling_speed = touch.effective_radius * car.u[SPIN][corner.index]
    motion = tyre_motion(effects, corner, touch, rolling_speed)
    return TyreContact(touch, forces_of_tyre(car, effects, corner, motion), rolling_speed)


def tyre_motion(
    effects: PresentEffects, corner: Corner, touch: Contact, rolling_speed: ca.SX, lagging: bool = True
) -> ca.SX:
    """A column of `Car.tyre_motions`, or of `Car.steady_tyre_motions` for a tyre that is not `lagging`, (5,)."""
    speed_y = touch.speed_y * corner.axle.cornering_scale
    if lagging:
        speed_y = effects.lateral_speed(speed_y, corner)
    rolling = rolling_speed + (corner.axle.longitudinal_scale - 1) * (rolling_speed - touch.speed_x)
    return ca.vertcat(touch.load, touch.speed_x, speed_y, rolling, touch.inclination)


def forces_of_tyre(car: MovingCar, effects: PresentEffects, corner: Corner, motion: ca.SX) -> TyreForces:
    """Forces and slips of a tyre with a `motion` as `tyre_motion` gives it."""
    load, speed_x, speed_y, rolling_speed, inclination = ca.vertsplit(motion)
    friction = ca.SX(car.parameters.road.friction * corner.axle.grip_scale)
    friction = effects.friction(friction, corner, load)
    thrust = _slip_of_thrust(effects, corner, load, inclination)
    speed_y -= thrust * transport_speed(speed_x, corner.axle.tyre.standstill_speed)
    wheel = TyreInput(load, speed_x, speed_y, rolling_speed, friction, inclination, corner.side)
    forces = corner.axle.tyre.forces(wheel)
    return forces._replace(lateral_slip=forces.lateral_slip - thrust)


def _slip_of_thrust(effects: PresentEffects, corner: Corner, load: ca.SX, inclination: ca.SX) -> ca.SX:
    """Lateral slip that would make the force which a tyre makes without any [-]: as such it fades where slip uses
    the grip (Pacejka 2012, chapter 4: ply steer and conicity shift the slip angle)."""
    thrust = effects.thrust(ca.SX(0), corner, load, inclination)
    if thrust.is_zero():
        return thrust
    stiffness = corner.axle.tyre.cornering_stiffness_at(load)
    return thrust / ca.fmax(stiffness, LEAST_STIFFNESS)


def wheel_outputs(tyre: TyreForces, touch: Contact) -> ca.SX:
    """A column of `Car.wheel_outputs`, (7,)."""
    return ca.vertcat(
        tyre.longitudinal,
        tyre.lateral,
        touch.load,
        tyre.aligning_moment,
        tyre.longitudinal_slip,
        ca.atan(-tyre.lateral_slip),
        touch.inclination,
    )
