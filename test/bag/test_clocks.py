"""Clocks that begin anew or are set in a recording are counted on, or cut, with a sentence."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag import write_bag
from vsense_ros.bag.clocks import with_steady_clocks
from vsense_ros.bag.importers import build, import_recording
from vsense_ros.messages.recording import Channel, Recording

SECOND = 1_000_000_000
NOON = 1_714_564_800 * SECOND


def table(path: Path, times: list[str]) -> None:
    rows = [f"{time},{0.01 * i:.4f}" for i, time in enumerate(times)]
    path.write_text("\n".join(["t,yaw_rate", *rows]) + "\n")


def mapping(**time: str) -> dict:
    rate = {"column": "yaw_rate", "unit": "rad/s"}
    return {"time": {"column": "t", **time}, "topics": {"imu/data": {"angular_velocity": [None, None, rate]}}}


@pytest.mark.parametrize(
    ("unit", "bits", "step"), [("us", 32, 1e-2), ("ms", 32, 1e-2), ("ms", 16, 0.1), ("us", 16, 5e-3)]
)
def test_a_counter_that_begins_anew_is_counted_on(unit: str, bits: int, step: float, tmp_path: Path) -> None:
    size = {"us": 1e6, "ms": 1e3}[unit]
    turn = 2**bits
    true = np.arange(2000) * step
    numbers = (np.rint(true * size).astype(np.int64) + turn - round(0.7 * min(true[-1] * size, turn))) % turn
    table(tmp_path / "log.csv", [str(n) for n in numbers])
    found = import_recording(tmp_path / "log.csv", mapping=mapping(unit=unit))
    np.testing.assert_allclose(found["imu/data"].seconds, true, atol=1.1 / size)
    assert any(f"a counter of {bits} bits of" in note for note in found.notes)


def test_local_time_at_the_end_of_summer_time_goes_on(tmp_path: Path) -> None:
    first = datetime(2024, 10, 27, 0, 59, 57, tzinfo=UTC)
    local = []
    for i in range(600):
        moment = first + timedelta(seconds=0.01 * i)
        local.append(moment + timedelta(hours=2 if moment < datetime(2024, 10, 27, 1, tzinfo=UTC) else 1))
    table(tmp_path / "log.csv", [f"{m:%Y-%m-%d %H:%M:%S.%f}" for m in local])
    found = import_recording(tmp_path / "log.csv", mapping=mapping(unit="iso"))
    np.testing.assert_allclose(np.diff(found["imu/data"].seconds), 0.01, atol=1e-6)
    assert any("goes back by an hour" in note for note in found.notes)


def imu(stamp: np.ndarray, received: np.ndarray | None = None) -> Channel:
    rates = np.random.default_rng(0).normal(size=(len(stamp), 3))
    return build.imu(stamp, rates, rates, received=received)


def test_a_computer_that_begins_in_1970_keeps_the_longer_part(tmp_path: Path) -> None:
    stamp = NOON + np.arange(1000) * SECOND // 100
    stamp[:300] -= NOON - 30 * SECOND
    write_bag(tmp_path / "late", Recording({"imu/data": imu(stamp)}))
    found = import_recording(tmp_path / "late")
    assert np.array_equal(found["imu/data"].stamp, stamp[300:])
    assert any("the clock was set by" in note and "the longest is used" in note for note in found.notes)
    assert found.duration == pytest.approx(6.99)


def test_of_a_logger_that_started_again_all_topics_keep_the_same_part() -> None:
    stamp = np.concatenate([np.arange(3000, 5000), np.arange(0, 900)]) * SECOND // 100
    slow = stamp[::20]
    wheels = build.joints("vehicle/wheel_speeds", slow, "velocity", {"wheel_fl": np.arange(len(slow)) * 1.0})
    found = with_steady_clocks(Recording({"imu/data": imu(stamp), wheels.topic: wheels}))
    assert np.array_equal(found["imu/data"].stamp, stamp[:2000])
    assert np.array_equal(found[wheels.topic].stamp, slow[:100])


def test_stamps_of_a_clock_that_was_set_go_on_as_they_arrived() -> None:
    received = NOON + np.arange(1000) * SECOND // 100
    stamp = received - 5_000_000
    stamp[400:] += 86_400 * 365 * SECOND
    found = with_steady_clocks(Recording({"imu/data": imu(stamp, received)}))
    assert np.array_equal(found["imu/data"].stamp, received - 5_000_000)
    assert any("its clock was set by +31536000.0 s" in note for note in found.notes)


def test_times_out_of_order_and_pauses_are_left_alone() -> None:
    stamp = NOON + np.arange(1000) * SECOND // 100
    stamp[500:] += 3 * 3600 * SECOND  # a pause of three hours
    stamp[[100, 101]] = stamp[[101, 100]]
    stamp[200] -= 65_536_000 + 10_000_000  # late by the turn of a counter of 16 bits
    recording = Recording({"imu/data": imu(stamp)})
    assert with_steady_clocks(recording) is recording
