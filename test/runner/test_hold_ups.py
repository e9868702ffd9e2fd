"""A computer that is held up: messages that are read late, with the stamps of their measurement or of their arrival."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from drives import FIX, IMU, SECOND, STEERING, VELOCITY, WHEELS, distance, feed, messages
from vsense_ros.evaluate.metrics import compare
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner, run

CAN = (WHEELS, STEERING)
ALL = (IMU, *CAN, FIX, VELOCITY)
TIMES = 4.0, 8.0  # [s] at which drivers are held up, in the middle of the manoeuvre and after it
APART = 20_000  # [ns] between two readings that have waited
OUTPUTS = "speed", "side_slip", "lateral_velocity", "yaw_rate", "yaw", "position"
WITHIN, NEES = 0.9, 2.0  # [-] at least, at most; or what the drive has without a hold-up, less and plus a tenth


def held_up(recording: Recording, topics: tuple[str, ...], length: float, *, stamped_late: bool) -> Recording:
    """The drive whose messages of these topics arrive together after a time [s], with stamps of then or their own."""

    def late(channel: Channel) -> Channel:
        received = channel.received.copy()
        for time in TIMES:
            begin = recording.start + round(time * SECOND)
            end = begin + round(length * SECOND)
            waiting = (received >= begin) & (received < end)
            received[waiting] = end
            # One after the other, and none overtakes another.
            spaced = APART * np.arange(len(received))
            received = np.maximum.accumulate(received - spaced) + spaced
        stamp = channel.stamp + (received - channel.received) * stamped_late
        return replace(channel, stamp=stamp, received=received)

    return replace(recording, channels=recording.channels | {topic: late(recording[topic]) for topic in topics})


@dataclass(frozen=True)
class Outcome:
    """Shares of errors within two standard deviations [-] and NEES of the outputs, and what was said of the sensors."""

    within: dict[str, float]
    nees: dict[str, float]
    said: set[str]


def outcome(recording: Recording, truth: Recording, vehicle: Vehicle) -> Outcome:
    """What the observer makes of a drive, and says while it does."""
    runner = Runner(vehicle, recording.map_origin)
    said: set[str] = set()
    for i, sample in enumerate(messages(recording)):
        runner.add(sample)
        if i % 20 == 0:
            said |= {line.message for line in runner.diagnostics(sample.received)}
    scores = compare(run(recording, vehicle).output, truth)
    known = {name: scores[name] for name in OUTPUTS}
    return Outcome(
        {name: float(score.within_2s or 0.0) for name, score in known.items()},
        {name: float(score.nees or np.inf) for name, score in known.items()},
        said,
    )


@pytest.fixture(scope="module")
def undisturbed(lane_change: Recording, vehicle: Vehicle) -> Outcome:
    """The drive without a hold-up."""
    return outcome(lane_change, lane_change, vehicle)


FAST = [(ALL, 0.3, True), (CAN, 1.0, False), (CAN, 1.0, True)]
CASES = [
    *FAST,
    *(
        pytest.param(topics, length, stamped_late, marks=pytest.mark.exam)
        for topics in (ALL, CAN, (IMU,))
        for length in (0.3, 1.0, 3.0)
        for stamped_late in (False, True)
        if (topics, length, stamped_late) not in FAST
    ),
]


@pytest.mark.parametrize(("topics", "length", "stamped_late"), CASES)
def test_estimates_of_a_computer_that_was_held_up_are_as_uncertain_as_they_are_wrong(
    lane_change: Recording,
    vehicle: Vehicle,
    undisturbed: Outcome,
    topics: tuple[str, ...],
    length: float,
    stamped_late: bool,
) -> None:
    late = held_up(lane_change, topics, length, stamped_late=stamped_late)
    result = outcome(late, lane_change, vehicle)
    for name in OUTPUTS:
        assert result.within[name] >= min(WITHIN, undisturbed.within[name] - 0.1), (name, result)
        assert result.nees[name] <= max(NEES, undisturbed.nees[name] + 0.1), (name, result)
    reported = [sentence for sentence in result.said if "those of arrival after a hold-up" in sentence]
    assert bool(reported) == stamped_late, result.said


@pytest.mark.parametrize("silent", [(STEERING,), CAN, (IMU, *CAN)], ids=len)
def test_without_steering_the_angle_is_as_uncertain_as_drivers_steer(
    lane_change: Recording, vehicle: Vehicle, silent: tuple[str, ...]
) -> None:
    heard = {topic: channel for topic, channel in lane_change.channels.items() if topic not in silent}
    scores = compare(run(replace(lane_change, channels=heard), vehicle).output, lane_change)
    for name in ("side_slip", "lateral_velocity", "yaw"):
        within, nees = scores[name].within_2s, scores[name].nees
        assert within is not None
        assert nees is not None
        assert within >= WITHIN, (name, scores[name])
        assert nees <= NEES, (name, scores[name])


def test_an_observer_that_is_held_up_itself_loses_nothing(lane_change: Recording, vehicle: Vehicle) -> None:
    """All messages have waited in its queue, in the order in which they were sent."""
    in_time = feed(Runner(vehicle, lane_change.map_origin), messages(lane_change))
    samples = messages(lane_change)
    begin, end = (lane_change.start + round(time * SECOND) for time in (4.0, 7.0))
    late = [replace(s, received=max(s.received or 0, end)) if (s.received or 0) >= begin else s for s in samples]
    observer = feed(Runner(vehicle, lane_change.map_origin), late)
    assert max(distance(observer, in_time)) < 1e-9
    assert not any(health.invalid or health.too_late for health in observer.health)


def test_a_drive_without_hold_ups_loses_no_reading(clean: Runner) -> None:
    assert not any(health.invalid for health in clean.health)
