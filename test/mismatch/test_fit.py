"""Fits and their equations against other libraries: an optimiser, where parameters can stand in for one another, and
least squares on all rows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from vsense_ros.mismatch.candidates import FreeParameter
from vsense_ros.mismatch.fit import Fit, fit, slopes_at
from vsense_ros.mismatch.simulation import ParameterSet

DEVIATIONS = {"mass": 0.1, "drag": 0.1, "rolling": 0.002}
WEIGHT = 3.0  # of a free parameter that is one deviation off
TIME = np.linspace(0.0, 60.0, 600)
FORCE = 1500.0 + 1200.0 * np.sign(np.sin(0.25 * TIME))  # [N] of drive that is known


def speed(mass: float, drag: float, rolling: float) -> np.ndarray:
    """Of a car on a straight road [m/s]: Euler steps of Newton's second law."""
    m, v, found = 1500.0 * (1 + mass), 25.0, []
    for force in FORCE:
        v += (TIME[1] - TIME[0]) * ((force - (0.4 + 0.6 * drag) * v**2) / m - 9.81 * (0.01 + rolling))
        found.append(v)
    return np.array(found)


class Speeds:
    """Residuals of the speed in standard deviations of 0.2 m/s."""

    predictor = SimpleNamespace(lost=lambda parameter_set: [False], ahead=1, foresee=lambda settings: None)

    def __init__(self, **true: float) -> None:
        self.measured = speed(**true) + 0.2 * np.random.default_rng(1).standard_normal(len(TIME))

    def __call__(self, parameter_set: ParameterSet, instead=None) -> list[np.ndarray]:
        return [(speed(**parameter_set.values) - self.measured) / 0.2]


def parameter(name: str, deviation: float) -> FreeParameter:
    return FreeParameter(
        name, "-", deviation, -5 * deviation, 5 * deviation, lambda values, a: {name: values[name] + a}
    )


AMOUNTS = st.tuples(*[st.integers(-20, 20).map(lambda tenths: tenths / 10)] * len(DEVIATIONS))


@settings(deadline=None, max_examples=40)
@given(AMOUNTS, AMOUNTS)
def test_a_fit_follows_a_valley_in_which_mass_and_resistances_stand_in_for_one_another(hidden, from_where):
    deviations = np.array(list(DEVIATIONS.values()))
    true, begin = np.array(hidden) * deviations, np.array(from_where) * deviations
    residuals, start = Speeds(**dict(zip(DEVIATIONS, true, strict=True))), ParameterSet(dict.fromkeys(DEVIATIONS, 0.0))
    free_parameters = tuple(parameter(name, deviation) for name, deviation in DEVIATIONS.items())
    parameter_set = ParameterSet(dict(zip(DEVIATIONS, begin, strict=True)))
    first = Fit(parameter_set, free_parameters, begin, residuals(parameter_set), [], WEIGHT)
    first = replace(first, slopes=slopes_at(residuals, start, first, lambda: None))
    found = fit(residuals, start, free_parameters, first=first)

    def all_residuals(prior: np.ndarray) -> np.ndarray:
        (off,) = residuals(ParameterSet(dict(zip(DEVIATIONS, prior * deviations, strict=True))))
        return np.append(off, np.sqrt(WEIGHT) * prior)

    best = 2 * least_squares(all_residuals, begin / deviations, bounds=(-5, 5)).cost
    assert found.value == pytest.approx(best, rel=0.01)


def drawn(seed: int, free_parameters: int = 4, windows: int = 5) -> Fit:
    """A fit with slopes and residuals at random, windows of different lengths."""
    rng = np.random.default_rng(seed)
    rows = rng.integers(10, 40, windows)
    every = tuple(parameter(f"knob {i}", float(rng.uniform(0.5, 2))) for i in range(free_parameters))
    return Fit(
        ParameterSet({}), every, rng.normal(size=free_parameters), [rng.normal(size=n) for n in rows],
        [rng.normal(size=(n, free_parameters)) for n in rows], WEIGHT,
    )  # fmt: skip


def stacked(at: Fit, windows: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """A matrix and a right side whose least squares are the change that fits some windows."""
    unit = np.sqrt(at.weight) * np.eye(len(at.free_parameters))
    matrix = np.vstack([*(at.slopes[i] for i in windows), unit])
    return matrix, -np.concatenate([*(at.residuals[i] for i in windows), unit @ at.scaled_offsets])


@given(st.integers(0, 10_000))
def test_the_equations_turn_the_knobs_as_least_squares_on_all_rows_do(seed):
    at = drawn(seed)
    everything = list(range(len(at.residuals)))
    matrix, right = stacked(at, everything)
    expected, *_ = np.linalg.lstsq(matrix, right)
    assert_allclose(at.equations.change(), expected, rtol=1e-9, atol=1e-9)
    left = matrix @ expected - right
    assert at.equations.values(expected).sum() == pytest.approx(left @ left)
    assert at.equations.values().sum() == pytest.approx(at.value)


@given(st.integers(0, 10_000), st.sets(st.integers(0, 4), min_size=1, max_size=4))
def test_what_is_left_out_is_judged_by_what_fits_the_rest(seed, group):
    at = drawn(seed)
    rest = [i for i in range(len(at.residuals)) if i not in group]
    change, *_ = np.linalg.lstsq(*stacked(at, rest))
    off = np.concatenate([at.residuals[i] + at.slopes[i] @ change for i in group])
    share = len(off) / sum(map(len, at.residuals))
    expected = off @ off + share * at.weight * np.sum((at.scaled_offsets + change) ** 2)
    assert at.equations.out_of_sample(sorted(group)) == pytest.approx(expected)


@given(st.integers(0, 10_000))
def test_a_signature_keeps_what_the_other_knobs_cannot_stand_in_for(seed):
    at = drawn(seed)
    *others, new = at.free_parameters
    rows = np.vstack(at.slopes)
    matrix = np.vstack([rows[:, :-1], np.sqrt(at.weight) * np.eye(len(others))])
    signature = np.append(rows[:, -1], np.zeros(len(others)))
    change, *_ = np.linalg.lstsq(matrix, signature)
    left = rows[:, -1] - rows[:, :-1] @ change
    assert at.equations.independent_share([new]) == pytest.approx(np.linalg.norm(left) / np.linalg.norm(rows[:, -1]))
    assert at.equations.only(range(len(others))).independent_share([new]) == 0.0
