"""A car in motion, as far as effects may refer to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca

from vsense_ros.model.contact import Contact
from vsense_ros.model.parameter import Scalar
from vsense_ros.model.schema.physics import Axle, NominalPhysics
from vsense_ros.model.tyres import TyreForces


@dataclass(frozen=True, eq=False)
class Corner:
    """Constants of one corner of the car."""

    index: int  # 0 to 3: fl, fr, rl, rr
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
        """The index of the other wheel of the axle."""
        return self.index ^ 1


@dataclass(frozen=True, eq=False)
class TyreContact:
    """Where a tyre touches the road, and what the road does to it."""

    touch: Contact
    tyre: TyreForces
    rolling_speed: ca.SX


class MovingCar(Protocol):
    """Symbols and expressions of a car in motion; coordinates, velocities, inputs and disturbances have the order of
    `coordinates.py`, wheels that of fl, fr, rl, rr."""

    q: ca.SX
    u: ca.SX
    inputs: ca.SX
    disturbances: ca.SX

    @property
    def parameters(self) -> NominalPhysics:
        """The parameters, with symbols in place of their numbers."""

    @property
    def corners(self) -> Sequence[Corner]:
        """The constants of each corner."""

    @property
    def contacts(self) -> Sequence[TyreContact]:
        """The contact of each tyre with the road."""

    @property
    def wheel_outputs(self) -> ca.SX:
        """A column of `coordinates.WHEEL_OUTPUTS` for each wheel, 7×4."""
