"""A receiver whose values a driver repeats is believed once for each measurement."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from recordings import planted
from recordings.planted import FIX, VELOCITY, repeated
from vsense_ros.api.estimation import estimate
from vsense_ros.bag import write_bag
from vsense_ros.bag.held import without_repeats
from vsense_ros.bag.importers import import_recording
from vsense_ros.messages.recording import Recording


def drive() -> Recording:
    return planted.drive("double_lane_change", "prototype_real", 0)


def held() -> Recording:
    """The drive with ten messages for each measurement of the receiver."""
    found = planted.changed(drive(), FIX, repeated(10))
    return planted.changed(found, VELOCITY, repeated(10))


@pytest.mark.parametrize("topic", [FIX, VELOCITY])
def test_a_bag_gives_each_measurement_once_and_says_so(topic: str, tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", held())
    found = import_recording(tmp_path / "bag")
    measured = drive()[topic]
    assert len(found[topic]) == len(measured) - 1
    assert found[topic].stamp.tolist() == measured.stamp[:-1].tolist()
    assert any(note.startswith(f"{topic}: each value stands in 10 messages") for note in found.notes)


def test_a_receiver_that_measures_each_of_its_messages_keeps_all(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", drive())
    found = import_recording(tmp_path / "bag")
    assert len(found[FIX]) == len(drive()[FIX])


def test_a_receiver_that_stands_keeps_all() -> None:
    fix = drive()[FIX]
    rest = replace(fix, columns={name: np.repeat(values[:1], len(fix), axis=0) for name, values in fix.columns.items()})
    recording = Recording({FIX: rest})
    assert without_repeats(recording) is recording


@pytest.mark.slow
def test_side_slip_is_as_good_as_without_the_repeats() -> None:
    def error(recording: Recording) -> float:
        rmse = estimate(recording, "prototype_real")["side_slip"].rmse
        assert rmse is not None
        return float(np.degrees(rmse))

    right = error(drive())
    assert error(without_repeats(held())) < right + 0.02
