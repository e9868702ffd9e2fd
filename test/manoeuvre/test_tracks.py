"""Tracks against closed forms, and drivers on them."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import fresnel

from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import MANOEUVRES, drive
from vsense_ros.manoeuvre.double_lane_change import lanes, vehicle_width
from vsense_ros.manoeuvre.leung_tracks import DOUBLE_OVAL, EIGHT, LEUNG, SLALOM, TRACKS, on_track
from vsense_ros.manoeuvre.track import Along, Piece, Track, left_turn, right_turn, straight, with_clothoids
from vsense_ros.model.coordinates import POSITION, ROLL, SPEED_X
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle

TURNS = st.lists(
    st.tuples(st.floats(10, 60), st.floats(-250, 250).filter(lambda a: abs(a) > 30)), min_size=1, max_size=5
)


@pytest.fixture(scope="module")
def saloon() -> Vehicle:
    return load_vehicle(Path(__file__).resolve().parents[2] / "config" / "vehicles" / "jaguar_saloon.yaml")


def test_the_tracks_of_the_thesis_have_its_lengths_and_close_where_they_should() -> None:
    assert Track(DOUBLE_OVAL).length == pytest.approx(900 + 4 * 30 * np.pi)  # 1277 m
    assert TRACKS["double_oval"].length == pytest.approx(1277.0, abs=0.1)
    assert Track(SLALOM).length == pytest.approx(323, abs=0.5)
    radius = 145 / (2 * np.sqrt(3))
    closing = Track((straight(145), left_turn(radius, 240), straight(145), right_turn(radius, 240)))
    assert np.hypot(closing.x[-1], closing.y[-1]) < 1e-9
    assert np.sin(closing.heading[-1] / 2) == pytest.approx(0, abs=1e-9)
    assert np.hypot(Track(EIGHT).x[-1], Track(EIGHT).y[-1]) == pytest.approx(2.2, abs=0.1)
    assert {f"double_oval_{kph}" for kph in LEUNG.speeds_kph} <= set(MANOEUVRES)


@given(st.floats(5, 100), st.floats(0.005, 0.2), st.floats(0, 300))
@settings(max_examples=30, deadline=None)
def test_a_clothoid_is_the_integral_of_fresnel(length: float, curvature: float, before: float) -> None:
    track = Track((straight(before + 1), Piece(length, 0.0, curvature)))
    scale = np.sqrt(np.pi * length / curvature)
    sine, cosine = fresnel(length / scale)
    assert track.x[-1] - before - 1 == pytest.approx(scale * cosine, rel=1e-10, abs=1e-9)
    assert track.y[-1] == pytest.approx(scale * sine, rel=1e-10, abs=1e-9)


@given(st.floats(5, 80), st.floats(10, 350))
@settings(max_examples=30, deadline=None)
def test_an_arc_lies_on_its_circle(radius: float, degrees: float) -> None:
    for sign in (1, -1):
        track = Track((left_turn(radius, sign * degrees),))
        assert np.hypot(track.x, track.y - sign * radius) == pytest.approx(radius, rel=1e-12)


@given(TURNS, st.floats(0.5, 4))
@settings(max_examples=30, deadline=None)
def test_clothoids_keep_length_and_heading_and_leave_no_jump(turns: list[tuple[float, float]], length: float) -> None:
    pieces = [straight(20.0), *(left_turn(*turn) for turn in turns), straight(20.0)]
    smooth = with_clothoids(pieces, length)
    assert sum(piece.length for piece in smooth) == pytest.approx(sum(piece.length for piece in pieces))
    assert sum(piece.turning for piece in smooth) == pytest.approx(sum(piece.turning for piece in pieces), abs=1e-9)
    for one, other in pairwise(smooth):
        assert one.end == pytest.approx(other.begin, abs=1e-12)


def test_clothoids_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"no room for clothoids of 8 m"):
        with_clothoids([straight(20), left_turn(2, 90), straight(20)], 8.0)
    with pytest.raises(ValueError, match="slope is shorter"):
        Track((straight(100), straight(5, grade=0.1), straight(100)), blend=20.0)


@given(TURNS, st.floats(-1, 1), st.floats(0.02, 0.98))
@settings(max_examples=30, deadline=None)
def test_a_point_beside_a_track_is_found_where_it_is(
    turns: list[tuple[float, float]], offset: float, share: float
) -> None:
    track = Track(with_clothoids([straight(20.0), *(left_turn(*turn) for turn in turns)], 4.0))
    along = Along(track)
    until = int(share * len(track.distance))
    for i in range(0, until + 1, 2):  # as a car comes there, past all crossings
        x = track.x[i] - offset * np.sin(track.heading[i])
        y = track.y[i] + offset * np.cos(track.heading[i])
        distance, beside, heading = along.find(x, y)
    i = (until // 2) * 2
    assert distance == pytest.approx(track.distance[i], abs=0.03)
    assert beside == pytest.approx(offset, abs=0.005)
    assert heading == pytest.approx(track.heading[i], abs=0.005)


def test_the_hill_goes_up_and_comes_down_to_where_it_began() -> None:
    hill = TRACKS["hill"]
    assert hill.z[-1] == pytest.approx(0.0, abs=1e-9)
    steep = 600 + 100 * np.pi / 2  # m at 15 %, besides 200 m at 5 %
    exact = steep * np.sin(np.arctan(0.15)) + 200 * np.sin(np.arctan(0.05))
    assert hill.z.max() == pytest.approx(exact, rel=5e-3)  # its kinks are rounded
    slope = np.gradient(hill.z, hill.distance)
    assert np.sin(hill.grade) == pytest.approx(slope, abs=2e-3)
    on_map = np.hypot(np.gradient(hill.x, hill.distance), np.gradient(hill.y, hill.distance))
    assert on_map == pytest.approx(np.cos(hill.grade), abs=2e-3)
    grade, bank = hill.slopes(np.array([-10.0, 600.0, 1000.0, 1e4]))
    assert np.tan(grade) == pytest.approx([0, 0.05, 0.15, 0])
    assert np.tan(bank) == pytest.approx([0, 0, -0.05, 0])


def test_the_lane_change_has_the_gates_of_the_thesis(saloon: Vehicle) -> None:
    wide = 1.72 / vehicle_width(saloon)  # its car is 14 mm wider
    for (begin, end, right, left), (x, until, middle, width) in zip(
        lanes(saloon, LEUNG.lane_change_entry),
        ((400, 415, 0, 2.142), (445, 470, 3.586, 2.314), (495, 525, 0.172, 2.486)),
        strict=True,
    ):
        assert (begin, end) == (x, until)
        assert (right + left) / 2 == pytest.approx(middle, abs=0.01)
        assert left - right == pytest.approx(0.25 + (width - 0.25) / wide, abs=0.01)


@pytest.mark.exam
def test_the_driver_keeps_to_the_tightest_track(saloon: Vehicle) -> None:
    drive_ = drive("slalom", saloon)
    along = Along(TRACKS["slalom"])
    offsets = [along.find(*drive_.q[i, POSITION][:2])[1] for i in range(0, len(drive_.t), 20)]
    assert np.abs(offsets).max() < 0.35
    assert drive_.u[:, SPEED_X] == pytest.approx(5.0, abs=0.3)
    assert along.find(*drive_.q[-1, POSITION][:2])[0] == pytest.approx(TRACKS["slalom"].length, abs=3.0)


def test_a_car_that_cannot_drive_a_track_at_a_speed_is_told_so_in_a_sentence(saloon: Vehicle) -> None:
    on_ice = saloon.with_parameters({"road.friction": 0.3})
    q, u = rolling_straight(on_ice, 15.0)
    driver = on_track(Track((straight(20), left_turn(30, 180))), 15.0, on_ice)
    with pytest.raises(InputError, match=r"leaves the track after .* m, at .* km/h"):
        simulate(on_ice, driver, 6.0, step=1e-3, keep_every=10, q=q, u=u)


@pytest.mark.exam
def test_the_saloon_rolls_and_turns_as_its_file_says(saloon: Vehicle) -> None:
    """Axle stiffnesses of table 5.1 show in the side slip of a slow oval's bends."""
    speed = 25 / 3.6
    q, u = rolling_straight(saloon, speed)
    first_bend = 65.0  # [s]
    found = simulate(saloon, on_track(TRACKS["double_oval"], speed, saloon), first_bend, keep_every=10, q=q, u=u)
    lateral = found.acceleration[:, 1]
    roll_gradient = np.degrees(np.polyfit(lateral, found.q[:, ROLL], 1)[0]) * 9.80665
    assert roll_gradient == pytest.approx(4.2, abs=0.15)
    turning = np.abs(lateral) > 1.5
    a, b, mass, rear = 1.36, 1.546, 1858.0, 120_000.0
    slip_per_curvature = b - a * mass * speed**2 / ((a + b) * rear)
    curvature = lateral[turning] / found.u[turning, SPEED_X] ** 2
    ratio = found.side_slip[turning] / curvature
    assert np.median(ratio) == pytest.approx(slip_per_curvature, rel=0.03)
