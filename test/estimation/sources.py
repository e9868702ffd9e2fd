"""A gyro of one axis that knows no car, and its messages: what the intake of a filter needs of a sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.messages.recording import Sample

SECOND = 1_000_000_000
DEVIATION = 0.1


@dataclass
class Gyro:
    """Two components, of which messages state the standard deviation if they have one."""

    topic: str = "gyro"
    message: str = "geometry_msgs/msg/Vector3Stamped"
    frame_id: str = "body"
    geodetic: bool = False
    noisy: bool = True
    states_noise: bool = True
    least_stated: float = 0.5
    latency: float = 0.0
    timeout: float = 1.0
    offset: float = 0.0

    def offsets(self) -> Array:
        return np.full(2, self.offset)

    def deviations(self) -> Array:
        return np.full(2, DEVIATION)

    def noise_in_words(self, deviations: Array) -> str:
        return f"{deviations[0]:g} rad/s"

    def read(self, names: tuple[str, ...], values: Mapping[str, Array], value: Array, variance: Array) -> None:
        value[:] = values["vector"][:2]
        if "stated" in values:
            variance[:] = values["stated"][:2]

    def read_rows(self, names: tuple[str, ...], columns: Mapping[str, Array], value: Array, variance: Array) -> None:
        value[:] = columns["vector"][:, :2]


def message(
    time: float, value: tuple[float, float] = (0.1, 0.2), *, arrival: float | None = None, **changes: object
) -> Sample:
    """A message of the gyro, measured at `time` [s]; its arrival is unknown unless it is given."""
    values = {"vector": np.array([*value, 0.0])}
    if (stated := changes.pop("stated", None)) is not None:
        values["stated"] = np.asarray(stated)
    fields = {"topic": "gyro", "kind": Gyro().message, "frame_id": "body", **changes}
    received = None if arrival is None else round(arrival * SECOND)
    return Sample(stamp=round(time * SECOND), values=values, received=received, **fields)  # type: ignore[arg-type]
