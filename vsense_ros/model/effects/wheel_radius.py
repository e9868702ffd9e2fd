"""A wheel of another size than the vehicle file says."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.effects.base import Effect, size
from vsense_ros.model.schema.physics import Axle


class WheelRadius(Effect):
    """A tyre radius that differs on one wheel: wear, a spare wheel, a wrong figure."""

    id: ClassVar[str] = "wheel_radius"
    sentence: ClassVar[str] = "a wheel of another radius"
    mistaken_for: ClassVar[tuple[str, ...]] = ("tyre_underinflation",)
    needs: ClassVar[tuple[str, ...]] = ("wheel_speeds",)

    fl: float = size("-", "relative error of the radius, front left", typical=0.01, high=0.2)
    fr: float = size("-", "relative error of the radius, front right", typical=0.01, high=0.2)
    rl: float = size("-", "relative error of the radius, rear left", typical=0.01, high=0.2)
    rr: float = size("-", "relative error of the radius, rear right", typical=0.01, high=0.2)

    def wheel(self, wheel: int, axle: Axle) -> Axle:
        return axle.model_copy(update={"unloaded_radius": axle.unloaded_radius * (1 + getattr(self, WHEELS[wheel]))})
