"""What the tyre models share: slip that stays finite at standstill, the end of contact, and the lag behind the slip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca

from vsense_ros.model.parameter import Scalar
from vsense_ros.model.tyres.base import TyreInput


@dataclass(frozen=True)
class SlipLimits:
    """Limits that keep slips and forces of tyres finite."""

    smallest_slip: float = 1e-6  # [-] keeps the direction of the slip vector defined where the slip vanishes
    smallest_load: float = 1.0  # [N] keeps force ratios defined where the wheel is in the air
    shortest_relaxation: float = 1e-3  # [m] keeps the rate of a tyre without relaxation finite


SLIP = SlipLimits()


def transport_speed(speed: Scalar, standstill_speed: Scalar) -> Scalar:
    """What sliding velocities are divided by, positive and smooth through standstill [m/s]."""
    return ca.sqrt(speed**2 + standstill_speed**2)


class Slips(NamedTuple):
    """Sliding velocities of a contact patch over the speed that they are referred to."""

    reference_speed: Scalar  # positive [m/s]
    longitudinal: Scalar  # [-]
    lateral: Scalar  # [-]


def slips(wheel: TyreInput, velocity: Scalar, standstill_speed: Scalar) -> Slips:
    """Slips of a wheel, referred to the size of a `velocity` [m/s]."""
    reference = transport_speed(velocity, standstill_speed)
    return Slips(reference, (wheel.rolling_speed - wheel.speed_x) / reference, -wheel.speed_y / reference)


def contact(load: Scalar) -> Scalar:
    """1 on the road, 0 in the air [-]."""
    return ca.fmin(ca.fmax(load, 0) / SLIP.smallest_load, 1)


def relaxation_rate(length: Scalar, rolling_speed: Scalar, standstill_speed: Scalar) -> Scalar:
    """Rate [1/s] at which a force follows its steady value: d(force)/dt = rate · (steady force − force).

    The deflection of a tyre builds up over the distance rolled, `length` [m] (Pacejka 2012, section 7.2), so the rate
    grows with the speed. It keeps a rest at standstill, where a tyre that does not roll yields to its slip speed alone.
    """
    return transport_speed(rolling_speed, standstill_speed) / ca.fmax(length, SLIP.shortest_relaxation)
