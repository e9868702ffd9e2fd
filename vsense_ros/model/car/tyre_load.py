"""The force of the road on a wheel of the car with all its bodies, and its derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.car.tyre_contacts import wheel_outputs
from vsense_ros.model.contact import Contact, contact
from vsense_ros.model.multibody.mechanism import BodyState
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.schema.physics import Axle
from vsense_ros.model.tyres import TyreForces, TyreInput


class TyreLoad:
    """What a tyre does to its wheel, as a function of the motion of the wheel.

    `axle` holds symbols in place of its numbers, `centre` is that of the wheel in its own axes (3,), `side` 1 on the
    left and -1 on the right, `friction` that of the road; `road` is the road where the wheel stands, in road axes: by
    how much its tangent plane passes below the point under `cog` [m], and its slopes along and across [-].
    """

    def __init__(self, axle: Axle, centre: ca.SX, side: Scalar, friction: Scalar, road: Sequence[ca.SX]) -> None:
        self._axle, self._centre, self._side, self._friction, self._road = axle, centre, side, friction, road

    def __call__(self, state: BodyState) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Tyre on the tangent plane of the road below it: force vector, its main derivatives, `WHEEL_OUTPUTS`."""
        a = self._axle
        normal, height = self._road_under(state.up, state.height)
        centre = state.origin + state.rotation @ self._centre
        axle = state.rotation[:, 1]
        spin = ca.vertcat(axle, ca.cross(centre, axle))
        carrier = state.velocity - spin * state.rate
        touch = contact(
            a,
            a.unloaded_radius,
            centre,
            axle,
            normal,
            height,
            lambda point: carrier[3:] + ca.cross(carrier[:3], point),
        )
        slips = ca.SX.sym("slips", 4)  # load, speed x, speed y, rolling speed
        camber = ca.SX.sym("camber")
        forces_by_slips = a.tyre.forces(
            TyreInput(
                load=slips[0],
                speed_x=slips[1],
                speed_y=slips[2] * a.cornering_scale,
                rolling_speed=slips[3] + (a.longitudinal_scale - 1) * (slips[3] - slips[1]),
                friction=self._friction * a.grip_scale,
                camber=camber,
                side=self._side,
            )
        )
        result = ca.vertcat(*forces_by_slips)
        parameters = ca.vertcat(*(s for s in ca.symvar(result) if not ca.depends_on(ca.vertcat(slips, camber), s)))
        tyre = ca.Function("tyre", [slips, camber, parameters], [result, ca.jacobian(result[:3], slips)])
        rolling = touch.effective_radius * state.rate
        present_slips = ca.vertcat(touch.load, touch.speed_x, touch.speed_y, rolling)
        values, slopes = tyre(present_slips, touch.inclination, parameters)
        forces = TyreForces(*ca.vertsplit(values))
        force = forces.longitudinal * touch.ahead + forces.lateral * touch.sideways + touch.load * touch.normal
        moment = forces.aligning_moment * touch.normal + touch.rolling_resistance(a, rolling) * axle
        wrench = spatial.force_at(touch.point, force, moment)
        by_velocity, by_place = _tangents(a, touch, centre, axle, slopes)
        return wrench, by_velocity, by_place, wheel_outputs(forces, touch)

    def _road_under(self, up: ca.SX, height: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Normal of the road below the wheel (3), in the axes of the chassis, in which `up` is that below `cog`, and
        how high `cog` is over the tangent plane there [m]."""
        rise, slope_x, slope_y = self._road
        level = ca.sqrt(1 - up[0] ** 2)
        ahead = ca.vertcat(level, -up[0] * up[1] / level, -up[0] * up[2] / level)
        steepness = ca.sqrt(1 + slope_x**2 + slope_y**2)
        normal = (up - slope_x * ahead - slope_y * ca.cross(up, ahead)) / steepness
        return normal, (height + rise) / steepness


def _tangents(a: Axle, touch: Contact, centre: ca.SX, axle: ca.SX, slopes: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Derivatives (6×6) of a tyre's force vector by the velocity and by a small displacement of its wheel."""

    def row(direction: ca.SX) -> ca.SX:
        """Velocity of the contact point in a direction, per velocity of the wheel without its spin (1×6)."""
        spin = ca.dot(direction, ca.cross(axle, touch.point - centre))
        return ca.horzcat(ca.cross(touch.point, direction).T - spin * axle.T, direction.T)

    lifting = row(touch.normal)
    rolling = ca.horzcat(touch.effective_radius * axle.T, ca.SX(1, 3))
    pressed = ca.if_else(touch.load > 0, 1, 0)
    by_speeds = ca.vertcat(-pressed * a.tyre_damping * lifting, row(touch.ahead), row(touch.sideways), rolling)
    by_lift = -pressed * a.tyre_stiffness * lifting
    forces = ca.horzcat(
        spatial.force_at(touch.point, touch.ahead, ca.SX(3, 1)),
        spatial.force_at(touch.point, touch.sideways, ca.SX(3, 1)),
        ca.vertcat(touch.normal, ca.SX(3, 1)),
    )
    normal = spatial.force_at(touch.point, touch.normal, ca.SX(3, 1))
    by_velocity = forces @ (slopes @ by_speeds) + normal @ by_speeds[0, :]
    by_place = forces @ (slopes[:, 0] @ by_lift) + normal @ by_lift
    return by_velocity, by_place
