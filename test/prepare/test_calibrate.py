"""Calibration by ordinary drives: what is hidden in a simulated car comes out as accurately as it says."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from vsense_ros.bag import read_bag, write_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.estimation.regression import posterior
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.calibrated import Calibrated, Change, apply
from vsense_ros.prepare.calibration import Calibration, calibrate
from vsense_ros.prepare.catalogue import catalogue_values
from vsense_ros.prepare.new_vehicle import new_vehicle, write_new_vehicle

BAGS = Path(__file__).parents[2] / "bags"
CATALOGUE = {"mass": 1395.0, "wheelbase": 2.63, "track": 1.54, "axle_load_front": 820.0, "tyre": "205/55R16 91V"}
# What the car really has; the catalogue and the rules do not say it.
HIDDEN = {"steering.ratio": 14.0, "front.unloaded_radius": 0.3195, "rear.unloaded_radius": 0.3195,
          "chassis.mass": 1460.0, "rear.cornering_scale": 1.1}  # fmt: skip
ATTITUDE = (0.03, 0.06, 0.04)
ANTENNA = 0.6


def catalogue_car() -> Vehicle:
    return new_vehicle(catalogue_values(**CATALOGUE)).vehicle


@cache
def hidden_car() -> Vehicle:
    car = catalogue_car().with_parameters(HIDDEN)
    sensors = dict(car.sensors)
    sensors["imu"] = sensors["imu"].model_copy(update={"attitude": ATTITUDE})
    for name in ("position", "velocity"):
        sensors[name] = sensors[name].model_copy(update={"position": (ANTENNA, 0.0, 0.9), "noise": 0.05})
    return car.model_copy(update={"sensors": sensors})


@cache
def drive(name: str) -> Recording:
    return generate(name, hidden_car(), 3)


def bends() -> tuple[Recording, ...]:
    return drive("double_oval_50"), drive("right_turn")


@cache
def calibrated() -> Calibration:
    return calibrate(bends(), catalogue_car())


def quantity(name: str):
    return next(one for one in calibrated().quantities if one.name == name)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "true", "close"),
    [
        ("steering ratio", 14.0, 0.5),
        ("rolling radius, front", None, 1e-3),
        ("rolling radius, rear", None, 1e-3),
        ("pitch of the inertial sensor's mounting", ATTITUDE[1], 0.015),
        ("roll of the inertial sensor's mounting", ATTITUDE[0], 0.02),
        ("yaw of the inertial sensor's mounting", ATTITUDE[2], 0.03),
    ],
)
def test_what_is_hidden_comes_out_close_and_within_three_deviations(name, true, close):
    found = quantity(name)
    if true is None:
        true = float(rolling_radii(hidden_car())[0 if "front" in name else 2])
    assert found.determined
    assert abs(found.after - true) < close
    assert abs(found.after - true) < 3 * found.deviation + 1e-3
    assert abs(found.after - true) < abs(found.before - true)


@pytest.mark.slow
def test_the_written_file_has_the_new_numbers_with_deviation_and_drives_and_keeps_the_rest(tmp_path):
    write_new_vehicle(tmp_path / "car.yaml", new_vehicle(catalogue_values(**CATALOGUE)))
    for i, recording in enumerate(bends()):
        write_bag(tmp_path / f"drive_{i}", recording.between(0.0, 30.0))
    names = ("drive_0", "drive_1", "--vehicle", "car.yaml", "--output", "new.yaml")
    arguments = [one if one.startswith("--") else str(tmp_path / one) for one in names]
    result = CliRunner().invoke(main, ["calibrate", *arguments, "--json"])
    assert result.exit_code == 0, result.stderr
    said = json.loads(result.output)
    assert said["prediction"]["silences"] == 2  # one in each half minute
    table = {one["name"]: one for one in said["quantities"]}
    car = load_vehicle(tmp_path / "new.yaml")
    assert car.physics.steering.ratio == pytest.approx(table["steering ratio"]["after"], abs=1e-3)
    assert "drive_0" in car.uncertainty["physics.steering.ratio"].source
    text = (tmp_path / "new.yaml").read_text(encoding="utf-8")
    assert "calibrated by drive_0, drive_1)" in next(row for row in text.splitlines() if row.startswith("    ratio:"))
    assert car.physics.chassis == load_vehicle(tmp_path / "car.yaml").physics.chassis


@pytest.mark.slow
def test_what_a_straight_drive_does_not_determine_stays_and_is_said_with_what_to_drive(tmp_path):
    found = calibrate([drive("coast_down")], catalogue_car())
    ratio = next(one for one in found.quantities if one.name == "steering ratio")
    assert not ratio.determined
    assert found.vehicle.physics.steering.ratio == catalogue_car().physics.steering.ratio
    assert any("tight bends" in advice for advice in found.advice)


@pytest.mark.slow
def test_a_reference_in_the_recording_is_not_looked_at():
    blind = [
        Recording({t: c for t, c in one.channels.items() if not t.startswith("reference")}, name=one.name)
        for one in bends()
    ]
    assert calibrate(blind, catalogue_car()).vehicle == calibrated().vehicle


@pytest.mark.slow
def test_a_drive_without_gnss_is_refused_with_what_is_missing():
    without = Recording({t: c for t, c in drive("coast_down").channels.items() if t != "gps/velocity"}, name="tunnel")
    with pytest.raises(InputError, match=r"tunnel: no GNSS velocity"):
        calibrate([without], catalogue_car())


def test_a_regression_of_independent_errors_is_that_of_the_textbook():
    rng = np.random.default_rng(0)
    x = np.column_stack([np.ones(4000), rng.normal(size=4000)])
    y = x @ [0.5, -2.0] + rng.normal(0, 0.3, 4000)
    found = posterior([(x[i : i + 100], y[i : i + 100]) for i in range(0, 4000, 100)], np.zeros(2), np.full(2, 1e3))
    expected = np.linalg.lstsq(x, y, rcond=None)[0]
    assert found.values == pytest.approx(expected, abs=1e-6)
    textbook = np.sqrt(np.diag(np.linalg.inv(x.T @ x))) * 0.3
    assert found.deviations == pytest.approx(textbook, rel=0.35)


def test_errors_that_last_as_long_as_a_block_do_not_count_as_many():
    rng = np.random.default_rng(1)
    errors, hits = [], 0
    for _ in range(60):
        blocks = [(np.ones((50, 1)), np.full(50, rng.normal()) + rng.normal(0, 0.1, 50)) for _ in range(20)]
        found = posterior(blocks, np.zeros(1), np.full(1, 1e3))
        errors.append(float(found.values[0]))
        hits += abs(found.values[0]) < 2 * found.deviations[0]
    assert np.std(errors) == pytest.approx(20**-0.5, rel=0.3)
    assert hits > 50


def test_without_data_a_coefficient_stays_what_it_was():
    found = posterior([(np.array([[1.0, 0.0]] * 30), np.full(30, 2.0))], np.array([0.0, 7.0]), np.array([1e3, 0.5]))
    assert found.values[1] == pytest.approx(7.0)
    assert found.left[1] == pytest.approx(1.0)


def _without(recording: Recording, *topics: str) -> Recording:
    return Recording({t: c for t, c in recording.channels.items() if t not in topics}, name=recording.name)


@pytest.mark.parametrize(
    ("topic", "words"),
    [("vehicle/steering", "No steering angle"), ("vehicle/wheel_speeds", "No speeds of four wheels")],
)
def test_a_drive_without_a_sensor_calibrates_the_others_and_says_what_is_missing(topic, words):
    found = calibrate([_without(read_bag(BAGS / "hills"), topic)], load_vehicle(vehicle_path("prototype_model")))
    assert len(found.missing) == 1
    assert found.missing[0].startswith(words)
    assert "hills" in found.missing[0]
    assert any(one.determined for one in found.quantities)


@pytest.mark.parametrize("topic", ["imu/data", "gps/velocity"])
def test_a_drive_without_what_everything_is_compared_with_is_refused_with_its_topic(topic):
    with pytest.raises(InputError, match=topic):
        calibrate([_without(read_bag(BAGS / "hills"), topic)], load_vehicle(vehicle_path("prototype_model")))


def test_an_empty_recording_and_half_a_minute_too_few_are_refused(tmp_path):
    car = load_vehicle(vehicle_path("prototype_model"))
    with pytest.raises(InputError, match="no GNSS velocity"):
        calibrate([Recording({}, name="nothing")], car)
    with pytest.raises(InputError, match="expected at least 20 s"):
        calibrate([read_bag(BAGS / "step_steer")], car)


def test_what_is_no_recording_is_refused_by_the_command_in_one_sentence(tmp_path):
    (tmp_path / "drive.bin").write_bytes(bytes(100))
    result = CliRunner().invoke(main, ["calibrate", str(tmp_path / "drive.bin"), "--vehicle", "prototype_model"])
    assert result.exit_code == 2
    assert "Traceback" not in result.stderr
    assert "no importer knows this" in result.stderr


def test_a_correction_below_its_own_uncertainty_leaves_the_value_and_says_how_sure_it_is():
    car = catalogue_car()
    path, before = "physics.steering.ratio", car.physics.steering.ratio
    for shift, after, deviation in ((0.2, before, 0.36), (0.9, before + 0.9, 0.3)):
        one = Calibrated("ratio", "-", before, before + shift, 1.5, 0.3, {path: Change(before + shift, 0.3)})
        changed = apply(car, [one], "a drive")
        assert changed.physics.steering.ratio == pytest.approx(after)
        assert changed.uncertainty[path].deviation == pytest.approx(deviation, abs=0.005)


def test_a_number_that_is_itself_a_deviation_changes_by_any_amount():
    car = catalogue_car()
    one = Calibrated("noise", "rad/s", 0.003, 0.0029, 0.003, 0.0003, {"sensors.imu.rate_noise.2": Change(0.0029)})
    assert apply(car, [one], "a drive").sensors["imu"].rate_noise[2] == 0.0029
