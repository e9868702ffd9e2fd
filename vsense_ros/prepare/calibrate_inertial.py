"""Mounting of the inertial sensor: how it leans and points, and what its accelerometers read too much.

A sensor that leans by small angles (φ, θ, ψ) reads v - a x v of a vector v in the axes of the car. Of a turn its gyros
read (-θ r, φ r), whatever the road; its accelerometers read (-θ g, φ g) on a level road, and beside that their bias.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.estimation.regression import Posterior, posterior
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.sensors import Imu
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrate_course import compliance, relative_compliance
from vsense_ros.prepare.calibrated import Calibrated, Change
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive

Array = NDArray[np.float64]

_ADVICE = "braking and accelerating straight ahead, and bends in both directions, on a level road, with GNSS"
_AXES = ("roll", "pitch", "yaw")


def inertial(drives: Sequence[CalibrationDrive], car: Vehicle) -> Iterator[Calibrated]:
    """Roll, pitch and yaw of the mounting, and offsets of the accelerometers."""
    sensor = next(((name, s) for name, s in car.sensors.items() if isinstance(s, Imu)), None)
    if sensor is None or all(np.isnan(drive.forces[:, :2]).all() for drive in drives):
        return
    name, imu = sensor
    forward, leftward = _forward(drives, imu), _left(drives, car, imu)
    if forward is None or leftward is None:
        return
    has_all_axes = any(np.isfinite(drive.forces[:, 2]).any() for drive in drives)
    yaw = _joined((-leftward.values[2], leftward.deviations[2]), (forward.values[2], forward.deviations[2]))
    tilts, offsets = [], []
    for k, (post, sign, slope) in enumerate(
        ((leftward, 1.0, CALIBRATION.crossfall), (forward, -1.0, _mean_grade(drives, car)))
    ):
        by_gyro = _tilt_by_gyro(drives, k, leftward) if has_all_axes else None
        tilt, offset = _tilt_and_offset(post, sign * GRAVITY, slope, by_gyro, imu.force_bias, has_all_axes)
        tilts.append(tilt)
        offsets.append(offset)
    if has_all_axes:
        yield from _mounting(name, imu, [*tilts, yaw])
    for axis, words, (value, deviation) in ((0, "longitudinal", offsets[1]), (1, "lateral", offsets[0])):
        before = imu.force_offset[axis]
        prior = max(imu.force_bias, GRAVITY * CALIBRATION.tilt_deviation * (not has_all_axes))
        yield Calibrated(
            f"offset of the {words} accelerometer", "m/s²", before, value, prior, deviation,
            {f"sensors.{name}.force_offset.{axis}": Change(round(value, 4), deviation)}, _ADVICE,
        )  # fmt: skip


def _left(drives: Sequence[CalibrationDrive], car: Vehicle, imu: Imu) -> Posterior | None:
    """Lateral force on constant, V r, dV/dt, dr/dt and V² dr/dt."""
    blocks: list[tuple[Array, Array]] = []
    for drive in drives:
        speed, rate = drive.speed, drive.yaw_rate
        turning = drive.slope(rate)
        x = np.column_stack([np.ones(len(speed)), speed * rate, drive.slope(speed), turning, speed**2 * turning])
        blocks += drive.blocks(x, drive.smooth(drive.forces[:, 1]), drive.driving)
    slip = compliance(car, "rear")
    arm = car.physics.chassis.cog_to_rear_axle + imu.position[0]
    prior = np.array(
        [
            GRAVITY * CALIBRATION.tilt_deviation,
            CALIBRATION.rolling_deviation,
            CALIBRATION.tilt_deviation,
            CALIBRATION.arm_deviation,
            relative_compliance(car, "rear") * slip,
        ]
    )
    return posterior(blocks, np.array([0.0, 1.0, 0.0, arm, -slip]), prior) if blocks else None


def _forward(drives: Sequence[CalibrationDrive], imu: Imu) -> Posterior | None:
    """Longitudinal force on constant, dV/dt, V r and r²."""
    blocks: list[tuple[Array, Array]] = []
    for drive in drives:
        speed, rate = drive.speed, drive.yaw_rate
        x = np.column_stack([np.ones(len(speed)), drive.slope(speed), speed * rate, rate**2])
        blocks += drive.blocks(x, drive.smooth(drive.forces[:, 0]), drive.driving)
    prior = np.array(
        [
            GRAVITY * CALIBRATION.tilt_deviation,
            CALIBRATION.rolling_deviation,
            CALIBRATION.tilt_deviation,
            2 * CALIBRATION.arm_deviation,
        ]
    )
    return posterior(blocks, np.array([0.0, 1.0, 0.0, -imu.position[0]]), prior) if blocks else None


def _mean_grade(drives: Sequence[CalibrationDrive], car: Vehicle) -> float:
    """Standard deviation of the mean grade of drives [rad], by that of a grade at one place and how far they go."""
    distance = sum(float(np.nansum(np.where(drive.driving, drive.speed, 0.0))) for drive in drives) * CALIBRATION.step
    length = CALIBRATION.grade_length
    return float(car.observer.surroundings.grade * np.sqrt(length / (length + distance)))


def _tilt_by_gyro(drives: Sequence[CalibrationDrive], axis: int, leftward: Posterior) -> tuple[float, float] | None:
    """Roll (axis 0) or pitch (1) of the mounting by what the gyro across reads of turns, with its deviation [rad].

    The body leans in a turn as well, in proportion to the lateral force, of which `leftward` says by how much. A gyro
    that is not exactly across reads a share of the turn, too, which no drive can distinguish from a tilt.
    """
    axis_across, sign = (1, 1.0) if axis == 0 else (0, -1.0)
    leaning = (leftward.values[1] - 1) / GRAVITY if axis == 0 else 0.0
    blocks: list[tuple[Array, Array]] = []
    for drive in drives:
        rate = drive.yaw_rate
        lateral = drive.speed * rate
        x = np.column_stack([rate, np.ones(len(rate)), drive.slope(lateral), lateral * rate])
        blocks += drive.blocks(x, drive.smooth(drive.rates[:, axis_across]), drive.driving)
    if not blocks:
        return None
    prior = np.array(
        [
            CALIBRATION.tilt_deviation,
            CALIBRATION.gyro_bias_deviation,
            CALIBRATION.leaning_deviation,
            max(leftward.deviations[1] / GRAVITY, 1e-4),
        ]
    )
    estimated = posterior(blocks, np.array([0.0, 0.0, 0.0, leaning]), prior)
    return sign * float(estimated.values[0]), float(np.hypot(estimated.deviations[0], CALIBRATION.cross_axis_deviation))


def _tilt_and_offset(
    force: Posterior, gain: float, slope: float, by_gyro: tuple[float, float] | None, bias: float, has_all_axes: bool
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Tilt [rad] and offset [m/s²], each with its deviation, of the mean force = gain (tilt + slope) + offset, given
    the tilt by the gyro and the standard deviation of the roads' mean `slope` [rad]. Without all axes the tilt cannot
    be taken off, and all of it is offset."""
    mean, deviation = float(force.values[0]), float(force.deviations[0])
    if not has_all_axes:
        return (0.0, 0.0), (mean, float(np.hypot(deviation, GRAVITY * slope)))
    design = np.array([[gain, 1.0]])
    weight = 1 / (deviation**2 + (GRAVITY * slope) ** 2)
    information = design.T @ design * weight + np.diag([1 / CALIBRATION.tilt_deviation**2, 1 / bias**2])
    right = design[0] * mean * weight
    if by_gyro is not None:
        information[0, 0] += by_gyro[1] ** -2
        right[0] += by_gyro[0] / by_gyro[1] ** 2
    covariance = np.linalg.inv(information)
    tilt, offset = covariance @ right
    sigma = np.sqrt(np.diag(covariance))
    return (float(tilt), float(sigma[0])), (float(offset), float(sigma[1]))


def _joined(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """Mean of two estimates with their deviations, by their precisions."""
    weights = first[1] ** -2, second[1] ** -2
    return (
        float((first[0] * weights[0] + second[0] * weights[1]) / sum(weights)),
        float(sum(weights) ** -0.5),
    )


def _mounting(name: str, imu: Imu, small_angles: Sequence[tuple[float, float]]) -> Iterator[Calibrated]:
    """The attitude of the file, turned by the small angles that were found."""
    prior = CALIBRATION.tilt_deviation
    largest = CALIBRATION.determined_share * prior
    determined = [value if deviation < largest else 0.0 for value, deviation in small_angles]
    turned = Rotation.from_rotvec(determined) * Rotation.from_euler("xyz", imu.attitude)
    attitude = turned.as_euler("xyz")
    for axis, (words, after, (_, deviation)) in enumerate(zip(_AXES, attitude, small_angles, strict=True)):
        yield Calibrated(
            f"{words} of the inertial sensor's mounting", "rad", imu.attitude[axis], float(after), prior, deviation,
            {f"sensors.{name}.attitude.{axis}": Change(round(float(after), 5), deviation)}, _ADVICE,
        )  # fmt: skip
