"""Fits against another library's optimiser, where parameters can stand in for one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares, minimize

from vsense_ros.identification.free_parameter import FreeParameter, added
from vsense_ros.identification.least_squares import (
    DivergedError,
    Fit,
    Settings,
    cost,
    fit,
    fit_each,
    prior_weight,
    slopes_at,
    solve,
)
from vsense_ros.identification.parameter_set import ParameterSet

DEVIATIONS = {"mass": 0.1, "drag": 0.1, "rolling": 0.002}
WEIGHT = 3.0  # of a free parameter that is one deviation off
TIME = np.linspace(0.0, 60.0, 600)
FORCE = 1500.0 + 1200.0 * np.sign(np.sin(0.25 * TIME))  # [N] of drive that is known
NOMINAL = ParameterSet(dict.fromkeys(DEVIATIONS, 0.0))


def speed(mass: float, drag: float, rolling: float) -> np.ndarray:
    """Speed of a car on a straight road [m/s]: Euler steps of Newton's second law."""
    m, v, found = 1500.0 * (1 + mass), 25.0, []
    for force in FORCE:
        v += (TIME[1] - TIME[0]) * ((force - (0.4 + 0.6 * drag) * v**2) / m - 9.81 * (0.01 + rolling))
        found.append(v)
    return np.array(found)


class Simulated:
    """What a test simulates: one block that never diverges."""

    at_once = 1

    def prepare(self, parameter_sets: Sequence[ParameterSet], near: ParameterSet | None = None) -> None:
        pass

    def diverged(self, parameter_set: ParameterSet) -> list[bool]:
        return [False]


class Speeds(Simulated):
    """Residuals of the speed in standard deviations of 0.2 m/s."""

    def __init__(self, **true: float) -> None:
        self.measured = speed(**true) + 0.2 * np.random.default_rng(1).standard_normal(len(TIME))

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[np.ndarray] | None = None) -> list[np.ndarray]:
        return [(speed(**parameter_set.values) - self.measured) / 0.2]


class Hyperbola(Simulated):
    """A residual with a minimum on either side of x = 0 (at ±2) and no value within 0.5 of it."""

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[np.ndarray] | None = None) -> list[np.ndarray]:
        if self.diverged(parameter_set) == [True]:
            if instead is None:
                raise DivergedError
            return list(instead)
        x = parameter_set.values["x"]
        return [np.array([x - 4.0 / x, 0.1 * (x - 2.0)])]

    def diverged(self, parameter_set: ParameterSet) -> list[bool]:
        return [abs(parameter_set.values["x"]) < 0.5]


def parameter(name: str, deviation: float, starts: tuple[float, ...] = (0.0,)) -> FreeParameter:
    return FreeParameter(name, "-", deviation, -5 * deviation, 5 * deviation, added(name), starts=starts)


def begun(residuals: Speeds, offsets: np.ndarray) -> Fit:
    """A fit that is where it begins, with its slopes."""
    free_parameters = tuple(parameter(name, deviation) for name, deviation in DEVIATIONS.items())
    parameter_set = ParameterSet(dict(zip(DEVIATIONS, offsets, strict=True)))
    first = Fit(parameter_set, free_parameters, offsets, residuals(parameter_set), [], WEIGHT)
    return replace(first, slopes=slopes_at(residuals, NOMINAL, first))


OFFSETS = st.tuples(*[st.integers(-20, 20).map(lambda tenths: tenths / 10)] * len(DEVIATIONS))


@settings(deadline=None, max_examples=40)
@given(OFFSETS, OFFSETS)
def test_a_fit_follows_a_valley_in_which_mass_and_resistances_stand_in_for_one_another(hidden, from_where):
    deviations = np.array(list(DEVIATIONS.values()))
    true, begin = np.array(hidden) * deviations, np.array(from_where) * deviations
    residuals = Speeds(**dict(zip(DEVIATIONS, true, strict=True)))
    first = begun(residuals, begin)
    found = fit(residuals, NOMINAL, first.free_parameters, first=first)

    def all_residuals(scaled: np.ndarray) -> np.ndarray:
        (off,) = residuals(ParameterSet(dict(zip(DEVIATIONS, scaled * deviations, strict=True))))
        return np.append(off, np.sqrt(WEIGHT) * scaled)

    best = 2 * least_squares(all_residuals, begin / deviations, bounds=(-5, 5)).cost
    assert found.value == pytest.approx(best, rel=0.01)


@settings(deadline=None, max_examples=40)
@given(OFFSETS, OFFSETS)
@example((-1.3, -1.9, 0.0), (0.0, 1.4, -1.8))
@example((-1.9, -1.1, 0.0), (0.9, -1.3, 0.2))
def test_a_fit_that_slopes_of_its_beginning_stop_short_goes_on_with_those_of_where_it_is(hidden, from_where):
    """One beginning in a hundred or two is so far off that the slopes from there, corrected by each step, do not lead
    to the bottom of the valley."""
    deviations = np.array(list(DEVIATIONS.values()))
    true, begin = np.array(hidden) * deviations, np.array(from_where) * deviations
    residuals = Speeds(**dict(zip(DEVIATIONS, true, strict=True)))
    first = begun(residuals, begin)
    stopped = fit(residuals, NOMINAL, first.free_parameters, first=first)
    slopes = slopes_at(residuals, NOMINAL, stopped)
    found = fit(residuals, NOMINAL, first.free_parameters, first=replace(stopped, slopes=slopes))

    def all_residuals(scaled: np.ndarray) -> np.ndarray:
        (off,) = residuals(ParameterSet(dict(zip(DEVIATIONS, scaled * deviations, strict=True))))
        return np.append(off, np.sqrt(WEIGHT) * scaled)

    best = 2 * least_squares(all_residuals, begin / deviations, bounds=(-5, 5)).cost
    assert found.value == pytest.approx(best, rel=0.01)


@given(st.integers(0, 10_000), st.floats(0.01, 2.0))
def test_a_step_that_is_too_long_becomes_the_best_one_of_the_length_that_is_allowed(seed, longest):
    rng = np.random.default_rng(seed)
    slopes, residuals, offsets = [rng.normal(size=(9, 2))], [rng.normal(size=9)], rng.normal(size=2)

    def value(change: np.ndarray) -> float:
        return cost([residuals[0] + slopes[0] @ change]) + WEIGHT * float(np.sum((offsets + change) ** 2))

    free, step = solve(slopes, residuals, offsets, WEIGHT), solve(slopes, residuals, offsets, WEIGHT, longest=longest)
    assert np.linalg.norm(step) == pytest.approx(min(longest, np.linalg.norm(free)), rel=1e-6)
    if np.linalg.norm(free) > longest:
        around = np.linspace(0, 2 * np.pi, 721)
        others = [value(longest * np.array([np.cos(angle), np.sin(angle)])) for angle in around]
        assert value(step) <= min(others) + 1e-9


def test_a_fit_begins_where_it_fits_best_and_stays_on_that_side():
    there = parameter("x", 1.0, starts=(-3.0, 3.0))
    found = fit(Hyperbola(), ParameterSet({"x": 0.0}), [there])
    assert found.offsets[0] == pytest.approx(2.0, abs=0.01)
    assert found.converged


def test_a_start_that_cannot_be_simulated_is_passed_over_and_without_another_one_the_fit_fails():
    assert fit(Hyperbola(), ParameterSet({"x": 0.0}), [parameter("x", 1.0, starts=(0.0, 3.0))]).offsets[0] > 1.0
    with pytest.raises(DivergedError):
        fit(Hyperbola(), ParameterSet({"x": 0.0}), [parameter("x", 1.0)])


def test_an_offset_stays_within_its_bounds_though_the_value_falls_beyond():
    bounded = replace(parameter("x", 1.0, starts=(1.2,)), high=1.5)
    found = fit(Hyperbola(), ParameterSet({"x": 0.0}), [bounded])
    assert found.offsets[0] == 1.5


def test_what_is_minimised_is_the_squared_residuals_and_what_departing_from_nominal_costs():
    settings = Settings(iterations=20, weight=5.0)
    found = fit(Hyperbola(), ParameterSet({"x": 0.0}), [parameter("x", 1.0, starts=(3.0,))], settings=settings)

    def value(x: np.ndarray) -> float:
        return cost(Hyperbola()(ParameterSet({"x": float(x[0])}))) + 5.0 * float(x[0]) ** 2

    assert found.value == pytest.approx(minimize(value, [1.5], bounds=[(0.6, 5.0)]).fun, rel=1e-3)


def test_the_prior_counts_against_all_residuals_together():
    assert prior_weight([np.full(100, 2.0)]) == pytest.approx(4 * prior_weight([np.full(100, 1.0)]))
    assert prior_weight([np.full(100, 0.1)]) == prior_weight([np.full(100, 1.0)])


class SideBySide(Speeds):
    """Counts what is simulated, and how many at once."""

    at_once = 3

    def __init__(self, **true: float) -> None:
        super().__init__(**true)
        self.prepared: list[list[ParameterSet]] = []
        self.asked: list[ParameterSet] = []

    def prepare(self, parameter_sets: Sequence[ParameterSet], near: ParameterSet | None = None) -> None:
        self.prepared.append(list(parameter_sets))

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[np.ndarray] | None = None) -> list[np.ndarray]:
        self.asked.append(parameter_set)
        return super().__call__(parameter_set, instead)


@given(st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 3), max_size=5))
@settings(max_examples=20, deadline=None)
def test_fits_side_by_side_end_where_each_ends_alone(begins: list[tuple[float, ...]]):
    true = {"mass": 0.08, "drag": -0.05, "rolling": 0.001}
    residuals, alone = SideBySide(**true), Speeds(**true)
    first = [begun(alone, np.array(begin) * list(DEVIATIONS.values())) for begin in begins]
    found = fit_each(residuals, NOMINAL, first)
    assert len(found) == len(first)
    for one, at in zip(found, first, strict=True):
        np.testing.assert_array_equal(one.offsets, fit(alone, NOMINAL, at.free_parameters, first=at).offsets)
    assert all(1 < len(together) <= residuals.at_once for together in residuals.prepared)
    for together in residuals.prepared:  # and each of them is asked for
        assert all(any(one is asked for asked in residuals.asked) for one in together)


def test_a_fit_that_goes_on_from_another_does_not_simulate_where_that_one_is():
    residuals = SideBySide(mass=0.08, drag=-0.05, rolling=0.001)
    first = begun(residuals, np.zeros(3))
    residuals.asked.clear()
    fit(residuals, NOMINAL, first.free_parameters, first=first)
    assert residuals.asked
    assert all(one.values != first.parameter_set.values for one in residuals.asked)
