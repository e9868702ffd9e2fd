"""Grip that falls as the tyres heat up."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.model.effects.base import Effect, of_axle, shape, size
from vsense_ros.model.moving_car import Corner, MovingCar

HEAT_CAPACITY = 8e3  # [J/K] of the tread that takes part
LEAST = 0.2  # of the grip that is left at any temperature


class TyreHeating(Effect):
    """Friction power heats the treads, they cool to the surroundings, and grip falls with their temperature."""

    id: ClassVar[str] = "tyre_heating"
    sentence: ClassVar[str] = "grip that falls as the tyres heat up"
    mistaken_for: ClassVar[tuple[str, ...]] = ("friction_change", "aero_downforce")
    internal_state: ClassVar[tuple[str, ...]] = ("heat_fl", "heat_fr", "heat_rl", "heat_rr")

    front: float = size("1/K", "relative loss of grip per kelvin, front", typical=0.003, low=-0.01, high=0.05)
    rear: float = size("1/K", "relative loss of grip per kelvin, rear", typical=0.003, low=-0.01, high=0.05)
    cooling_time: float = shape("s", "time constant of cooling", default=60.0, typical=30.0, low=5.0, high=1000.0)

    def friction(self, friction: ca.SX, corner: Corner, load: ca.SX, internal_state: ca.SX) -> ca.SX:
        return friction * ca.fmax(1 - of_axle(self, corner) * internal_state[corner.index], LEAST)

    def update(self, internal_state: ca.SX, car: MovingCar, h: ca.SX) -> ca.SX:
        powers = [
            c.tyre.longitudinal * (c.rolling_speed - c.touch.speed_x) - c.tyre.lateral * c.touch.speed_y
            for c in car.contacts
        ]
        heating = ca.vertcat(*powers) / HEAT_CAPACITY
        return internal_state + h * (heating - internal_state / self.cooling_time)

    def relaxed(self, internal_state: NDArray[np.float64], duration: float) -> NDArray[np.float64]:
        return internal_state * np.exp(-duration / self.cooling_time)
