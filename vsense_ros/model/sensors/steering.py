"""Steering angle sensor: an input of the model, whose offset the observer estimates."""

from __future__ import annotations

from math import pi
from typing import ClassVar, Literal

import numpy as np

from vsense_ros.model.coordinates import STEERING
from vsense_ros.model.parameter import parameter
from vsense_ros.model.schema.physics import NominalPhysics
from vsense_ros.model.sensors.base import MeasuredQuantity, Names, Response, SensorBase, Values, Vector, joint_state
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive


class Steering(SensorBase):
    """Road-wheel angle [rad]; where only the steering wheel is measured, the vehicle's ratio converts it."""

    message: ClassVar[str] = "sensor_msgs/msg/JointState"
    joints: ClassVar[Names] = ("steering_wheel", "road_wheel_front")
    place: ClassVar[int] = 3
    words: ClassVar[str] = "a steering angle"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"steering"})
    inputs: ClassVar[slice | None] = slice(STEERING, STEERING + 1)
    awaited: ClassVar[float] = 5.0
    sampling: ClassVar[Sampling | None] = Sampling(10, 2, 2, (2**-10,))
    # More than this lateral acceleration cornering does not bring about.
    response: ClassVar[Response | None] = Response(2, by_speed=True, least=1.5, words="the steering angle is")

    kind: Literal["steering"] = "steering"
    topic: str = "vehicle/steering"
    ratio: float | None = parameter("-", "steering-wheel over road-wheel angle; default: the vehicle's", default=None)
    gain: float = parameter("-", "true road-wheel angle over the reported one", gt=0, lt=10, default=1.0)
    limit: float = parameter("rad", "road-wheel angles beyond this are refused", gt=0, default=0.9)
    # As an input of the model it has no noise. Defaults: Leung 2010, table B.1.
    simulated_noise: float = parameter(
        "rad", "standard deviation at the steering wheel, in a simulation", ge=0, default=1.0 * pi / 180
    )
    simulated_bias: float = parameter(
        "rad", "standard deviation of the constant error at the steering wheel, in a simulation", ge=0,
        default=5.0 * pi / 180,
    )  # fmt: skip

    def of_car(self, physics: NominalPhysics) -> SensorBase:
        return self if self.ratio is not None else self.model_copy(update={"ratio": physics.steering.ratio})

    def deviations(self) -> Vector:
        return np.zeros(1)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        self._read_angle(names, values, out)
        if abs(out[0]) > self.limit:
            out[0] = np.nan

    def read_rows(self, names: Names, columns: Values, out: Vector, variance: Vector) -> None:
        self._read_angle(names, {field: column.T for field, column in columns.items()}, out.T)
        out[np.abs(out) > self.limit] = np.nan

    def _read_angle(self, names: Names, values: Values, out: Vector) -> None:
        """Fill `out` (1,) or (1, n) with the angle of the road wheels in one or n messages, however large."""
        out[0] = np.nan
        position = values.get("position")
        if position is None or len(position) != len(names):
            return
        if "road_wheel_front" in names:
            out[0] = self.gain * position[names.index("road_wheel_front")]
        elif "steering_wheel" in names and self.ratio is not None:
            out[0] = self.gain * position[names.index("steering_wheel")] / self.ratio

    def simulated(self, drive: SimulatedDrive) -> Content:
        """Messages of the angle of the steering wheel. Raises `ValueError` if the steering ratio is not known."""
        if self.ratio is None:
            raise ValueError("a steering sensor without a ratio cannot be simulated; `of_car` gives it the vehicle's")
        angle = self.ratio * drive.truth + drive.bias * self.simulated_bias * drive.rng.standard_normal()
        angle = angle + self.simulated_noise * drive.rng.standard_normal(angle.shape)
        return joint_state("position", drive.digitized(angle), ("steering_wheel",))
