"""A GNSS antenna that sits elsewhere."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.effects.base import Effect, of_kind, size
from vsense_ros.model.sensors import GnssPosition, GnssVelocity, SensorBase


class GnssLeverArm(Effect):
    """The antenna's place differs from that which the vehicle file gives."""

    id: ClassVar[str] = "gnss_lever_arm"
    sentence: ClassVar[str] = "a GNSS antenna that sits elsewhere than the vehicle file says"
    changes_sides: ClassVar[tuple[str, ...]] = ("y",)
    mistaken_for: ClassVar[tuple[str, ...]] = ("sensor_delay",)
    needs: ClassVar[tuple[str, ...]] = ("gnss_velocity",)

    x: float = size("m", "added to the place of the antenna, forward", typical=0.5, high=10.0)
    y: float = size("m", "added to the place of the antenna, to the left", typical=0.5, high=5.0)

    def sensors(self, sensors: dict[str, SensorBase]) -> dict[str, SensorBase]:
        def moved(antenna: GnssPosition | GnssVelocity) -> dict[str, object]:
            x, y, z = antenna.position
            return {"position": (x + self.x, y + self.y, z)}

        return of_kind(of_kind(sensors, "gnss_position", moved), "gnss_velocity", moved)
