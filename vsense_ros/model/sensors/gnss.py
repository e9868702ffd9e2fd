"""What sensors of a GNSS receiver have in common."""

from __future__ import annotations

import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import Position, SensorBase, Vector


class Receiver(SensorBase):
    """Measures at a low rate, and not at all under a bridge."""

    timeout: float = parameter("s", "silence after which the sensor counts as lost", gt=0, default=2.5)


class Antenna(Receiver):
    """A sensor that measures how one antenna moves."""

    position: Position = parameter("m", "antenna in the axes of cog", default=(0.0, 0.0, 0.0))

    def mounting(self) -> Vector:
        return np.array(self.position)
