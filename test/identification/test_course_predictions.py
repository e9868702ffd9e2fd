"""Predictions of the course while the receiver is silent tell a better vehicle file from a worse one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from vsense_ros.errors import InputError
from vsense_ros.identification.prediction import PREDICTION, Prediction, compare, judged, predict
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle


@cache
def car() -> Vehicle:
    """A compact car whose gyro is calibrated: a bias that the observer still estimates would hide what tyres do."""
    car = new_vehicle(catalogue_values(mass=1395.0, wheelbase=2.63, track=1.54, tyre="205/55R16 91V")).vehicle
    imu = car.sensors["imu"].model_copy(update={"rate_bias": 1e-4})
    return car.model_copy(update={"sensors": {**car.sensors, "imu": imu}})


@cache
def drive() -> Recording:
    return generate("double_oval_50", car(), 3).between(0.0, 66.0)


@cache
def truly() -> Prediction:
    return predict([drive()], car())


def test_a_file_with_a_wrong_steering_ratio_and_soft_tyres_predicts_worse_than_the_true_one() -> None:
    changed = {"steering.ratio": 1.3 * car().physics.steering.ratio, "rear.cornering_scale": 0.5}
    wrongly = predict([drive()], car().with_parameters(changed))
    verdict = compare(truly(), wrongly)
    assert verdict.is_worse
    assert f"{np.degrees(verdict.after):.2f}°" in verdict.sentence
    assert not compare(wrongly, truly()).is_worse


def test_what_the_receiver_says_in_a_silence_changes_nothing_of_what_is_predicted() -> None:
    """The prediction must not hear what it is compared with: with a lie there, the errors are that of the lie."""
    gnss = drive()["gps/velocity"]
    seconds = (gnss.stamp - drive().first_stamp) * 1e-9 - PREDICTION.settled
    silent = (seconds >= 0) & (seconds % (PREDICTION.silence + PREDICTION.between) >= PREDICTION.between)
    lie = 0.02
    linear = gnss.columns["linear"].copy()
    east, north = linear[silent, 0].copy(), linear[silent, 1].copy()
    linear[silent, 0], linear[silent, 1] = east - lie * north, north + lie * east
    lying = replace(gnss, columns={**gnss.columns, "linear": linear})
    recording = replace(drive(), channels={**drive().channels, "gps/velocity": lying})
    lied = predict([recording], car())
    assert truly().error < 0.5 * lie
    assert lied.error == pytest.approx(lie, rel=0.3)


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
        predict([drive()], car().model_copy(update={"sensors": sensors}))
    without = {topic: one for topic, one in drive().channels.items() if topic != "gps/velocity"}
    assert judged([replace(drive(), channels=without)], car(), car()) is None
