"""The course of GNSS against the integrated yaw rate: bias and scale of the gyro, latency, antenna, rear tyres.

At the antenna the course is ahead of the heading by the side slip there, (x + l) r / V - k V r, with the distance x + l
of the antenna from the rear axle and the cornering compliance k of that axle. Over a stretch of the drive,

    course - ∫ r dt = constant - b t - τ r + (x + l) r / V - k V r - s ∫ r dt,

where b is the bias of the gyro, s the error of its scale, and τ how much older the course is than the yaw rate. Without
s its error passes for latency. All of it is linear, and neither a heading nor a side slip needs to be measured (compare
Bevly et al. 2006, IEEE Trans. Vehicular Technology 55(6)).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.regression import Posterior, posterior
from vsense_ros.model.handling.base import cornering_stiffness, static_loads
from vsense_ros.model.sensors import Imu, Steering, WheelSpeeds
from vsense_ros.model.sensors.gnss import Antenna, Receiver
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.car_numbers import ANTENNA_DEVIATION, GYRO_SCALE_DEVIATION
from vsense_ros.prepare.calibrated import Calibrated, Change
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive

Array = NDArray[np.float64]


def rear_compliance(car: Vehicle) -> float:
    """Slip angle of the rear axle per lateral acceleration, by the vehicle file [rad s²/m]."""
    return compliance(car, "rear")


def compliance(car: Vehicle, axle: str) -> float:
    """Slip angle of an axle per lateral acceleration, by the vehicle file [rad s²/m]."""
    chassis = car.physics.chassis
    arms = chassis.cog_to_rear_axle, chassis.cog_to_front_axle
    index = ("front", "rear").index(axle)
    part, load = (car.physics.front, car.physics.rear)[index], static_loads(car)[index]
    return chassis.mass * arms[index] / sum(arms) / (2 * cornering_stiffness(part, load))


def relative_compliance(car: Vehicle, axle: str) -> float:
    """Standard deviation of the compliance of an axle over its value [-]."""
    stated = car.deviations().get(f"{axle}.cornering_scale")
    return CALIBRATION.compliance_deviation if stated is None else stated / getattr(car.physics, axle).cornering_scale


def course(drives: Sequence[CalibrationDrive], car: Vehicle) -> Iterator[Calibrated]:
    """Bias and scale of the yaw rate, latency between GNSS and the gyro, place of the antenna ahead, rear tyres."""
    antenna = next((s for s in car.sensors.values() if isinstance(s, Antenna) and s.kind == "gnss_velocity"), None)
    imu = next(((name, s) for name, s in car.sensors.items() if isinstance(s, Imu)), None)
    blocks = [block for drive in drives for block in _blocks(drive)]
    if antenna is None or imu is None or not blocks:
        return
    arm, slip = car.physics.chassis.cog_to_rear_axle, rear_compliance(car)
    places = [name for name, s in car.sensors.items() if isinstance(s, Antenna)]
    stated = [car.uncertainty[p].deviation for n in places if (p := f"sensors.{n}.position") in car.uncertainty]
    bias, scale, place = imu[1].rate_offset[2], imu[1].rate_scale[2], antenna.position[0]
    mean = np.array([-bias, 0.0, arm + place, -slip, -scale])
    places_off, slip_off = max(stated, default=ANTENNA_DEVIATION), relative_compliance(car, "rear") * slip
    prior = np.array(
        [max(imu[1].rate_bias, 1e-4), CALIBRATION.latency_deviation, places_off, slip_off, GYRO_SCALE_DEVIATION]
    )
    estimated = posterior(blocks, mean, prior)
    yield _gyro(imu[0], bias, estimated)
    yield _scale(imu[0], scale, estimated)
    yield _latency(car, imu[0], estimated)
    yield _antenna(places, car, place, estimated)
    yield _rear(car, estimated)


def _blocks(drive: CalibrationDrive) -> Iterator[tuple[Array, Array]]:
    """Rows of the equation, its constant taken off, times the speed: the course errs by velocity over speed."""
    east, north = (drive.smooth(component) for component in drive.velocity.T)
    rate, speed = drive.yaw_rate, drive.speed
    length = round(CALIBRATION.block / CALIBRATION.step)
    for begin in range(0, len(drive.t) - length + 1, length):
        rows = slice(begin, begin + length)
        if not (drive.driving[rows].all() and np.isfinite(rate[rows]).all()):
            continue
        v, r = speed[rows], rate[rows]
        heading = np.cumsum(r) * CALIBRATION.step
        y = np.unwrap(np.arctan2(north[rows], east[rows])) - heading
        x = np.column_stack([drive.t[rows], -r, r / v, v * r, heading])
        weight = v / v.mean()
        centre = weight @ np.column_stack([x, y]) / weight.sum()
        yield (x - centre[:-1]) * v[:, None], (y - centre[-1]) * v


def _gyro(name: str, before: float, estimated: Posterior) -> Calibrated:
    after, deviation = -float(estimated.values[0]), float(estimated.deviations[0])
    return Calibrated(
        "bias of the yaw rate", "rad/s", before, after, float(estimated.prior[0]), deviation,
        {f"sensors.{name}.rate_offset.2": Change(_rounded(after, 1e-6), deviation)},
        "any drive with GNSS of a few minutes",
    )  # fmt: skip


def _scale(name: str, before: float, estimated: Posterior) -> Calibrated:
    after, deviation = -float(estimated.values[4]), float(estimated.deviations[4])
    return Calibrated(
        "error of the yaw rate's scale", "-", before, after, float(estimated.prior[4]), deviation,
        {f"sensors.{name}.rate_scale.2": Change(_rounded(after, 1e-5), deviation)},
        "full turns in both directions with GNSS, such as roundabouts",
    )  # fmt: skip


def _latency(car: Vehicle, imu: str, estimated: Posterior) -> Calibrated:
    """GNSS is late, or what comes with the gyro over the bus: no message is stamped before its measurement."""
    delay, deviation = float(estimated.values[1]), float(estimated.deviations[1])
    bus = Imu | Steering | WheelSpeeds
    name = "latency of GNSS" if delay > 0 else "latency of the bus (inertial sensor, steering, wheels)"
    delayed = [n for n, s in car.sensors.items() if isinstance(s, Receiver if delay > 0 else bus)]
    first = car.sensors[delayed[0] if delay > 0 else imu].latency
    changes = {
        f"sensors.{n}.latency": Change(_rounded(car.sensors[n].latency + abs(delay), 1e-4), deviation) for n in delayed
    }
    worth = max(deviation, CALIBRATION.smallest_latency) < abs(delay)
    return Calibrated(
        name, "s", first, first + abs(delay) if worth else first, float(estimated.prior[1]), deviation,
        changes if worth else {}, "bends in both directions with GNSS, such as roundabouts",
    )  # fmt: skip


def _antenna(places: Sequence[str], car: Vehicle, before: float, estimated: Posterior) -> Calibrated:
    after = float(estimated.values[2]) - car.physics.chassis.cog_to_rear_axle
    deviation = float(estimated.deviations[2])
    return Calibrated(
        "place of the GNSS antenna ahead of the centre of gravity", "m", before, after, float(estimated.prior[2]),
        deviation,
        {f"sensors.{name}.position.0": Change(_rounded(after, 1e-3), deviation) for name in places},
        "tight bends at 15 to 30 km/h in both directions, with GNSS",
    )  # fmt: skip


def _rear(car: Vehicle, estimated: Posterior) -> Calibrated:
    scale, before = car.physics.rear.cornering_scale, rear_compliance(car)
    after = max(-float(estimated.values[3]), 0.2 * before)
    relative = float(estimated.deviations[3]) / after
    value = scale * before / after
    return Calibrated(
        "cornering stiffness of the rear axle over the file's tyre", "-", scale, value,
        relative_compliance(car, "rear") * scale, relative * value,
        {"physics.rear.cornering_scale": Change(_rounded(value, 1e-4), relative * value)},
        "bends at 60 km/h and more with 2 to 4 m/s², as a winding road has, with GNSS",
    )  # fmt: skip


def _rounded(value: float, step: float) -> float:
    return float(f"{round(value / step) * step:.6g}")
