"""The linear tyre: forces proportional to slip, without a limit (Leung 2010, eqs. 3.13 to 3.15).

For small slips only: neither load nor friction limits the forces. Good for models that a filter shall keep simple.
"""

from __future__ import annotations

from typing import Literal

import casadi as ca

from vsense_ros.model.parameter import Scalar, parameter
from vsense_ros.model.tyres.base import RelaxationLengths, Tyre, TyreForces, TyreInput
from vsense_ros.model.tyres.slip import contact, slips


class Linear(Tyre):
    """Parameters of a linear tyre."""

    model: Literal["linear"]
    slip_stiffness: float = parameter("N", "longitudinal force per longitudinal slip", gt=0)
    cornering_stiffness: float = parameter("N/rad", "lateral force per slip angle", gt=0)
    camber_stiffness: float = parameter("N/rad", "lateral force per inclination angle", ge=0, default=0.0)
    pneumatic_trail: float = parameter("m", "aligning moment over lateral force", ge=0, lt=0.2, default=0.0)
    relaxation_length: float = parameter("m", "distance rolled until 63 % of a force have built up", ge=0, default=0.0)
    standstill_speed: float = parameter(
        "m/s", "added to the velocity so that slip stays finite at standstill", gt=0, le=2, default=0.3
    )

    def steepest_slope(self, load: Scalar) -> Scalar:
        """Largest increase of longitudinal force per longitudinal slip [N]."""
        return self.slip_stiffness

    def cornering_stiffness_at(self, load: Scalar) -> Scalar:
        """Lateral force per slip angle at zero slip [N/rad]."""
        return self.cornering_stiffness

    def forces(self, wheel: TyreInput) -> TyreForces:
        """Steady forces and slips; grip and side of the car are without effect."""
        travel, _, slip_y = slips(wheel, wheel.speed_x, self.standstill_speed)
        # Braking counts against the speed over ground, driving against that of the tread (Leung's eq. 3.15).
        faster = ca.fmax(ca.fabs(wheel.speed_x), ca.fabs(wheel.rolling_speed))
        _, slip_x, _ = slips(wheel, faster, self.standstill_speed)
        on_road = contact(wheel.load)
        force_x = on_road * self.slip_stiffness * slip_x
        from_slip = on_road * self.cornering_stiffness * ca.atan(slip_y)
        rolling = wheel.speed_x / travel
        force_y = from_slip - on_road * self.camber_stiffness * wheel.camber * rolling**2
        moment = -self.pneumatic_trail * rolling * from_slip
        return TyreForces(force_x, force_y, moment, slip_x, slip_y)

    def relaxation_lengths(self, wheel: TyreInput) -> RelaxationLengths:
        """Distance over which the longitudinal and the lateral force build up [m]."""
        return RelaxationLengths(self.relaxation_length, self.relaxation_length)
