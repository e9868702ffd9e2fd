"""Wheel speed sensors: spin of each wheel relative to its hub."""

from __future__ import annotations

from statistics import median
from typing import ClassVar, Literal

import casadi as ca
import numpy as np

from vsense_ros.model.coordinates import SPIN, WHEELS
from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import parameter
from vsense_ros.model.schema.observer_settings import Disturbances
from vsense_ros.model.schema.physics import NominalPhysics
from vsense_ros.model.sensors.base import (
    Bias,
    ComparedSignal,
    Component,
    JointSensor,
    MeasuredQuantity,
    Names,
    Quantity,
    Values,
    Vector,
    by_name,
    joint_state,
)
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive

NAMES = tuple(f"wheel_{wheel}" for wheel in WHEELS)
SPREAD = 0.3  # share of the error of the radius that wheels of a car do not have in common: wear, pressure, load
LOADED = 0.98  # rolling radius of a tyre under a car over its unloaded one, about


def _mean_speed(value: Vector, radius: float) -> Vector:
    return np.asarray(radius * value.mean(axis=1))


def _difference_front(value: Vector, radius: float) -> Vector:
    return radius * (value[:, 0] - value[:, 1])


def _difference_rear(value: Vector, radius: float) -> Vector:
    return radius * (value[:, 2] - value[:, 3])


def _difference_axles(value: Vector, radius: float) -> Vector:
    return radius * (value[:, 0] + value[:, 1] - value[:, 2] - value[:, 3]) / 2


class WheelSpeeds(JointSensor):
    """Spin speeds [rad/s]; any wheel may be absent, and one that reads zero has the variance noise² + lowest²."""

    joints: ClassVar[Names] = NAMES
    field: ClassVar[str] = "velocity"
    place: ClassVar[int] = 2
    words: ClassVar[str] = "wheel speeds"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset({"rolling speed"})
    quantities: ClassVar[tuple[Quantity, ...]] = tuple(
        Quantity(f"angular_velocity.{w}", "rad/s", f"of the wheel {w} about its axle, positive forward") for w in WHEELS
    )
    components: ClassVar[tuple[Component, ...]] = tuple(Component(w, f"speed of the wheel {w}") for w in WHEELS)
    signals: ClassVar[tuple[ComparedSignal, ...]] = (
        ComparedSignal("speed", "m/s", _mean_speed, 0.05),
        ComparedSignal("wheel_difference_front", "m/s", _difference_front, 0.02),
        ComparedSignal("wheel_difference_rear", "m/s", _difference_rear, 0.02),
        ComparedSignal("wheel_difference_axles", "m/s", _difference_axles, 0.02),
    )
    sampling: ClassVar[Sampling | None] = Sampling(10, 1, 2, (2**-6,))
    longest_still: ClassVar[float] = 2.0

    kind: Literal["wheel_speeds"] = "wheel_speeds"
    topic: str = "vehicle/wheel_speeds"
    noise: float = parameter("rad/s", "standard deviation", gt=0, default=0.05)
    lowest: float = parameter(
        "rad/s", "slowest speed that it measures: zero stands for any that is slower, with this standard deviation "
        "(passive sensors 2 to 5, active ones 0 to 2)", ge=0, le=20, default=2.0,
    )  # fmt: skip
    radius_error: float | None = parameter(
        "-", "standard deviation of the relative error of each wheel's radius beyond that which all have in common; "
        f"default: {SPREAD:g} of observer.surroundings.radius_error", ge=0, default=None,
    )  # fmt: skip
    radius_error_drift: float | None = parameter(
        "-", f"its change in one second; default: {SPREAD:g} of observer.surroundings.radius_error_drift", ge=0,
        default=None,
    )  # fmt: skip

    def of_surroundings(self, around: Disturbances) -> WheelSpeeds:
        error, drift = self.radius_error, self.radius_error_drift
        errors = {
            "radius_error": SPREAD * around.radius_error if error is None else error,
            "radius_error_drift": SPREAD * around.radius_error_drift if drift is None else drift,
        }
        return self.model_copy(update=errors)

    def biases(self) -> tuple[Bias, ...]:
        if not self.radius_error:
            return ()
        return tuple(Bias(f"radius_error_{w}", self.radius_error, self.radius_error_drift or 0.0) for w in WHEELS)

    def deviations(self) -> Vector:
        return np.full(len(self.joints), self.noise)

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        super().read(names, values, out, variance)
        if 0.0 in out.tolist():
            variance[out == 0] += self.lowest**2

    def read_rows(self, names: Names, columns: Values, out: Vector, variance: Vector) -> None:
        if type(self).read is not WheelSpeeds.read:  # a kind that reads its messages otherwise
            super().read_rows(names, columns, out, variance)
            return
        by_name(names, self.joints, columns[self.field].T, out.T)
        variance[out == 0] += self.lowest**2

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        return motion.spin * (1 - biases) if biases.numel() else motion.spin

    def simulated(self, drive: SimulatedDrive) -> Content:
        """The truth and noise: radii of a simulated car are those of its vehicle file."""
        value = drive.truth + self.deviations() * drive.rng.standard_normal(drive.truth.shape)
        measured = np.where(np.abs(value) < self.lowest, 0.0, value)
        return joint_state(self.field, drive.digitized(measured), self.joints)

    def first_speed(self, value: Vector, physics: NominalPhysics) -> float | None:
        """By the median of the wheels that are there, of which one may be wrong."""
        present = [spin for spin in value.tolist() if spin == spin]
        return median(present) * physics.rear.unloaded_radius * LOADED if present else np.nan

    def first_velocities(self, value: Vector) -> dict[int, float]:
        return {SPIN.start + i: spin for i, spin in enumerate(value.tolist()) if np.isfinite(spin)}

    def speeds(self, value: Vector, radii: Vector) -> Vector:
        """The median of the wheels that are there."""
        rolling, speeds = value * radii, np.full(len(value), np.nan)
        present = np.isfinite(rolling).any(axis=1)
        speeds[present] = np.nanmedian(rolling[present], axis=1)
        return speeds

    def mean_speed(self, value: Vector, radius: float) -> Vector:
        return _mean_speed(value, radius)
