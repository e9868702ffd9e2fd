"""What is said of a run on a recording, on drives whose truth is a closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sine_drive import EPOCH, SineDrive, car_of_sine_drive
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner, run
from vsense_ros.runner.catalogue import every_filter
from vsense_ros.runner.playing import play
from vsense_ros.runner.run import topics_in
from vsense_ros.runner.vote_settings import VOTE

NAME = "strapdown"


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return car_of_sine_drive()


@pytest.fixture(scope="module")
def drive() -> Recording:
    return SineDrive(16.0).recording()


def inertial(recording: Recording, field: str, change: object, after: float, until: float = np.inf) -> Recording:
    """The recording whose vectors of a field became `change(vectors)` for a time [s]."""
    channel = recording["imu/data"]
    values = channel.columns[field].copy()
    rows = (channel.seconds > after) & (channel.seconds < until)
    values[rows] = change(values[rows])  # type: ignore[operator]
    changed = replace(channel, columns={**channel.columns, field: values})
    return replace(recording, channels={**recording.channels, "imu/data": changed})


def fed(recording: Recording, car: Vehicle) -> Runner:
    runner = Runner(car, recording.map_origin, every_filter()[NAME].make)
    for sample in recording.samples(topics_in(recording, runner.topics)):
        runner.add(sample)
    return runner


def out(runner: Runner) -> list[str]:
    return [axes.name(axis) for axes, axis, _ in runner.vote.out]


def test_on_a_drive_in_which_all_is_right_no_axis_is_left_out(car, drive):
    runner = fed(drive, car)
    assert out(runner) == []
    assert runner.resets.reported == []
    assert (runner.faults, runner.restarts) == (0, 0)


@pytest.mark.parametrize(("axis", "sign", "name"), [(1, 1.0, "pitch rate"), (2, -1.0, "yaw rate")])
def test_a_gyro_that_jumps_is_left_out_by_its_axis_and_its_name(car, drive, axis, sign, name):
    jumped = inertial(drive, "angular_velocity", lambda v: v + sign * 0.6 * np.eye(3)[axis], 12.0)
    runner = fed(jumped, car)
    assert out(runner) == [f"imu {name}"]
    ((axes, place, one),) = runner.vote.out
    assert place == axis
    assert one.since == pytest.approx(EPOCH + 12e9, abs=0.5e9)
    (line,) = [diagnostic for diagnostic in runner.diagnostics() if diagnostic.name == "imu"]
    assert line.message == f"not believed: {name} jumped away from all others"
    assert axes.present


def test_an_accelerometer_that_freezes_is_left_out(car, drive):
    frozen = inertial(
        drive, "linear_acceleration", lambda v: np.column_stack([v[:, 0], 0 * v[:, 1] + 0.7, v[:, 2]]), 12.0
    )
    ((_, place, one),) = fed(frozen, car).vote.out
    assert (place, one.why) == (4, "is frozen")


def test_a_gyro_at_the_end_of_its_range_is_believed_as_soon_as_it_moves_on(car):
    bend = SineDrive(11.2).recording()  # turns at 0.26 rad/s after 10 s, and at less than 0.22 from 10.75 s on
    ended = inertial(bend, "angular_velocity", lambda v: np.minimum(v, 0.22), 8.0)
    runner = fed(ended, car)
    assert out(runner) == []
    assert runner.health[list(runner.names).index("imu")].problem == "yaw rate is frozen: not believed any more"


def test_an_axis_that_agrees_again_is_believed_again(car, drive):
    longer = SineDrive(18.0).recording()
    moment = inertial(longer, "angular_velocity", lambda v: v + np.array([0.0, 0.0, 0.6]), 10.0, 11.0)
    runner = fed(moment, car)
    assert out(runner) == []
    (axes,) = runner.vote.axes.values()
    assert axes.wait == {2: 2 * VOTE.agreed}


def test_a_run_has_estimates_at_the_rate_that_was_asked_for_and_shares_of_progress(car, drive):
    shares: list[float] = []
    found = run(drive, car, NAME, rate=10.0, progress=shares.append)
    odometry = found.output["vsense/odometry"]
    steps = np.diff(odometry.stamp) * 1e-9
    assert steps.min() >= 0.0999
    assert np.median(steps) == pytest.approx(0.1, abs=0.011)
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert found.failure == ""
    assert found.realtime_factor > 1.0
    assert found.step_us_median > 0.0
    assert [line.level for line in found.diagnostics if line.name == "imu"] == [Level.OK]
    assert found.output.metadata == drive.metadata


def test_a_recording_without_the_sensors_of_the_car_is_refused_with_what_was_expected(car, drive):
    with pytest.raises(
        InputError, match=r"sine: none of the vehicle's sensors is in it; expected .*imu/data.*, found other"
    ):
        run(Recording({"other": replace(drive["imu/data"], topic="other")}, "sine"), car, NAME)
    with pytest.raises(InputError, match=r"recording: none of .* found nothing"):
        run(Recording({}), car, NAME)
    empty = drive["imu/data"].select(slice(0, 0))
    with pytest.raises(InputError, match="none of"):
        run(Recording({"imu/data": empty}), car, NAME)


def test_a_filter_that_never_starts_is_an_error_that_says_what_it_waits_for(car, drive):
    with pytest.raises(InputError, match=r"sine: the filter .* never started .*"):
        run(replace(drive, channels={"imu/data": drive["imu/data"]}), car, NAME)


def test_topics_without_messages_are_no_topics(drive):
    topics = ("imu/data", "gps/fix", "gps/attitude")
    assert topics_in(drive, topics) == ("imu/data", "gps/fix")
    empty = replace(drive, channels={**drive.channels, "gps/fix": drive["gps/fix"].select(slice(0, 0))})
    assert topics_in(empty, topics) == ("imu/data",)


def test_a_recording_that_is_played_is_what_its_messages_are_one_by_one(car: Vehicle, drive: Recording) -> None:
    """With a vector that is absent for a while, and one that is no quantity."""
    absent = inertial(drive, "angular_velocity", lambda vectors: np.full_like(vectors, np.nan), 5.0, 5.5)
    strange = inertial(absent, "linear_acceleration", lambda vectors: 1e9 + vectors, 8.0, 8.2)
    played, fed = (Runner(car, make=every_filter()[NAME].make) for _ in range(2))
    topics = topics_in(strange, played.topics)
    count = sum(1 for _ in play(played, strange, topics))
    for sample in strange.samples(topics):
        fed.add(sample)
    assert count == sum(len(strange[topic]) for topic in topics)
    assert played.stamp == fed.stamp > 0
    np.testing.assert_array_equal(played.filter.memory, fed.filter.memory)
    assert played.diagnostics() == fed.diagnostics()
    assert played.health == fed.health
