"""Laps are folded onto one another by position, and a profile belongs to its place."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.mismatch.road import ROAD_SETTINGS, SPACING, Road, place_of, point, points, profile

RADIUS = 100.0  # [m] of a circular track


def lap(
    begin: float, length: float, *, noise: float = 0.0, offset: float = 0.0, backwards: bool = False, seed: int = 0
):
    """Travelled distance, east and north every 2 m on a circle, from `begin` [m] on."""
    travelled = np.arange(0.0, length, 2.0)
    angle = (begin + travelled) / RADIUS * (-1 if backwards else 1)
    rng = np.random.default_rng(seed)
    east, north = (RADIUS + offset) * np.cos(angle), (RADIUS + offset) * np.sin(angle)
    return travelled, east + noise * rng.standard_normal(len(east)), north + noise * rng.standard_normal(len(east))


def at_angles(distance, abscissa, begin: float):
    """Abscissa at whole degrees of the track."""
    angle = np.degrees((begin + distance) / RADIUS)
    return lambda degree: float(np.interp(degree, angle, abscissa))


@pytest.mark.parametrize(("noise", "offset"), [(0.0, 0.0), (1.5, 3.0)])
def test_a_second_recording_of_a_lap_has_the_abscissa_of_the_first(noise, offset):
    road = Road()
    first = at_angles(*road.follow(*lap(0.0, 500.0)), 0.0)
    second = at_angles(*road.follow(*lap(100.0, 350.0, noise=noise, offset=offset)), 100.0)
    for degree in (80, 120, 200, 250):
        assert second(degree) == pytest.approx(first(degree), abs=8.0)


def test_the_second_lap_of_one_recording_has_the_abscissa_of_the_first():
    distance, abscissa = Road().follow(*lap(0.0, 3 * 2 * np.pi * RADIUS, noise=0.5))
    found = at_angles(distance, abscissa, 0.0)
    for degree in (120, 200, 300):
        assert found(degree + 360) == pytest.approx(found(degree), abs=5.0)
        assert found(degree + 720) == pytest.approx(found(degree), abs=5.0)


def test_the_other_direction_of_a_road_is_another_road():
    road = Road()
    _, first = road.follow(*lap(0.0, 400.0))
    _, second = road.follow(*lap(0.0, 400.0, backwards=True))
    _, elsewhere = road.follow(*lap(0.0, 400.0, offset=60.0))
    assert len({round(a[0] // ROAD_SETTINGS.stretch) for a in (first, second, elsewhere)}) == 3


def test_who_drives_on_where_the_road_is_not_known_yet_lengthens_it():
    road = Road()
    road.follow(*lap(0.0, 200.0))
    distance, abscissa = road.follow(*lap(0.0, 500.0))
    assert np.diff(abscissa) == pytest.approx(np.diff(distance), abs=10.0)
    again = at_angles(*road.follow(*lap(250.0, 200.0)), 250.0)
    assert again(200) == pytest.approx(at_angles(distance, abscissa, 0.0)(200), abs=8.0)


def test_a_profile_is_linear_between_its_points_and_nothing_elsewhere():
    values = {0.0: 0.02, SPACING: 0.04, ROAD_SETTINGS.stretch: -0.01}
    assert profile(values, np.array([0.0, SPACING / 2, SPACING])) == pytest.approx([0.02, 0.03, 0.04])
    assert profile(
        values, np.array([-SPACING, 2 * SPACING, ROAD_SETTINGS.stretch / 2, ROAD_SETTINGS.stretch + SPACING])
    ) == pytest.approx([0] * 4)
    assert profile(values, np.array([1.5 * SPACING, ROAD_SETTINGS.stretch])) == pytest.approx([0.02, -0.01])


@given(st.floats(0, 5 * ROAD_SETTINGS.stretch))
def test_the_name_of_a_point_tells_its_place(abscissa):
    size, at = place_of(point("effects.road_bank.bank", abscissa))
    assert size == "effects.road_bank.bank"
    assert at == pytest.approx(abscissa, abs=0.5)
    assert place_of("effects.road_bank.bank") is None


def test_points_are_where_the_car_has_been():
    found = points([np.arange(0.0, 220.0), ROAD_SETTINGS.stretch + np.arange(0.0, 10.0)])
    assert found == pytest.approx(np.arange(0, 5) * SPACING)


@given(st.integers(0, 2**32 - 1), st.integers(0, 60))
def test_a_place_is_met_where_the_nearest_of_all_points_is(seed: int, count: int):
    """As a search of all points finds it: within the spacing along the road, and across by no more than a lane."""
    rng, s = np.random.default_rng(seed), ROAD_SETTINGS
    columns = [*rng.uniform(-40.0, 40.0, (2, count)), rng.uniform(-4.0, 4.0, count), rng.uniform(0.0, 1e3, count)]
    road = Road(*(column.tolist() for column in columns))
    for east, north, course in np.column_stack([rng.uniform(-50.0, 50.0, (20, 2)), rng.uniform(-4.0, 4.0, 20)]):
        met = []
        for x, y, heading, abscissa in zip(*columns, strict=True):
            along = np.cos(heading) * (east - x) + np.sin(heading) * (north - y)
            across = np.cos(heading) * (north - y) - np.sin(heading) * (east - x)
            if abs(along) < s.spacing and abs(across) < s.near and np.cos(course - heading) > np.cos(s.turned):
                met.append((abs(across), abscissa + along))
        expected = min(met)[1] if met else None
        assert road.abscissa_of(east, north, course) == (None if expected is None else pytest.approx(expected))
