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

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import casadi as ca
from pydantic import BaseModel

from vsense_ros.cache import digest_of
from vsense_ros.model import spatial
from vsense_ros.model.car.bodies import tree_of, wheel_inertia
from vsense_ros.model.car.forces import air_drag, suspension_resistance, wheel_force
from vsense_ros.model.car.kinematics import gravity_in_body, kinematics
from vsense_ros.model.car.present_effects import PresentEffects
from vsense_ros.model.car.suspension import HubMotion, ackermann_angle, straight_guide, table_guide
from vsense_ros.model.car.tyre_contacts import forces_of_tyre, tyre_contact, tyre_motion, wheel_outputs
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import (
    COORDINATES,
    DISTURBANCES,
    INPUTS,
    RATES,
    REAR_STEERING,
    SPIN,
    STEERING,
    STEERING_OFFSET,
    TORQUES,
    TRAVEL,
    VELOCITY,
    WHEELS,
)
from vsense_ros.model.effects.base import AXLES
from vsense_ros.model.moving_car import Corner, TyreContact
from vsense_ros.model.multibody.tree import Tree
from vsense_ros.model.parameter import Scalar, numbers, symbols
from vsense_ros.model.schema.suspension_tables import (
    Coefficients,
    SuspensionTables,
    coefficients,
    coefficients_in_one_form,
)
from vsense_ros.model.vehicle import Vehicle

# Of each wheel its side, 1 on the left and -1 on the right; of each axle whether it is steered; of each axle 1 ahead of
# `cog` and -1 behind it. Besides values of parameters, nothing else differs between the equations of the corners.
PLACEMENT = (1.0, -1.0, 1.0, -1.0, 1.0, 0.0, 1.0, -1.0)


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
        placed = _placed_by_symbols(self._tables) if corners_alike else _placed_by_numbers(self._tables)
        self.placement, self.placed, self._coefficients = placed
        self.parameter_names = tuple(name for name, _ in numbers(vehicle.physics))
        self.p, self.parameters = symbols(vehicle.physics)
        self.q: ca.SX = ca.SX.sym("q", COORDINATES)
        self.u: ca.SX = ca.SX.sym("u", COORDINATES)
        self.force = ca.SX.sym("force", COORDINATES)  # generalized forces beyond the model's
        self.disturbances = ca.SX.sym("disturbances", len(DISTURBANCES))
        self.inputs: ca.SX = ca.SX.sym("inputs", len(INPUTS))
        self._root_velocity = ca.vertcat(self.u[RATES], self.u[VELOCITY])  # spatial velocity of the chassis [ω; v]
        self._joint_rates = _by_corner(self.u[TRAVEL], self.u[SPIN])
        self._effects = PresentEffects(self.parameters.acting())
        self.internal_state = self._effects.internal_state
        self.internal_state_slices = self._effects.slices

    @cached_property
    def identity(self) -> str:
        """A text that differs wherever the equations of two cars do, also of different versions of the project; empty
        where they are made by a class that has no file."""
        package, other_files = Path(__file__).parents[1], set[Path]()
        settings = ["" if self._tables is None else self._tables.model_dump_json()]
        for part in _parts(self._vehicle.physics):
            file = getattr(sys.modules.get(type(part).__module__), "__file__", None)
            if file is None:
                return ""
            if package not in Path(file).parents:
                other_files.add(Path(file))
            for name in type(part).model_fields:
                value = getattr(part, name)
                # Of numbers the names count, not the values, which stay symbols.
                settings.append(name if isinstance(value, float | BaseModel) else f"{name}={value!r}")
        code = [digest_of(package), *(path.read_text(encoding="utf-8") for path in sorted(other_files))]
        return "\n".join((*code, *settings))

    @cached_property
    def corners_alike(self) -> Car:
        """This car with corners that have equal equations down to each operation."""
        return Car(self._vehicle, corners_alike=True)

    @cached_property
    def _wheelbase(self) -> Scalar:
        return self.parameters.chassis.cog_to_front_axle + self.parameters.chassis.cog_to_rear_axle

    @cached_property
    def corners(self) -> tuple[Corner, ...]:
        """The corners of the car in the order fl, fr, rl, rr."""
        chassis = self.parameters.chassis
        weight = chassis.mass * GRAVITY
        corners = []
        for i in range(len(WHEELS)):
            front, side, ahead = i < 2, self.placement[i], self.placement[6 + i // 2]
            axle = self.parameters.front if front else self.parameters.rear
            arm = ahead * (chassis.cog_to_front_axle if front else chassis.cog_to_rear_axle)
            opposite_arm = chassis.cog_to_rear_axle if front else chassis.cog_to_front_axle
            static_load = weight * opposite_arm / self._wheelbase / 2
            loaded_radius = axle.unloaded_radius - static_load / axle.tyre_stiffness
            centre = ca.vertcat(arm, side * axle.track / 2, loaded_radius - chassis.cog_height)
            axle = self._effects.wheel(i, axle)
            corners.append(Corner(i, axle, side, centre, static_load, loaded_radius))
        return tuple(corners)

    @cached_property
    def _road_wheel_angle(self) -> ca.SX:
        """Mean of both front wheels [rad]."""
        return self._effects.front_angle(self.inputs[STEERING] - self.disturbances[STEERING_OFFSET], self)

    def _toe(self, corner: Corner) -> ca.SX:
        """Angle by which rear steering and effects turn a wheel to the left [rad]."""
        rear = ca.SX(0)
        if self.parameters.steering.rear:
            rear = (1 - self.placement[4 + corner.index // 2]) * self.inputs[REAR_STEERING]
        return self._effects.toe(rear, corner, self)

    def _guide(self, corner: Corner, travel: ca.SX, angle: ca.SX) -> HubMotion:
        """How the hub moves at a `travel` [m] and a mean `angle` of the front wheels [rad]."""
        if self._tables is not None:
            axle = "front" if corner.front else "rear"
            return table_guide(self._tables, self._coefficients[axle], corner.side, corner.centre, travel, angle)
        # A wheel whose contact point moves along this line has its lateral force act at the roll centre.
        slope = 2 * corner.axle.roll_centre_height / corner.axle.track
        direction = ca.vertcat(0, ca.SX(corner.side * slope), 1) / ca.sqrt(1 + slope**2)
        steered = self.placement[4 + corner.index // 2]
        if steered.is_zero():
            return straight_guide(corner.centre, direction, travel, ca.SX(0))
        share, middle = self.parameters.steering.ackermann, corner.side * corner.axle.track / 2
        toe = ackermann_angle(steered * angle, share, self._wheelbase, middle)
        return straight_guide(corner.centre, direction, travel, toe)

    @cached_property
    def _hubs(self) -> list[HubMotion]:
        angle = self._road_wheel_angle
        return [self._guide(c, self.q[TRAVEL][c.index], angle).turned(self._toe(c)) for c in self.corners]

    def _wheel_inertia(self, corner: Corner, hub: HubMotion) -> ca.SX:
        """Inertia of a wheel about its centre in the axes of the chassis, 3×3 [kg m²]."""
        return wheel_inertia(corner, hub)

    @cached_property
    def _tree(self) -> Tree:
        inertias = [self._wheel_inertia(corner, hub) for corner, hub in zip(self.corners, self._hubs, strict=True)]
        chassis = self.parameters.chassis
        return tree_of(chassis, self._effects, self.corners, self._hubs, inertias, self.u[TRAVEL])

    @cached_property
    def contacts(self) -> list[TyreContact]:
        """Contacts of the tyres fl, fr, rl, rr with the road."""
        pairs = zip(self.corners, self._hubs, strict=True)
        return [tyre_contact(self, self._effects, corner, hub) for corner, hub in pairs]

    def _loads(self, contacts: Sequence[TyreContact]) -> tuple[ca.SX, ca.SX, list[ca.SX]]:
        """Joint efforts, force on the chassis, and forces on hubs and wheels."""
        forces: list[ca.SX] = []
        efforts: list[ca.SX] = []
        for corner, hub, tyre in zip(self.corners, self._hubs, contacts, strict=True):
            i, design = corner.index, self._guide(corner, ca.SX(0), ca.SX(0))
            resistance = suspension_resistance(self, corner, hub, design)
            forces += [ca.SX(6, 1), wheel_force(corner, hub, tyre)]
            efforts += [
                -self._effects.suspension_force(resistance, corner, self) + self.force[TRAVEL][i],
                self._effects.wheel_torque(self.inputs[TORQUES][i], corner, self) + self.force[SPIN][i],
            ]
        chassis = self._effects.chassis_force(air_drag(self), self) + ca.vertcat(
            self.force[RATES], self.force[VELOCITY]
        )
        return ca.vertcat(*efforts), chassis, forces

    @cached_property
    def dynamics(self) -> ca.SX:
        """Derivatives of `u` (14): a function of q, u, force, disturbances, inputs and p."""
        root, joints = self._tree.forward_dynamics(self._root_velocity, self._joint_rates, *self._loads(self.contacts))
        # A uniform field accelerates the whole tree alike, so gravity need not be applied body by body.
        linear = root[spatial.LINEAR] + gravity_in_body(self.q, self.disturbances)
        return _by_coordinate(ca.vertcat(root[spatial.ANGULAR], linear), joints)

    def missing_force(self, acceleration: ca.SX, tyre_forces: ca.SX) -> ca.SX:
        """Generalized force (14) that the derivatives `acceleration` (14) of `u` need beyond what acts, if each tyre's
        longitudinal, lateral and vertical force and its moment are the columns of `tyre_forces` (4×4)."""
        contacts = [
            replace(
                contact,
                touch=replace(contact.touch, load=tyre_forces[2, i]),
                tyre=contact.tyre._replace(
                    longitudinal=tyre_forces[0, i], lateral=tyre_forces[1, i], aligning_moment=tyre_forces[3, i]
                ),
            )
            for i, contact in enumerate(self.contacts)
        ]
        efforts, chassis, forces = self._loads(contacts)
        linear = acceleration[VELOCITY] - gravity_in_body(self.q, self.disturbances)
        root, joints = self._tree.inverse_dynamics(
            self._root_velocity,
            self._joint_rates,
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
        return ca.horzcat(*(tyre_motion(self._effects, c, t.touch, t.rolling_speed, lagging) for c, t in pairs))

    def tyre_forces(self, motions: ca.SX) -> ca.SX:
        """Longitudinal, lateral and vertical force and moment of each tyre by `tyre_motions` (5×4); 4×4."""
        columns = []
        for corner in self.corners:
            forces = forces_of_tyre(self, self._effects, corner, motions[:, corner.index])
            load = motions[0, corner.index]
            columns.append(ca.vertcat(forces.longitudinal, forces.lateral, load, forces.aligning_moment))
        return ca.horzcat(*columns)

    def next_internal_state(self, h: ca.SX) -> ca.SX:
        """The internal state for a step of `h` [s] that begins now, from that of the last step."""
        return self._effects.update(self, h)

    @cached_property
    def wheel_outputs(self) -> ca.SX:
        """A column for each wheel fl, fr, rl, rr: force x, y, z [N], aligning moment [N m] in `contact_*`, longitudinal
        slip, slip angle [rad], inclination angle (positive where the top leans to the right, ISO 8855) [rad]; 7×4."""
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


class _Placed(NamedTuple):
    """The numbers in which the equations of the corners differ."""

    expressions: ca.SX  # numbers, or symbols that stand for them
    values: tuple[float, ...]
    coefficients: dict[str, Coefficients]  # of the suspension tables, by axle


def _placed_by_numbers(tables: SuspensionTables | None) -> _Placed:
    of_axles = {axle: coefficients(tables, axle) for axle in AXLES} if tables is not None else {}
    return _Placed(ca.SX(ca.DM(PLACEMENT)), PLACEMENT, of_axles)


def _placed_by_symbols(tables: SuspensionTables | None) -> _Placed:
    """Symbols in place of what the corners differ in."""
    values: list[float] = []
    symbols: list[ca.SX] = []

    def symbol(value: float) -> ca.SX:
        values.append(value)
        symbols.append(ca.SX.sym("placement"))
        return symbols[-1]

    for value in PLACEMENT:
        symbol(value)
    of_axles = coefficients_in_one_form(tables, symbol) if tables is not None else {}
    return _Placed(ca.vertcat(*symbols), tuple(values), of_axles)


def _by_corner(travel: ca.SX, spin: ca.SX) -> ca.SX:
    """Values of hubs and wheels in the order of the tree: hub, wheel, hub, wheel …"""
    return ca.vec(ca.horzcat(travel, spin).T)


def _by_coordinate(root: ca.SX, joints: ca.SX) -> ca.SX:
    """In the order of the velocities, from a spatial vector of the chassis and the joints in the order of the tree."""
    return ca.vertcat(root[spatial.LINEAR], root[spatial.ANGULAR], joints[0::2], joints[1::2])


def _parts(model: BaseModel) -> Iterator[BaseModel]:
    """A model and all models in it."""
    yield model
    for name in type(model).model_fields:
        value = getattr(model, name)
        if isinstance(value, BaseModel):
            yield from _parts(value)


_CARS: dict[tuple[object, ...], Car] = {}


def car_of(vehicle: Vehicle) -> Car:
    """The `Car` for a vehicle's structure; built once per process, whatever the values of the parameters."""
    physics = vehicle.physics
    structure = (
        physics.front.tyre.model,
        physics.rear.tyre.model,
        physics.steering.rear,
        vehicle.suspension,
        *(name for name, _ in numbers(physics)),
    )
    if structure not in _CARS:
        _CARS[structure] = Car(vehicle)
    return _CARS[structure]
