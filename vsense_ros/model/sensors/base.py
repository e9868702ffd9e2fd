"""What all sensors have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from vsense_ros.model.parameter import Part, parameter

if TYPE_CHECKING:
    from vsense_ros.model.car.car import Motion

Vector = NDArray[np.float64]
Names = tuple[str, ...]  # of the joints in a JointState
Values = Mapping[str, Vector]  # fields of a message by name

Length = Annotated[float, Field(ge=-20, le=20)]
Angle = Annotated[float, Field(ge=-6.2832, le=6.2832)]
Deviation = Annotated[float, Field(gt=0)]
Triple = tuple[float, float, float]
Position = tuple[Length, Length, Length]
Attitude = tuple[Angle, Angle, Angle]
Deviations = tuple[Deviation, Deviation, Deviation]
NoiseFromMessage = Annotated[
    bool, Field(description="covariances that messages state count instead of the standard deviations here")
]


@dataclass(frozen=True)
class Bias:
    """A slowly varying error of a sensor: a random walk, or a decaying one where `time_constant` is finite.

    `deviation` is the standard deviation at start, `drift` that of the change after one second (random walk), or
    ignored where a time constant [s] keeps the standard deviation at `deviation`.
    """

    name: str
    deviation: float
    drift: float
    time_constant: float = float("inf")


class SensorBase(Part):
    """Where a sensor's messages come from and how far they can be trusted."""

    message: ClassVar[str] = ""  # message type
    uses_acceleration: ClassVar[bool] = False  # True: the equation refers to the accelerations
    is_input: ClassVar[bool] = False  # True: the values drive the model instead of correcting it

    kind: str = Field(description="what it is")
    topic: str = Field(description="topic of its messages")
    frame_id: str = Field(default="", description="expected frame of the messages; empty: any")
    latency: float = parameter("s", "age of a measurement at its stamp", ge=-1, le=2, default=0.0)
    gate: float = parameter(
        "-", "a measurement is refused beyond this many standard deviations of its innovation", gt=0, default=6.0
    )
    timeout: float = parameter("s", "silence after which the sensor counts as lost", gt=0, default=0.5)

    def biases(self) -> tuple[Bias, ...]:
        """Errors to be estimated along with the state."""
        return ()

    def mounting(self) -> Vector:
        """Constants of the sensor's equation, (k,)."""
        return np.zeros(0)

    def deviations(self) -> Vector:
        """Standard deviation of each component where a message does not give one, (m,)."""
        raise NotImplementedError

    def offsets(self) -> Vector:
        """Known errors of the components, which whoever calls `read` takes off, (m,)."""
        return np.zeros(len(self.deviations()))

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        """Fill `out` (m,) and `variance` (m,) from the fields of a message; NaN marks an absent component."""
        raise NotImplementedError

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        """What the sensor would measure, (m,), as a function of a `Motion`."""
        raise NotImplementedError


def covariance_diagonal(flat: Vector | None, size: int) -> Vector | None:
    """Diagonal of a row-major covariance, or None where it is absent (-1) or unknown (zeros)."""
    return None if flat is None else _diagonal(flat.tobytes(), size)


@lru_cache(maxsize=64)
def _diagonal(flat: bytes, size: int) -> Vector | None:
    """Kept, because most sensors send the same covariance for ever."""
    covariance = np.frombuffer(flat)
    if len(covariance) == 0 or covariance[0] <= 0:
        return None
    diagonal = covariance[:: int(len(covariance) ** 0.5) + 1][:size]
    return diagonal if diagonal.min() > 0 else None


def by_name(names: Names, wanted: Names, values: Vector | None, out: Vector) -> None:
    """Pick the elements of a JointState's field by joint name; NaN where a joint is missing."""
    if values is not None and names == wanted and len(values) == len(names):
        out[:] = values
        return
    out[:] = np.nan
    if values is None or len(values) != len(names):
        return
    for i, name in enumerate(wanted):
        if name in names:
            out[i] = values[names.index(name)]
