"""Recordings in which sensors alone are wrong, in ways that no effect of the library has, or hardly anything moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hidden import driven, prototype, seconds
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.mismatch.answer_schema import Answer
from vsense_ros.mismatch.explain import explain_recordings
from vsense_ros.model.effects import EVERY

Change = Callable[[np.ndarray, np.ndarray, np.ndarray], None]  # of times [s], rates [rad/s] and forces [m/s²] in place


def changed(recording: Recording, change: Change) -> Recording:
    """With other readings of the inertial sensor."""
    imu = recording["imu/data"]
    rates, forces = imu.columns["angular_velocity"].copy(), imu.columns["linear_acceleration"].copy()
    change(seconds(recording, "imu/data"), rates, forces)
    columns = {**imu.columns, "angular_velocity": rates, "linear_acceleration": forces}
    return replace(recording, channels={**recording.channels, "imu/data": replace(imu, columns=columns)})


def names_no_physics_of_the_car(found: Answer) -> bool:
    return all(EVERY[name].acts_on() == "sensor" for name in found.answer_set)


@pytest.mark.exam
def test_where_nothing_but_a_sensor_is_wrong_nothing_of_the_car_is_named():
    """A gyro of another scale and with an offset, and an accelerometer with one: the scale is what shows."""

    def wrong(_: np.ndarray, rates: np.ndarray, forces: np.ndarray) -> None:
        rates[:, 2] = 1.05 * rates[:, 2] + 0.02
        forces[:, 1] += 0.4

    drives = [changed(driven(prototype(), manoeuvre), wrong) for manoeuvre in ("sweep", "slalom", "brake")]
    found = explain_recordings(drives[:2], prototype(), drives[2:]).answer
    assert found.verdict == "named"
    assert names_no_physics_of_the_car(found)
    scale = next(effect for effect in found.effects if effect.id == "gyro_scale")
    assert scale.parameters[0].value == pytest.approx(0.05, abs=0.01)


@pytest.mark.exam
@pytest.mark.parametrize("other", ["the gyro the other way", "the accelerometer"])
def test_two_recordings_with_different_defects_of_one_sensor_are_of_no_effect(other):
    def turning(_: np.ndarray, rates: np.ndarray, forces: np.ndarray) -> None:
        rates[:, 2] += 0.03

    def opposite(_: np.ndarray, rates: np.ndarray, forces: np.ndarray) -> None:
        if other == "the accelerometer":
            forces[:, 1] += 0.5
        else:
            rates[:, 2] -= 0.03

    drives = [changed(driven(prototype(), "sweep"), turning), changed(driven(prototype(), "slalom"), opposite)]
    found = explain_recordings(drives, prototype()).answer
    assert found.verdict == "unknown"
    assert {signal.name for signal in found.located.signals[:2]} & {"yaw_rate", "lateral_acceleration"}


@pytest.mark.exam
def test_a_defect_that_begins_half_way_is_no_physics_of_the_car_and_since_when_it_is_there_is_told():
    def late(t: np.ndarray, rates: np.ndarray, forces: np.ndarray) -> None:
        forces[t > t[-1] / 2, 1] += 0.8

    drives = [changed(driven(prototype(), manoeuvre), late) for manoeuvre in ("sweep", "slalom", "brake")]
    found = explain_recordings(drives[:2], prototype(), drives[2:]).answer
    assert found.verdict == "unknown"
    assert found.located.signals[0].name == "lateral_acceleration"
    assert found.onset is not None
    assert (found.onset.looks_like, found.onset.where) == ("accelerometer_bias", "y")
    assert found.onset.value == pytest.approx(0.8, rel=0.1)
    for drive, begin in zip(drives[:2], found.onset.begins, strict=True):
        earliest, latest = begin.interval_90
        assert begin.recording == drive.name
        assert earliest < seconds(drive, "imu/data")[-1] / 2 < latest < earliest + 1.0
    assert "it begins at 6.5 s" in found.sentence


STANDS = 600.0  # [s]
PULL = 2.0  # [m/s²]


def standing_before(recording: Recording) -> Recording:
    """Ten minutes at standstill and a start straight ahead before a recording that begins to the east."""
    rng = np.random.default_rng(0)
    speed = float(np.hypot(*recording["gps/velocity"].columns["linear"][0, :2]))
    start = speed / PULL

    def before(topic: str, channel: Channel) -> Channel:
        step = int(np.median(np.diff(channel.stamp)))
        t = np.arange(-int((STANDS + start) * 1e9 / step), 0) * step * 1e-9  # before the recording begins
        share = np.clip(1 + t / start, 0.0, 1.0)[:, None]
        columns = {}
        for name, values in channel.columns.items():
            rows = np.repeat(values[:1].astype(float), len(t), axis=0)
            if topic == "imu/data" and name == "linear_acceleration":
                rows = [0.0, 0.0, 9.81] + 0.05 * rng.standard_normal(rows.shape)
                rows[:, 0] += PULL * ((share > 0) & (share < 1))[:, 0]
            elif topic == "imu/data" and name == "angular_velocity":
                rows = 0.002 * rng.standard_normal(rows.shape)
            elif name == "effort" and rows.size:
                rows = np.repeat(600.0 * 0.27 * PULL / 4 * ((share > 0) & (share < 1)), 4, axis=1)  # as in `driven`
            elif (topic, name) == ("gps/fix", "longitude"):
                behind = np.where(t[:, None] < -start, -speed * start / 2, t[:, None] * speed * (1 + share) / 2)
                rows = rows + behind / (111_320 * np.cos(np.radians(channel.columns["latitude"][0])))
            elif name in ("velocity", "linear"):
                rows = rows * share + 0.01 * rng.standard_normal(rows.shape)
            columns[name] = np.concatenate([rows, values]).astype(values.dtype)
        stamp = channel.stamp[0] + np.rint(t * 1e9).astype(np.int64)
        late = channel.received[0] - channel.stamp[0]
        return replace(
            channel, stamp=np.concatenate([stamp, channel.stamp]),
            received=np.concatenate([stamp + late, channel.received]), columns=columns,
        )  # fmt: skip

    return replace(recording, channels={topic: before(topic, c) for topic, c in recording.channels.items()})


@pytest.mark.exam
def test_of_ten_minutes_at_standstill_with_one_bend_nothing_is_named():
    found = explain_recordings([standing_before(driven(prototype(), "bend", duration=20.0))], prototype()).answer
    assert (found.verdict, found.answer_set) == ("no_mismatch", ())
    assert found.driven_s < 60.0  # of 630 s: who stands has no window
