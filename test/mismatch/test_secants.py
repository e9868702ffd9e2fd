"""Secants by sizes at places of a long road, of residuals whose slopes are known in closed form."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from vsense_ros.identification.free_parameter import FreeParameter, added
from vsense_ros.identification.least_squares import Fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.cross_validation import places
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.secants import Secants
from vsense_ros.mismatch.windows import Readings
from vsense_ros.model.effects.base import SPACING

SPEED, WINDOWS = 25.0, 8  # [m/s], windows of 20 s one after the other
ROAD = np.arange(0.0, SPEED * 20.0 * WINDOWS, SPACING)


def window(number: int) -> SimpleNamespace:
    begin = 20.0 * number
    t = np.array([begin, begin + 20.0])
    return SimpleNamespace(begin=begin, end=begin + 20.0, run_in=2.5, place=Readings(t, SPEED * t[:, None]))


def near(at: np.ndarray, place: float) -> np.ndarray:
    """What a size at a place does: a triangle that ends at its neighbours."""
    return np.maximum(0.0, 1.0 - np.abs(at - place) / SPACING)


class Road:
    """One signal, a wave that nothing explains, which each place changes by its triangle, and a base parameter
    everywhere by 1."""

    at_once = 2
    layout = [["yaw_rate"]] * WINDOWS
    predictor = SimpleNamespace(dataset=SimpleNamespace(windows=[window(i) for i in range(WINDOWS)]))

    def prepare(self, parameter_sets: Sequence[ParameterSet], near: ParameterSet | None = None) -> None:
        pass

    def diverged(self, parameter_set: ParameterSet) -> list[bool]:
        return [False] * WINDOWS

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[np.ndarray] | None = None) -> list[np.ndarray]:
        values = dict(parameter_set.values)
        offset = values.pop("offset")
        every = [places(one) for one in self.predictor.dataset.windows]
        return [
            np.sin(at / 30.0) + offset + sum(size * near(at, float(name)) for name, size in values.items())
            for at in every
        ]


POINTS = tuple(
    FreeParameter(f"{place}", "-", 0.5, -1.0, 1.0, added(f"{place}"), place=("size", place)) for place in ROAD.tolist()
)


@pytest.fixture(scope="module")
def secants() -> Secants:
    road, start = Road(), ParameterSet({"offset": 0.0, **{point.name: 0.0 for point in POINTS}})
    base = FreeParameter("offset", "-", 2.0, -9.0, 9.0, added("offset"))
    residuals = road(start)
    fitted = Fit(start, (base,), np.zeros(1), residuals, [np.full((len(r), 1), 2.0) for r in residuals], 1.0)
    found = Secants(cast(Residuals, road), start, fitted)
    found.simulate_new([cast(Any, SimpleNamespace(free_parameters=POINTS, along_road=True, places=POINTS))])
    return found


def test_a_secant_by_a_size_at_a_place_is_its_triangle_in_every_window(secants: Secants) -> None:
    for point in POINTS:
        assert point.place is not None
        for part, one in zip(secants.column(point), Road.predictor.dataset.windows, strict=True):
            np.testing.assert_allclose(part, near(places(one), point.place[1]), atol=1e-12)


def test_equations_that_are_joined_are_those_of_the_joined_fit(secants: Secants) -> None:
    joined, of_fit = secants.joined_equations(secants.base, POINTS), secants.joined(secants.base, POINTS).equations
    for name in ("normal", "right", "costs", "rows", "scaled_offsets"):
        np.testing.assert_allclose(getattr(joined, name), getattr(of_fit, name), atol=1e-9)


def test_secants_of_a_long_road_are_stored_for_the_windows_that_pass_their_place(secants: Secants) -> None:
    stored = [
        sum(part.nbytes if part.strides[0] else part.itemsize for part in secants.column(point)) for point in POINTS
    ]
    every = sum(part.nbytes for part in secants.column(POINTS[0]))
    assert max(stored) < 2.1 / WINDOWS * every
