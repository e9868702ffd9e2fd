"""What sensors of a GNSS receiver have in common."""

from __future__ import annotations

import numpy as np

from vsense_ros.model.parameter import parameter
from vsense_ros.model.sensors.base import Position, SensorBase, Values, Vector
from vsense_ros.model.sensors.simulated import Content, SimulatedDrive


class Receiver(SensorBase):
    """Measures at a low rate, and not at all under a bridge."""

    timeout: float = parameter("s", "silence after which the sensor counts as lost", gt=0, default=2.5)


class Antenna(Receiver):
    """A sensor that measures how one antenna moves."""

    position: Position = parameter("m", "antenna in the axes of cog", default=(0.0, 0.0, 0.0))

    def mounting(self) -> Vector:
        return np.array(self.position)


def orientation_in(values: Values) -> Vector | None:
    """The unit quaternion x, y, z, w (4,) of a sensor_msgs/Imu; None where its covariance says that there is none, or
    where it is no rotation, as all zeros are not."""
    orientation, flat = values["orientation"], values.get("orientation_covariance")
    square = float(orientation @ orientation)
    if (flat is not None and len(flat) and flat[0] == -1) or not 0.25 < square < 4:
        return None
    return np.asarray(orientation / np.sqrt(square))


def orientation_message(drive: SimulatedDrive, orientation: Vector, variances: tuple[float, float, float]) -> Content:
    """A sensor_msgs/Imu that has no more than quaternions x, y, z, w (n, 4), with variances of roll, pitch and yaw
    [rad²]."""
    absent = drive.repeated([-1, *[0] * 8])
    return Content(
        {
            "orientation": drive.digitized(orientation),
            "orientation_covariance": drive.repeated(np.diag(variances).ravel()),
            "angular_velocity": drive.repeated([0, 0, 0]),
            "angular_velocity_covariance": absent,
            "linear_acceleration": drive.repeated([0, 0, 0]),
            "linear_acceleration_covariance": absent,
        }
    )
