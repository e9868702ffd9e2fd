"""Folds of a cross-validation."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.estimation.reading import Map
from vsense_ros.identification.free_parameter import FreeParameter, added
from vsense_ros.identification.least_squares import Fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.cross_validation import (
    by_pieces,
    by_stretches,
    by_windows,
    only_pieces_can_validate,
    passed_once,
)
from vsense_ros.mismatch.road import ROAD_SETTINGS, Road
from vsense_ros.mismatch.signals import grid
from vsense_ros.mismatch.windows import Dataset, Readings

UNKNOWNS = tuple(FreeParameter(name, "-", 0.1, -1.0, 1.0, added(name)) for name in ("mass", "drag", "slope"))
SIGNALS = ["longitudinal_acceleration", "speed"]


def window(recording: int, begin: float, end: float, speed: float, at: float) -> SimpleNamespace:
    """A stretch of steady driving that begins at an abscissa [m]."""
    t = np.array([begin - 1.0, end + 1.0])
    return SimpleNamespace(
        recording=recording, begin=begin, end=end, run_in=2.5, place=Readings(t, (at + speed * (t - begin))[:, None])
    )


def residuals_of(windows: list[SimpleNamespace]) -> SimpleNamespace:
    dataset = Dataset(tuple(windows), {}, (), (), Road(), Map(None))
    return SimpleNamespace(predictor=SimpleNamespace(dataset=dataset), layout=[SIGNALS] * len(windows))


def fit_of(windows: list[SimpleNamespace], seed: int, free_parameters: int = 3) -> Fit:
    rng = np.random.default_rng(seed)
    rows = [len(SIGNALS) * len(grid(w)) for w in windows]
    slopes = [rng.normal(size=(n, free_parameters)) for n in rows]
    offsets = 0.05 * np.ones(free_parameters)
    return Fit(
        ParameterSet({}), UNKNOWNS[:free_parameters], offsets, [rng.normal(size=n) for n in rows], slopes, weight=2.0
    )


@given(st.integers(0, 1000), st.floats(6.0, 40.0), st.floats(10.0, 25.0), st.integers(0, 3))
def test_all_that_is_known_is_in_the_parts_and_nothing_twice(seed, speed, duration, free_parameters):
    windows = [window(0, 0.0, duration, speed, 3e5), window(0, duration, 2 * duration, speed, 3e5 + duration * speed)]
    for parts_of, some in ((by_pieces, windows), (by_stretches, windows[:1]), (by_windows, windows)):
        whole = fit_of(some, seed, free_parameters)
        folds = parts_of(residuals_of(some), whole)
        parts, known = folds.apart(whole).equations, whole.equations
        assert sorted(i for group in folds.groups for i in group) == list(range(len(parts.rows)))
        assert folds.rows.sum() == known.rows.sum()
        assert parts.normal.sum(axis=0) == pytest.approx(known.normal.sum(axis=0))
        assert parts.right.sum(axis=0) == pytest.approx(known.right.sum(axis=0))
        assert folds.own.sum() == pytest.approx(whole.value)
        assert folds.gains(parts, whole.value) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_of_two_neighbouring_pieces_of_a_road_one_is_in_each_fold():
    """20 m/s for 25 s: where a row is on the road is written into its residual."""
    (driven,) = windows = [window(0, 0.0, 25.0, 20.0, 0.5 * ROAD_SETTINGS.stretch)]
    whole = fit_of(windows, 0)
    place = np.interp(grid(driven), driven.place.t, driven.place.value[:, 0]) - 0.5 * ROAD_SETTINGS.stretch
    told = Fit(whole.parameter_set, UNKNOWNS, whole.offsets, [np.tile(place, 2)], whole.slopes, whole.weight)
    first, second = by_pieces(residuals_of(windows), told).apart(told).residuals
    assert {int(at // 50) for at in first} == {1, 3, 5, 7, 9}
    assert {int(at // 50) for at in second} == {2, 4, 6, 8}  # the first 2.5 s find the state of the car


def test_a_road_is_passed_once_unless_recordings_or_laps_come_there_again():
    first, next_one = (
        window(0, 0.0, 25.0, 20.0, 0.5 * ROAD_SETTINGS.stretch),
        window(0, 22.5, 47.5, 20.0, 0.5 * ROAD_SETTINGS.stretch + 450.0),
    )
    elsewhere, again = (
        window(1, 0.0, 25.0, 20.0, 1.5 * ROAD_SETTINGS.stretch),
        window(1, 0.0, 25.0, 18.0, 0.5 * ROAD_SETTINGS.stretch + 10.0),
    )
    assert passed_once([first, next_one])
    assert passed_once([first, elsewhere])
    assert not passed_once([first, again])


def recordings_of(*roads: float) -> SimpleNamespace:
    """Recordings of roads of their own with these lengths [m], and a point each 50 m."""
    each = [[window(i, 0.0, length / 20.0, 20.0, (i + 0.5) * ROAD_SETTINGS.stretch)] for i, length in enumerate(roads)]
    points = [
        (i + 0.5) * ROAD_SETTINGS.stretch + at for i, length in enumerate(roads) for at in range(0, int(length), 50)
    ]
    return SimpleNamespace(windows=[w for part in each for w in part], by_recording=lambda: each, points=points)


def test_several_short_recordings_of_roads_of_their_own_are_proven_by_dropping_each_in_turn():
    assert not only_pieces_can_validate(recordings_of(*8 * [300.0]))
    assert only_pieces_can_validate(recordings_of(*2 * [800.0]))
    assert only_pieces_can_validate(recordings_of(300.0))
