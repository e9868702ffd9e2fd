"""The bodies of a car as a tree: a chassis, and at each corner a hub and a wheel."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.car.present_effects import PresentEffects
from vsense_ros.model.car.suspension import HubMotion
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.moving_car import Corner
from vsense_ros.model.multibody.tree import Body, Tree
from vsense_ros.model.schema.physics import Chassis


def tree_of(
    chassis: Chassis,
    effects: PresentEffects,
    corners: Sequence[Corner],
    hubs: Sequence[HubMotion],
    wheel_inertias: Sequence[ca.SX],
    travel_rates: ca.SX,
) -> Tree:
    """The tree of a car whose wheels have these inertias (3×3) in the axes of the chassis.

    Hubs are points, wheels bodies of revolution. Their frames have their origins in the wheel centres and, at this
    instant, the axes of the chassis; nothing depends on the spin angle. Hub and wheel share that point, so the hub
    carries the mass of both: the equations are the same, and shorter.
    """
    # The file gives mass, centre and inertia of the whole car; subtracting hubs and wheels leaves the chassis.
    sprung = ca.SX(chassis.mass)
    first_moment = ca.SX.zeros(3)
    inertia = ca.diag(ca.vertcat(ca.SX(chassis.roll_inertia), chassis.pitch_inertia, chassis.yaw_inertia))
    bodies: list[Body] = []
    unturned, at_origin = ca.SX.eye(3), ca.SX(3, 1)
    for corner, hub, wheel_inertia in zip(corners, hubs, wheel_inertias, strict=True):
        a = corner.axle
        mass = a.hub_mass + a.wheel_mass
        sprung = sprung - mass
        first_moment = first_moment - mass * corner.centre
        offset = spatial.skew(corner.centre)
        across, along = a.wheel_diametral_inertia, a.wheel_spin_inertia
        inertia = inertia + mass * (offset @ offset) - ca.diag(ca.vertcat(ca.SX(across), along, across))
        point = spatial.rigid_inertia(mass, at_origin, ca.SX(3, 3))
        disc = ca.diagcat(wheel_inertia, ca.SX(3, 3))
        name, spin = WHEELS[corner.index], ca.vertcat(hub.axle, at_origin)
        axis_rate = hub.bend * travel_rates[corner.index]
        bodies.append(Body(f"hub_{name}", -1, hub.subspace, unturned, hub.centre, point, axis_rate))
        bodies.append(Body(f"wheel_{name}", len(bodies) - 1, spin, unturned, at_origin, disc))
    sprung, first_moment, inertia = effects.chassis(sprung, first_moment, inertia)
    centre = first_moment / sprung
    offset = spatial.skew(centre)
    inertia = inertia + sprung * (offset @ offset)  # from about cog to about the chassis's own centre
    return Tree(spatial.rigid_inertia(sprung, centre, inertia), tuple(bodies))


def wheel_inertia(corner: Corner, hub: HubMotion) -> ca.SX:
    """Inertia of a wheel about its centre in the axes of the chassis, 3×3 [kg m²]."""
    across, along = corner.axle.wheel_diametral_inertia, corner.axle.wheel_spin_inertia
    return across * ca.SX.eye(3) + (along - across) * hub.axle @ hub.axle.T
