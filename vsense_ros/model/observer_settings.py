"""Settings of the observer that a vehicle file may change."""

from __future__ import annotations

from vsense_ros.model.parameter import Part, parameter


class ForceErrors(Part):
    """How far the model's generalized forces may be wrong, as the standard deviation of the acceleration they cause."""

    longitudinal: float = parameter("m/s²", "along x", ge=0, default=0.5)
    lateral: float = parameter("m/s²", "along y", ge=0, default=0.5)
    vertical: float = parameter("m/s²", "along z", ge=0, default=0.3)
    roll: float = parameter("rad/s²", "about x", ge=0, default=0.3)
    pitch: float = parameter("rad/s²", "about y", ge=0, default=0.3)
    yaw: float = parameter("rad/s²", "about z", ge=0, default=0.3)
    suspension: float = parameter("m/s²", "on the travel of each wheel", ge=0, default=1.0)
    wheel_spin: float = parameter("rad/s²", "on the spin of each wheel where its torque is unknown", ge=0, default=30.0)
    time_constant: float = parameter("s", "correlation time of the errors", gt=0, default=0.5)
    wheel_spin_time_constant: float = parameter("s", "correlation time on the wheels", gt=0, default=0.5)


class Surroundings(Part):
    """How far road, steering offset and tyre radius may be from what is assumed."""

    grade: float = parameter("rad", "standard deviation of the slope along the road", ge=0, default=0.02)
    grade_time_constant: float = parameter("s", "its correlation time", gt=0, default=10.0)
    bank: float = parameter("rad", "standard deviation of the slope across the road", ge=0, default=0.01)
    bank_time_constant: float = parameter("s", "its correlation time", gt=0, default=10.0)
    steering_offset: float = parameter("rad", "standard deviation of the road-wheel angle's offset", ge=0, default=0.01)
    steering_offset_drift: float = parameter("rad", "its change in one second", ge=0, default=1e-5)
    radius_error: float = parameter(
        "-", "standard deviation of the relative error of the tyre radius", ge=0, default=0.01
    )
    radius_error_drift: float = parameter("-", "its change in one second", ge=0, default=1e-6)


class ObserverSettings(Part):
    """The errorEKF's settings."""

    longest_step: float = parameter("s", "longest time step of the prediction", gt=0, le=0.05, default=0.01)
    merge_window: float = parameter(
        "s", "measurements this close are taken as simultaneous", ge=0, le=0.02, default=0.002
    )
    history: float = parameter(
        "s", "how late a measurement may come and still be used in its place", ge=0, le=5, default=0.5
    )
    force_errors: ForceErrors = ForceErrors()
    surroundings: Surroundings = Surroundings()
