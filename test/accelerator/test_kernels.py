"""The kernels' mocks beside mathematics in double precision, and their counted clocks."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from linear_systems import SPECIAL, mass_matrices, positive_definite, prototype, requests, tables
from vsense_ros.accelerator import float32
from vsense_ros.accelerator.kernels import BODY_MASS, KERNELS, SOLVE_14, SOLVE_42, SUSPENSION_MOTION
from vsense_ros.accelerator.kernels.suspension_motion import QUANTITIES

words = st.integers(0, 2**32 - 1)


@given(words, words)
def test_a_product_is_the_nearest_binary32_of_the_exact_one_or_zero_below_the_normal_numbers(a, b):
    x, y = float32.flushed(np.array([a, b], np.uint32).view(np.float32))
    found = float32.multiply(x, y)
    with np.errstate(all="ignore"):
        exact = np.float64(x) * np.float64(y)  # of 24 by 24 bits: exact in double precision
        nearest = np.float32(exact)
        scaled = np.float32(exact * 2.0**64)  # rounded to 24 bits, as if there were no smallest number
    if np.isnan(nearest):
        assert np.isnan(found)
    elif abs(scaled) < 2.0**-62:
        assert found == 0
        assert np.signbit(found) == np.signbit(exact)
    else:
        assert found == nearest


def test_a_product_just_below_the_normal_numbers_is_zero():
    assert float32.multiply(np.float32(2.0**-126), np.float32(1 - 2.0**-24)) == 0
    assert float32.divide(np.float32(2.0**-126), np.float32(1 + 2.0**-23)) == 0


def test_results_have_one_pattern_for_a_nan_and_no_subnormal_numbers():
    found = float32.canonical(SPECIAL.view(np.float32))
    assert set(found[np.isnan(SPECIAL.view(np.float32))]) == {0x7FC00000}
    assert not np.any((found & 0x7F800000 == 0) & (found & 0x007FFFFF != 0))


def test_a_mass_matrix_of_the_car_is_solved_to_rounding():
    a = mass_matrices(30, 1)
    b = np.random.default_rng(2).normal(0, 1000, (30, 14))
    system = np.concatenate([a, b[:, :, None]], axis=2).astype(np.float32)
    found, refused = SOLVE_14.run(system.view(np.uint32).reshape(30, -1))
    exact = np.linalg.solve(a, b[:, :, None])[:, :, 0]
    error = np.linalg.norm(found.view(np.float32) - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert not refused.any()
    assert error.max() < 1e-5


@pytest.mark.parametrize("kernel", [SOLVE_14, SOLVE_42], ids=lambda k: k.name)
def test_a_positive_definite_system_is_solved_as_well_as_by_elimination_in_binary32(kernel):
    n, random = kernel.size, np.random.default_rng(3)
    a = positive_definite(random, n, 40)
    b = random.standard_normal((40, n, 1))
    system = np.concatenate([a, b], axis=2).astype(np.float32)
    found, _ = kernel.run(system.view(np.uint32).reshape(40, -1))
    given = system.astype(float)
    exact = np.linalg.solve(given[:, :, :n], given[:, :, n:])[:, :, 0]
    usual = np.array([scipy.linalg.solve(s[:, :n], s[:, n], assume_a="pos") for s in system])  # float32 Cholesky
    assert usual.dtype == np.float32
    sizes = np.linalg.norm(exact, axis=1)
    ours = np.linalg.norm(found.view(np.float32) - exact, axis=1) / sizes
    theirs = np.linalg.norm(usual - exact, axis=1) / sizes
    assert np.median(ours / np.maximum(theirs, 1e-7)) < 3


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf, 1e-40, -0.0])
def test_a_pivot_that_is_no_positive_normal_number_makes_every_word_a_nan_and_is_told(bad):
    system = np.concatenate([np.eye(14), np.ones((14, 1))], axis=1).astype(np.float32)
    system[5, 5] = bad
    found, refused = SOLVE_14.run(system.view(np.uint32).reshape(1, -1))
    assert refused.all()
    assert np.all(found == 0x7FC00000)


def test_a_body_has_the_mass_matrix_that_its_kinetic_energy_tells():
    """T = 1/2 Σ m_i v_i² of eight points that move with the body."""
    random = np.random.default_rng(4)
    points, masses = random.normal(0, 0.5, (8, 3)), random.uniform(1, 5, 8)
    rotation = np.linalg.qr(random.standard_normal((3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    inertia = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))
    mass = masses.sum()
    centre = masses @ points / mass
    flat = [rotation.reshape(9), inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], centre, [mass]]
    found, _ = BODY_MASS.run(np.concatenate(flat).astype(np.float32).view(np.uint32))
    matrix = BODY_MASS.matrix(found.view(np.float32), mass)
    twist = random.standard_normal(6)
    velocities = twist[3:] + np.cross(twist[:3], points @ rotation.T)
    assert 0.5 * twist @ matrix @ twist == pytest.approx(0.5 * masses @ np.sum(velocities**2, axis=1), rel=1e-5)


def test_suspension_motion_is_that_of_the_tables_in_double_precision():
    suspension = prototype().suspension
    low, high = suspension.travel
    half = (high - low) / 2
    travel, steering, speed = np.array([0.02, -0.03, 0.01, 0.04]), 0.15, np.array([0.3, -0.2, 0.1, 0.5])
    sides = (1, -1, 1, -1)
    xi = (travel - (low + high) / 2) / half
    given = np.stack([xi, [steering / suspension.steering * s for s in sides], speed / half], axis=-1)
    found, _ = SUSPENSION_MOTION.run(given.astype(np.float32).reshape(12).view(np.uint32), tables())
    found = found.view(np.float32).reshape(4, 6, 4).astype(float)
    for i, side in enumerate(sides):
        exact = suspension.columns("front" if i < 2 else "rear", travel[i], side * steering)
        for j, name in enumerate(QUANTITIES):
            value, slope, curvature = exact[name]
            scale = np.abs(np.array(getattr(suspension.front if i < 2 else suspension.rear, name))).max() + 1e-6
            assert found[i, j, 0] == pytest.approx(value, abs=2e-6 * scale)
            assert found[i, j, 1] / half == pytest.approx(slope, abs=2e-5 * scale / half)
            assert 2 * found[i, j, 2] / half**2 == pytest.approx(curvature, abs=2e-4 * scale / half**2)
            assert found[i, j, 3] == pytest.approx(slope * speed[i], abs=1e-4 * scale)


def test_every_kernel_needs_fewer_clocks_than_that_of_the_thesis_by_far():
    assert SOLVE_14.cycles() <= 340
    assert SOLVE_14.cycles(P=15, DEEP=0) <= 225
    assert SOLVE_42.cycles() <= 2720
    assert BODY_MASS.cycles() <= 32
    assert SUSPENSION_MOTION.cycles() <= 160


def test_requests_of_every_kernel_give_as_many_words_as_they_should():
    for kernel in KERNELS.values():
        found, refused = kernel.run(requests(kernel, 5), tables() if kernel.table_words else None)
        assert found.shape == (5, kernel.words_out)
        assert refused.shape == (5,)
