"""One force curve for all loads, frictions and directions of slip (Best & Bogdanski 2016, eqs. 21 to 27).

Slip is normalised by the friction force, so that stiffness, shape, peak and curvature describe the tyre under every
load and friction: few numbers, which an identification can separate. Axes are ISO 8855, the paper's are SAE: lateral
slip and lateral force both change their signs, the curve between them stays.
"""

from __future__ import annotations

from typing import Literal

import casadi as ca

from vsense_ros.model.parameter import Scalar, parameter
from vsense_ros.model.tyres.base import RelaxationLengths, Tyre, TyreForces, TyreInput
from vsense_ros.model.tyres.slip import SLIP, contact, slips, transport_speed


class Similarity(Tyre):
    """Parameters of a tyre in similarity form, named as in the paper's table 1."""

    model: Literal["similarity"]
    stiffness: float = parameter("N/rad", "C_α: lateral stiffness; the slope at zero slip is peak times this", gt=0)
    longitudinal_ratio: float = parameter("-", "K_x: longitudinal over lateral stiffness", gt=0, lt=20)
    shape: float = parameter("-", "C: how far the curve falls beyond its maximum", ge=1, le=2.5)
    peak: float = parameter("-", "D: largest force over friction times load", gt=0, le=3)
    curvature: float = parameter("-", "E: where the maximum lies", gt=-20, lt=1)
    relaxation_time: float = parameter("s", "τ: lag of the forces, whatever the speed", ge=0, le=1, default=0.0)
    relaxation_length: float = parameter("m", "distance over which forces build up, besides", ge=0, le=5, default=0.0)
    standstill_speed: float = parameter(
        "m/s", "added to the velocity so that slip stays finite at standstill", gt=0, le=2, default=0.3
    )

    def steepest_slope(self, load: Scalar) -> Scalar:
        """Largest increase of longitudinal force per longitudinal slip, that at zero slip [N]."""
        return self.peak * self.stiffness * self.longitudinal_ratio

    def cornering_stiffness_at(self, load: Scalar) -> Scalar:
        """Lateral force per slip angle at zero slip [N/rad]."""
        return self.peak * self.stiffness

    def forces(self, wheel: TyreInput) -> TyreForces:
        """Steady forces and slips, no aligning moment; inclination and side of the car are without effect."""
        _, slip_x, slip_y = slips(wheel, wheel.speed_x, self.standstill_speed)
        limit = wheel.friction * ca.fmax(wheel.load, SLIP.smallest_load)
        k_x = self.stiffness / limit * self.longitudinal_ratio * slip_x
        k_y = self.stiffness / limit * slip_y
        k = ca.sqrt(k_x**2 + k_y**2 + SLIP.smallest_slip**2)
        scaled = k / self.shape
        bent = scaled - self.curvature * (scaled - ca.atan(scaled))
        # An identified shape above 2 would let the curve cross zero far out, and the tyre push the sliding car.
        curve = ca.fmax(self.peak * ca.sin(self.shape * ca.atan(bent)), 0)
        share = contact(wheel.load) * curve * limit / k
        return TyreForces(share * k_x, share * k_y, ca.SX(0), slip_x, slip_y)

    def relaxation_lengths(self, wheel: TyreInput) -> RelaxationLengths:
        """Distance over which the forces build up [m]: that rolled in the paper's constant time, and a constant one."""
        rolled = self.relaxation_time * transport_speed(wheel.rolling_speed, self.standstill_speed)
        length = rolled + self.relaxation_length
        return RelaxationLengths(length, length)
