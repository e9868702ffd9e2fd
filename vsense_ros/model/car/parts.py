"""The simplified car in parts, of which some may be computed elsewhere: the tables of its suspensions, and the inertias
of its wheels, which turn with camber and toe. Chassis and hubs have matrices that do not change.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from vsense_ros import codegen
from vsense_ros.model.car.bodies import wheel_inertia
from vsense_ros.model.car.car import Car
from vsense_ros.model.car.suspension import HubMotion, hub_from_columns
from vsense_ros.model.coordinates import COORDINATES, TRAVEL, WHEELS
from vsense_ros.model.moving_car import Corner
from vsense_ros.model.schema.suspension_tables import AxleTable, Columns, TablePlace, columns_within, place_in_tables
from vsense_ros.model.vehicle import Vehicle

COLUMNS = tuple(AxleTable.model_fields)
_POSITION = ("q", "disturbances", "inputs", "p", "internal_state")


class CarInParts(Car):
    """As `Car`, whose equations take two of their parts as symbols: `columns` (18×4), of each wheel value, slope and
    half the curvature of each column of its tables, and `inertias` (6×4), of each wheel xx xy xz yy yz zz in the axes
    of the chassis [kg m²]. Raises `ValueError` for a vehicle without tables."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle)
        if self._tables is None:
            raise ValueError(f"{vehicle.name} has no tables of its suspensions")
        self.columns = ca.SX.sym("columns", 3 * len(COLUMNS), len(WHEELS))
        self.inertias = ca.SX.sym("inertias", 6, len(WHEELS))

    @cached_property
    def places(self) -> list[TablePlace]:
        """The place of each wheel in the tables of its suspension."""
        tables, angle = self._tables, self._road_wheel_angle
        assert tables is not None
        return [place_in_tables(tables, self.q[TRAVEL][c.index], c.side * angle) for c in self.corners]

    @cached_property
    def _hubs(self) -> list[HubMotion]:
        hubs = []
        for corner, place in zip(self.corners, self.places, strict=True):
            columns_of_wheel = ca.horzsplit(ca.reshape(self.columns[:, corner.index], 3, len(COLUMNS)))
            columns_in_table: Columns = {}
            for name, column in zip(COLUMNS, columns_of_wheel, strict=True):
                value, slope, half_curvature = ca.vertsplit(column)
                columns_in_table[name] = value, slope, half_curvature
            travel = self.q[TRAVEL][corner.index]
            hub = hub_from_columns(columns_in_table, place, corner.side, corner.centre, travel)
            hubs.append(hub.turned(self._toe(corner)))
        return hubs

    def _wheel_inertia(self, corner: Corner, hub: HubMotion) -> ca.SX:
        xx, xy, xz, yy, yz, zz = ca.vertsplit(self.inertias[:, corner.index])
        return ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))

    # The parts themselves, in double precision

    @property
    def _position(self) -> list[ca.SX]:
        return [self.q, self.disturbances, self.inputs, self.p, self.internal_state]

    def places_function(self) -> ca.Function:
        """(q, u, disturbances, inputs, p, internal_state) → of each wheel ξ within its tables, η, rate of ξ [1/s];
        3×4."""
        places_of_wheels = [
            ca.vertcat(place.within, place.across, self.u[TRAVEL][i] / place.half)
            for i, place in enumerate(self.places)
        ]
        arguments = [self.q, self.u, *self._position[1:]]
        return codegen.function("places", arguments, [ca.horzcat(*places_of_wheels)], ("q", "u", *_POSITION[1:]))

    def columns_function(self) -> ca.Function:
        """(q, disturbances, inputs, p, internal_state) → `columns`."""
        columns_of_wheels = []
        for corner, place in zip(self.corners, self.places, strict=True):
            of_axle = self._coefficients["front" if corner.front else "rear"]
            columns_of_wheels.append(
                ca.vertcat(*(v for values in columns_within(of_axle, place).values() for v in values))
            )
        return codegen.function("columns", self._position, [ca.horzcat(*columns_of_wheels)], _POSITION)

    def axes_function(self) -> ca.Function:
        """(…, columns) → of each wheel the rotation from its axes, y along its axle, to those of the chassis, by rows;
        9×4."""
        rotations = []
        for hub in self._hubs:
            ahead = ca.vertcat(hub.axle[1], -hub.axle[0], 0) / ca.sqrt(hub.axle[0] ** 2 + hub.axle[1] ** 2)
            turn = ca.horzcat(ahead, hub.axle, ca.cross(ahead, hub.axle))
            rotations.append(ca.vec(turn.T))
        return codegen.function(
            "axes", [*self._position, self.columns], [ca.horzcat(*rotations)], (*_POSITION, "columns")
        )

    def inertias_function(self) -> ca.Function:
        """The function (…, columns) → `inertias`."""
        inertias = []
        for corner, hub in zip(self.corners, self._hubs, strict=True):
            matrix = wheel_inertia(corner, hub)
            inertias.append(ca.vertcat(matrix[0, :].T, matrix[1, 1:].T, matrix[2, 2]))
        arguments = [*self._position, self.columns]
        return codegen.function("inertias", arguments, [ca.horzcat(*inertias)], (*_POSITION, "columns"))

    # The car of its parts

    def dynamics_function(self) -> ca.Function:
        """(q, u, force, disturbances, inputs, p, internal_state, columns, inertias) → derivatives of u (14)."""
        arguments = [self.q, self.u, self.force, *self._position[1:], self.columns, self.inertias]
        names = ("q", "u", "force", *_POSITION[1:], "columns", "inertias")
        return codegen.function("dynamics_of_parts", arguments, [self.dynamics], names)

    def mass_function(self) -> ca.Function:
        """(q, disturbances, inputs, p, internal_state, columns, inertias) → mass matrix (14×14)."""
        acceleration = ca.SX.sym("acceleration", COORDINATES)
        matrix = ca.jacobian(self.inertia_times(acceleration), acceleration)
        arguments = [*self._position, self.columns, self.inertias]
        return codegen.function("mass_of_parts", arguments, [matrix], (*_POSITION, "columns", "inertias"))
