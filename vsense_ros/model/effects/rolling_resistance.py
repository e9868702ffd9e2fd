"""Rolling resistance beyond that of the vehicle file."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, VehicleFile, size
from vsense_ros.model.schema.physics import Axle


class RollingResistance(Effect):
    """A resistance of all tyres in proportion to the wheel load: soft ground, cold or worn tyres."""

    id: ClassVar[str] = "rolling_resistance"
    sentence: ClassVar[str] = "rolling resistance in proportion to the wheel loads"
    mistaken_for: ClassVar[tuple[str, ...]] = ("aero_drag", "road_grade", "brake_drag")
    needs: ClassVar[tuple[str, ...]] = ("wheel_torques",)

    coefficient: float = size("-", "added to the file's coefficients", typical=0.005, low=-0.008, high=0.3)

    @classmethod
    def prior(cls, vehicle: VehicleFile) -> dict[str, float]:
        return {"coefficient": 0.0007}  # a twentieth of what tyres have

    def wheel(self, wheel: int, axle: Axle) -> Axle:
        return axle.model_copy(update={"rolling_resistance": axle.rolling_resistance + self.coefficient})
