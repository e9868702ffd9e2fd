"""Fiala's tyre: a brush of tread elements that stick at the front of the contact patch and slide behind.

Leung 2010, section 3.3.3, names the model and its want of combined slip. Here the slips of both directions, each
weighted by its stiffness, act as one vector (Pacejka 2012, section 3.2.3), so that the resultant respects the friction
circle; with slip in one direction alone this is Fiala's formula, and his aligning moment.
"""

from __future__ import annotations

from typing import Literal

import casadi as ca
from pydantic import model_validator

from vsense_ros.model.parameter import Scalar, parameter
from vsense_ros.model.tyres.base import RelaxationLengths, Tyre, TyreForces, TyreInput
from vsense_ros.model.tyres.slip import SLIP, contact, slips


class Fiala(Tyre):
    """Parameters of a Fiala tyre."""

    model: Literal["fiala"]
    slip_stiffness: float = parameter("N", "longitudinal force per longitudinal slip, at zero slip", gt=0)
    cornering_stiffness: float = parameter("N/rad", "lateral force per slip angle, at zero slip", gt=0)
    static_friction: float = parameter("-", "friction coefficient at zero slip", gt=0, le=3)
    sliding_friction: float = parameter("-", "friction coefficient at slip 1 and beyond", gt=0, le=3)
    pneumatic_trail: float = parameter("m", "pneumatic trail at zero slip", ge=0, lt=0.2, default=0.03)
    relaxation_length: float = parameter("m", "distance rolled until 63 % of a force have built up", ge=0, default=0.0)
    standstill_speed: float = parameter(
        "m/s", "added to the velocity so that slip stays finite at standstill", gt=0, le=2, default=0.3
    )

    @model_validator(mode="after")
    def _friction_falls(self) -> Fiala:
        if self.sliding_friction > self.static_friction:
            raise ValueError(
                f"sliding_friction {self.sliding_friction:g} exceeds static_friction {self.static_friction:g}"
            )
        return self

    def steepest_slope(self, load: Scalar) -> Scalar:
        """Largest increase of longitudinal force per longitudinal slip, that at zero slip [N]."""
        return self.slip_stiffness

    def cornering_stiffness_at(self, load: Scalar) -> Scalar:
        """Lateral force per slip angle at zero slip [N/rad]."""
        return self.cornering_stiffness

    def forces(self, wheel: TyreInput) -> TyreForces:
        """Steady forces and slips; inclination and side of the car are without effect."""
        travel, slip_x, slip_y = slips(wheel, wheel.speed_x, self.standstill_speed)
        size = ca.fmin(ca.sqrt(slip_x**2 + slip_y**2 + SLIP.smallest_slip**2), 1)
        coefficient = wheel.friction * (self.static_friction - (self.static_friction - self.sliding_friction) * size)
        limit = coefficient * ca.fmax(wheel.load, SLIP.smallest_load)
        # What the force would be if all of the contact patch stuck to the road.
        elastic_x, elastic_y = self.slip_stiffness * slip_x, self.cornering_stiffness * slip_y
        elastic = ca.sqrt(elastic_x**2 + elastic_y**2 + (SLIP.smallest_slip * self.cornering_stiffness) ** 2)
        sticking = ca.fmax(1 - elastic / (3 * limit), 0)  # share of the contact patch
        share = contact(wheel.load) * limit * (1 - sticking**3) / elastic
        trail = 3 * self.pneumatic_trail * (1 - sticking) * sticking**3 / (1 - sticking**3)
        force_y = share * elastic_y
        moment = -trail * (wheel.speed_x / travel) * force_y
        return TyreForces(share * elastic_x, force_y, moment, slip_x, slip_y)

    def relaxation_lengths(self, wheel: TyreInput) -> RelaxationLengths:
        """Distance over which the longitudinal and the lateral force build up [m]."""
        return RelaxationLengths(self.relaxation_length, self.relaxation_length)
