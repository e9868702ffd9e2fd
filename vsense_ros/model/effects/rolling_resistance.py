"""Rolling resistance beyond that of the vehicle file."""

from __future__ import annotations

from types import SimpleNamespace
from typing import ClassVar

from vsense_ros.model.effects.base import Effect, changed, size


class RollingResistance(Effect):
    """A resistance of all tyres in proportion to the wheel load: soft ground, cold or worn tyres."""

    id: ClassVar[str] = "rolling_resistance"
    sentence: ClassVar[str] = "rolling resistance in proportion to the wheel loads"
    excited_by: ClassVar[tuple[str, ...]] = ("coast-down", "driving at constant speed")
    mistaken_for: ClassVar[tuple[str, ...]] = ("aero_drag", "road_grade", "brake_drag")
    needs: ClassVar[tuple[str, ...]] = ("wheel_torques",)

    coefficient: float = size("-", "added to the file's coefficients", typical=0.005, low=-0.02, high=0.3)

    def wheel(self, wheel: int, axle: SimpleNamespace) -> SimpleNamespace:
        return changed(axle, rolling_resistance=axle.rolling_resistance + self.coefficient)
