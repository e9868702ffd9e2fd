"""The observer says whether its forces add up to what the inertial sensor feels."""

import numpy as np
import pytest

from drives import IMU, SECOND, altered, changed, feed, messages
from marks import exam_except
from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.diagnostic import Level
from vsense_ros.model.car.balance import SHARES, CarBalance
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.schema.drivetrain import Drivetrain
from vsense_ros.runner import Runner, run


def balance_line(observer):
    return next(line for line in observer.diagnostics() if line.name == "balance of forces")


def estimated(observer, samples, rate=100.0):
    """The observer after the messages, asked for an estimate at this rate [Hz]."""
    last = 0
    for sample in samples:
        observer.add(sample)
        if observer.started and observer.stamp - last > SECOND / rate:
            last = observer.stamp
            observer.estimate()
    return observer


def test_on_a_drive_without_faults_they_do(vehicle, lane_change):
    observer = estimated(Runner(vehicle, lane_change.map_origin), messages(lane_change))
    assert balance_line(observer).level is Level.OK
    assert len(balance_line(observer).values) == 6
    shares = [float(share) for share in balance_line(observer).values.values()]
    assert max(shares) < 8
    assert balance_line(observer).message == f"tyre forces add up to what imu feels, to {max(shares):.0f} %"


@pytest.mark.parametrize("axis", exam_except([0, 2], 2))
def test_an_accelerometer_that_comes_to_feel_another_force_is_told(vehicle, lane_change, axis):
    """From the middle of the drive on, too slowly for the gate to refuse it: the forces do not add up, or the other
    sensors have voted it out."""

    def drifts(sample):
        force = sample.values["linear_acceleration"].copy()
        force[axis] += 2.5 * max(0.0, (sample.stamp - lane_change.start) / SECOND - 2.0) / 8.0
        return changed(sample, linear_acceleration=force)

    samples = altered(messages(lane_change), lambda sample: sample.topic == IMU, drifts)
    observer = estimated(Runner(vehicle, lane_change.map_origin), samples)
    levels = {line.name: line.level for line in observer.diagnostics()}
    assert Level.WARN in (levels["balance of forces"], levels["imu"]) or levels["imu"] is Level.ERROR


def test_shares_of_the_weight_are_as_uncertain_as_the_accelerations_that_are_compared(vehicle):
    along, across, pitching = 0.5, 0.3, 2.0
    covariance = np.diag([along, across, 0.0, 0.0, pitching, 0.0]) ** 2
    found = dict(zip(SHARES, CarBalance(vehicle.physics).deviations(covariance).tolist(), strict=True))
    chassis = vehicle.physics.chassis
    weight, base = chassis.mass * GRAVITY, chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    shifted = np.hypot(chassis.cog_height * chassis.mass * along, chassis.pitch_inertia * pitching) / base
    assert found["longitudinal force"] == pytest.approx(along / GRAVITY)
    assert found["lateral force"] == pytest.approx(across / GRAVITY)
    assert found["front load"] == pytest.approx(shifted / (weight * chassis.cog_to_rear_axle / base))
    assert found["vertical force"] == pytest.approx(0.0, abs=1e-9)


def test_forces_that_the_filter_hardly_knows_may_differ_from_what_is_felt(vehicle, lane_change, monkeypatch):
    observer = estimated(Runner(vehicle, lane_change.map_origin), messages(lane_change, 8.0))
    monkeypatch.setattr(observer.adapter.balance, "_since", 1000.0)
    monkeypatch.setattr(observer.adapter.balance, "_square", np.full(6, 0.12**2))
    assert "longitudinal force 12 %" in balance_line(observer).message
    newest = observer.adapter.balance._newest
    monkeypatch.setitem(newest.__dict__, "acceleration_covariance", np.diag([1.0, 0, 0, 0, 0, 0]) ** 2)
    assert "longitudinal force" not in balance_line(observer).message


def test_the_noise_of_an_accelerometer_is_no_force_that_is_missing(vehicle, lane_change):
    rng = np.random.default_rng(46)

    def shaken(sample):
        force = sample.values["linear_acceleration"] + np.array([0.0, 6.0 * rng.standard_normal(), 0.0])
        return changed(sample, linear_acceleration=force)

    samples = altered(messages(lane_change, 8.0), lambda sample: sample.topic == IMU, shaken)
    line = balance_line(estimated(Runner(vehicle, lane_change.map_origin), samples))
    assert float(line.values["lateral force [%]"]) > 8
    assert line.level is Level.OK


def test_longitudinal_forces_of_wheels_that_are_absent_are_not_compared(vehicle, lane_change):
    sensors = {name: one for name, one in vehicle.sensors.items() if one.kind != "wheel_speeds"}
    car = vehicle.model_copy(update={"drivetrain": Drivetrain(), "sensors": sensors})
    observer = estimated(Runner(car, lane_change.map_origin), messages(lane_change, 4.0))
    (force,) = (s.values["force"] for s in observer.estimate() if s.topic == "vsense/wheel_force/rl")
    assert np.isnan(force[0])
    assert "longitudinal force [%]" not in balance_line(observer).values
    assert "lateral force [%]" in balance_line(observer).values


def test_without_its_inertial_sensor_there_is_no_balance(vehicle, lane_change):
    observer = feed(Runner(vehicle), [s for s in messages(lane_change) if s.topic != IMU])
    topics = [sample.topic for sample in observer.estimate()]
    assert "vsense/balance" not in topics
    assert "vsense/odometry" in topics
    assert balance_line(observer).message == "nothing to compare yet"


def test_what_is_published_is_what_is_over(vehicle, lane_change):
    """The sum of the published forces less mass times the specific force of the truth, on a straight stretch."""
    output = run(lane_change, vehicle).output
    channel = output["vsense/balance"]
    wheels = [output[f"vsense/wheel_force/{wheel}"] for wheel in ("fl", "fr", "rl", "rr")]
    loads = sum(wheel.columns["force"][:, 2] for wheel in wheels)
    loads = np.interp(channel.stamp, wheels[0].stamp, loads)
    over = channel.columns["force"][:, 2]
    late = channel.seconds > 2.0
    felt = lane_change[IMU].columns["linear_acceleration"][:, 2].mean() * vehicle.physics.chassis.mass
    assert np.mean(over[late]) == pytest.approx(np.mean(loads[late]) - felt, abs=0.01 * felt)


def without(axes, sample):
    """A message of the inertial sensor without some of its six axes."""
    value = np.concatenate([sample.values["angular_velocity"], sample.values["linear_acceleration"]])
    value[axes] = np.nan
    return changed(sample, angular_velocity=value[:3], linear_acceleration=value[3:])


def test_with_an_inertial_sensor_that_lacks_axes_what_these_tell_is_compared(vehicle, lane_change):
    """As a car's own, which knows the yaw rate and two accelerations: the sums are those of a sensor with all axes,
    but for gravity that is felt as the body leans, and what a mounting point feels as it turns."""
    poorer = altered(messages(lane_change, 8.0), lambda s: s.topic == IMU, lambda s: without([0, 1, 5], s))
    whole, part = (
        estimated(Runner(vehicle, lane_change.map_origin), samples) for samples in (messages(lane_change, 8.0), poorer)
    )
    assert list(balance_line(part).values) == ["longitudinal force [%]", "lateral force [%]", "yaw moment [%]"]
    assert balance_line(part).level is Level.OK
    for name, share in balance_line(part).values.items():
        assert float(share) == pytest.approx(float(balance_line(whole).values[name]), abs=2.0)
    (sample,) = (sample for sample in part.estimate() if sample.topic == "vsense/balance")
    np.testing.assert_array_equal(np.isnan(sample.values["force"]), [False, False, True])
    np.testing.assert_array_equal(np.isnan(sample.values["torque"]), [True, True, False])


def test_with_no_axis_that_tells_a_sum_nothing_is_compared_and_that_is_said(vehicle, lane_change):
    poorer = altered(messages(lane_change, 3.0), lambda s: s.topic == IMU, lambda s: without([2, 3, 4, 5], s))
    observer = estimated(Runner(vehicle, lane_change.map_origin), poorer)
    assert balance_line(observer).message == "not compared: imu lacks the axes"
    assert "vsense/balance" not in [sample.topic for sample in observer.estimate()]


def test_a_reading_that_comes_late_does_not_take_the_place_of_a_newer_one(vehicle, lane_change):
    """Else the comparison would be with one that is too old for any."""
    observer = feed(Runner(vehicle, lane_change.map_origin), messages(lane_change, 4.0))
    value, variance = np.array([0, 0, 0, 0, 0, 9.81]), np.ones(6)
    observer.adapter.balance.measured(Event(observer.names.index("imu"), observer.stamp - SECOND, value, variance))
    assert np.isfinite(observer.snapshot().unbalanced).all()
