"""What kind of car it is, asked of cars that are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.characterise import Characteristics, Quantity, characterise, drive_tests, regression
from vsense_ros.identification.drive_signals import DRIVE_SIGNALS, DriveSignals, of_recording
from vsense_ros.manoeuvre.leung_tracks import on_track
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.manoeuvre.track import Track, left_turn, straight
from vsense_ros.messages.recording import Recording
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.handling.bicycle_2dof import Bicycle2Dof
from vsense_ros.model.handling.response import Response
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle

VEHICLES = Path(__file__).resolve().parents[2] / "config" / "vehicles"


@pytest.fixture(scope="module")
def saloon() -> Vehicle:
    return load_vehicle(VEHICLES / "jaguar_saloon.yaml")


def value(found: Characteristics, name: str) -> Quantity:
    (one,) = (q for q in found.quantities if q.name.startswith(name))
    return one


def linear_drive(car: Vehicle, kph: float, *, roll_gradient: float = 0.05, offset: float = 0.0) -> DriveSignals:
    """A minute of the linear model on a winding road, with a steering wheel that is off by `offset` [rad]."""
    t = np.arange(0, 60, DRIVE_SIGNALS.step)
    rng = np.random.default_rng(int(kph))
    angle = 0.02 * np.sin(0.35 * t) + 0.008 * np.sin(1.3 * t + 1) + 0.003 * np.sin(5 * t)
    model = Bicycle2Dof()
    inputs = np.column_stack([angle, np.full(len(t), kph / 3.6)])
    states = Response(model, model.numbers(car)).drive(np.zeros(2), inputs, DRIVE_SIGNALS.step)[:-1]
    lateral = inputs[:, 1] * states[:, 1]
    spin = np.tile(inputs[:, [1]] / 0.3, (1, 4)) + 0.04 * rng.standard_normal((len(t), 4))
    return DriveSignals(
        f"{kph} km/h", np.ones(len(t), dtype=bool), inputs[:, 1],
        states[:, 1] + 1.7e-3 * rng.standard_normal(len(t)),
        car.physics.steering.ratio * angle + offset + np.radians(1) * rng.standard_normal(len(t)), True, spin,
        np.radians(roll_gradient) * lateral, None, states[:, 0],
    )  # fmt: skip


def test_a_linear_car_is_recovered_from_noisy_drives_at_two_speeds(saloon: Vehicle) -> None:
    drives = [linear_drive(saloon, kph, roll_gradient=0.34, offset=0.05) for kph in (30.0, 60.0)]
    found = characterise("linear", drives, saloon)
    numbers = car_numbers(saloon)
    wheelbase = numbers["to_front"] + numbers["to_rear"]
    understeer = numbers["mass"] / wheelbase * (
        numbers["to_rear"] / numbers["front_stiffness"] - numbers["to_front"] / numbers["rear_stiffness"]
    )  # fmt: skip
    for name, true, tolerance in (
        ("steering ratio", 17.58, 0.3),
        ("understeer gradient", np.degrees(understeer * GRAVITY), 0.05),
        ("steering offset", np.degrees(0.05), 0.1),
        ("roll gradient", 0.34 * GRAVITY, 0.02),
        ("cornering stiffness of the axle, front", numbers["front_stiffness"], 0.03 * numbers["front_stiffness"]),
        ("cornering stiffness of the axle, rear", numbers["rear_stiffness"], 0.03 * numbers["rear_stiffness"]),
    ):
        one = value(found, name)
        assert one.value == pytest.approx(true, abs=tolerance), name
        assert one.deviation is not None
        assert 0 < one.deviation < 2 * tolerance


def test_the_frequency_response_is_that_of_the_model(saloon: Vehicle) -> None:
    drive = linear_drive(saloon, 60.0)
    rng = np.random.default_rng(0)
    angle = 0.01 * np.convolve(rng.standard_normal(len(drive)), np.ones(10) / 3, mode="same")
    model = Bicycle2Dof()
    response = Response(model, model.numbers(saloon))
    rate = response.drive(np.zeros(2), np.column_stack([angle, drive.speed]), DRIVE_SIGNALS.step)[:-1, 1]
    broad = DriveSignals("broad", drive.valid, drive.speed, rate, 17.58 * angle, True)
    found = characterise("broad", [broad], saloon)
    (one,) = found.responses
    expected = response.frequency_response(60 / 3.6, 2 * np.pi * one.frequency, "yaw_rate")
    assert one.gain == pytest.approx(np.abs(expected), rel=0.1)
    # Inputs are held for a step, which delays by half of one.
    late = 2 * np.pi * one.frequency * DRIVE_SIGNALS.step / 2
    assert one.phase == pytest.approx(np.angle(expected) - late, abs=0.1)


def test_at_one_speed_the_ratio_is_the_file_s_and_that_is_said(saloon: Vehicle) -> None:
    found = characterise("one speed", [linear_drive(saloon, 50.0)], saloon)
    assert value(found, "steering ratio").value is None
    assert "one speed" in value(found, "steering ratio").note
    k = car_numbers(saloon)
    softer = k["to_rear"] / k["front_stiffness"] - k["to_front"] / k["rear_stiffness"]
    gradient = k["mass"] / (k["to_front"] + k["to_rear"]) * softer * np.degrees(GRAVITY)  # of a linear single track
    assert value(found, "understeer gradient").value == pytest.approx(gradient, abs=0.05)


def test_without_a_vehicle_file_what_needs_one_is_said(saloon: Vehicle) -> None:
    found = characterise("no file", [linear_drive(saloon, 50.0)], None)
    assert "--vehicle" in value(found, "understeer gradient").note
    assert value(found, "roll gradient").value is not None


def test_a_straight_drive_tells_radii_and_nothing_of_bends(saloon: Vehicle) -> None:
    drive = linear_drive(saloon, 50.0)
    still = np.zeros(len(drive))
    straight = DriveSignals("road", drive.valid, drive.speed, still, still, True, drive.spin)
    found = characterise("straight", [straight], saloon)
    assert value(found, "rolling radius, front").value == pytest.approx(0.3, rel=1e-3)
    assert value(found, "understeer gradient").note == "no bends"


def test_the_jackknife_tells_how_far_off_a_regression_is() -> None:
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(200):
        x = np.column_stack([rng.standard_normal(6000), np.ones(6000)])
        slow = np.repeat(rng.standard_normal(20), 300)  # errors that last as long as a stretch
        best, deviation = regression([(x, x @ [2.0, 1.0] + slow)])
        errors.append((best - [2.0, 1.0]) / deviation)
    assert np.std(errors, axis=0) == pytest.approx(1.0, abs=0.15)


def test_what_cannot_be_told_apart_has_no_value() -> None:
    x = np.ones((3000, 2))
    best, deviation = regression([(x, np.ones(3000))])
    assert np.isnan(best).all()
    assert np.isinf(deviation).all()


@pytest.fixture(scope="module")
def bend(saloon: Vehicle) -> Recording:
    q, u = rolling_straight(saloon, 8.0)
    drive = simulate(saloon, on_track(Track((straight(20), left_turn(30, 120))), 8.0, saloon), 12.0, q=q, u=u)
    return record(drive, saloon, 0, name="bend", biased=False)


def test_a_recording_is_put_on_one_clock(bend: Recording, saloon: Vehicle) -> None:
    signals = of_recording(bend, saloon)
    turning = np.abs(signals.yaw_rate) > 0.1
    assert signals.at_steering_wheel
    assert signals.spin is not None
    assert signals.side_slip is not None
    geometric = np.median(signals.steering[turning] / (signals.yaw_rate / signals.speed)[turning])
    assert geometric / (17.58 * 2.906) == pytest.approx(1.0, abs=0.06)


def test_a_recording_without_steering_is_refused(bend: Recording, saloon: Vehicle) -> None:
    channels = {topic: c for topic, c in bend.channels.items() if topic != "vehicle/steering"}
    with pytest.raises(InputError, match="no topic vehicle/steering"):
        of_recording(Recording(channels, name="bare"), saloon)


def test_steering_of_another_name_is_told(bend: Recording, saloon: Vehicle) -> None:
    steering = replace(bend["vehicle/steering"], names=("tiller",))
    with pytest.raises(InputError, match="names tiller; expected steering_wheel"):
        of_recording(Recording({**bend.channels, "vehicle/steering": steering}, name="odd"), saloon)


def test_readings_at_two_places_are_not_mixed(saloon: Vehicle) -> None:
    one = linear_drive(saloon, 40.0)
    with pytest.raises(InputError, match="one kind at a time"):
        characterise("both", [one, replace(one, at_steering_wheel=False)], saloon)


@given(st.sampled_from(["imu/data", "reference/odometry", "vehicle/wheel_speeds", "vehicle/steering"]), st.booleans())
@settings(max_examples=8, deadline=None)
def test_absent_and_infinite_values_become_no_wrong_numbers(
    bend: Recording, saloon: Vehicle, topic: str, everywhere: bool
) -> None:
    channel = bend[topic]
    columns = {}
    for name, column in channel.columns.items():
        bad = column.copy()
        bad[slice(None) if everywhere else slice(100, 160)] = np.nan if everywhere else np.inf
        columns[name] = bad
    broken = Recording({**bend.channels, topic: replace(channel, columns=columns)}, name="broken")
    found = characterise("broken", [of_recording(broken, saloon)], saloon)
    for one in found.quantities:
        assert one.value is None or np.isfinite(one.value)
        assert one.value is not None or one.note
    ratios = [one.value for one in found.quantities if one.name.startswith("rolling radius") and one.value]
    assert ratios == pytest.approx([0.288] * len(ratios), abs=0.01)


@pytest.mark.exam
def test_the_saloon_is_what_its_file_says(saloon: Vehicle) -> None:
    found = characterise("saloon", drive_tests(saloon), saloon)
    assert value(found, "steering ratio").value == pytest.approx(17.58, rel=0.005)
    assert value(found, "roll gradient").value == pytest.approx(3.3, abs=0.1)
    for axle in ("front", "rear"):
        one = value(found, f"cornering stiffness of a tyre, {axle}")
        assert one.value == pytest.approx(one.file, rel=0.06)
        radius = value(found, f"rolling radius, {axle} (straight at 15 km/h)")
        assert radius.value == pytest.approx(radius.file, abs=3e-4)


def test_a_name_that_is_nothing_is_told() -> None:
    result = CliRunner().invoke(main, ["characterise", "nothing_of_this_name"])
    assert result.exit_code == 2
    assert "neither a recording nor a vehicle file" in result.output
