"""What filters of this package may know of a car, as plain numbers by name: from a vehicle file, or for a study."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.sensors.wheel_speeds import LOADED
from vsense_ros.model.vehicle import Vehicle

STRAIGHT = float(np.radians(1.0))  # [rad/s] of yaw rate below which Leung 2010 (4.2.1) calls a drive straight
TYPICAL_SPEED = 15.0  # [m/s] at which a road that changes along the way changes in time
SLIP_ERROR = 0.0015  # [rad] by which a brush errs as an axle: tyres have another curve, links yield
STEERING_ERROR = 0.3  # [1/rad] times the road-wheel angle squared: by which it errs, as ratios are not constant
SHAKING_NOISE = 0.1  # [m/s²/√Hz] of a body that shakes on its springs, in an accelerometer across
# Share by which a gyro may read too much or too little: data sheets say up to ±3 % (MPU-6050).
GYRO_SCALE_DEVIATION = 0.01
STIFFNESS_DEVIATION = 0.15  # share by which a car's tyres may be softer or stiffer than its file says
ANTENNA_DEVIATION = 0.5  # [m] by which an antenna may sit ahead of or behind where the vehicle file says
SAMPLE_TIME = 0.01  # [s] for which filters hold an inertial reading (Leung 2010, table B.1)


def car_numbers(vehicle: Vehicle, sensors: Iterable[SensorBase]) -> dict[str, float]:
    """Parameters of all filters by name [SI]: the single-track model of the car at rest, its wheels, and the sensors'
    noise and mounting."""
    chassis, front, rear = vehicle.physics.chassis, vehicle.physics.front, vehicle.physics.rear
    a, b = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    load = chassis.mass * GRAVITY / (a + b) / 2
    road = vehicle.observer.surroundings
    numbers = {
        "mass": chassis.mass,
        "yaw_inertia": chassis.yaw_inertia,
        "to_front": a,
        "to_rear": b,
        "front_stiffness": 2 * float(front.tyre.cornering_stiffness_at(load * b)) * front.cornering_scale,
        "rear_stiffness": 2 * float(rear.tyre.cornering_stiffness_at(load * a)) * rear.cornering_scale,
        "friction": vehicle.physics.road.friction,
        "stiffness_deviation": STIFFNESS_DEVIATION,
        "slip_error": SLIP_ERROR,
        "steering_error": STEERING_ERROR,
        "shaking_noise": SHAKING_NOISE,
        "pitching_noise": 0.05,  # [m/s²/√Hz] of a body that pitches on its springs, in an accelerometer along
        "leaning": 5e-4,  # [rad/√s] of heading, by a gyro whose axis leans with body and road
        "grade_drift": 0.02,  # [m/s²/√s] by which the bias of an accelerometer along drifts, with the road's grade
        "bank_drift": 0.3,  # [m/s²/√s] by which that of one across drifts, with the road's bank
        "gyro_scale_deviation": GYRO_SCALE_DEVIATION,
        "antenna_deviation": ANTENNA_DEVIATION,
        **roll_numbers(vehicle),
        "rolling_radius": rear.unloaded_radius * LOADED,
        "rear_track": rear.track,
        "straight_rate": STRAIGHT,
        "sample_time": SAMPLE_TIME,
        "gyro_noise": 0.003,
        "acceleration_noise": 0.1,
        "spin_noise": 0.05,
        "steering_noise": 0.001,
        "antenna_x": 0.0,
        "antenna_y": 0.0,
        "gravity": GRAVITY,
        "road_bank": road.bank,
        "road_bank_time": road.bank / max(road.bank_change * TYPICAL_SPEED, 0.02 * road.bank, 1e-9) + 0.1,
    }
    for sensor in sensors:
        deviations = sensor.deviations()
        if "rates and forces" in sensor.measures:
            numbers["gyro_noise"], numbers["acceleration_noise"] = float(deviations[2]), float(deviations[4])
        elif "rolling speed" in sensor.measures:
            numbers["spin_noise"] = float(deviations[2])
        elif "steering" in sensor.measures and deviations.any():
            numbers["steering_noise"] = float(deviations[0])
        elif "course" in sensor.measures:
            numbers["antenna_x"], numbers["antenna_y"] = sensor.mounting()[:2].tolist()
    return numbers


def roll_numbers(vehicle: Vehicle) -> dict[str, float]:
    """How the body rolls on its springs, with straight guides of the wheels (Milliken & Milliken 1995, section 18.4).

    `roll_gain`: share of a lateral acceleration that roll adds to what an accelerometer feels, g dφ/da_y. What the
    roll centres carry passes the springs by, but not the tyres. `roll_frequency` [rad/s] and `roll_damping` [-] are
    those of the body on springs and tyres, `roll_arm` [m] the height of cog above its roll axis.
    """
    chassis, axles = vehicle.physics.chassis, (vehicle.physics.front, vehicle.physics.rear)
    a, b = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    springs = sum((x.suspension_stiffness + 2 * x.antiroll_stiffness) * x.track**2 / 2 for x in axles)
    tyres = sum(x.tyre_stiffness * x.track**2 / 2 for x in axles)
    dampers = sum(x.suspension_damping * x.track**2 / 2 for x in axles)
    axis = (axles[0].roll_centre_height * b + axles[1].roll_centre_height * a) / (a + b)
    unsprung = [2 * (x.hub_mass + x.wheel_mass) for x in axles]
    body = chassis.mass - sum(unsprung)
    below = sum(mass * x.unloaded_radius for mass, x in zip(unsprung, axles, strict=True))
    moment = body * ((chassis.mass * chassis.cog_height - below) / body - axis)
    on_springs, on_tyres = moment / springs, chassis.mass * chassis.cog_height / tyres
    gain = (on_springs + on_tyres) / (1 - GRAVITY * (on_springs + moment / tyres))  # dφ/da_y [rad/(m/s²)]
    # About cog, since it is the acceleration of cog that turns the body.
    inertia, stiffness = chassis.roll_inertia, moment / gain
    share = on_springs / (on_springs + on_tyres)  # of the roll that the dampers see
    return {
        "roll_gain": GRAVITY * gain,
        "roll_frequency": float(np.sqrt(stiffness / inertia)),
        "roll_damping": float(dampers * share**2 / (2 * np.sqrt(stiffness * inertia))),
        "roll_arm": chassis.cog_height - axis,
    }
