"""Predictions of the course while the receiver is silent: what is withheld, compared, and concluded."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from vsense_ros.errors import InputError
from vsense_ros.identification import prediction
from vsense_ros.identification.prediction import PREDICTION, Prediction, compare, judged, predict
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle

SPEED, RATE = 12.0, 0.1  # [m/s], [rad/s] of a steady circle


def car() -> Vehicle:
    return new_vehicle(catalogue_values(mass=1395.0, wheelbase=2.63, track=1.54, tyre="205/55R16 91V")).vehicle


def circle(seconds: float = 90.0) -> Recording:
    """What a receiver says of a steady circle, ten times a second."""
    t = np.arange(0.0, seconds, 0.1)
    linear = SPEED * np.column_stack([np.cos(RATE * t), np.sin(RATE * t), 0 * t])
    stamp = (t * 1e9).astype(np.int64)
    columns = {"linear": linear, "angular": np.zeros_like(linear)}
    kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
    return Recording({"gps/velocity": Channel("gps/velocity", kind, stamp, stamp, columns)}, name="circle")


def observer_off_by(error: float, heard: list[Recording]):
    """An observer in place of the real one that knows the circle but for an error of its heading [rad]."""

    def run(recording: Recording, vehicle: Vehicle, rate: float, progress: object = None) -> SimpleNamespace:
        heard.append(recording)
        t = np.arange(0.0, 90.0, 1 / rate)
        heading = RATE * t + error
        zero, stamp = 0 * t, (t * 1e9).astype(np.int64)
        columns = {
            "orientation": np.column_stack([zero, zero, np.sin(heading / 2), np.cos(heading / 2)]),
            "linear": np.column_stack([zero + SPEED, zero, zero]),
            "angular": np.column_stack([zero, zero, zero + RATE]),
        }
        odometry = Channel("vsense/odometry", "nav_msgs/msg/Odometry", stamp, stamp, columns)
        return SimpleNamespace(output={"vsense/odometry": odometry})

    return run


def test_the_error_is_that_of_the_course_and_the_observer_hears_nothing_in_silences(monkeypatch) -> None:
    heard: list[Recording] = []
    monkeypatch.setattr(prediction, "run", observer_off_by(0.01, heard))
    found = predict([circle()], car())
    assert found.squares == pytest.approx(np.full(6, 0.01**2), rel=0.05)
    t = heard[0]["gps/velocity"].seconds
    assert np.diff(t).max() == pytest.approx(PREDICTION.silence, abs=0.2)
    assert np.sum(np.diff(t) > 1.0) >= 5


def test_a_file_with_a_larger_error_is_worse_and_says_by_how_much(monkeypatch) -> None:
    predictions = []
    for error in (0.002, 0.01):
        monkeypatch.setattr(prediction, "run", observer_off_by(error, []))
        predictions.append(predict([circle()], car()))
    spread = 1e-7 * np.arange(6)
    verdict = compare(predictions[0], Prediction(predictions[1].squares + spread))
    assert verdict.is_worse
    assert f"{np.degrees(verdict.after):.2f}°" in verdict.sentence


def test_a_comparison_of_equal_files_is_not_worse_and_few_silences_judge_nothing() -> None:
    same = Prediction(np.array([1e-4, 4e-4, 2e-4, 3e-4, 1e-4]))
    assert not compare(same, same).is_worse
    few = Prediction(np.full(PREDICTION.fewest - 1, 1e-6))
    verdict = compare(few, Prediction(100 * few.squares))
    assert not verdict.is_worse
    assert "Not judged" in verdict.sentence


def test_a_file_that_loses_the_car_is_worse_than_one_that_follows_it() -> None:
    follows = Prediction(np.linspace(1e-5, 2e-5, 6))
    assert compare(follows, Prediction(np.full(6, np.nan))).is_worse
    assert not compare(Prediction(np.full(6, np.nan)), follows).is_worse


def test_a_car_without_gnss_velocity_is_refused_and_a_recording_without_it_is_not_judged() -> None:
    sensors = {name: one for name, one in car().sensors.items() if one.kind != "gnss_velocity"}
    with pytest.raises(InputError, match="GNSS velocity"):
        predict([circle()], car().model_copy(update={"sensors": sensors}))
    assert judged([replace(circle(), channels={})], car(), car()) is None
