"""Settings of the observer that a vehicle file may change."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, model_validator

from vsense_ros.model.parameter import Part, parameter

_FORMER = frozenset({"grade_time_constant", "bank_time_constant"})


class ForceErrors(Part):
    """How far the model's generalized forces may be wrong, as the standard deviation of the acceleration they cause.

    What is wrong along and across the car are the forces of the tyres: they act on the road, and turn the body too."""

    longitudinal: float = parameter("m/s²", "along x", ge=0, default=0.5)
    unmeasured_drive: float = parameter(
        "m/s²", "along x, besides, where nothing measures wheels or their torques: engine and brakes", ge=0, default=3.0
    )
    lateral: float = parameter("m/s²", "along y", ge=0, default=0.5)
    vertical: float = parameter("m/s²", "along z", ge=0, default=0.1)
    roll: float = parameter("rad/s²", "about x, besides what the lateral one turns", ge=0, default=0.1)
    pitch: float = parameter("rad/s²", "about y, besides what the longitudinal one turns", ge=0, default=0.1)
    yaw: float = parameter("rad/s²", "about z", ge=0, default=0.3)
    suspension: float = parameter("m/s²", "on the travel of each wheel", ge=0, default=1.0)
    wheel_spin: float = parameter("rad/s²", "on the spin of each wheel where its torque is unknown", ge=0, default=30.0)
    time_constant: float = parameter("s", "correlation time of the errors", gt=0, default=0.5)
    wheel_spin_time_constant: float = parameter("s", "correlation time on the wheels", gt=0, default=0.5)


class Disturbances(Part):
    """How far road, steering offset and tyre radius may be from what is assumed."""

    grade: float = parameter("rad", "standard deviation of the slope along the road", ge=0, default=0.03)
    bank: float = parameter("rad", "standard deviation of the slope across the road", ge=0, default=0.015)
    grade_change: float = parameter(
        "rad/m", "standard deviation of the change of the grade along the road: its curvature", ge=0,
        default=1e-3,
    )  # fmt: skip
    bank_change: float = parameter(
        "rad/m", "standard deviation of the change of the bank along the road: its twist", ge=0, default=1e-3
    )
    change_length: float = parameter("m", "distance along which such a change persists", gt=0, default=20.0)
    steering_offset: float = parameter("rad", "standard deviation of the road-wheel angle's offset", ge=0, default=0.01)
    steering_offset_drift: float = parameter("rad", "its change in one second", ge=0, default=1e-5)
    radius_error: float = parameter(
        "-", "standard deviation of the relative error of the tyre radius", ge=0, default=0.01
    )
    radius_error_drift: float = parameter("-", "its change in one second", ge=0, default=1e-6)
    load: float = parameter(
        "kg", "standard deviation of what the car weighs beyond the file; it counts in the deviations of tyre forces "
        "alone", ge=0, default=100.0,
    )  # fmt: skip

    @model_validator(mode="before")
    @classmethod
    def _without_what_it_had(cls, settings: Any) -> Any:
        """Accepts files from the time when slopes returned to their means by time instead of by distance: their keys
        for it are ignored."""
        if not isinstance(settings, dict):
            return settings
        return {name: value for name, value in settings.items() if name not in _FORMER}


class UnseenErrors(Part):
    """Errors that last for minutes and that innovations do not show: they widen what is published of the state."""

    rear_axle_direction: float = parameter(
        "rad", "standard deviation of the direction in which the rear axle rolls: thrust angle, toe, roll steer", ge=0,
        default=0.002,
    )  # fmt: skip
    rear_slip: float = parameter(
        "-", "standard deviation of what load and stiffness of the tyres do to the slip angle of the rear axle, as a "
        "share of it", ge=0, le=1, default=0.1,
    )  # fmt: skip
    timing: float = parameter("s", "standard deviation of the time of the stamps", ge=0, default=0.008)
    yaw_rate: float = parameter(
        "rad/s", "standard deviation of what scale, mounting and bandwidth of a gyro do to the yaw rate", ge=0,
        default=0.0015,
    )  # fmt: skip
    position_share: float = parameter(
        "-", "share of the noise of GNSS positions that lasts for minutes, and no averaging takes away", ge=0, le=1,
        default=0.2,
    )  # fmt: skip
    crossfall: float = parameter(
        "rad", "standard deviation of the lean of road and inertial sensor that lasts all along", ge=0, default=0.02
    )
    antenna: float = parameter(
        "m", "standard deviation of the place of GNSS antennas along the car, until courses in bends show it", ge=0,
        default=1.0,
    )  # fmt: skip


class EstimatedParameter(Part):
    """A physical parameter that the observer estimates along with the state; the file's value is its mean at start."""

    deviation: float = parameter(
        "of the parameter", "standard deviation of the file's value; may be left out where `uncertainty` has it", gt=0
    )
    lower: float | None = Field(
        description="least value; default: four standard deviations below the file's", default=None,
        json_schema_extra={"unit": "of the parameter"},
    )  # fmt: skip
    upper: float | None = Field(
        description="largest value; default: four standard deviations above the file's", default=None,
        json_schema_extra={"unit": "of the parameter"},
    )  # fmt: skip
    drift: float = parameter("of the parameter", "standard deviation of its change in one second", ge=0, default=0.0)

    @model_validator(mode="after")
    def _bounds_in_order(self) -> EstimatedParameter:
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError(f"lower {self.lower:g} must be less than upper {self.upper:g}")
        return self

    def bounds(self, value: float) -> tuple[float, float]:
        """Least and largest value of a parameter whose value in the file is this."""
        lower = value - 4 * self.deviation if self.lower is None else self.lower
        return lower, value + 4 * self.deviation if self.upper is None else self.upper


class ObserverSettings(Part):
    """The observer's settings: the errorEKF's, and which physical parameters a second filter estimates beside it."""

    longest_step: float = parameter("s", "longest time step of the prediction", gt=0, le=0.05, default=0.01)
    merge_window: float = parameter(
        "s", "measurements closer in time than this count as simultaneous", ge=0, le=0.02, default=0.002
    )
    history: float = parameter(
        "s", "largest delay with which a measurement is still used at its time", ge=0, le=5, default=0.5
    )
    force_errors: ForceErrors = ForceErrors()
    surroundings: Disturbances = Disturbances()
    unseen: UnseenErrors = UnseenErrors()
    parameters: dict[str, EstimatedParameter] = Field(
        description="physical parameters to be estimated, by their names below `physics`", default_factory=dict
    )
    parameter_filter: Literal["ekf", "ukf"] = Field(
        description="how the sensitivities to these parameters are computed: exact derivatives, or sigma points",
        default="ekf",
    )
