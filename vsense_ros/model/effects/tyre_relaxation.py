"""Lateral tyre forces that build up over a distance rolled."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.effects.base import Effect, of_axle, size
from vsense_ros.model.moving_car import Corner, MovingCar
from vsense_ros.model.tyres.slip import SLIP, transport_speed

STANDSTILL = 0.3  # [m/s] keeps the lag finite at rest


class TyreRelaxation(Effect):
    """The slip that a tyre responds to lags behind that of the wheel by a distance (Pacejka 2012, section 7.2).

    In a step of `h` the wheel's slip speed s is taken as a ramp, which the lagged one y follows exactly:
    y⁺ = y + (1 − e)(s − y) + φ (s⁺ − s), with e = exp(−h/τ) and φ = 1 − (τ/h)(1 − e). Per wheel the internal
    state holds y, s, the part of y that is constant during the step, and φ.
    """

    id: ClassVar[str] = "tyre_relaxation"
    sentence: ClassVar[str] = "lateral tyre forces that build up over a distance rolled"
    mistaken_for: ClassVar[tuple[str, ...]] = ("sensor_delay", "sloshing_load")
    internal_state: ClassVar[tuple[str, ...]] = tuple(
        f"{name}_{wheel}" for wheel in WHEELS for name in ("lagged", "speed", "constant", "share")
    )

    front: float = size("m", "relaxation length of the front tyres", typical=0.4, low=0.0, high=5.0)
    rear: float = size("m", "relaxation length of the rear tyres", typical=0.4, low=0.0, high=5.0)

    def lateral_speed(self, speed: ca.SX, corner: Corner, internal_state: ca.SX) -> ca.SX:
        constant, share = internal_state[4 * corner.index + 2], internal_state[4 * corner.index + 3]
        return ca.if_else(of_axle(self, corner) > SLIP.shortest_relaxation, constant + share * speed, speed)

    def update(self, internal_state: ca.SX, car: MovingCar, h: ca.SX) -> ca.SX:
        after = []
        for corner, contact in zip(car.corners, car.contacts, strict=True):
            lagged, before = internal_state[4 * corner.index], internal_state[4 * corner.index + 1]
            present = contact.touch.speed_y * corner.axle.cornering_scale
            rolled = h * transport_speed(contact.rolling_speed, STANDSTILL)
            ratio = rolled / ca.fmax(of_axle(self, corner), SLIP.shortest_relaxation)
            decay = ca.exp(-ratio)
            share = 1 - (1 - decay) / ratio
            lagged = lagged + (1 - decay) * (before - lagged) + share * (present - before)
            constant = lagged + (1 - ca.sqrt(decay)) * (present - lagged) - share * present
            after += [lagged, present, constant, share]
        return ca.vertcat(*after)
