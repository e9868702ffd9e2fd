"""The 14-degree-of-freedom car: a chassis, four wheels that travel on guided hubs, and their spins.

Coordinates `q` (14): position of `cog` in the map [m], roll, pitch, yaw [rad], suspension compressions fl, fr, rl, rr
[m], spin angles of the wheels [rad]. Velocities `u` (14): velocity of `cog` in body axes [m/s], body rates [rad/s],
compression rates [m/s], spin speeds [rad/s]. `cog` is the centre of gravity in the design position, standing on level
ground.

Nine bodies: the sprung mass, four hubs on guided joints and four wheels on revolute joints, in relative coordinates
(the simplified vehicle of Rodríguez 2020). Hubs move as the suspension tables of the vehicle file say, where it has
them: their travel is then the height of the wheel centre over its design position, and tables take the place of roll
centres and Ackermann. Without tables they travel on straight guides, inclined in the lateral plane such that each axle
has the roll centre that the file gives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from vsense_ros.model import spatial
from vsense_ros.model.car.contact import Contact, contact
from vsense_ros.model.car.road import Road, over_road, turning
from vsense_ros.model.car.suspension import (
    Coefficients,
    HubMotion,
    coefficients,
    coefficients_in_one_form,
    straight_guide,
    table_guide,
)
from vsense_ros.model.constants import AIR_DENSITY, GRAVITY
from vsense_ros.model.coordinates import (
    BANK,
    COORDINATES,
    DISTURBANCES,
    GRADE,
    INPUTS,
    PITCH,
    PITCH_RATE,
    RADIUS_ERROR,
    RATES,
    ROAD_HEIGHT,
    ROLL,
    ROLL_RATE,
    SPEED_X,
    SPEED_Y,
    SPIN,
    STEERING,
    STEERING_OFFSET,
    TORQUES,
    TRAVEL,
    VELOCITY,
    WHEELS,
    YAW,
    YAW_RATE,
    X,
    Y,
    Z,
)
from vsense_ros.model.motion import Motion
from vsense_ros.model.multibody.tree import Body, Tree
from vsense_ros.model.parameter import Scalar, numbers, symbols
from vsense_ros.model.tyres import TyreForces, TyreInput
from vsense_ros.model.tyres.slip import transport_speed
from vsense_ros.model.vehicle import Axle, Vehicle

STIFFENING = 1.5  # slope that time steps assume, over the tyre's steepest: without a margin remnants of slip stay
REACTING = (2.0, 1.0)  # speeds of sliding where time steps begin to stiffen a car with its wheel, and do so fully [m/s]
STEADY = (0.25, 0.5)  # speeds of sliding where time steps begin to foresee how a car goes on, and do so fully [m/s]
# Of each wheel its side, 1 on the left and -1 on the right; of each axle whether it is steered; of each axle 1 ahead of
# `cog` and -1 behind it. Besides values of parameters, nothing else differs between the equations of the corners.
PLACEMENT = (1.0, -1.0, 1.0, -1.0, 1.0, 0.0, 1.0, -1.0)
LEAST_STIFFNESS = 1.0  # [N/rad] of a tyre that has left the road


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


@dataclass(frozen=True, eq=False)
class Corner:
    """What does not move of a corner."""

    index: int
    axle: Axle  # with symbols in place of its numbers
    side: ca.SX  # 1 on the left, -1 on the right
    centre: ca.SX  # of the wheel in the design position (3×1) [m]
    static_load: Scalar  # [N]
    loaded_radius: Scalar  # under that load [m]

    @property
    def front(self) -> bool:
        return self.index < 2

    @property
    def opposite(self) -> int:
        """The other wheel of the axle."""
        return self.index ^ 1


@dataclass(frozen=True, eq=False)
class TyreContact:
    """Where a tyre touches the road, and what the road does to it."""

    touch: Contact
    tyre: TyreForces
    rolling_speed: ca.SX


class Car:
    """Symbolic equations of motion of a vehicle's *structure*; the values of its parameters stay symbols.

    Two vehicles with the same kinds of tyres, the same suspension tables and the same effects share one `Car`, and so
    its compiled code. `internal_state` holds those of the effects that depend on the past: a time step leaves it as it
    is, `next_internal_state` moves it on between steps. With `corners_alike` the corners have the same equations, down
    to each operation: what they differ in are then symbols, `placement`, that stand for the numbers `placed`.
    """

    def __init__(self, vehicle: Vehicle, corners_alike: bool = False) -> None:
        self._vehicle = vehicle
        self._tables = vehicle.suspension
        self._coefficients: dict[str, Coefficients] = {}
        self.placed: tuple[float, ...] = PLACEMENT  # what `placement` stands for
        self.placement = ca.SX(ca.DM(PLACEMENT))
        if self._tables is not None:
            self._coefficients = {axle: coefficients(self._tables, axle) for axle in ("front", "rear")}
        if corners_alike:
            self._make_corners_alike()
        self.parameter_names = tuple(name for name, _ in numbers(vehicle.physics))
        self.p, self.parameters = symbols(vehicle.physics)
        self.q: ca.SX = ca.SX.sym("q", COORDINATES)
        self.u: ca.SX = ca.SX.sym("u", COORDINATES)
        self.force = ca.SX.sym("force", COORDINATES)  # generalized forces beyond the model's
        self.disturbances = ca.SX.sym("disturbances", len(DISTURBANCES))
        self.inputs: ca.SX = ca.SX.sym("inputs", len(INPUTS))
        self._effects = present = self.parameters.effects.present()
        self.internal_state = ca.SX.sym("internal_state", sum(len(effect.internal_state) for effect in present))
        ends = np.cumsum([len(effect.internal_state) for effect in present]).tolist()
        self._internal_states = tuple(
            self.internal_state[end - len(effect.internal_state) : end]
            for effect, end in zip(present, ends, strict=True)
        )

    def _make_corners_alike(self) -> None:
        """Symbols take the place of what the corners differ in."""
        symbols: list[ca.SX] = []

        def symbol(value: float) -> ca.SX:
            self.placed += (value,)
            symbols.append(ca.SX.sym("placement"))
            return symbols[-1]

        self.placed = ()
        for value in PLACEMENT:
            symbol(value)
        if self._tables is not None:
            self._coefficients = coefficients_in_one_form(self._tables, symbol)
        self.placement = ca.vertcat(*symbols)

    @cached_property
    def corners_alike(self) -> Car:
        """The same car, with corners that have the same equations down to each operation."""
        return Car(self._vehicle, corners_alike=True)

    @property
    def internal_state_slices(self) -> dict[str, slice]:
        """Where in `internal_state` the part of each effect is that has one, by id."""
        found, first = {}, 0
        for effect in (effect for effect in self._effects if effect.internal_state):
            found[effect.id] = slice(first, first := first + len(effect.internal_state))
        return found

    @cached_property
    def _wheelbase(self) -> Scalar:
        return self.parameters.chassis.cog_to_front_axle + self.parameters.chassis.cog_to_rear_axle

    @cached_property
    def corners(self) -> tuple[Corner, ...]:
        """fl, fr, rl, rr."""
        chassis = self.parameters.chassis
        weight = chassis.mass * GRAVITY
        corners = []
        for i in range(len(WHEELS)):
            front, side, ahead = i < 2, self.placement[i], self.placement[6 + i // 2]
            axle = self.parameters.front if front else self.parameters.rear
            arm = ahead * (chassis.cog_to_front_axle if front else chassis.cog_to_rear_axle)
            other = chassis.cog_to_rear_axle if front else chassis.cog_to_front_axle
            static_load = weight * other / self._wheelbase / 2
            loaded_radius = axle.unloaded_radius - static_load / axle.tyre_stiffness
            centre = ca.vertcat(arm, side * axle.track / 2, loaded_radius - chassis.cog_height)
            for effect in self._effects:
                axle = effect.wheel(i, axle)
            corners.append(Corner(i, axle, side, centre, static_load, loaded_radius))
        return tuple(corners)

    @cached_property
    def _road_wheel_angle(self) -> ca.SX:
        """Mean of both front wheels [rad]."""
        angle = self.inputs[STEERING] - self.disturbances[STEERING_OFFSET]
        for effect, state in zip(self._effects, self._internal_states, strict=True):
            angle = effect.front_angle(angle, self, state)
        return angle

    def _toed(self, corner: Corner, hub: HubMotion) -> HubMotion:
        """A hub with its axle turned about the vertical by what the effects do to it."""
        toe = ca.SX(0)
        for effect, state in zip(self._effects, self._internal_states, strict=True):
            toe = effect.toe(toe, corner, self, state)
        return hub if toe.is_zero() else replace(hub, axle=spatial.rotation_z(toe) @ hub.axle)

    def _steered(self, corner: Corner, angle: ca.SX) -> ca.SX:
        """Angle of a wheel on a straight guide for a mean `angle` of the front wheels [rad]: from parallel to full
        Ackermann."""
        steered = self.placement[4 + corner.index // 2]
        if steered.is_zero():
            return ca.SX(0)
        angle = steered * angle
        share, tangent = self.parameters.steering.ackermann, ca.tan(angle)
        turning = ca.atan2(self._wheelbase * tangent, self._wheelbase - corner.side * corner.axle.track / 2 * tangent)
        return (1 - share) * angle + share * turning

    def _guide(self, corner: Corner, travel: ca.SX, angle: ca.SX) -> HubMotion:
        """How the hub moves at a `travel` [m] and a mean `angle` of the front wheels [rad]."""
        if self._tables is not None:
            axle = "front" if corner.front else "rear"
            return table_guide(self._tables, self._coefficients[axle], corner.side, corner.centre, travel, angle)
        # A wheel whose contact point moves along this line has its lateral force act at the roll centre.
        slope = 2 * corner.axle.roll_centre_height / corner.axle.track
        direction = ca.vertcat(0, ca.SX(corner.side * slope), 1) / ca.sqrt(1 + slope**2)
        return straight_guide(corner.centre, direction, travel, self._steered(corner, angle))

    @cached_property
    def _hubs(self) -> list[HubMotion]:
        angle = self._road_wheel_angle
        return [self._toed(c, self._guide(c, self.q[TRAVEL][c.index], angle)) for c in self.corners]

    @cached_property
    def _tree(self) -> Tree:
        """Hubs are points, wheels bodies of revolution. Their frames have their origins in the wheel centres and, at
        this instant, the axes of the chassis; nothing depends on the spin angle. Hub and wheel share that point, so the
        hub carries the mass of both: the equations are the same, and shorter."""
        chassis = self.parameters.chassis
        # The file gives mass, centre and inertia of the whole car; the chassis is what is left without hubs and wheels.
        sprung = ca.SX(chassis.mass)
        first_moment = ca.SX.zeros(3)
        inertia = ca.diag(ca.vertcat(ca.SX(chassis.roll_inertia), chassis.pitch_inertia, chassis.yaw_inertia))
        bodies: list[Body] = []
        unturned, here = ca.SX.eye(3), ca.SX(3, 1)
        for corner, hub in zip(self.corners, self._hubs, strict=True):
            a = corner.axle
            mass = a.hub_mass + a.wheel_mass
            sprung = sprung - mass
            first_moment = first_moment - mass * corner.centre
            offset = spatial.skew(corner.centre)
            across, along = a.wheel_diametral_inertia, a.wheel_spin_inertia
            inertia = inertia + mass * (offset @ offset) - ca.diag(ca.vertcat(ca.SX(across), along, across))
            point = spatial.rigid_inertia(mass, here, ca.SX(3, 3))
            disc = ca.diagcat(self._wheel_inertia(corner, hub), ca.SX(3, 3))
            name, spin = WHEELS[corner.index], ca.vertcat(hub.axle, here)
            axis_rate = hub.bend * self.u[TRAVEL][corner.index]
            bodies.append(Body(f"hub_{name}", -1, hub.subspace, unturned, hub.centre, point, axis_rate))
            bodies.append(Body(f"wheel_{name}", len(bodies) - 1, spin, unturned, here, disc))
        for effect in self._effects:
            sprung, first_moment, inertia = effect.chassis(sprung, first_moment, inertia)
        centre = first_moment / sprung
        offset = spatial.skew(centre)
        inertia = inertia + sprung * (offset @ offset)  # from about cog to about the chassis's own centre
        return Tree(spatial.rigid_inertia(sprung, centre, inertia), tuple(bodies))

    def _wheel_inertia(self, corner: Corner, hub: HubMotion) -> ca.SX:
        """Inertia of a wheel about its centre in the axes of the chassis, 3×3."""
        across, along = corner.axle.wheel_diametral_inertia, corner.axle.wheel_spin_inertia
        return across * ca.SX.eye(3) + (along - across) * hub.axle @ hub.axle.T

    @cached_property
    def root_velocity(self) -> ca.SX:
        """Spatial velocity of the chassis `[ω; v]`, 6×1."""
        return ca.vertcat(self.u[RATES], self.u[VELOCITY])

    @cached_property
    def _rates(self) -> ca.SX:
        """Joint rates."""
        return _by_corner(self.u[TRAVEL], self.u[SPIN])

    @cached_property
    def contacts(self) -> list[TyreContact]:
        """Of the wheels fl, fr, rl, rr."""
        return [self._contact(corner, hub) for corner, hub in zip(self.corners, self._hubs, strict=True)]

    def _contact(self, corner: Corner, hub: HubMotion) -> TyreContact:
        """Where a tyre touches the road, and the forces there."""
        a = corner.axle
        # Where the wheel stands in the design position: what it moves by changes little on a surface that bends little.
        road = Road(self.disturbances).under(corner.centre[X], corner.centre[Y], self.q[Z])
        normal = over_road(self.q).T @ road.normal
        angular, linear = self.u[RATES], self.u[VELOCITY]
        travelling = hub.subspace * self.u[TRAVEL][corner.index]
        turning = angular + travelling[spatial.ANGULAR]
        velocity = linear + ca.cross(angular, hub.centre) + travelling[spatial.LINEAR]
        touch = contact(
            a,
            a.unloaded_radius * (1 + self.disturbances[RADIUS_ERROR]),
            hub.centre,
            hub.axle,
            normal,
            road.height,
            lambda point: velocity + ca.cross(turning, point - hub.centre),
        )
        rolling_speed = touch.effective_radius * self.u[SPIN][corner.index]
        motion = self._tyre_motion(corner, touch, rolling_speed)
        return TyreContact(touch, self._tyre(corner, motion), rolling_speed)

    def _tyre_motion(self, corner: Corner, touch: Contact, rolling_speed: ca.SX, lagging: bool = True) -> ca.SX:
        """A column of `tyre_motions`."""
        speed_y = touch.speed_y * corner.axle.cornering_scale
        if lagging:
            for effect, state in zip(self._effects, self._internal_states, strict=True):
                speed_y = effect.lateral_speed(speed_y, corner, state)
        rolling = rolling_speed + (corner.axle.longitudinal_scale - 1) * (rolling_speed - touch.speed_x)
        return ca.vertcat(touch.load, touch.speed_x, speed_y, rolling, touch.inclination)

    def _tyre(self, corner: Corner, motion: ca.SX) -> TyreForces:
        """Forces and slips of a tyre by a column of `tyre_motions`."""
        load, speed_x, speed_y, rolling_speed, inclination = ca.vertsplit(motion)
        friction = ca.SX(self.parameters.road.friction * corner.axle.grip_scale)
        for effect, state in zip(self._effects, self._internal_states, strict=True):
            friction = effect.friction(friction, corner, load, state)
        thrust = self._slip_of_thrust(corner, load, inclination)
        speed_y -= thrust * transport_speed(speed_x, corner.axle.tyre.standstill_speed)
        wheel = TyreInput(load, speed_x, speed_y, rolling_speed, friction, inclination, corner.side)
        found = corner.axle.tyre.forces(wheel)
        return found._replace(lateral_slip=found.lateral_slip - thrust)

    def _slip_of_thrust(self, corner: Corner, load: ca.SX, inclination: ca.SX) -> ca.SX:
        """Lateral slip that would make the force which a tyre makes without any [-]: as such it fades where slip uses
        the grip (Pacejka 2012, chapter 4: ply steer and conicity shift the slip angle)."""
        thrust = ca.SX(0)
        for effect in self._effects:
            thrust = effect.thrust(thrust, corner, load, inclination)
        if thrust.is_zero():
            return thrust
        stiffness = corner.axle.tyre.cornering_stiffness_at(load)
        return thrust / ca.fmax(stiffness, LEAST_STIFFNESS)

    def _suspension_force(self, corner: Corner, hub: HubMotion) -> ca.SX:
        """Generalized force of spring, damper and anti-roll bar on the travel [N], positive in bump."""
        a, i = corner.axle, corner.index
        design = self._guide(corner, ca.SX(0), ca.SX(0))
        upward = ca.cross(ca.SX([1, 0, 0]), design.axle)
        lift = design.subspace[5] + ca.cross(design.subspace[:3], -corner.loaded_radius * upward)[2]
        # In the design position the spring carries what the load on the contact point leaves of the weight of the hub.
        preload = corner.static_load * lift - (a.hub_mass + a.wheel_mass) * GRAVITY * design.subspace[5]
        spring = preload / design.spring_ratio + a.suspension_stiffness * hub.spring
        damper = a.suspension_damping * hub.spring_ratio * self.u[TRAVEL][i]
        bar = a.antiroll_stiffness * (self.q[TRAVEL][i] - self.q[TRAVEL][corner.opposite])
        resistance = (spring + damper) * hub.spring_ratio + bar
        for effect in self._effects:
            resistance = effect.suspension_force(resistance, corner, self)
        return -resistance

    def _wheel_torque(self, corner: Corner) -> ca.SX:
        """Torque about the axle besides that of the road [N m]."""
        torque = self.inputs[TORQUES][corner.index]
        for effect in self._effects:
            torque = effect.wheel_torque(torque, corner, self)
        return torque

    def _wheel_force(self, corner: Corner, hub: HubMotion, contact: TyreContact) -> ca.SX:
        """What the road does to a wheel: force vector about its centre (6×1)."""
        touch, tyre = contact.touch, contact.tyre
        force = tyre.longitudinal * touch.ahead + tyre.lateral * touch.sideways + touch.load * touch.normal
        resistance = touch.rolling_resistance(corner.axle, contact.rolling_speed)
        moment = tyre.aligning_moment * touch.normal + resistance * hub.axle
        return spatial.force_at(touch.point - hub.centre, force, moment)

    def _chassis_force(self) -> ca.SX:
        """What acts on the chassis besides its suspensions and its weight: force vector about `cog` (6×1)."""
        speed = self.u[SPEED_X]
        drag = -0.5 * AIR_DENSITY * self.parameters.aerodynamics.drag_area * speed * ca.fabs(speed)
        force = ca.vertcat(ca.SX(3, 1), drag, ca.SX(2, 1))
        for effect, state in zip(self._effects, self._internal_states, strict=True):
            force = effect.chassis_force(force, self, state)
        return force

    def _loads(self, contacts: Sequence[TyreContact]) -> tuple[ca.SX, ca.SX, list[ca.SX]]:
        """Joint efforts, force on the chassis, forces on hubs and wheels: what the tree is moved by."""
        forces: list[ca.SX] = []
        efforts: list[ca.SX] = []
        for corner, hub, tyre in zip(self.corners, self._hubs, contacts, strict=True):
            i = corner.index
            forces += [ca.SX(6, 1), self._wheel_force(corner, hub, tyre)]
            efforts += [
                self._suspension_force(corner, hub) + self.force[TRAVEL][i],
                self._wheel_torque(corner) + self.force[SPIN][i],
            ]
        chassis = self._chassis_force() + ca.vertcat(self.force[RATES], self.force[VELOCITY])
        return ca.vertcat(*efforts), chassis, forces

    @cached_property
    def dynamics(self) -> ca.SX:
        """Derivatives of `u` (14): a function of q, u, force, disturbances, inputs and p."""
        root, joints = self._tree.forward_dynamics(self.root_velocity, self._rates, *self._loads(self.contacts))
        # A uniform field accelerates the whole tree alike, so gravity need not be applied body by body.
        linear = root[spatial.LINEAR] + gravity_in_body(self.q, self.disturbances)
        return _by_coordinate(ca.vertcat(root[spatial.ANGULAR], linear), joints)

    def missing_force(self, acceleration: ca.SX, tyre_forces: ca.SX) -> ca.SX:
        """Generalized force (14) that the derivatives `acceleration` (14) of `u` need beyond what acts, if each tyre's
        longitudinal, lateral and vertical force and its moment are the columns of `tyre_forces` (4×4)."""
        given = [
            replace(
                contact,
                touch=replace(contact.touch, load=tyre_forces[2, i]),
                tyre=contact.tyre._replace(
                    longitudinal=tyre_forces[0, i], lateral=tyre_forces[1, i], aligning_moment=tyre_forces[3, i]
                ),
            )
            for i, contact in enumerate(self.contacts)
        ]
        efforts, chassis, forces = self._loads(given)
        linear = acceleration[VELOCITY] - gravity_in_body(self.q, self.disturbances)
        root, joints = self._tree.inverse_dynamics(
            self.root_velocity,
            self._rates,
            ca.vertcat(acceleration[RATES], linear),
            _by_corner(acceleration[TRAVEL], acceleration[SPIN]),
            chassis,
            forces,
        )
        return _by_coordinate(root, joints - efforts)

    @cached_property
    def tyre_motions(self) -> ca.SX:
        """What each tyre's forces depend on: load, speeds x and y, rolling speed, inclination; 5×4."""
        return self._tyre_motions(lagging=True)

    @cached_property
    def steady_tyre_motions(self) -> ca.SX:
        """`tyre_motions` without the lag of tyres behind their slip, which within one step would hide how the slip
        acts on the car in many; 5×4."""
        return self._tyre_motions(lagging=False)

    def _tyre_motions(self, lagging: bool) -> ca.SX:
        pairs = zip(self.corners, self.contacts, strict=True)
        return ca.horzcat(*(self._tyre_motion(c, t.touch, t.rolling_speed, lagging) for c, t in pairs))

    def tyre_forces(self, motions: ca.SX) -> ca.SX:
        """Longitudinal, lateral and vertical force and moment of each tyre by `tyre_motions` (5×4); 4×4."""
        columns = []
        for corner in self.corners:
            found = self._tyre(corner, motions[:, corner.index])
            load = motions[0, corner.index]
            columns.append(ca.vertcat(found.longitudinal, found.lateral, load, found.aligning_moment))
        return ca.horzcat(*columns)

    @cached_property
    def stiffening(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """What a time step adds to the Jacobian of the dynamics by u, as a product of 14×4 and 4×14, and which part
        of the latter it applies to the rates at the beginning of the step instead, 4×14.

        Wheels are light and tyres steep: below 10 m/s slip changes faster than any affordable step. Where a tyre
        slides, the tangent to its flat force curve says nothing of the steep slope at zero slip that the step will come
        across, and the wheel would be thrown to and fro between the two for ever. With a slope steeper than the curve
        has anywhere, sliding goes down with each step.

        Of a wheel that sticks, or soon will, the additional force acts on wheel and car alike, here a rigid body in the
        plane, so that it takes no momentum from nowhere. Of one that slides on it acts on the wheel alone: sliding
        changes at the rate at which the car slows down, and a force that grew with this rate, which no tyre has, would
        push a car forward that brakes on locked wheels. Of a wheel in between, slower than both, the rate that the car
        has at the beginning of the step causes no such force, but what the step departs from it does.
        """
        chassis = self.parameters.chassis
        responses, slopes, foreseen = [], [], []
        for corner, wheel in zip(self.corners, self.contacts, strict=True):
            touch, spin = wheel.touch, SPIN.start + corner.index
            transport = transport_speed(wheel.rolling_speed, corner.axle.tyre.standstill_speed)
            steepest = corner.axle.tyre.steepest_slope(touch.load) / transport
            tangent = ca.jacobian(wheel.tyre.longitudinal, self.u[spin]) / touch.effective_radius
            excess = ca.fmax(STIFFENING * steepest - tangent, 0)
            sliding = ca.sqrt((wheel.rolling_speed - touch.speed_x) ** 2 + touch.speed_y**2)
            sticks = _within(tangent, 0, steepest)
            share = ca.fmax(sticks, _within(sliding, *REACTING))
            response = ca.SX.zeros(COORDINATES)
            response[SPEED_X : SPEED_Y + 1] = share * touch.ahead[X : Y + 1] / chassis.mass
            response[YAW_RATE] = share * ca.cross(touch.point, touch.ahead)[Z] / chassis.yaw_inertia
            response[spin] = -touch.effective_radius / corner.axle.wheel_spin_inertia
            responses.append(response)
            by_car = -excess * share * ca.jacobian(touch.speed_x, self.u)
            slopes.append(excess * ca.jacobian(wheel.rolling_speed, self.u) + by_car)
            foreseen.append((1 - sticks) * _within(sliding, *STEADY) * by_car)
        return ca.horzcat(*responses), ca.vertcat(*slopes), ca.vertcat(*foreseen)

    def next_internal_state(self, h: ca.SX) -> ca.SX:
        """The internal state for a step of `h` [s] that begins now, from that of the last step."""
        parts = zip(self._effects, self._internal_states, strict=True)
        return ca.vertcat(*(effect.update(state, self, h) for effect, state in parts if effect.internal_state))

    @cached_property
    def wheel_outputs(self) -> ca.SX:
        """Of each wheel fl, fr, rl, rr: force x, y, z [N], aligning moment [N m] in `contact_*`, longitudinal slip,
        slip angle [rad], inclination angle (positive where the top leans to the right, ISO 8855) [rad]; 7×4."""
        return ca.horzcat(*(wheel_outputs(contact.tyre, contact.touch) for contact in self.contacts))

    def inertia_times(self, acceleration: ca.SX) -> ca.SX:
        """Generalized force (14) that belongs to the accelerations `acceleration` (14) at rest: M(q) · acceleration."""
        root = ca.vertcat(acceleration[RATES], acceleration[VELOCITY])
        f = self._tree.inertia_times(root, _by_corner(acceleration[TRAVEL], acceleration[SPIN]))
        return _by_coordinate(f[:6], f[6:])

    @property
    def kinematics(self) -> ca.SX:
        """Derivatives of `q` (14) as a function of q, u and disturbances."""
        return kinematics(self.q, self.u, self.disturbances)


def wheel_outputs(tyre: TyreForces, touch: Contact) -> ca.SX:
    """A column of `Car.wheel_outputs`."""
    return ca.vertcat(
        tyre.longitudinal,
        tyre.lateral,
        touch.load,
        tyre.aligning_moment,
        tyre.longitudinal_slip,
        ca.atan(-tyre.lateral_slip),
        touch.inclination,
    )


def _by_corner(travel: ca.SX, spin: ca.SX) -> ca.SX:
    """In the order of the tree: hub, wheel, hub, wheel …"""
    return ca.vec(ca.horzcat(travel, spin).T)


def _by_coordinate(root: ca.SX, joints: ca.SX) -> ca.SX:
    """In the order of the velocities, from a spatial vector of the chassis and the joints in the order of the tree."""
    return ca.vertcat(root[spatial.LINEAR], root[spatial.ANGULAR], joints[0::2], joints[1::2])


def _within(value: ca.SX, none: ca.SX | float, full: ca.SX | float) -> ca.SX:
    """0 before `none`, 1 beyond `full`, linear in between."""
    return ca.fmin(ca.fmax((value - none) / (full - none), 0), 1)


def kinematics(q: ca.SX, u: ca.SX, disturbances: ca.SX) -> ca.SX:
    """Derivatives of the coordinates (14): x, y and yaw on the map, z, roll and pitch over the road, which turns as the
    car moves on; z-y-x angles, singular at a pitch of 90°."""
    road, (velocity, turn, rates) = Road(disturbances), _over_road(q, u, disturbances)
    heading = ca.vertcat(ca.cos(q[YAW]), ca.sin(q[YAW]))
    ahead, aside, _ = ca.vertsplit(road.to_level @ velocity)
    east, north = heading[0] * ahead - heading[1] * aside, heading[1] * ahead + heading[0] * aside
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


_CARS: dict[tuple[object, ...], Car] = {}


def car_of(vehicle: Vehicle) -> Car:
    """The `Car` for a vehicle's structure; built once per process, whatever the values of the parameters."""
    physics = vehicle.physics
    structure = (
        physics.front.tyre.model,
        physics.rear.tyre.model,
        vehicle.suspension,
        *(name for name, _ in numbers(physics)),
    )
    if structure not in _CARS:
        _CARS[structure] = Car(vehicle)
    return _CARS[structure]
