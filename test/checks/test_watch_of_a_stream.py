"""What a watch keeps of a stream, and what it says of a drive in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from synthetic_motion import GNSS_SIGNALS, IMU, POSITION, STEERING, VELOCITY, Drive
from vsense_ros.bag.importers import build
from vsense_ros.checks import watch as module
from vsense_ros.checks.finding import Finding, Kind
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.watch import PlausibilityWatch
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Channel, Recording, Sample

START = 1_600_000_000_000_000_000
SECOND = 1_000_000_000
JOINTS = "sensor_msgs/msg/JointState"


def drive(sign: float = 1.0, duration: float = 40.0) -> Recording:
    """The closed drive with a steering angle of this sign."""
    signals = Drive(duration=duration).signals()
    stamp = build.nanoseconds(np.arange(len(signals["wz"])) * 0.02, START)
    rates, forces = (np.column_stack([signals[f"{v}{axis}"] for axis in "xyz"]) for v in "wa")
    velocity = np.column_stack([*(signals[name] for name in GNSS_SIGNALS), 0 * signals["wz"]])
    latitude = 50 + signals["y"] / 111_229.0
    longitude = 8 + signals["x"] / 71_696.0
    fix = build.fix(stamp[::5], latitude[::5], longitude[::5], 0 * latitude[::5])
    channels: tuple[Channel, ...] = (
        build.imu(stamp, rates, forces),
        build.velocity(stamp[::5], velocity[::5]),
        fix,
        build.joints(STEERING, stamp, "position", {"steering_wheel": sign * signals["steering_wheel"]}),
    )
    return Recording({channel.topic: channel for channel in channels})


def fed(recording: Recording) -> PlausibilityWatch:
    watch = PlausibilityWatch("car")
    for sample in recording.samples():
        watch.add(sample)
    return watch


def joint(seconds: float, value: float = 0.0, names: tuple[str, ...] = ("steering_wheel",)) -> Sample:
    values = {"position": np.full(len(names), value), "velocity": np.zeros(0), "effort": np.zeros(0)}
    return Sample(STEERING, JOINTS, START + round(seconds * 1e9), values, names=names)


def seen(watch: PlausibilityWatch, monkeypatch: pytest.MonkeyPatch, now: int) -> Recording | None:
    """The recording that the watch looks at."""
    looked: list[Recording] = []

    def spy(recording: Recording, topics: object) -> list[Finding]:
        looked.append(recording)
        return []

    monkeypatch.setattr(module, "findings", spy)
    watch.diagnostics(now)
    return looked[0] if looked else None


def test_a_stream_in_which_all_is_right_raises_no_doubt():
    assert fed(drive()).diagnostics(START + 40 * SECOND) == []


def test_a_reversed_signal_is_a_warning_that_names_it():
    (diagnostic,) = fed(drive(-1.0)).diagnostics(START + 40 * SECOND)
    assert (diagnostic.name, diagnostic.level) == ("car: plausibility", Level.WARN)
    assert "vehicle/steering: steering_wheel is against" in diagnostic.message


def test_of_less_than_fifteen_seconds_nothing_is_said():
    assert fed(drive(-1.0, duration=14.0)).diagnostics(START + 14 * SECOND) == []


def test_the_latest_forty_seconds_are_kept(monkeypatch):
    watch = PlausibilityWatch("car")
    for i in range(600):
        watch.add(joint(0.1 * i, i))
    looked = seen(watch, monkeypatch, START + 60 * SECOND)
    assert looked is not None
    assert looked[STEERING].columns["position"][:, 0].tolist() == list(range(199, 600))


def test_samples_within_twenty_milliseconds_of_the_one_before_are_left_out_unless_they_carry_other_joints(monkeypatch):
    watch = PlausibilityWatch("car")
    for i in range(2000):
        watch.add(joint(0.01 * i, i))
    looked = seen(watch, monkeypatch, START + 20 * SECOND)
    assert looked is not None
    assert looked[STEERING].columns["position"][:, 0].tolist() == list(range(0, 2000, 2))
    watch = PlausibilityWatch("car")
    for i in range(1000):
        watch.add(joint(0.02 * i, i))
        watch.add(joint(0.02 * i + 0.01, -i, ("road_wheel_front",)))
    looked = seen(watch, monkeypatch, START + 20 * SECOND)
    assert looked is not None
    channel = looked[STEERING]
    assert channel.names == ("steering_wheel", "road_wheel_front")
    np.testing.assert_array_equal(channel.columns["position"][:4, 0], [0, np.nan, 1, np.nan])
    np.testing.assert_array_equal(channel.columns["position"][:4, 1], [np.nan, 0, np.nan, -1])
    assert channel.columns["effort"].shape == (2000, 2)


@pytest.mark.parametrize(("jump", "anew"), [(9.0, False), (11.0, True), (-30.0, True)])
def test_a_stream_begins_anew_where_its_clock_was_set(monkeypatch, jump, anew):
    watch = PlausibilityWatch("car")
    for i in range(100):
        watch.add(joint(100 + 0.1 * i, 0.0))
    for i in range(200):
        watch.add(joint(100 + 9.9 + jump + 0.1 * i, 1.0))
    looked = seen(watch, monkeypatch, START + 200 * SECOND)
    assert looked is not None
    assert len(looked[STEERING]) == (200 if anew else 300)
    assert (looked[STEERING].columns["position"] == 1.0).all() == anew


def test_a_look_is_repeated_after_ten_seconds_and_not_before(monkeypatch):
    looks: list[int] = []

    def spy(recording: Recording, topics: object) -> list[Finding]:
        looks.append(1)
        return [
            Finding(IMU, Kind.SIGN, Reason.TURNS_AGAINST, "angular_velocity.z", "gnss"),
            Finding(VELOCITY, Kind.JUMP, Reason.SIGNAL_JUMPS, "linear.x"),
            Finding(POSITION, Kind.HELD, Reason.REPEATED_VALUES),
        ]

    monkeypatch.setattr(module, "findings", spy)
    watch = fed(drive())
    (first,) = watch.diagnostics(START)
    assert first.message.startswith("imu/data: the yaw rate is against")
    assert ";" not in first.message  # jumps and held values are the matter of the monitor
    for seconds, expected in ((0.0, 1), (9.9, 1), (10.0, 2), (19.0, 2), (21.0, 3), (20.0, 4)):
        watch.diagnostics(START + round(seconds * 1e9))
        assert len(looks) == expected, seconds


def test_a_topic_with_few_samples_is_not_looked_at(monkeypatch):
    for count, expected in ((20, False), (21, True)):
        watch = PlausibilityWatch("car")
        for i in range(count):
            watch.add(joint(1.0 * i))
        assert (seen(watch, monkeypatch, START) is not None) == expected


def test_arrivals_are_those_of_the_samples_and_their_stamps_where_none_is_known(monkeypatch):
    watch = PlausibilityWatch("car")
    for i in range(40):
        watch.add(joint(1.0 * i) if i % 2 else late(joint(1.0 * i)))
    looked = seen(watch, monkeypatch, START)
    assert looked is not None
    delay = looked[STEERING].received - looked[STEERING].stamp
    assert delay[:4].tolist() == [SECOND, 0, SECOND, 0]


def late(sample: Sample) -> Sample:
    return Sample(
        sample.topic, sample.kind, sample.stamp, sample.values, names=sample.names, received=sample.stamp + SECOND
    )


def test_joints_of_which_a_sample_has_no_value_are_absent(monkeypatch):
    watch = PlausibilityWatch("car")
    for i in range(40):
        values = {"position": np.array([float(i)]) if i % 2 else np.zeros(0)}
        watch.add(Sample(STEERING, JOINTS, START + i * SECOND, values, names=("steering_wheel",) if i else ("other",)))
    looked = seen(watch, monkeypatch, START)
    assert looked is not None
    values = looked[STEERING].columns["position"]
    assert values.shape == (40, 2)
    assert np.isnan(values[:, 0]).all()
    np.testing.assert_array_equal(values[:4, 1], [np.nan, 1.0, np.nan, 3.0])
