"""What the tyre models share: slip that stays finite at standstill, the end of contact, and the lag behind the slip."""

from __future__ import annotations

import casadi as ca

SMALLEST_SLIP = 1e-6  # keeps the direction of the slip vector defined where the slip vanishes
SMALLEST_LOAD = 1.0  # [N] keeps force ratios defined where the wheel is in the air
SHORTEST_RELAXATION = 1e-3  # [m] keeps the rate of a tyre without relaxation finite


def transport_speed(speed: ca.SX | float, standstill_speed: ca.SX | float) -> ca.SX:
    """What sliding velocities are divided by, positive and smooth through standstill [m/s]."""
    return ca.sqrt(speed**2 + standstill_speed**2)


def slips(
    over: ca.SX, speed_x: ca.SX, speed_y: ca.SX, rolling_speed: ca.SX, standstill_speed: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Transport speed of the velocity `over` [m/s]; longitudinal and lateral slip: sliding velocities over it [-]."""
    transport = transport_speed(over, standstill_speed)
    return transport, (rolling_speed - speed_x) / transport, -speed_y / transport


def contact(load: ca.SX) -> ca.SX:
    """1 on the road, 0 in the air [-]."""
    return ca.fmin(ca.fmax(load, 0) / SMALLEST_LOAD, 1)


def relaxation_rate(
    length: ca.SX | float, rolling_speed: ca.SX | float, standstill_speed: ca.SX | float
) -> ca.SX | float:
    """Rate [1/s] at which a force follows its steady value: d(force)/dt = rate · (steady force − force).

    The deflection of a tyre builds up over the distance rolled, `length` [m] (Pacejka 2012, section 7.2), so the rate
    grows with the speed. It keeps a rest at standstill, where a tyre that does not roll yields to its slip speed alone.
    """
    return transport_speed(rolling_speed, standstill_speed) / ca.fmax(length, SHORTEST_RELAXATION)
