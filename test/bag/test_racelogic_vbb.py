"""The VBOX brake stop, against facts that the importer does not use."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymap3d
import pytest

from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError


def test_position_and_velocity_of_the_receiver_agree_in_all_three_axes(vbb_path: Path) -> None:
    recording = import_recording(vbb_path)
    fix, velocity = recording["gps/fix"], recording["gps/velocity"]
    place = [fix.columns[name][:, 0] for name in ("latitude", "longitude", "altitude")]
    enu = np.column_stack(pymap3d.geodetic2enu(*place, *(values[0] for values in place)))
    derivative = np.gradient(enu, fix.seconds, axis=0)
    assert np.std(derivative - velocity.columns["linear"], axis=0).max() < 0.05


def test_the_place_is_an_airfield_in_england_and_the_car_brakes_once_from_motorway_speed(vbb_path: Path) -> None:
    recording = import_recording(vbb_path)
    fix = recording["gps/fix"]
    assert fix.columns["latitude"][0, 0] == pytest.approx(51.985, abs=0.005)
    assert fix.columns["longitude"][0, 0] == pytest.approx(-1.057, abs=0.005)
    speed = np.hypot(*recording["gps/velocity"].columns["linear"][:, :2].T)
    assert speed.max() * 3.6 == pytest.approx(117.6, abs=0.1)
    slope = (speed[50:] - speed[:-50]) / 0.5
    assert -13.0 < slope.min() < -8.0


def test_times_are_utc_of_the_day_that_the_file_states(vbb_path: Path) -> None:
    recording = import_recording(vbb_path)
    assert np.datetime64(recording.start, "ns") == np.datetime64("2023-10-20T11:27:13.390")
    assert set(np.unique(np.diff(recording["gps/fix"].stamp))) == {10_000_000}


def test_the_covariance_turned_to_enu_has_the_horizontal_and_vertical_errors_that_the_file_states(
    vbb_path: Path,
) -> None:
    """RMS_HPOS and RMS_VPOS of the first sample, which the importer does not use."""
    covariance = import_recording(vbb_path)["gps/fix"].columns["position_covariance"][0].reshape(3, 3)
    assert np.sqrt(covariance[0, 0] + covariance[1, 1]) == pytest.approx(0.93380, abs=1e-4)
    assert np.sqrt(covariance[2, 2]) == pytest.approx(1.42716, abs=1e-4)


def test_of_a_truncated_file_all_whole_samples_are_read(vbb_path: Path, tmp_path: Path) -> None:
    whole = import_recording(vbb_path)["gps/fix"]
    data = vbb_path.read_bytes()
    cut = tmp_path / "cut.vbb"
    cut.write_bytes(data[: len(data) * 3 // 4])
    recording = import_recording(cut)
    rows = len(recording["gps/fix"])
    assert 0.5 * len(whole) < rows < len(whole)
    np.testing.assert_array_equal(recording["gps/fix"].columns["latitude"], whole.columns["latitude"][:rows])
    assert "damaged or cut off at byte" in recording.notes[0]


def test_a_file_without_samples_is_an_input_error(vbb_path: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.vbb"
    cut.write_bytes(vbb_path.read_bytes()[:2000])
    with pytest.raises(InputError, match="no samples of latitude"):
        import_recording(cut)


def test_longitude_that_counts_west_is_turned(vbb_path: Path) -> None:
    from vsense_ros.bag.importers.racelogic_vbb import _counts_west

    time = np.arange(10.0)
    latitude, east_speed = np.full(10, 52.0), np.full(10, 20.0)
    assert _counts_west(latitude, 1.0 - time * 1e-4, east_speed, time)
    assert not _counts_west(latitude, 1.0 + time * 1e-4, east_speed, time)
