"""One filter of the GNSS/INS family on a simulated drive, without messages or transport between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vsense_ros.assess.drives import (
    ANTENNA_KNOWN,
    KEPT,
    LEVEL,
    SCALE_KNOWN,
    SHAKING_KNOWN,
    SLIP_KNOWN,
    STEERING_KNOWN,
    STEP,
    TYRES_KNOWN,
    Case,
    Readings,
    Truth,
    sensors_of,
    study_car,
)
from vsense_ros.identification.handling_values import similar
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS
from vsense_ros.navigation.motion import Motions, Readout
from vsense_ros.navigation.space import Definition


def grip(car: Vehicle) -> float:
    """Largest lateral force of a car's tyres over their load [-], mean of both axles at static loads, on its road: most
    tyres carry more than the friction of the road says, which is a factor on their forces."""
    chassis = car.physics.chassis
    a, b = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    load = chassis.mass * GRAVITY / (a + b) / 2
    peaks = [similar(axle, load * arm)[3] for axle, arm in ((car.physics.front, b), (car.physics.rear, a))]
    return car.physics.road.friction * sum(peaks) / 2


def follow(
    name: str,
    truth: Truth,
    case: Case,
    read: Readings,
    *,
    definition: Definition | None = None,
    every: int = KEPT,
) -> tuple[Motions, NDArray[np.int64]]:
    """Estimates of a filter on the readings of a case, at each tenth of them or `every` so many, and the indices (n,)
    of these readings. Without a `definition` the filter is that of the catalogue by this name."""
    sensors = sensors_of(case.errors)
    known = {
        "road_bank": LEVEL, "stiffness_deviation": TYRES_KNOWN, "gyro_scale_deviation": SCALE_KNOWN,
        "slip_error": SLIP_KNOWN, "shaking_noise": SHAKING_KNOWN,
        "antenna_deviation": ANTENNA_KNOWN, "steering_error": STEERING_KNOWN,
        "pitching_noise": SHAKING_KNOWN,
        "leaning": 1e-5,  # [rad/√s]
        "grade_drift": 1e-4, "bank_drift": 1e-4,  # [m/s²/√s] of a level road
    }  # fmt: skip
    car = study_car(case.plant)
    numbers = {**car_numbers(car, sensors.values()), **known, "friction": grip(car)}
    filter = Aided(name, definition or DEFINITIONS[name][1], numbers, sensors)
    readout = Readout(filter)
    variances = {key: sensor.deviations() ** 2 for key, sensor in sensors.items()}
    fix = read.fixes[0]
    first = {
        "yaw": float(np.arctan2(fix[1], fix[0])), "forward_velocity": float(np.hypot(*fix)),
        "velocity_east": float(fix[0]), "velocity_north": float(fix[1]), "yaw_rate": float(read.imu[0, 2]),
    }  # fmt: skip
    rows = {"imu": read.imu, "wheels": read.wheels, "steering": read.steering, "velocity": read.fixes}
    if case.errors.heading is not None:
        rows["heading"] = read.heading
    for key, values in rows.items():
        filter.give_reading(key, values[0])
    filter.start(filter.definition.start({**numbers, **first}))
    used = [key for key in ("heading", "wheels", "steering", "imu") if key in rows and filter.uses(key)]
    has_fix = np.isfinite(read.fixes[:, 0]).tolist()
    snapshots, at = [], []
    means = {key: 0.5 * (rows[key][1:] + rows[key][:-1]) for key in used}  # of a step's two ends
    for k in range(1, len(truth.t)):
        for key in used:
            filter.give_reading(key, means[key][k - 1])
        filter.predict(STEP)
        if has_fix[k]:
            filter.correct("velocity", read.fixes[k], variances["velocity"])
        for key in used:
            filter.correct(key, rows[key][k], variances[key])
        if k % every == 0:
            snapshots.append(readout.snapshot(k))
            at.append(k)
    return readout.motions(snapshots), np.array(at)
