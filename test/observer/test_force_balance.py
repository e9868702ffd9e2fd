"""The observer says whether its forces add up to what the inertial sensor feels."""

import numpy as np
import pytest

from drives import IMU, SECOND, altered, changed, feed, messages
from vsense_ros.messages.diagnostic import Level
from vsense_ros.observer import Observer, run


def told(observer):
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
    observer = estimated(Observer(vehicle, lane_change.map_origin), messages(lane_change))
    assert told(observer).level is Level.OK
    assert len(told(observer).values) == 6
    assert all(float(share) < 8 for share in told(observer).values.values())


@pytest.mark.parametrize(("axis", "what"), [(0, "longitudinal force"), (2, "vertical force")])
def test_an_accelerometer_that_comes_to_feel_another_force_is_told(vehicle, lane_change, axis, what):
    """From the middle of the drive on, too slowly for the gate to refuse it."""

    def drifts(sample):
        force = sample.values["linear_acceleration"].copy()
        force[axis] += 2.5 * max(0.0, (sample.stamp - lane_change.start) / SECOND - 2.0) / 8.0
        return changed(sample, linear_acceleration=force)

    samples = altered(messages(lane_change), lambda sample: sample.topic == IMU, drifts)
    observer = estimated(Observer(vehicle, lane_change.map_origin), samples)
    assert told(observer).level is Level.WARN
    assert what in told(observer).message


def test_without_its_inertial_sensor_there_is_no_balance(vehicle, lane_change):
    observer = feed(Observer(vehicle), [s for s in messages(lane_change) if s.topic != IMU])
    topics = [sample.topic for sample in observer.estimate()]
    assert "vsense/balance" not in topics
    assert "vsense/odometry" in topics
    assert told(observer).message == "nothing to compare yet"


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
