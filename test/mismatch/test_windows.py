"""What is made of recordings before a model is held against them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hidden import driven, prototype, unheard
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.driving import cut_off
from vsense_ros.mismatch.prediction_settings import PREDICTION
from vsense_ros.mismatch.windows import Readings, _averaged, build_dataset


def turned_about(recording: Recording) -> Recording:
    """As a sensor would measure that looks backwards."""
    imu = recording["imu/data"]
    fields = ("angular_velocity", "linear_acceleration")
    columns = {**imu.columns, **{field: imu.columns[field] * [-1.0, -1.0, 1.0] for field in fields}}
    return replace(recording, channels={**recording.channels, "imu/data": replace(imu, columns=columns)})


@pytest.mark.parametrize("silent", [("vehicle/wheel_speeds",), ("gps/velocity", "gps/fix")])
def test_speed_and_heading_do_not_depend_on_how_the_inertial_sensor_is_mounted(silent):
    recording = unheard(driven(prototype(), "brake"), *silent)
    sensors = prototype().sensors
    backwards = sensors["imu"].model_copy(update={"attitude": (0.0, 0.0, np.pi)})
    vehicle = prototype().model_copy(update={"sensors": {**sensors, "imu": backwards}})
    (as_usual,) = build_dataset([recording], prototype()).windows
    (found,) = build_dataset([turned_about(recording)], vehicle).windows
    for name in ("speed", "turned"):
        assert getattr(found, name).value == pytest.approx(getattr(as_usual, name).value, abs=1e-9)


def test_readings_are_in_the_axes_of_the_car_and_kept_as_the_sensor_gave_them():
    recording = driven(prototype(), "brake")
    imu = prototype().sensors["imu"].model_copy(update={"attitude": (0.0, 0.0, np.pi)})
    vehicle = prototype().model_copy(update={"sensors": {**prototype().sensors, "imu": imu}})
    (as_usual,) = build_dataset([recording], prototype()).windows
    (found,) = build_dataset([turned_about(recording)], vehicle).windows
    of_car, mounted = found.readings["imu"].value, found.readings["imu"].in_own_axes.value
    assert of_car == pytest.approx(as_usual.readings["imu"].value, abs=1e-9)
    assert mounted == pytest.approx(of_car * [-1, -1, 1, -1, -1, 1], abs=1e-9)
    assert found.readings["wheel_speeds"].in_own_axes is found.readings["wheel_speeds"]


def test_what_two_windows_of_a_recording_have_in_common_is_driven_once():
    (recording,) = (driven(prototype(), "slalom", duration=40.0),)
    dataset = build_dataset([recording, recording], prototype())
    assert len(dataset.windows) == 4
    assert dataset.driven == pytest.approx(2 * 40.0, abs=1.0)


def the_other_way(recording: Recording) -> Recording:
    """As if the whole drive had been turned round on the map."""
    velocity = recording["gps/velocity"]
    columns = {**velocity.columns, "linear": velocity.columns["linear"] * [-1.0, -1.0, 1.0]}
    return replace(recording, channels={**recording.channels, "gps/velocity": replace(velocity, columns=columns)})


def test_what_recordings_turn_is_counted_from_one_way_on_the_map_so_that_they_may_be_of_one_plane():
    recording = driven(prototype(), "slalom")
    there, back = (w.turned.value for w in build_dataset([recording, the_other_way(recording)], prototype()).windows)
    assert there[0] == pytest.approx(0.0, abs=0.02)
    assert np.cos(back) == pytest.approx(-np.cos(there), abs=1e-9)
    assert np.sin(back) == pytest.approx(-np.sin(there), abs=1e-9)


def test_what_is_held_out_turns_from_the_way_that_what_was_fitted_set_out_on():
    recording = driven(prototype(), "slalom")
    fitted = build_dataset([recording], prototype())
    (back,) = build_dataset([the_other_way(recording)], prototype(), fitted).windows
    assert np.cos(back.turned.value[0]) == pytest.approx(-1.0, abs=1e-3)


def test_without_a_course_on_the_map_each_recording_counts_from_its_own_way():
    recording = driven(prototype(), "slalom")
    blind = unheard(the_other_way(recording), "gps/velocity")
    dataset = build_dataset([blind, recording, the_other_way(recording)], prototype())
    begins = [float(np.cos(w.turned.value[0, 0])) for w in dataset.windows]
    assert begins == pytest.approx([1.0, 1.0, -1.0], abs=1e-3)


def test_recordings_of_two_evidences_are_told_apart_where_they_are_joined():
    recording = driven(prototype(), "slalom")
    fitted, unseen = build_dataset([recording], prototype()), build_dataset([recording, recording], prototype())
    whole = fitted.joined(unseen)
    assert [w.recording for w in whole.windows] == [0, 1, 2]
    assert len(whole.by_recording()) == len(whole.recordings) == 3
    assert whole.driven == pytest.approx(3 * fitted.driven)


@given(seed=st.integers(0, 999), rate=st.sampled_from([150.0, 200.0, 500.0, 1000.0]))
def test_a_quick_sensor_is_averaged_over_each_hundredth_of_a_second(seed, rate):
    rng = np.random.default_rng(seed)
    t = 3.0 + np.cumsum(rng.uniform(0.8, 1.2, 400)) / rate
    value = rng.normal(size=(400, 2))
    value[rng.random((400, 2)) < 0.2] = np.nan
    at, mean = _averaged(t, value)
    cells = np.floor((t - t[0]) / 0.01)
    for row, cell in enumerate(np.unique(cells)):
        inside = cells == cell
        assert at[row] == pytest.approx(t[inside].mean())
        for column in range(2):
            known = value[inside, column][np.isfinite(value[inside, column])]
            assert mean[row, column] == pytest.approx(known.mean() if len(known) else np.nan, nan_ok=True)


def test_values_that_are_held_for_longer_than_the_grid_are_not_averaged():
    t = np.arange(2000) / 200.0
    value = np.repeat(np.random.default_rng(0).normal(size=(400, 1)), 5, axis=0)
    at, same = _averaged(t, value)
    assert at is t
    assert same is value


def test_a_sensor_that_gives_a_value_for_each_hundredth_of_a_second_is_left_as_it_is():
    t, value = np.arange(100) * 0.01, np.arange(200.0).reshape(100, 2)
    at, same = _averaged(t, value)
    assert at is t
    assert same is value


@pytest.mark.parametrize("noise", [0.01, 0.03, 0.1])
@pytest.mark.parametrize("rate", [25.0, 100.0])
def test_a_noisy_speed_jolts_the_car_that_follows_it_no_more_than_is_allowed(noise, rate):
    t = np.arange(0.0, 400.0, 1 / rate)
    white = np.random.default_rng(1).normal(0.0, noise, len(t))
    frequency = cut_off(Readings(t, (20.0 + 3.0 * np.sin(0.6 * t) + white)[:, None]))
    assert PREDICTION.lowest_cut_off < frequency < PREDICTION.highest_cut_off
    # Parseval: the spectrum of the noise below the frequency, times that of the derivative.
    spectrum, at = np.fft.rfft(white), np.fft.rfftfreq(len(t), 1 / rate)
    jolts = np.sqrt(2 * np.sum(np.abs(2 * np.pi * at * spectrum)[at < frequency] ** 2)) / len(t)
    assert jolts == pytest.approx(PREDICTION.noise_acceleration, rel=0.25)


def test_a_speed_without_noise_is_followed_as_quickly_as_any():
    t = np.arange(0.0, 60.0, 0.01)
    assert cut_off(Readings(t, (20.0 + 3.0 * np.sin(0.6 * t))[:, None])) == PREDICTION.highest_cut_off
