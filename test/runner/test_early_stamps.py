"""A receiver whose clock stamps its readings before they are made, and delivers them at their stamps."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drives import FIX, SECOND, VELOCITY, distance, feed, messages
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner

EARLY = 0.065  # [s]
UNTIL = 8.0  # [s] of the drive


def with_receiver_latency(vehicle: Vehicle, latency: float) -> Vehicle:
    """The vehicle whose GNSS readings have this age at their stamps [s]."""
    sensors = {
        name: sensor.model_copy(update={"latency": latency}) if sensor.topic in (FIX, VELOCITY) else sensor
        for name, sensor in vehicle.sensors.items()
    }
    return vehicle.model_copy(update={"sensors": sensors})


def drive(recording: Recording, early: float) -> list[Sample]:
    """The drive with all messages received at their stamps, and GNSS stamped `early` [s] before its measurement."""

    def stamped(sample: Sample) -> Sample:
        stamp = sample.stamp - round(early * SECOND) if sample.topic in (FIX, VELOCITY) else sample.stamp
        return replace(sample, stamp=stamp, received=stamp)

    return sorted((stamped(sample) for sample in messages(recording, UNTIL)), key=lambda sample: sample.received or 0)


@pytest.fixture(scope="module")
def early(vehicle: Vehicle, lane_change: Recording) -> Runner:
    """The observer after a drive whose GNSS comes before the time that it measures."""
    observer = Runner(with_receiver_latency(vehicle, -EARLY), lane_change.map_origin)
    return feed(observer, drive(lane_change, EARLY))


def test_readings_that_come_before_their_time_are_used_at_their_time(early, vehicle, lane_change):
    in_time = Runner(with_receiver_latency(vehicle, 0.0), lane_change.map_origin)
    feed(in_time, drive(lane_change, 0.0))
    assert max(distance(early, in_time)) < 1e-3  # the two start at other instants


def test_the_observer_does_not_go_ahead_to_a_reading_and_back_for_the_others(early):
    assert all(health.late == 0 for health in early.health)
    assert all(health.used > 50 for health in early.health)


def test_a_reading_that_waits_is_used_when_the_state_is_asked_for_its_time(vehicle, lane_change):
    observer = Runner(with_receiver_latency(vehicle, -EARLY), lane_change.map_origin)
    samples = drive(lane_change, EARLY)
    place = max(i for i, sample in enumerate(samples) if sample.topic == VELOCITY)
    feed(observer, samples[:place])
    health = observer.health[observer.names.index("velocity")]
    count = health.used
    observer.add(samples[place])
    assert health.used == count
    observer.snapshot_at(samples[place].stamp + round(EARLY * SECOND))
    assert health.used == count + 1


def test_a_second_reading_of_the_same_sensor_lets_the_first_be_used(vehicle, lane_change):
    observer = Runner(with_receiver_latency(vehicle, -EARLY), lane_change.map_origin)
    samples = drive(lane_change, EARLY)
    feed(observer, samples)
    velocity = next(s for s in reversed(samples) if s.topic == VELOCITY)
    for step in range(1, 11):
        stamp = samples[-1].stamp + step * SECOND // 10
        observer.add(replace(velocity, stamp=stamp, received=stamp))
    assert observer.stamp == stamp - SECOND // 10 + round(EARLY * SECOND)
