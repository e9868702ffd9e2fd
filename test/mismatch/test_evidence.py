"""The evidence of sets of effects, against the exact density of linear models and against all sets of a small one."""

import itertools

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from vsense_ros.mismatch.evidence import EvidenceSettings, Products, SetEvidence, Size

ROWS, UNKNOWNS, LITTLE, ODDS = 40, 7, 0.1, 0.2
# So sure is the expectation of variance one that it is known; every row is an independent sample.
KNOWN_VARIANCE = EvidenceSettings(samples=1.0, expected=1e10, odds=ODDS)
TRUTH = np.array([0.4, 0.0, 0.9, 0.0, 0.0, -1.1, 0.0])


@pytest.fixture
def blocks():
    """Slopes and residuals of two windows with one signal each, in which three unknowns are not zero."""
    rng = np.random.default_rng(3)
    slopes = [rng.normal(size=(ROWS, UNKNOWNS)) for _ in range(2)]
    return slopes, [rng.normal(size=ROWS) - s @ TRUTH for s in slopes]


def sizes(joins=True):
    """The sizes that may be in a set: all unknowns but the first, which is a base parameter."""
    return [Size(i, f"effect {i}", f"size {i}", -9.0, 9.0, LITTLE, joins) for i in range(1, UNKNOWNS)]


def evidence_of(blocks, settings=KNOWN_VARIANCE, of=None):
    slopes, residuals = blocks
    products = Products.of(residuals, slopes, [1, 1], [float(ROWS)] * 2)
    return SetEvidence(products, np.zeros(UNKNOWNS), of or sizes(), settings)


def every_set():
    return [frozenset(c) for count in range(UNKNOWNS) for c in itertools.combinations(range(UNKNOWNS - 1), count)]


def exact(blocks, chosen):
    """Logarithm of the density of all residuals, with unknowns integrated out, and of the prior odds."""
    slopes, residuals = (np.concatenate(parts) for parts in blocks)
    deviations = np.array([1.0, *(1.0 if i in chosen else LITTLE for i in range(UNKNOWNS - 1))])
    covariance = np.eye(len(residuals)) + (slopes * deviations**2) @ slopes.T
    return multivariate_normal.logpdf(residuals, np.zeros(len(residuals)), covariance) + len(chosen) * np.log(
        ODDS / (1 - ODDS)
    )


def test_with_known_variances_evidence_is_the_exact_density_of_the_residuals(blocks):
    evidence = evidence_of(blocks)
    offsets = [evidence.of(chosen).evidence - exact(blocks, chosen) for chosen in every_set()]
    assert np.ptp(offsets) < 1e-3


def test_the_search_finds_the_best_of_all_sets(blocks):
    assert evidence_of(blocks).search() == max(every_set(), key=lambda chosen: exact(blocks, chosen)) == {1, 4}


def test_the_search_finds_two_sizes_that_hide_each_other():
    rng = np.random.default_rng(5)
    first = rng.normal(size=ROWS)
    slopes = np.column_stack([rng.normal(size=ROWS), first, first + 0.1 * rng.normal(size=ROWS)] + [
        rng.normal(size=ROWS) for _ in range(UNKNOWNS - 3)])  # fmt: skip
    blocks = [slopes] * 2, [20 * (slopes[:, 2] - slopes[:, 1]) + 0.1 * rng.normal(size=ROWS)] * 2
    found = evidence_of(blocks)
    assert found.search() == {0, 1}
    assert found.of(frozenset({0})).evidence < found.of(frozenset()).evidence + 3


def test_neighbours_are_ordered_by_their_exact_evidence_where_variances_are_known(blocks):
    around = evidence_of(blocks).neighbours(frozenset({1}))
    exactly = [exact(blocks, chosen) for chosen in around]
    np.testing.assert_allclose(exactly, sorted(exactly, reverse=True))


def test_a_block_that_nothing_explains_does_not_decide():
    slopes = [np.zeros((ROWS, UNKNOWNS)) for _ in range(2)]
    slopes[0][:, 2] = slopes[1][:, 3] = 1.0
    rng = np.random.default_rng(1)
    small, huge = 2.0 + 0.1 * rng.normal(size=ROWS), 100 * rng.normal(size=ROWS)
    found = evidence_of((slopes, [small, huge]), EvidenceSettings(samples=0.5, expected=0.5))
    assert found.search() == {1}


def test_probabilities_are_shares_of_the_sets_that_have_an_effect(blocks):
    found = evidence_of(blocks)
    for chosen in every_set():
        found.of(chosen)
    weights = np.exp([exact(blocks, chosen) for chosen in every_set()])
    having = np.array([1 in chosen for chosen in every_set()])
    assert found.probabilities()["effect 2"] == pytest.approx(weights[having].sum() / weights.sum(), abs=1e-3)


def with_profile():
    """The first four sizes, and one that has the first unknown with the last two along a road."""
    return [*sizes()[:4], Size(1, "effect 1", "size 1", -9.0, 9.0, LITTLE, along=(5, 6))]


def exact_with_profile(blocks, chosen):
    slopes, residuals = (np.concatenate(parts) for parts in blocks)
    large = {i + 1 for i in chosen if i < 4} | ({1, 5, 6} if 4 in chosen else set())
    deviations = np.array([1.0, *(1.0 if i in large else LITTLE for i in range(1, UNKNOWNS))])
    covariance = np.eye(len(residuals)) + (slopes * deviations**2) @ slopes.T
    odds = len(chosen) * np.log(ODDS / (1 - ODDS)) + (4 in chosen) * np.log(KNOWN_VARIANCE.doubtful)
    return multivariate_normal.logpdf(residuals, np.zeros(len(residuals)), covariance) + odds


@pytest.mark.parametrize("begin", [frozenset(), frozenset({1}), frozenset({1, 4})])
def test_what_a_profile_along_the_road_promises_is_its_exact_evidence(blocks, begin):
    found = evidence_of(blocks, of=with_profile())
    around = found.neighbours(begin)
    assert any(4 in chosen ^ begin for chosen in around)
    assert not any({0, 4} <= chosen for chosen in around)  # one size for all of the road, or one for every place
    exactly = [exact_with_profile(blocks, chosen) for chosen in around]
    np.testing.assert_allclose(exactly, sorted(exactly, reverse=True))
    offsets = [found.of(chosen).evidence - exact_with_profile(blocks, chosen) for chosen in around]
    assert np.ptp(offsets) < 1e-3


def test_a_profile_has_a_plane_in_it(blocks):
    plane = Size(2, "effect 2", "size 2", -9.0, 9.0, LITTLE, plane=True)
    found = evidence_of(blocks, of=[plane, with_profile()[-1]])
    assert frozenset({0, 1}) not in found.neighbours(frozenset({1}))


def test_a_set_has_no_size_out_of_its_bounds(blocks):
    bounded = [*sizes()[:1], Size(2, "effect 2", "size 2", -9.0, 0.0, LITTLE), *sizes()[2:]]
    assert evidence_of(blocks, of=bounded).search() == {4}


def test_a_set_has_one_place_of_an_effect_whose_places_do_not_join(blocks):
    one_effect = [Size(i, "radius", f"wheel {i}", -9.0, 9.0, LITTLE, False) for i in range(1, UNKNOWNS)]
    assert evidence_of(blocks, of=one_effect).search() == {4}


def test_products_are_those_of_each_signal_of_each_window():
    rng = np.random.default_rng(2)
    slopes, residuals = rng.normal(size=(6, 2)).astype(np.float32), rng.normal(size=6)
    products = Products.of([residuals, np.zeros(0)], [slopes, np.zeros((0, 2))], [2, 1], [5.0, 9.0])
    np.testing.assert_allclose(products.normal[1], slopes[3:].T @ slopes[3:], rtol=1e-5)
    np.testing.assert_allclose(products.right[0], slopes[:3].T @ residuals[:3], rtol=1e-5)
    assert products.rows.tolist() == [3, 3]
    assert products.durations.tolist() == [5.0, 5.0]
