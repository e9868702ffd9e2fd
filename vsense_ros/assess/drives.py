"""Simulated drives for a comparison of filters: the true motion of the plant, and the readings of its sensors.

The plant is the car of a vehicle file with all its degrees of freedom. Its sensors are those of Leung 2010, appendix B:
all at cog, at 100 Hz, with white noise and a constant bias; a fix each second.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields, replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import in_place_of
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import MANOEUVRES
from vsense_ros.manoeuvre.receivers import RECEIVERS
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import (
    PITCH,
    PITCH_RATE,
    ROLL,
    ROLL_RATE,
    SPEED_X,
    SPEED_Y,
    SPIN,
    STEERING,
    YAW,
    YAW_RATE,
)
from vsense_ros.model.sensors import GnssAttitude, GnssVelocity, Imu, SensorBase, Steering, WheelSpeeds
from vsense_ros.model.sensors.simulated import quantized
from vsense_ros.model.simulation.closed_loop import Trajectory, rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

PLANT = "jaguar_saloon"
STEP = 0.01  # [s] between readings
KEPT = 10  # steps between estimates that are scored
STEERING_RATIO = 17.58  # steering-wheel over road-wheel angle (table A.1); errors of table B.2 are of the former
# [rad] by which the road may lean: the plant's is level, which every filter of the thesis takes for granted.
LEVEL = 1e-3
# Share by which the tyres may be stiffer or softer. The filters of the thesis take them for known; 15 % is what
# `car_numbers` says of a car from its file, and costs `integrated` most where side slip is small.
TYRES_KNOWN = 0.02
# Errors that the plant does not have, as filters assume here: the gyro of appendix B has no error of scale [-], and the
# road does not shake the body [m/s²/√Hz].
SCALE_KNOWN, SHAKING_KNOWN = 1e-5, 1e-4
SLIP_KNOWN = 3e-4  # [rad] by which the curve of a brush is off that of the plant's tyres where they slide
STEERING_KNOWN = 1e-3  # [1/rad] of the road-wheel angle squared
ANTENNA_KNOWN = 1e-3  # [m] by which the antenna sits elsewhere than at cog
SETTLED = 20.0  # [s] after which estimates are scored: the thesis does not say which window it takes
_DEGREE = np.pi / 180


class Error(NamedTuple):
    """Standard deviation of the noise, and bias."""

    noise: float
    bias: float


_GYRO, _FORCE = Error(0.1 * _DEGREE, 1.0 * _DEGREE), Error(0.5, 1.0)
_STEERING = Error(1.0 * _DEGREE / STEERING_RATIO, 5.0 * _DEGREE / STEERING_RATIO)


@dataclass(frozen=True)
class Bus:
    """CAN bus between the sensors of the car and a filter: values in steps, and late. Fixes do not come by it.

    All runs of Leung 2010, chapters 4 and 5, have one (section 4.2.2, appendix B), without numbers. The step of the yaw
    rate is read from figure 4.6, where 100 Hz look like 5 Hz; the others are common ones of stability controllers, and
    small beside the noise of table B.1.
    """

    delay: float = 0.01  # [s]
    rate_step: float = 0.25 * _DEGREE  # [rad/s]
    force_step: float = 0.05  # [m/s²]
    spin_step: float = 0.01  # [rad/s]
    steering_step: float = 0.1 * _DEGREE / STEERING_RATIO  # of the road wheels [rad]

    def carry(self, readings: Readings) -> Readings:
        """Readings as they arrive: those of the first instant stand until the first message is there."""
        late = max(0, round(self.delay / STEP))
        imu_steps = np.repeat([self.rate_step, self.force_step], 3)

        def carried(values: Array, step: Array | float) -> Array:
            held = np.concatenate([np.repeat(values[:1], late, axis=0), values[: len(values) - late]])
            return quantized(held, step)

        return replace(
            readings,
            imu=carried(readings.imu, imu_steps),
            wheels=carried(readings.wheels, self.spin_step),
            steering=carried(readings.steering, self.steering_step),
        )


@dataclass(frozen=True)
class Errors:
    """Errors of the sensors (Leung 2010, tables B.1 and B.2), at cog: standard deviations of the noise, and biases."""

    gyro: Error = _GYRO  # [rad/s]
    force: Error = _FORCE  # [m/s²]
    steering: Error = _STEERING  # of the road wheels [rad]
    spin: float = 0.04  # [rad/s]
    fix: float = 0.025  # [m/s] to the east and to the north
    fix_period: float = 1.0  # [s]
    heading: float | None = None  # [rad] of a magnetometer, or of two antennas; None: there is none
    feels_gravity: bool = True  # whether roll and pitch of the body enter the accelerometers
    bus: Bus | None = None  # that the readings of the car come by; None: directly


@dataclass(frozen=True)
class Case:
    """One drive of a study: manoeuvre by name, seed of the noise, errors of the sensors, and an outage [s] from, to."""

    manoeuvre: str
    seed: int
    errors: Errors = Errors()
    outage: tuple[float, float] | None = None
    plant: str = PLANT
    noise: float = 1.0  # factor on the noise of all sensors; with 0 only the errors of the models remain


@dataclass(frozen=True)
class Truth:
    """True motion of the plant at n instants."""

    t: Array
    yaw: Array
    forward_velocity: Array
    lateral_velocity: Array
    yaw_rate: Array
    forces: Array  # (n, 2) specific, along and across
    level_forces: Array  # (n, 2) the same without gravity
    steer: Array
    spins: Array  # (n, 4)
    tilting: Array | None = None  # (n, 3) roll and pitch rate, specific force upwards; None: a body that stays level

    @property
    def side_slip(self) -> Array:
        """[rad]"""
        return np.arctan2(self.lateral_velocity, self.forward_velocity)


def receiver(name: str, errors: Errors | None = None) -> Errors:
    """Errors with the velocity of a receiver of table 4.8. Raises `InputError` for an unknown name."""
    if name not in RECEIVERS:
        raise InputError(f"no receiver {name!r}; known are {', '.join(RECEIVERS)}")
    return replace(errors or Errors(), fix=RECEIVERS[name].velocity)


def drive_plant(manoeuvre: str, plant: str, store: Path) -> Truth:
    """True motion of the plant in a manoeuvre. `store` is the folder that `trajectory` keeps it in."""
    s = trajectory(manoeuvre, plant, store)
    roll, pitch = s.q[:, ROLL], s.q[:, PITCH]
    gravity = GRAVITY * np.column_stack([-np.sin(pitch), np.sin(roll) * np.cos(pitch)])
    level = s.acceleration[:, :2]
    return Truth(
        t=s.t, yaw=s.q[:, YAW], forward_velocity=s.u[:, SPEED_X], lateral_velocity=s.u[:, SPEED_Y],
        yaw_rate=s.u[:, YAW_RATE], forces=level + gravity, level_forces=level, steer=s.inputs[:, STEERING],
        spins=s.u[:, SPIN],
        tilting=np.column_stack(
            [s.u[:, [ROLL_RATE, PITCH_RATE]], s.acceleration[:, 2] + GRAVITY * np.cos(roll) * np.cos(pitch)]
        ),
    )  # fmt: skip


def trajectory(manoeuvre: str, plant: str, store: Path) -> Trajectory:
    """Trajectory of the plant in a manoeuvre, all its coordinates; kept in `store`, since it takes long to drive."""
    own = digest(plant, manoeuvre, *sources("vsense_ros", "model", "manoeuvre", "assess/drives*"))
    file = store / f"plant_{manoeuvre}_{own}.npz"
    if not file.exists():
        car, chosen = load_vehicle(vehicle_path(plant)), MANOEUVRES[manoeuvre]
        q, u = rolling_straight(car, chosen.speed)
        driven = simulate(car, chosen.driver(car), chosen.duration, step=1e-3, keep_every=round(STEP / 1e-3), q=q, u=u)
        file.parent.mkdir(parents=True, exist_ok=True)
        with in_place_of(file) as temporary, temporary.open("wb") as out:
            np.savez(out, **{one.name: getattr(driven, one.name) for one in fields(driven)})
    with np.load(file) as found_again:
        return Trajectory(**{key: found_again[key] for key in found_again.files})


@cache
def study_car(plant: str) -> Vehicle:
    return load_vehicle(vehicle_path(plant))


def sensors_of(errors: Errors) -> dict[str, SensorBase]:
    """Sensors at cog with these errors, without gates of their own: a study has no receivers that lie."""
    gyro, force = errors.gyro.noise, errors.force.noise
    sensors: dict[str, SensorBase] = {
        "imu": Imu(rate_noise=(gyro,) * 3, force_noise=(force,) * 3, gate=1e6),
        "wheels": WheelSpeeds(noise=errors.spin, gate=1e6),
        "steering": Steering(gate=1e6),
        "velocity": GnssVelocity(noise=errors.fix, gate=1e6),
    }
    if errors.heading is not None:
        sensors["heading"] = GnssAttitude(noise=errors.heading, gate=1e6)
    return sensors


@dataclass(frozen=True)
class Readings:
    """Readings of one case, a row each; `fixes` (n, 2) are NaN where there is none."""

    imu: Array  # (n, 6)
    wheels: Array  # (n, 4)
    steering: Array  # (n, 1)
    fixes: Array
    heading: Array  # (n, 2) cosine and sine


def readings(truth: Truth, case: Case) -> Readings:
    """Readings of a drive, with the errors of the case and the noise of its seed."""
    errors, n = case.errors, len(truth.t)
    random = np.random.default_rng([case.seed, 2010])
    noise = case.noise * random.standard_normal((n, 11))
    imu = np.zeros((n, 6))
    imu[:, 2] = truth.yaw_rate + errors.gyro.bias + errors.gyro.noise * noise[:, 0]
    forces = truth.forces if errors.feels_gravity else truth.level_forces
    imu[:, 3:5] = forces + errors.force.bias + errors.force.noise * noise[:, 1:3]
    imu[:, 5] = GRAVITY
    if truth.tilting is not None and errors.feels_gravity:  # noise of its own: that of the others stays as it was
        more = case.noise * np.random.default_rng([case.seed, 2011]).standard_normal((n, 3))
        kinds = (errors.gyro, errors.gyro, errors.force)
        bias, deviation = np.array([one.bias for one in kinds]), np.array([one.noise for one in kinds])
        imu[:, [0, 1, 5]] = truth.tilting + bias + deviation * more
    wheels = truth.spins + errors.spin * noise[:, 3:7]
    steering = (truth.steer + errors.steering.bias + errors.steering.noise * noise[:, 7])[:, None]
    c, s = np.cos(truth.yaw), np.sin(truth.yaw)
    east = c * truth.forward_velocity - s * truth.lateral_velocity
    north = s * truth.forward_velocity + c * truth.lateral_velocity
    fixes = np.column_stack([east, north]) + errors.fix * noise[:, 8:10]
    every = max(1, round(errors.fix_period / STEP))
    silent = np.arange(n) % every != 0
    if case.outage is not None:
        silent |= (truth.t >= case.outage[0]) & (truth.t < case.outage[1])
    fixes[silent] = np.nan
    heading = truth.yaw + (errors.heading or 0.0) * noise[:, 10]
    direct = Readings(imu, wheels, steering, fixes, np.column_stack([np.cos(heading), np.sin(heading)]))
    return errors.bus.carry(direct) if errors.bus is not None else direct


def digest(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


@cache
def sources(package: str, *places: str) -> tuple[str, ...]:
    """Hashes of the files that a stored result depends on: folders of a package or patterns of its files
    (`folder/start_*`), and the vehicle file."""
    root = Path(str(resources.files(package)))
    patterns = [f"{place}.py" if "*" in place else f"{place}/**/*.py" for place in places]
    files = [file for pattern in patterns for file in sorted(root.glob(pattern))]
    return tuple(hashlib.sha256(file.read_bytes()).hexdigest() for file in [*files, vehicle_path(PLANT)])
