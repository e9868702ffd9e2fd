"""The linear tyre: forces proportional to slip, without a limit (Leung 2010, eqs. 3.13 to 3.15).

For small slips only: neither load nor friction limits the forces. Good for models that a filter shall keep simple.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Literal

import casadi as ca

from vsense_ros.model.parameter import Part, parameter
from vsense_ros.model.tyres.slip import contact, slips


class Linear(Part):
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


def steepest_slope(p: SimpleNamespace, load: ca.SX) -> ca.SX:
    """Largest increase of longitudinal force per longitudinal slip [N]."""
    return p.slip_stiffness


def cornering_stiffness(p: SimpleNamespace, load: ca.SX) -> ca.SX:
    """Lateral force per slip angle at zero slip [N/rad]."""
    return p.cornering_stiffness


def forces(
    p: SimpleNamespace,
    load: ca.SX,
    speed_x: ca.SX,
    speed_y: ca.SX,
    rolling_speed: ca.SX,
    friction: ca.SX,
    camber: ca.SX | float = 0.0,
    side: float = 1.0,
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX]:
    """Forces and slips as `tyres.forces` describes them; `friction` and `side` are without effect."""
    travel, _, slip_y = slips(speed_x, speed_x, speed_y, rolling_speed, p.standstill_speed)
    # Braking counts against the speed over ground, driving against that of the tread (Leung's eq. 3.15).
    faster = ca.fmax(ca.fabs(speed_x), ca.fabs(rolling_speed))
    _, slip_x, _ = slips(faster, speed_x, speed_y, rolling_speed, p.standstill_speed)
    on_road = contact(load)
    force_x = on_road * p.slip_stiffness * slip_x
    from_slip = on_road * p.cornering_stiffness * ca.atan(slip_y)
    rolling = speed_x / travel
    force_y = from_slip - on_road * p.camber_stiffness * camber * rolling**2
    return force_x, force_y, -p.pneumatic_trail * rolling * from_slip, slip_x, slip_y


def relaxation_lengths(
    p: SimpleNamespace,
    load: ca.SX,
    speed_x: ca.SX,
    speed_y: ca.SX,
    rolling_speed: ca.SX,
    friction: ca.SX,
    camber: ca.SX | float = 0.0,
    side: float = 1.0,
) -> tuple[ca.SX, ca.SX]:
    """Distance over which the longitudinal and the lateral force build up [m]."""
    return p.relaxation_length, p.relaxation_length
