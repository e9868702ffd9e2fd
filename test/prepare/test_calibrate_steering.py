"""The calibration of the steering changes the number that the sensor of the car uses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag import read_bag
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrate_course import compliance
from vsense_ros.prepare.calibrate_steering import steering
from vsense_ros.prepare.calibrated import apply
from vsense_ros.prepare.calibration_drive import CALIBRATION, CalibrationDrive, drive_of
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle

BAG = Path(__file__).parents[2] / "bags" / "hills"
TRUE_OVER_MEASURED = 1.144  # road-wheel angle, as on the Genesis


def catalogue_car() -> Vehicle:
    return new_vehicle(catalogue_values(mass=1395.0, wheelbase=2.63, track=1.54, tyre="205/55R16 91V")).vehicle


def drive_with_bends(car: Vehicle, at_road_wheel: bool) -> CalibrationDrive:
    """Bends of a single-track car in a steady state, whose sensor reports less than the angle of its road wheels."""
    t = np.arange(0.0, 120.0, CALIBRATION.step)
    speed, rate = 13.0 + 6.0 * np.sin(0.07 * t), 0.15 * np.sin(0.4 * t)
    wheelbase = car.physics.chassis.cog_to_front_axle + car.physics.chassis.cog_to_rear_axle
    understeer = compliance(car, "front") - compliance(car, "rear")
    angle = wheelbase * rate / speed + understeer * speed * rate
    absent = np.full((len(t), 3), np.nan)
    return CalibrationDrive(
        "bends", t, np.column_stack([0 * t, 0 * t, rate]), absent, np.column_stack([speed, 0 * t]),
        np.full((len(t), 4), np.nan), angle / TRUE_OVER_MEASURED, {}, at_road_wheel,
    )  # fmt: skip


@pytest.mark.parametrize("at_road_wheel", [True, False])
def test_the_calibrated_car_reads_the_true_road_wheel_angle(at_road_wheel: bool) -> None:
    car = catalogue_car()
    name, reported = ("road_wheel_front", 0.05) if at_road_wheel else ("steering_wheel", 0.05 * 15.5)
    car = car.with_parameters({"steering.ratio": 15.5})
    sensor = apply(car, steering([drive_with_bends(car, at_road_wheel)], car), "test").sensors["steering"]
    ratio = apply(car, steering([drive_with_bends(car, at_road_wheel)], car), "test").physics.steering.ratio
    read = np.empty(1)
    sensor.model_copy(update={"ratio": ratio}).read((name,), {"position": np.array([reported])}, read, np.empty(1))
    assert read[0] == pytest.approx(0.05 * TRUE_OVER_MEASURED, rel=0.01)


def test_a_drive_knows_where_its_steering_angle_was_measured() -> None:
    recording = read_bag(BAG)
    at_wheels = replace(recording["vehicle/steering"], names=("road_wheel_front",))
    assert not drive_of(recording, catalogue_car()).at_road_wheel
    changed = replace(recording, channels={**recording.channels, "vehicle/steering": at_wheels})
    assert drive_of(changed, catalogue_car()).at_road_wheel
