"""The multibody observers in the study of Leung's filters: errorEKF and SPI on the same drives, with the same sensors.

They know the car as the filters of the table do: from its vehicle file, that its wheels are alike, that a differential
drives the rear ones (table A.1), and that the road is level. Of the inertial sensor they get what the filters get, yaw
rate and the two specific forces along the road.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies.leung_scores import score, score_side_slip
from vsense_ros.assess.drives import (
    KEPT,
    LEVEL,
    SETTLED,
    STEP,
    TYRES_KNOWN,
    Case,
    Errors,
    Readings,
    Truth,
)
from vsense_ros.evaluate.signals import wrap
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.schema.observer_settings import EstimatedParameter
from vsense_ros.model.sensors import GnssVelocity, Imu, Steering, WheelSpeeds
from vsense_ros.model.sensors.base import joint_state
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.observer.catalogue import MakeFilter, error_ekf, spi
from vsense_ros.observer.estimate import Estimate, stacked
from vsense_ros.runner import Runner
from vsense_ros.runner.fit_judge import FitJudge
from vsense_ros.runner.latency_judge import LatencyJudge

Array = NDArray[np.float64]

_START = 1_000_000_000  # [ns]

BOUND = "bound"
OBSERVERS: dict[str, MakeFilter] = {"error_ekf": error_ekf, "spi": spi, "spi_unsure": spi, BOUND: error_ekf}
# How well an SPI knows the stiffness of its tyres: as the other filters of the table, or as those of two cars of a kind
# differ.
TYRES = {"spi": TYRES_KNOWN, "spi_unsure": 0.1}


@cache
def car_of_study(plant: str, errors: Errors, observer: str) -> Vehicle:
    """The plant's vehicle file with these sensors at cog and a level road."""
    car = load_vehicle(vehicle_path(plant))
    gyro, force = errors.gyro, errors.force
    sensors = {
        "imu": Imu(
            rate_noise=(gyro.noise,) * 3, force_noise=(force.noise,) * 3, rate_bias=max(abs(gyro.bias), 1e-4),
            force_bias=max(abs(force.bias), 1e-3), rate_bias_drift=1e-6, force_bias_drift=1e-6,
        ),
        "wheels": WheelSpeeds(noise=errors.spin, radius_error=0.0, radius_error_drift=0.0),
        "steering": Steering(),
        "velocity": GnssVelocity(noise=errors.fix, timeout=3 * errors.fix_period),
    }  # fmt: skip
    known = car.observer
    level = {"grade": LEVEL, "bank": LEVEL, "grade_change": 1e-6, "bank_change": 1e-6}
    surroundings = known.surroundings.model_copy(
        update={**level, "steering_offset": max(abs(errors.steering.bias), 1e-4)}
    )
    settings: dict[str, object] = {
        "surroundings": surroundings,
        "longest_step": STEP,
        "force_errors": known.force_errors.model_copy(
            update=_PERFECT if observer == BOUND else _by_steering(car, errors)
        ),
    }
    if observer in TYRES:
        known_within = EstimatedParameter(deviation=TYRES[observer])
        settings["parameters"] = {f"{axle}.cornering_scale": known_within for axle in ("front", "rear")}
    driven = car.drivetrain.model_copy(update={"driven": "rear"})
    observer_settings = known.model_copy(update=settings)
    return car.model_copy(update={"sensors": sensors, "drivetrain": driven, "observer": observer_settings})


# For a model without errors: no sensor measures the torques that drive the wheels.
_PERFECT = dict.fromkeys(("longitudinal", "lateral", "vertical", "roll", "pitch", "yaw", "suspension"), 1e-3)


def _by_steering(car: Vehicle, errors: Errors) -> dict[str, float]:
    """How far the forces across the car are wrong: as the filters of the thesis, the observer knows the plant's tyres,
    but the steering angle only with the noise of its sensor, which an input of a model does not have. It is new with
    each reading: of the last one's, 5 % are left."""
    numbers = car_numbers(car, ())
    force = numbers["front_stiffness"] * errors.steering.noise
    return {
        "lateral": force / numbers["mass"],
        "yaw": numbers["to_front"] * force / numbers["yaw_inertia"],
        "time_constant": STEP / 3,
    }


def as_recording(read: Readings, errors: Errors) -> Recording:
    """Readings as messages; without roll rate, pitch rate and vertical force."""
    n = len(read.imu)
    stamp = _START + (np.arange(n) * round(STEP * 1e9)).astype(np.int64)
    imu = read.imu.copy()
    imu[:, [0, 1, 5]] = np.nan
    unknown = np.zeros((n, 9))
    fixes = np.flatnonzero(np.isfinite(read.fixes[:, 0]))
    up = np.zeros((len(fixes), 1))
    covariance = np.zeros((len(fixes), 36))
    covariance[:, :21:7] = errors.fix**2
    content: dict[str, tuple[Any, NDArray[np.int64], dict[str, Array], tuple[str, ...]]] = {
        "imu": (
            Imu(), stamp,
            {
                "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
                "orientation_covariance": np.tile([-1.0, *[0.0] * 8], (n, 1)),
                "angular_velocity": imu[:, :3], "angular_velocity_covariance": unknown,
                "linear_acceleration": imu[:, 3:], "linear_acceleration_covariance": unknown,
            }, (),
        ),
        "wheels": (WheelSpeeds(), stamp, *joint_state("velocity", read.wheels, WheelSpeeds.joints)),
        "steering": (Steering(), stamp, *joint_state("position", read.steering, ("road_wheel_front",))),
        "velocity": (
            GnssVelocity(), stamp[fixes],
            {
                "linear": np.hstack([read.fixes[fixes], up]), "angular": np.zeros((len(fixes), 3)),
                "covariance": covariance,
            }, (),
        ),
    }  # fmt: skip
    return Recording(
        {
            sensor.topic: Channel(sensor.topic, sensor.message, at, at, columns, sensor.frame_id, names)
            for sensor, at, columns, names in content.values()
        },
        name="study",
    )


def estimate(name: str, truth: Truth, case: Case, read: Readings) -> dict[str, Any]:
    """What an observer makes of the readings of a case; as `leung_study.estimate`.

    Of `BOUND` the stated deviation counts, not the error: the covariance of a filter of the plant's own equations,
    along the true drive, is the Cramér-Rao bound of any filter without a bias (Tichavský, Muravchik & Nehorai 1998, eq.
    21). The noise of the steering angle, an input, and the bus are left out: the true bound is somewhat larger. At the
    limit (DO55) its estimate leaves the true drive, so that the bound there is only about right.
    """
    observer = Runner(car_of_study(case.plant, case.errors, name), make=OBSERVERS[name])
    if name == BOUND:  # of all that is measured, by sensors that are right
        observer.vote.axes.clear()  # each reading counts as far as its gate lets it
        for judge in observer.judges:
            if isinstance(judge, LatencyJudge):
                judge.latencies = None  # stamps are right: a doubt about them would be no part of a bound
            elif isinstance(judge, FitJudge):
                judge.are_believed = lambda: False  # so is the place of the antenna
    estimates: list[Estimate] = []
    last = 0
    for sample in as_recording(read, case.errors).samples(tuple(observer.topics)):
        observer.add(sample)
        if observer.started and observer.stamp >= last + round(KEPT * STEP * 1e9):
            estimates.append(observer.snapshot())
            last = observer.stamp
    stamp = np.array([one.stamp for one in estimates])
    at = np.rint((stamp - _START) * 1e-9 / STEP).astype(np.int64)
    inside = at < len(truth.t)
    made, at = stacked([one for one, true in zip(estimates, inside, strict=True) if true]), at[inside]
    settled = truth.t[at] > SETTLED
    speed, across = made.velocity[:, 0], made.velocity[:, 1]
    values = {
        "yaw": (wrap(made.attitude[:, 2] - truth.yaw[at]), truth.yaw[at]),
        "forward_velocity": (speed - truth.forward_velocity[at], truth.forward_velocity[at]),
        "lateral_velocity": (across - truth.lateral_velocity[at], truth.lateral_velocity[at]),
        "yaw_rate": (made.rates[:, 2] - truth.yaw_rate[at], truth.yaw_rate[at]),
        "side_slip": (wrap(made.side_slip[:, 0] - truth.side_slip[at]), truth.side_slip[at]),
    }
    scores: dict[str, Any] = {key: score(error, true, settled) for key, (error, true) in values.items()}
    return scores | score_side_slip(values["side_slip"][0], made.side_slip[:, 1], settled)
