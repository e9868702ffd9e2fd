"""Outputs of a CAN mapping that are the motion of the whole car: its speed, GNSS, and optical sensors of velocity.

Their fields are those that the column mapping of a table has for the same topics. What a message does not give is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from vsense_ros.driver.can_mapped_signal import Output, Signal
from vsense_ros.driver.gnss import COVARIANCE_DIAGONAL_KNOWN, SERVICE_GPS, STATUS_FIX, GnssSettings
from vsense_ros.driver.samples import UNMEASURED_VARIANCE
from vsense_ros.messages.recording import FIELDS
from vsense_ros.messages.topics import TOPICS

Array = NDArray[np.float64]
Columns = Mapping[str, Array]
_DEFAULT = GnssSettings()


class MotionBase(Output):
    """An output whose fields are signals: those that are given together make a message."""

    forms: ClassVar[tuple[tuple[str, ...], ...]]  # fields of which one set has to be there
    units: ClassVar[Mapping[str, str]]  # SI unit of each field
    topic_of_kind: ClassVar[str]  # whose type and frames the messages have

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        """What `kind` says."""
        return get_args(cls.model_fields["kind"].annotation)

    @model_validator(mode="after")
    def _complete(self) -> MotionBase:
        given = self.named_signals()
        if not any(given.keys() >= set(form) for form in self.forms):
            forms = ", or ".join(" and ".join(form) for form in self.forms)
            raise ValueError(f"{self.topic} is made of {forms}; found {', '.join(given) or 'none of them'}")
        for name, signal in given.items():
            if signal.output_unit != self.units[name]:
                raise ValueError(f"{name} is in {self.units[name]}, but the signal gives {signal.output_unit}")
        return self

    @property
    def message_kind(self) -> str:
        return TOPICS[self.topic_of_kind].kind

    @property
    def frames(self) -> tuple[str, str]:
        """Frame and child frame of the messages."""
        return TOPICS[self.topic_of_kind].frame_id, TOPICS[self.topic_of_kind].child_frame_id

    def named_signals(self) -> dict[str, Signal]:
        """Signals by field."""
        signals = {name: getattr(self, name) for name in self.units}
        return {name: signal for name, signal in signals.items() if signal is not None}

    def is_whole(self, values: Mapping[str, object]) -> bool:
        """True if the values are enough for a message."""
        return any(values.keys() >= set(form) for form in self.forms)

    def columns(self, values: Mapping[str, Array]) -> Columns:
        """The fields of the messages (n, length) that values (n,) in SI make, NaN where there is none."""
        rows = len(next(iter(values.values())))
        empty = {field: np.zeros((rows, width)) for field, width in FIELDS[self.message_kind].items()}
        return empty | self._filled({name: values.get(name, np.full(rows, np.nan)) for name in self.units}, rows)

    def _filled(self, values: Mapping[str, Array], rows: int) -> dict[str, Array]:
        raise NotImplementedError

    def _variance(self, name: str, otherwise: float) -> float:
        signal = getattr(self, name)
        return float((signal.standard_deviation if signal else None) or otherwise) ** 2


def _diagonal(rows: int, variances: list[float]) -> Array:
    return np.tile(np.diag(variances).ravel(), (rows, 1))


class SpeedOutput(MotionBase):
    """The speed of the car: `vehicle/speed`, a geometry_msgs/TwistStamped."""

    forms = (("speed",),)
    units = MappingProxyType({"speed": "m/s"})
    topic_of_kind = "vehicle/speed"
    kind: Literal["speed"]
    topic: str = "vehicle/speed"
    speed: Signal | None = None

    def _filled(self, values: Mapping[str, Array], rows: int) -> dict[str, Array]:
        return {"linear": np.column_stack([values["speed"], np.zeros((rows, 2))])}


def _in_axes_of_car(values: Mapping[str, Array], rows: int) -> Array:
    """Velocity (n, 3) [m/s] of `forward` and `left`, or of `speed` and `side_slip`."""
    forward, left, speed, slip = (values[name] for name in ("forward", "left", "speed", "side_slip"))
    by_speed = np.isnan(forward)
    along = np.where(np.isnan(slip), speed, speed * np.cos(slip))
    return np.column_stack(
        [np.where(by_speed, along, forward), np.where(by_speed, speed * np.sin(slip), left), np.full(rows, np.nan)]
    )


_BODY_FORMS = (("forward",), ("speed",))
_BODY_UNITS = {"forward": "m/s", "left": "m/s", "speed": "m/s", "side_slip": "rad"}


class BodyVelocityOutput(MotionBase):
    """A velocity in the axes of the car: `vehicle/velocity`, a geometry_msgs/TwistWithCovarianceStamped."""

    forms = _BODY_FORMS
    units = _BODY_UNITS
    topic_of_kind = "vehicle/velocity"
    kind: Literal["body_velocity"]
    topic: str = "vehicle/velocity"
    forward: Signal | None = None
    left: Signal | None = None
    speed: Signal | None = None
    side_slip: Signal | None = None

    def _filled(self, values: Mapping[str, Array], rows: int) -> dict[str, Array]:
        return {"linear": _in_axes_of_car(values, rows)}


class OdometryOutput(MotionBase):
    """A reference of velocity, as an optical sensor gives it: `reference/odometry`, a nav_msgs/Odometry."""

    forms = _BODY_FORMS
    units = MappingProxyType({**_BODY_UNITS, "yaw_rate": "rad/s"})
    topic_of_kind = "reference/odometry"
    kind: Literal["odometry"]
    topic: str = "reference/odometry"
    forward: Signal | None = None
    left: Signal | None = None
    speed: Signal | None = None
    side_slip: Signal | None = None
    yaw_rate: Signal | None = None

    def _filled(self, values: Mapping[str, Array], rows: int) -> dict[str, Array]:
        unknown = np.zeros((rows, 36))
        unknown[:, [21, 28]] = np.nan
        nothing = np.full(rows, np.nan)
        return {
            "position": np.full((rows, 3), np.nan),
            "orientation": np.full((rows, 4), np.nan),
            "pose_covariance": unknown,
            "linear": _in_axes_of_car(values, rows),
            "angular": np.column_stack([nothing, nothing, values["yaw_rate"]]),
        }


class GnssFixOutput(MotionBase):
    """A position: `gps/fix`, a sensor_msgs/NavSatFix. A standard deviation is in metres."""

    forms = (("latitude", "longitude"),)
    units = MappingProxyType({"latitude": "rad", "longitude": "rad", "altitude": "m"})
    topic_of_kind = "gps/fix"
    kind: Literal["gnss_fix"]
    topic: str = "gps/fix"
    latitude: Signal | None = None
    longitude: Signal | None = None
    altitude: Signal | None = Field(default=None, description="above the ellipsoid")

    def _filled(self, values: Mapping[str, Array], rows: int) -> dict[str, Array]:
        error = _DEFAULT.range_error
        variances = [self._variance(name, error) for name in ("longitude", "latitude", "altitude")]
        known = getattr(self.latitude, "standard_deviation", None) is not None
        constants = {"status": STATUS_FIX, "service": SERVICE_GPS}
        constants["position_covariance_type"] = COVARIANCE_DIAGONAL_KNOWN if known else 0
        return {
            **{name: np.full((rows, 1), float(value)) for name, value in constants.items()},
            "latitude": np.degrees(values["latitude"])[:, None],
            "longitude": np.degrees(values["longitude"])[:, None],
            "altitude": values["altitude"][:, None],
            "position_covariance": _diagonal(rows, variances if known else [0.0] * 3),
        }


class GnssVelocityOutput(MotionBase):
    """A velocity over ground: `gps/velocity`, a geometry_msgs/TwistWithCovarianceStamped east, north, up.

    It is made of speed and course (clockwise from north), or of east and north.
    """

    forms = (("speed", "course"), ("east", "north"))
    units = MappingProxyType({"speed": "m/s", "course": "rad", "east": "m/s", "north": "m/s", "up": "m/s"})
    topic_of_kind = "gps/velocity"
    kind: Literal["gnss_velocity"]
    topic: str = "gps/velocity"
    speed: Signal | None = None
    course: Signal | None = None
    east: Signal | None = None
    north: Signal | None = None
    up: Signal | None = None

    def _filled(self, values: Mapping[str, Array], rows: int) -> dict[str, Array]:
        east, north = values["east"], values["north"]
        by_course = np.isnan(east) | np.isnan(north)
        east = np.where(by_course, values["speed"] * np.sin(values["course"]), east)
        north = np.where(by_course, values["speed"] * np.cos(values["course"]), north)
        # As of a receiver on a port: NaN would spread over all axes of who turns the vector.
        missing = np.isnan(values["up"])
        covariance = np.zeros((rows, 6, 6))
        name = "east" if self.east is not None else "speed"
        covariance[:, 0, 0] = covariance[:, 1, 1] = self._variance(name, _DEFAULT.speed_deviation)
        covariance[:, 2, 2] = np.where(missing, UNMEASURED_VARIANCE, self._variance("up", _DEFAULT.speed_deviation))
        covariance[:, [3, 4, 5], [3, 4, 5]] = UNMEASURED_VARIANCE
        return {
            "linear": np.column_stack([east, north, np.where(missing, 0.0, values["up"])]),
            "covariance": covariance.reshape(rows, 36),
        }


class GnssAttitudeOutput(MotionBase):
    """A heading of two antennas: `gps/attitude`, a sensor_msgs/Imu.

    It is `heading`, clockwise from north, or `yaw`, counter-clockwise from east.
    """

    forms = (("heading",), ("yaw",))
    units = MappingProxyType({"heading": "rad", "yaw": "rad"})
    topic_of_kind = "gps/attitude"
    kind: Literal["gnss_attitude"]
    topic: str = "gps/attitude"
    heading: Signal | None = None
    yaw: Signal | None = None

    def _filled(self, values: Mapping[str, Array], rows: int) -> dict[str, Array]:
        yaw = np.where(np.isnan(values["yaw"]), math.pi / 2 - values["heading"], values["yaw"])
        variance = self._variance("yaw" if self.yaw is not None else "heading", _DEFAULT.heading_deviation)
        absent = np.tile([-1.0] + [0.0] * 8, (rows, 1))
        zero = np.zeros(rows)
        return {
            "orientation": np.column_stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)]),
            "orientation_covariance": _diagonal(rows, [UNMEASURED_VARIANCE, UNMEASURED_VARIANCE, variance]),
            "angular_velocity_covariance": absent,
            "linear_acceleration_covariance": absent,
        }


MotionOutput = (
    SpeedOutput | BodyVelocityOutput | OdometryOutput | GnssFixOutput | GnssVelocityOutput | GnssAttitudeOutput
)
MOTION_OUTPUTS: tuple[type[MotionBase], ...] = get_args(MotionOutput)
