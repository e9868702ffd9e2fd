"""The surface of a road along a track, against finite differences and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros.manoeuvre.banked_oval import SETTINGS, TRACK
from vsense_ros.manoeuvre.leung_tracks import TRACKS
from vsense_ros.manoeuvre.road_surface import RoadSurface
from vsense_ros.manoeuvre.track import Track, left_turn, straight, with_clothoids

PIECES = (straight(60.0), left_turn(30.0, 120, grade=0.1, bank=-0.2), straight(60.0, bank=0.1), left_turn(40.0, -90))
WINDING = Track(with_clothoids(PIECES, 20.0), blend=20.0)


def beside(track: Track, i: int, left: float) -> tuple[float, float]:
    """A place on the map, `left` [m] beside a point of the track."""
    heading = track.heading[i]
    return track.x[i] - left * np.sin(heading), track.y[i] + left * np.cos(heading)


def along(surface: RoadSurface, track: Track, until: int) -> None:
    """Go there as a car does."""
    for i in range(0, until, 4):
        surface.shape(track.x[i], track.y[i])


@example(453, 4.0, 0.0)
@given(st.integers(5, len(WINDING.x) - 5), st.floats(-4, 4), st.sampled_from([0.0, 0.01]))
@settings(max_examples=40, deadline=None)
def test_gradient_and_curvature_are_the_derivatives_of_the_height(i: int, left: float, crown: float) -> None:
    surface, step = RoadSurface(WINDING, crown), 1e-4
    along(surface, WINDING, i)
    # Between two points of the track: at one the curvature jumps.
    x, y = (np.array(beside(WINDING, i, left)) + beside(WINDING, i + 1, left)) / 2
    _, gradient, second = surface.shape(x, y)
    for axis, move in enumerate(step * np.eye(2)):
        up, down = surface.shape(x + move[0], y + move[1]), surface.shape(x - move[0], y - move[1])
        assert (up[0] - down[0]) / (2 * step) == pytest.approx(gradient[axis], abs=1e-6)
        # Between two points the middle is an arc, but the change of its curvature is that of the whole clothoid: beside
        # the middle the road turns away by that, and its slope with it.
        assert_allclose((up[1] - down[1]) / (2 * step), second[axis], atol=1e-6 + abs(left) * turning_slope(i))


def turning_slope(i: int) -> float:
    """The change of the winding road's curvature at a point, as it is 4 m to the left of the middle, times its steepest
    slope anywhere [1/m²]; zero on arcs and straights."""
    track, near = WINDING, slice(i - 1, i + 3)
    spacing = np.hypot(track.x[1] - track.x[0], track.y[1] - track.y[0])
    change = np.abs(np.diff(track.curvature[near])).max() / spacing / (1 - 4 * np.abs(track.curvature[near]).max())
    return float(np.hypot(track.grade, track.bank).max() * change)


@given(st.floats(0.0, 1.0))
@settings(max_examples=20, deadline=None)
def test_the_middle_of_the_road_has_the_heights_and_slopes_of_its_track(share: float) -> None:
    hill = TRACKS["hill"]
    surface, i = RoadSurface(hill), round(share * (len(hill.x) - 1))
    along(surface, hill, i)
    grade, bank, _, _, height = surface.under(hill.x[i], hill.y[i], hill.heading[i])
    assert height == pytest.approx(hill.z[i], abs=5e-3)
    assert grade == pytest.approx(hill.grade[i], abs=1e-4)
    assert bank == pytest.approx(hill.bank[i], abs=1e-4)


def test_a_banked_turn_is_a_cone() -> None:
    surface = RoadSurface(Track((left_turn(50.0, 180, bank=-0.2),)))
    for angle in (0.3, 1.0, 2.5):
        for radius in (48.0, 50.0, 53.0):
            x, y = radius * np.sin(angle), 50.0 - radius * np.cos(angle)
            grade, bank, bent, twist, height = surface.under(x, y, angle)
            assert height == pytest.approx((radius - 50.0) * np.tan(0.2), abs=1e-4)
            assert (grade, bank) == pytest.approx((0.0, -0.2), abs=1e-4)
            assert bent == pytest.approx(np.sin(0.2) / radius, rel=1e-2)  # of a cone round its axis (Meusnier)
            assert twist == pytest.approx(0.0, abs=1e-4)


def test_a_crowned_road_falls_to_both_sides() -> None:
    surface = RoadSurface(TRACK, SETTINGS.crown)
    for left in (-2.0, 2.0):
        _, bank, *_, height = surface.under(10.0, left, 0.0)
        assert height == pytest.approx(-SETTINGS.crown * left**2, abs=1e-9)
        assert np.tan(bank) == pytest.approx(-2 * SETTINGS.crown * left, abs=1e-9)


def test_before_and_beyond_its_ends_a_road_goes_straight_on() -> None:
    track = Track((straight(10.0, grade=0.1), left_turn(20.0, 90, grade=0.1)))
    surface = RoadSurface(track)
    assert surface.under(-5.0, 1.0, 0.0) == pytest.approx((0.1, 0.0, 0.0, 0.0, -5.0 * np.tan(0.1)), abs=1e-9)
    along(surface, track, len(track.x))
    grade, bank, bent, _, height = surface.under(track.x[-1], track.y[-1] + 7.0, np.pi / 2)
    assert (grade, bank, bent) == pytest.approx((0.1, 0.0, 0.0), abs=1e-3)
    assert height == pytest.approx(track.z[-1] + 7.0 * np.tan(0.1), abs=0.02)


def test_the_oval_is_closed_and_banked_enough_that_its_tyres_work_less() -> None:
    assert TRACK.heading[-1] == pytest.approx(2 * np.pi)
    lateral = 20.0**2 / SETTINGS.radius
    assert lateral * np.cos(SETTINGS.bank) - 9.81 * abs(np.sin(SETTINGS.bank)) < 0.75 * lateral
