"""A GNSS receiver that reports once a second, as most do, calibrates a car as one that reports ten times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from vsense_ros.bag import read_bag
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrated import Calibrated
from vsense_ros.prepare.calibration import calibrate
from vsense_ros.prepare.calibration_drive import CALIBRATION, drive_of, scatter
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle

BAG = Path(__file__).parents[2] / "bags" / "hills"


@cache
def catalogue_car() -> Vehicle:
    return new_vehicle(catalogue_values(mass=1395.0, wheelbase=2.63, track=1.54, tyre="205/55R16 91V")).vehicle


def with_receiver(hertz: float, recording: Recording) -> Recording:
    """The recording with the velocity of a slower receiver, that does not average."""
    channel = recording["gps/velocity"]
    number = np.floor(channel.stamp * 1e-9 * hertz)
    rows = np.flatnonzero(np.diff(number, prepend=-1.0))
    return replace(recording, channels={**recording.channels, "gps/velocity": channel.select(rows)})


@cache
def quantities(hertz: float) -> Mapping[str, Calibrated]:
    found = calibrate([with_receiver(hertz, read_bag(BAG))], catalogue_car())
    return {one.name: one for one in found.quantities}


@pytest.mark.parametrize("hertz", [1.0, 2.0])
def test_a_slow_receiver_says_what_a_quick_one_says_within_its_deviations(hertz: float) -> None:
    quick, slow = quantities(10.0), quantities(hertz)
    compared = [name for name, one in quick.items() if one.determined and not name.startswith("noise")]
    assert compared
    for name in compared:
        assert abs(slow[name].after - quick[name].after) < 2 * slow[name].deviation, name
    assert "noise of the GNSS velocity" not in slow


def test_bends_between_two_messages_a_second_apart_are_not_cut_off() -> None:
    recording = with_receiver(1.0, read_bag(BAG))
    channel = recording["gps/velocity"]
    seconds = (channel.stamp - recording.start) * 1e-9
    linear = channel.columns["linear"].copy()
    linear[:, 0], linear[:, 1] = 20.0, 3.0 * np.sin(2 * np.pi * 0.2 * seconds)
    changed = replace(channel, columns={**channel.columns, "linear": linear})
    drive = drive_of(replace(recording, channels={**recording.channels, "gps/velocity": changed}), catalogue_car())
    true = 3.0 * np.sin(2 * np.pi * 0.2 * drive.t)
    inside = np.isfinite(drive.velocity[:, 1]) & (drive.t > drive.t[0] + 3) & (drive.t < drive.t[-1] - 3)
    assert inside.sum() * CALIBRATION.step > 15.0
    assert np.abs(drive.velocity[inside, 1] - true[inside]).max() < 0.05 * 3.0
    assert drive.cut_off == pytest.approx(0.25, rel=0.01)


def test_an_outage_of_a_slow_receiver_is_not_interpolated() -> None:
    recording = with_receiver(1.0, read_bag(BAG))
    channel = recording["gps/velocity"]
    seconds = (channel.stamp - recording.start) * 1e-9
    silent = channel.select((seconds < 10.0) | (seconds > 14.0))
    drive = drive_of(replace(recording, channels={**recording.channels, "gps/velocity": silent}), catalogue_car())
    out = np.isnan(drive.velocity[:, 0])
    longest = np.diff(silent.stamp).max() * 1e-9
    assert out.sum() * CALIBRATION.step == pytest.approx(longest, abs=2 * CALIBRATION.step)


def test_messages_a_fifth_of_a_second_apart_and_slower_say_nothing_of_noise() -> None:
    stamp = (np.arange(200) * 2e8).astype(np.int64)
    assert np.isnan(scatter(stamp, np.sin(np.arange(200.0))[:, None])).all()
