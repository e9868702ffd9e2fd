"""A differential that couples the wheels of an axle."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from vsense_ros.model.coordinates import SPIN
from vsense_ros.model.effects.base import Effect, of_axle, shape, size
from vsense_ros.model.moving_car import Corner, MovingCar


class LimitedSlipDifferential(Effect):
    """A torque from the faster to the slower wheel of an axle, in proportion to the difference of their speeds until
    the clutch between them slips."""

    id: ClassVar[str] = "limited_slip_differential"
    sentence: ClassVar[str] = "a differential that couples left and right wheel"
    mistaken_for: ClassVar[tuple[str, ...]] = ("brake_drag", "tyre_load_sensitivity")
    needs: ClassVar[tuple[str, ...]] = ("wheel_speeds",)

    front: float = size("N m s/rad", "torque per difference of speed, front", typical=40.0, low=0.0, high=5000.0)
    rear: float = size("N m s/rad", "torque per difference of speed, rear", typical=40.0, low=0.0, high=5000.0)
    slipping: float = shape(
        "rad/s",
        "difference of speed from where on the torque hardly grows",
        default=6.0,
        typical=3.0,
        low=0.5,
        high=100.0,
    )

    def wheel_torque(self, torque: ca.SX, corner: Corner, car: MovingCar) -> ca.SX:
        difference = car.u[SPIN][corner.index] - car.u[SPIN][corner.opposite]
        return torque - of_axle(self, corner) * self.slipping * ca.tanh(difference / self.slipping)
