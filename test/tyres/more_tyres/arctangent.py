"""A tyre that is no part of the package: forces that grow with the arctangent of slip, without combined slip."""

from __future__ import annotations

import math
from typing import Literal

import casadi as ca

from vsense_ros.model.parameter import Scalar, parameter
from vsense_ros.model.tyres.base import RelaxationLengths, Tyre, TyreForces, TyreInput
from vsense_ros.model.tyres.slip import slips


class Arctangent(Tyre):
    """Parameters of an arctangent tyre."""

    model: Literal["arctangent"]
    stiffness: float = parameter("-", "slope at zero slip over the load", gt=0)
    grip: float = parameter("-", "largest force over the load", gt=0, le=3)
    standstill_speed: float = parameter("m/s", "keeps slip finite at standstill", gt=0, le=2, default=0.3)

    def forces(self, wheel: TyreInput) -> TyreForces:
        slip = slips(wheel, wheel.speed_x, self.standstill_speed)
        return TyreForces(
            self._force(wheel, slip.longitudinal),
            self._force(wheel, slip.lateral),
            0.0,
            slip.longitudinal,
            slip.lateral,
        )

    def relaxation_lengths(self, wheel: TyreInput) -> RelaxationLengths:
        return RelaxationLengths(0.0, 0.0)

    def steepest_slope(self, load: Scalar) -> Scalar:
        return self.stiffness * load

    def cornering_stiffness_at(self, load: Scalar) -> Scalar:
        return self.stiffness * load

    def _force(self, wheel: TyreInput, slip: Scalar) -> Scalar:
        largest = 2 / math.pi * self.grip * wheel.friction
        return wheel.load * largest * ca.atan(self.stiffness * slip / largest)
