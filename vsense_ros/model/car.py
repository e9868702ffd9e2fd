"""The 14-degree-of-freedom car: a chassis, four wheels that travel on straight guides, and their spins.

Coordinates `q` (14): position of `cog` in the map [m], roll, pitch, yaw [rad], suspension compressions fl, fr, rl, rr
[m], spin angles of the wheels [rad]. Velocities `u` (14): velocity of `cog` in body axes [m/s], body rates [rad/s],
compression rates [m/s], spin speeds [rad/s]. `cog` is the centre of gravity in the design position, standing on level
ground.

Nine bodies: the sprung mass, four hubs on prismatic joints and four wheels on revolute joints, in relative coordinates
(the simplified vehicle of Rodríguez 2020 with the kinematic table of a straight guide). The guides are inclined in the
lateral plane such that each axle has the roll centre that the vehicle file gives.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace

import casadi as ca

from vsense_ros.model import spatial
from vsense_ros.model.parameter import numbers, symbols
from vsense_ros.model.tree import Body, Tree
from vsense_ros.model.tyres import FORCES, STEEPEST_SLOPES
from vsense_ros.model.vehicle import Vehicle

GRAVITY = 9.80665  # [m/s²] standard acceleration of free fall
STIFFENING = 1.5  # slope that time steps assume, over the tyre's steepest: without a margin remnants of slip stay
AIR_DENSITY = 1.204  # [kg/m³] at 20 °C and 1013 hPa

WHEELS = ("fl", "fr", "rl", "rr")
COORDINATES = 14
X, Y, Z, ROLL, PITCH, YAW = range(6)
TRAVEL = slice(6, 10)
SPIN = slice(10, 14)

# Inputs of the dynamics: road-wheel angle [rad], its slow error is a bias, and wheel torques, drive minus brake [N m].
INPUTS = ("steering", "torque_fl", "torque_fr", "torque_rl", "torque_rr")

# Slowly varying quantities that enter the dynamics: slope of the road along and across the car (positive uphill, and
# positive where the left side is higher) [rad], offset of the measured road-wheel angle [rad], relative error of the
# tyre radius [-].
SURROUNDINGS = ("grade", "bank", "steering_offset", "radius_error")


@dataclass(frozen=True)
class Motion:
    """Symbols of one instant: what the sensor equations may refer to."""

    q: ca.SX  # (14,)
    u: ca.SX  # (14,)
    udot: ca.SX  # (14,) derivatives of u
    surroundings: ca.SX  # (4,)
    inputs: ca.SX  # (5,)

    @property
    def attitude(self) -> ca.SX:
        """Body to map, 3×3."""
        return spatial.rotation_rpy(self.q[ROLL], self.q[PITCH], self.q[YAW])

    @property
    def gravity(self) -> ca.SX:
        """Acceleration of free fall in body axes, 3×1 [m/s²]."""
        return gravity_in_body(self.q, self.surroundings)


def gravity_in_body(q: ca.SX, surroundings: ca.SX) -> ca.SX:
    """Acceleration of free fall in body axes for a car on a sloping road, 3×1 [m/s²]."""
    along, across = ca.sin(surroundings[0]), ca.sin(surroundings[1])
    on_road = -GRAVITY * ca.vertcat(along, across, ca.sqrt(1 - along**2 - across**2))
    return (spatial.rotation_y(q[PITCH]) @ spatial.rotation_x(q[ROLL])).T @ on_road


class Car:
    """Symbolic equations of motion of a vehicle's *structure*; the values of its parameters stay symbols.

    Two vehicles with the same kinds of tyres share one `Car`, and so its compiled code.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.parameter_names = tuple(name for name, _ in numbers(vehicle.physics))
        self.p, self._v = symbols(vehicle.physics)
        self._tyres = (vehicle.physics.front.tyre.model, vehicle.physics.rear.tyre.model)
        self.q = ca.SX.sym("q", COORDINATES)
        self.u = ca.SX.sym("u", COORDINATES)
        self.force = ca.SX.sym("force", COORDINATES)  # generalized forces beyond the model's
        self.surroundings = ca.SX.sym("surroundings", len(SURROUNDINGS))
        self.inputs = ca.SX.sym("inputs", len(INPUTS))

    @cached_property
    def _geometry(self) -> SimpleNamespace:
        v = self._v
        wheelbase = v.chassis.cog_to_front_axle + v.chassis.cog_to_rear_axle
        weight = v.chassis.mass * GRAVITY
        axles = (v.front, v.rear)
        arm = (v.chassis.cog_to_front_axle, -v.chassis.cog_to_rear_axle)
        static = (
            weight * v.chassis.cog_to_rear_axle / wheelbase / 2,
            weight * v.chassis.cog_to_front_axle / wheelbase / 2,
        )
        corners = []
        for i in range(4):
            axle, side = i // 2, 1 - 2 * (i % 2)
            a = axles[axle]
            radius = a.unloaded_radius * (1 + self.surroundings[3])
            loaded = a.unloaded_radius - static[axle] / a.tyre_stiffness
            centre = ca.vertcat(arm[axle], side * a.track / 2, loaded - v.chassis.cog_height)
            # A wheel whose contact point moves along this line has its lateral force act at the roll centre.
            slope = 2 * a.roll_centre_height / a.track
            guide = ca.vertcat(0, side * slope, 1) / ca.sqrt(1 + slope**2)
            corners.append(
                SimpleNamespace(
                    axle=a,
                    side=side,
                    radius=radius,
                    centre=centre,
                    guide=guide,
                    static_load=static[axle],
                    opposite=i + 1 - 2 * (i % 2),
                    front=axle == 0,
                    tyre=FORCES[self._tyres[axle]],
                    steepest_slope=STEEPEST_SLOPES[self._tyres[axle]],
                )
            )
        return SimpleNamespace(wheelbase=wheelbase, corners=corners)

    def _road_wheel_angles(self, angle: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Left and right front wheel for a mean `angle` [rad]: parallel to full Ackermann."""
        share, g = self._v.steering.ackermann, self._geometry
        half = self._v.front.track / 2
        tangent = ca.tan(angle)
        left = ca.atan2(g.wheelbase * tangent, g.wheelbase - half * tangent)
        right = ca.atan2(g.wheelbase * tangent, g.wheelbase + half * tangent)
        return (1 - share) * angle + share * left, (1 - share) * angle + share * right

    @cached_property
    def _tree(self) -> Tree:
        v = self._v
        chassis = v.chassis
        corners = self._geometry.corners
        left, right = self._road_wheel_angles(self.inputs[0] - self.surroundings[2])
        angles = (left, right, ca.SX(0), ca.SX(0))
        # The file gives mass, centre and inertia of the whole car; the chassis is what is left without hubs and wheels.
        sprung = chassis.mass
        first_moment = ca.SX.zeros(3)
        inertia = ca.diag(ca.vertcat(chassis.roll_inertia, chassis.pitch_inertia, chassis.yaw_inertia))
        bodies: list[Body] = []
        zero3 = ca.SX(3, 1)
        for i, corner in enumerate(corners):
            a = corner.axle
            mass = a.hub_mass + a.wheel_mass
            wheel_inertia = ca.diag(
                ca.vertcat(a.wheel_diametral_inertia, a.wheel_spin_inertia, a.wheel_diametral_inertia)
            )
            sprung = sprung - mass
            first_moment = first_moment - mass * corner.centre
            offset = spatial.skew(corner.centre)
            inertia = inertia + mass * (offset @ offset) - wheel_inertia
            hub = Body(
                f"hub_{WHEELS[i]}", -1, ca.vertcat(zero3, corner.guide), ca.SX.eye(3),
                corner.centre + corner.guide * self.q[6 + i], spatial.rigid_inertia(a.hub_mass, zero3, ca.SX(3, 3)),
            )  # fmt: skip
            # The wheel is a body of revolution: its frame steers but does not spin; nothing depends on the spin angle.
            wheel = Body(
                f"wheel_{WHEELS[i]}", len(bodies), ca.SX([0, 1, 0, 0, 0, 0]),
                spatial.rotation_z(angles[i]) if corner.front else ca.SX.eye(3), zero3,
                spatial.rigid_inertia(a.wheel_mass, zero3, wheel_inertia),
            )  # fmt: skip
            bodies += [hub, wheel]
        centre = first_moment / sprung
        offset = spatial.skew(centre)
        inertia = inertia + sprung * (offset @ offset)  # from about cog to about the chassis's own centre
        return Tree(spatial.rigid_inertia(sprung, centre, inertia), tuple(bodies))

    @cached_property
    def root_velocity(self) -> ca.SX:
        """Spatial velocity of the chassis `[ω; v]`, 6×1."""
        return ca.vertcat(self.u[3:6], self.u[0:3])

    @cached_property
    def _rates(self) -> ca.SX:
        """Joint rates in the order of the tree: hub, wheel, hub, wheel …"""
        return ca.vertcat(*(rate for i in range(4) for rate in (self.u[6 + i], self.u[10 + i])))

    @cached_property
    def _contacts(self) -> list[SimpleNamespace]:
        """Tyre contact of each wheel: point, axes (body axes), forces, slips, inclination; and the wheel load."""
        v = self._v
        attitude = spatial.rotation_y(self.q[PITCH]) @ spatial.rotation_x(self.q[ROLL])  # body to heading frame
        normal = attitude.T @ ca.SX([0, 0, 1])
        bodies = self._tree.bodies
        contacts = []
        for i, corner in enumerate(self._geometry.corners):
            a = corner.axle
            centre = bodies[2 * i].position
            height = self.q[Z] + normal.T @ centre
            axle = bodies[2 * i + 1].rotation[:, 1]
            ahead = ca.cross(axle, normal)
            ahead = ahead / ca.norm_2(ahead)
            upward = ca.cross(ahead, axle)
            loaded_radius = height / (normal.T @ upward)
            point = centre - loaded_radius * upward
            sideways = ca.cross(normal, ahead)
            travel_speed = corner.guide * self.u[6 + i]
            velocity = self.u[0:3] + ca.cross(self.u[3:6], point) + travel_speed
            deflection = corner.radius - loaded_radius
            load = a.tyre_stiffness * deflection - a.tyre_damping * (normal.T @ velocity)
            load = ca.if_else(deflection > 0, ca.fmax(load, 0), 0)
            factor = a.dynamic_radius_factor
            effective_radius = factor * corner.radius + (1 - factor) * loaded_radius
            rolling_speed = effective_radius * self.u[10 + i]
            speed_x = ahead.T @ velocity
            inclination = ca.asin(normal.T @ axle)
            force_x, force_y, moment, slip_x, slip_y = corner.tyre(
                a.tyre,
                load,
                speed_x,
                sideways.T @ velocity,
                rolling_speed,
                v.road.friction,
                camber=inclination,
                side=corner.side,
            )
            contacts.append(
                SimpleNamespace(
                    point=point,
                    centre=centre,
                    ahead=ahead,
                    sideways=sideways,
                    normal=normal,
                    axle=axle,
                    load=load,
                    force_x=force_x,
                    force_y=force_y,
                    moment=moment,
                    slip_x=slip_x,
                    slip_y=slip_y,
                    inclination=inclination,
                    effective_radius=effective_radius,
                    sliding_speed=rolling_speed - speed_x,
                    transport_speed=ca.sqrt(rolling_speed**2 + a.tyre.standstill_speed**2),
                    rolling=-a.rolling_resistance
                    * load
                    * effective_radius
                    * rolling_speed
                    / ca.sqrt(rolling_speed**2 + a.tyre.standstill_speed**2),
                )
            )
        return contacts

    @cached_property
    def dynamics(self) -> ca.SX:
        """Derivatives of `u` (14): a function of q, u, force, surroundings, inputs and p."""
        v = self._v
        tree, contacts, corners = self._tree, self._contacts, self._geometry.corners
        drag = -0.5 * AIR_DENSITY * v.aerodynamics.drag_area * self.u[0] * ca.fabs(self.u[0])
        root_force = ca.vertcat(self.force[3:6], self.force[0:3] + ca.vertcat(drag, 0, 0))
        forces: list[ca.SX] = []
        efforts: list[ca.SX] = []
        for i, (corner, contact) in enumerate(zip(corners, contacts, strict=True)):
            a = corner.axle
            compression, rate = self.q[6 + i], self.u[6 + i]
            preload = (corner.static_load - (a.hub_mass + a.wheel_mass) * GRAVITY) * corner.guide[2]
            spring = a.suspension_stiffness * compression + a.suspension_damping * rate
            bar = a.antiroll_stiffness * (compression - self.q[6 + corner.opposite])
            in_body = (
                contact.force_x * contact.ahead + contact.force_y * contact.sideways + contact.load * contact.normal
            )
            moment = contact.moment * contact.normal + contact.rolling * contact.axle
            to_wheel = tree.bodies[2 * i + 1].rotation.T
            forces += [
                ca.SX(6, 1),
                spatial.force_at(to_wheel @ (contact.point - contact.centre), to_wheel @ in_body, to_wheel @ moment),
            ]
            efforts += [
                -(preload + spring + bar) + self.force[6 + i],
                self.inputs[1 + i] + self.force[10 + i],
            ]
        root, joints = tree.forward_dynamics(self.root_velocity, self._rates, ca.vertcat(*efforts), root_force, forces)
        # A uniform field accelerates the whole tree alike, so gravity need not be applied body by body.
        linear = root[3:6] + gravity_in_body(self.q, self.surroundings)
        return ca.vertcat(linear, root[0:3], joints[0::2], joints[1::2])

    @cached_property
    def stiffening(self) -> tuple[ca.SX, ca.SX]:
        """What a time step adds to the Jacobian of the dynamics by u, as a product of 14×4 and 4×14.

        Wheels are light and tyres steep: below 10 m/s slip changes faster than any affordable step. Where a tyre
        slides, the tangent to its flat force curve says nothing of the steep slope at zero slip that the step will come
        across, and the wheel would be thrown to and fro between the two for ever. With a slope steeper than the curve
        has anywhere, sliding goes down with each step. The additional force acts on wheel and car alike, here a rigid
        body in the plane, so that it takes no momentum from nowhere.
        """
        chassis = self._v.chassis
        responses, slopes = [], []
        for i, (corner, contact) in enumerate(zip(self._geometry.corners, self._contacts, strict=True)):
            response = ca.SX.zeros(COORDINATES)
            response[0:2] = contact.ahead[0:2] / chassis.mass
            response[5] = ca.cross(contact.point, contact.ahead)[2] / chassis.yaw_inertia
            response[10 + i] = -contact.effective_radius / corner.axle.wheel_spin_inertia
            responses.append(response)
            steepest = corner.steepest_slope(corner.axle.tyre, contact.load) / contact.transport_speed
            tangent = ca.jacobian(contact.force_x, self.u[10 + i]) / contact.effective_radius
            excess = ca.fmax(STIFFENING * steepest - tangent, 0)
            slopes.append(excess * ca.jacobian(contact.sliding_speed, self.u))
        return ca.horzcat(*responses), ca.vertcat(*slopes)

    @cached_property
    def wheel_outputs(self) -> ca.SX:
        """Of each wheel fl, fr, rl, rr: force x, y, z [N], aligning moment [N m] in `contact_*`, longitudinal slip,
        slip angle [rad], inclination angle (positive where the top leans to the right, ISO 8855) [rad]; 7×4."""
        return ca.horzcat(
            *(
                ca.vertcat(c.force_x, c.force_y, c.load, c.moment, c.slip_x, ca.atan(-c.slip_y), c.inclination)
                for c in self._contacts
            )
        )

    def inertia_times(self, acceleration: ca.SX) -> ca.SX:
        """Generalized force (14) that belongs to the accelerations `acceleration` (14) at rest: M(q) · acceleration."""
        root = ca.vertcat(acceleration[3:6], acceleration[0:3])
        joints = ca.vertcat(*(a for i in range(4) for a in (acceleration[6 + i], acceleration[10 + i])))
        f = self._tree.inertia_times(root, joints)
        return ca.vertcat(f[3:6], f[0:3], f[6::2], f[7::2])

    @property
    def kinematics(self) -> ca.SX:
        """Derivatives of `q` (14) as a function of q and u."""
        return kinematics(self.q, self.u)


def kinematics(q: ca.SX, u: ca.SX) -> ca.SX:
    """Derivatives of the coordinates (14): z-y-x angles for the attitude, singular at a pitch of 90°."""
    roll, pitch, yaw = q[ROLL], q[PITCH], q[YAW]
    position = spatial.rotation_rpy(roll, pitch, yaw) @ u[0:3]
    s, c, t = ca.sin(roll), ca.cos(roll), ca.tan(pitch)
    angles = ca.vertcat(
        u[3] + t * (s * u[4] + c * u[5]),
        c * u[4] - s * u[5],
        (s * u[4] + c * u[5]) / ca.cos(pitch),
    )
    return ca.vertcat(position, angles, u[6:])


_CARS: dict[tuple[str, ...], Car] = {}


def car_of(vehicle: Vehicle) -> Car:
    """The `Car` for a vehicle's structure; built once per process, whatever the values of the parameters."""
    physics = vehicle.physics
    structure = (physics.front.tyre.model, physics.rear.tyre.model, *(name for name, _ in numbers(physics)))
    if structure not in _CARS:
        _CARS[structure] = Car(vehicle)
    return _CARS[structure]
