"""What is stated of the estimates of a car whose vehicle file is another car's: as wide as they are wrong, and said."""

from __future__ import annotations

import numpy as np
import pytest

from drives import IMU
from studies.thesis import KINDS, driven, observe, observing
from vsense_ros.bag.importers import import_recording
from vsense_ros.evaluate import faults
from vsense_ros.evaluate.faults import GYRO, Fault
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.manoeuvre.throttle_and_steer import MANOEUVRES
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner, run

SAID = "lateral tyre forces are not those of the vehicle file"


def car(*, mass: float = 1.0, steering: float = 1.0) -> Vehicle:
    """The observer's car of the bags with so many times its mass and its steering angle."""
    vehicle = load_vehicle(vehicle_path("prototype_model"))
    physics, sensors = vehicle.physics, dict(vehicle.sensors)
    sensors["steering"] = sensors["steering"].model_copy(update={"gain": steering})
    chassis = physics.chassis.model_copy(update={"mass": mass * physics.chassis.mass})
    physics = physics.model_copy(update={"chassis": chassis})
    return vehicle.model_copy(update={"physics": physics, "sensors": sensors})


def within_three(bag: str, vehicle: Vehicle) -> tuple[dict[str, float], str]:
    """Shares of errors against the truth within three of the standard deviations that are stated, and the headline."""
    recording = import_recording(shared_folder("bags") / bag)
    done = run(recording, vehicle, rate=50.0)
    estimates, truths = (read_signals(one, what) for one, what in ((done.output, "vsense"), (recording, "reference")))
    shares = {}
    for name in ("lateral_velocity", "yaw"):
        found = align(estimates[name], truths[name])
        settled = found.stamp > recording.start + 2_000_000_000
        shares[name] = float(np.mean(np.abs(found.error[settled, 0]) < 3 * found.deviation[settled]))
    return shares, next(line.message for line in done.diagnostics if line.name == "observer")


@pytest.mark.parametrize(("bag", "vehicle"), [("double_lane_change", car(mass=2.0)), ("hills", car(steering=2.0))])
def test_estimates_by_a_file_that_is_off_by_a_factor_are_as_uncertain_as_they_are_wrong(
    bag: str, vehicle: Vehicle
) -> None:
    shares, headline = within_three(bag, vehicle)
    assert min(shares.values()) > 0.95, shares
    assert SAID in headline


def test_nothing_is_said_of_the_car_of_the_file() -> None:
    assert SAID not in within_three("double_lane_change", car())[1]


def left_out(recording: Recording, observer: Runner) -> set[str]:
    """Inertial axes that are not believed at any time of a recording, all of whose sensors are right."""
    names: set[str] = set()
    for sample in recording.samples(tuple(topic for topic in observer.topics if topic in recording)):
        observer.add(sample)
        names |= {axes.name(axis) for axes, axis, _ in observer.vote.out}
    return names


def test_a_right_gyro_stays_in_with_twice_the_mass() -> None:
    recording = import_recording(shared_folder("bags") / "double_lane_change")
    assert "imu yaw rate" not in left_out(recording, Runner(car(mass=2.0)))


def test_a_gyro_that_drifts_away_slowly_makes_no_lateral_velocity_that_is_surer_than_it_is_right() -> None:
    whole = import_recording(shared_folder("bags") / "double_lane_change")
    drift = faults.added(GYRO, (2,), 0.1, rise=2.0)
    recording = Fault("", (IMU,), drift, 5.2, np.inf).of(whole).between(0.0, 9.0)
    output = run(recording, car(), rate=50.0).output
    estimates, truths = (read_signals(one, what) for one, what in ((output, "vsense"), (recording, "reference")))
    found = align(estimates["lateral_velocity"], truths["lateral_velocity"])
    drifts = found.stamp > recording.start + 5_200_000_000
    error = np.abs(found.error[drifts, 0])
    assert error.max() > 0.5  # it has done harm, which no other sensor shows at once
    assert (error < np.maximum(0.3, 3 * found.deviation[drifts])).all()


@pytest.mark.exam
def test_a_right_gyro_stays_in_with_wrong_mass_and_friction_where_wheels_of_two_axles_disagree_about_it() -> None:
    plant, model = (load_vehicle(vehicle_path(name)) for name in ("prototype_real", "prototype_model"))
    vehicle, trajectory = driven(plant, MANOEUVRES[1])
    recording = record(trajectory, vehicle, 2, name="manoeuvre 2", biased=False, every=4)
    observer, output, _ = observe(recording, observing(model, KINDS[0], 4), KINDS[0], 4)
    found = align(read_signals(output, "vsense")["yaw"], read_signals(recording, "reference")["yaw"])
    assert not any(observer.vote.out)
    assert np.abs(found.error).max() < 0.005
