"""An inertial sensor that leans is told; a road that leans is not taken for one."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drives import IMU, SECOND, messages
from vsense_ros.bag import datasets, read_bag
from vsense_ros.bag.importers import import_recording
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre.driver import SpeedKeeper
from vsense_ros.manoeuvre.road_surface import RoadSurface
from vsense_ros.manoeuvre.sensing import record
from vsense_ros.manoeuvre.track import Track, straight
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Recording
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.state import FORWARD, YAW_RATE
from vsense_ros.observer.tilt import TILT, Tilt
from vsense_ros.runner import Runner

BAGS = Path(__file__).parents[2] / "bags"


def leaning(recording: Recording, roll: float, pitch: float) -> Recording:
    """What an inertial sensor would have told that is turned by roll and pitch [deg]."""
    channel = recording[IMU]
    to_sensor = Rotation.from_euler("xyz", [roll, pitch, 0.0], degrees=True).inv()
    turned = {name: to_sensor.apply(channel.columns[name]) for name in ("angular_velocity", "linear_acceleration")}
    return replace(
        recording, channels={**recording.channels, IMU: replace(channel, columns={**channel.columns, **turned})}
    )


def said(recording: Recording, vehicle: Vehicle) -> list[Diagnostic]:
    """The line about the inertial sensor, each time it is another, of an observer that is asked ten times a second."""
    lines: list[Diagnostic] = []
    observer, asked = Runner(vehicle, recording.map_origin), 0
    for sample in messages(recording):
        observer.add(sample)
        if observer.started and observer.stamp >= asked + SECOND // 10:
            asked = observer.stamp
            observer.snapshot()
            (line,) = (line for line in observer.diagnostics() if line.name == "imu")
            if not lines or line.message != lines[-1].message:
                lines.append(line)
    return lines


@pytest.fixture(scope="module")
def watched(vehicle: Vehicle) -> Runner:
    return Runner(vehicle)


def after_a_while(observer: Runner, along: float, across: float, yaw_rate: float = 0.0) -> Tilt:
    """What is watched has driven on long enough to be sure, with these biases [m/s²] and this yaw rate [rad/s]."""
    mean, tilt = observer.filter.car.mean, Tilt(observer.sensors, observer.filter.car)
    mean[FORWARD], mean[YAW_RATE] = 20.0, yaw_rate
    mean[observer.filter.car.layout.biases[observer.names.index("imu")]][3:5] = along, across
    for stamp in range(SECOND, SECOND + int((TILT.least_time + 2.0) * SECOND), SECOND // 5):
        tilt.look(stamp, lambda: True)
    return tilt


@settings(deadline=None)
@given(roll=st.floats(-20.0, 20.0), pitch=st.floats(-20.0, 20.0))
def test_it_tells_the_roll_and_the_pitch_of_which_gravity_is_felt(watched: Runner, roll: float, pitch: float) -> None:
    x, y, _ = Rotation.from_euler("xyz", [roll, pitch, 0.0], degrees=True).inv().apply([0.0, 0.0, 9.80665])
    text = after_a_while(watched, x, y).sentence()
    assert bool(text) == (np.hypot(x, y) > TILT.largest)
    across = np.degrees(np.arcsin(y / 9.80665))  # roll, but for the pitch about which it is not
    for name, angle, felt in (("roll", across, y), ("pitch", pitch, x)):
        said = re.search(rf"a {name} of ([+-][\d.]+)°", text)
        assert bool(said) == (bool(text) and abs(felt) > TILT.largest / 2)
        assert said is None or float(said[1]) == pytest.approx(angle, abs=0.051)


def test_in_a_bend_nothing_is_known(watched: Runner) -> None:
    assert after_a_while(watched, 3.0, 0.0, yaw_rate=0.2).sentence() == ""


def rav4() -> tuple[Recording, Vehicle]:
    try:
        return import_recording(datasets.fetch("comma2k19_rav4")), load_vehicle(vehicle_path("rav4"))
    except InputError as error:
        pytest.skip(str(error))


@pytest.mark.exam
@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 5.0), (-5.0, 0.0)])
def test_on_a_real_road_it_is_told_with_the_angle_within_a_degree(roll: float, pitch: float) -> None:
    recording, car = rav4()
    line = said(leaning(recording, roll, pitch), car)[-1]
    assert line.level is Level.WARN
    word, angle = ("roll", roll) if roll else ("pitch", pitch)
    told = float(line.message.split(f"lacks a {word} of ")[1].split("°")[0])
    assert told == pytest.approx(angle, abs=1.0)


@pytest.fixture(scope="module")
def country_road(plant: Vehicle) -> Recording:
    """Up and down by 5 %, straight, for 28 s."""
    rises = [straight(70.0, grade=0.05 * sign) for sign in (1, -1, 1, -1, 1, -1)]
    track = Track((straight(60.0), *rises, straight(200.0)), blend=30.0)
    q, u = rolling_straight(plant, 18.0)
    feet = SpeedKeeper(plant, lambda t: 18.0)
    drive = simulate(plant, lambda t, q, u: np.append(0.0, feet(t, u)), 28.0, q=q, u=u, surface=RoadSurface(track))
    return record(drive, plant, 4, name="country road")


@pytest.mark.exam
def test_on_rises_it_is_told_where_no_height_is_known(vehicle: Vehicle, country_road: Recording) -> None:
    assert not any("tilted" in line.message for line in said(country_road, vehicle))
    words = said(leaning(country_road, 0.0, 5.0), vehicle)[-1].message
    assert "lacks a pitch of +" in words
    assert "or the road falls by" in words


@pytest.mark.exam
@pytest.mark.parametrize("bag", ["hills", "banked_oval", "steady_state_circle"])
def test_hills_and_banks_are_not_taken_for_it(vehicle: Vehicle, bag: str) -> None:
    assert not any("tilted" in line.message for line in said(read_bag(BAGS / bag), vehicle))


@pytest.mark.exam
def test_a_real_road_is_not_taken_for_it() -> None:
    assert not any("tilted" in line.message for line in said(*rav4()))
