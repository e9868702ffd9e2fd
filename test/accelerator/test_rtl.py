"""The hardware's sources give the bits of the mocks, clock for clock as counted. `make hw` does it with 10,000 each."""

import numpy as np
import pytest

from linear_systems import SPECIAL, requests, tables
from vsense_ros.accelerator.kernels import KERNELS, SOLVE_14
from vsense_ros.accelerator.rtl import Rtl, missing

pytestmark = [
    pytest.mark.exam,
    pytest.mark.skipif(bool(missing()), reason=f"needs {', '.join(missing())}: make hw-tools"),
]

# The others are built and compared by `make hw`: a minute of compiling.
CASES = [("solve14", {}, 600), ("body_mass", {}, 2000)]


@pytest.mark.parametrize(("name", "parameters", "count"), CASES)
def test_hardware_and_mock_give_the_same_bits_in_the_counted_clocks(name, parameters, count):
    kernel = KERNELS[name]
    given, table = requests(kernel, count, seed=11), tables() if kernel.table_words else None
    rtl = Rtl(kernel, **parameters)
    if table is not None:
        rtl.set_table(table)
    found, refused, cycles = rtl.run(given)
    expected, expected_refused = kernel.run(given, table)
    assert np.array_equal(refused, expected_refused)
    assert np.array_equal(found, expected)
    assert set(cycles.tolist()) == {kernel.cycles(**parameters)}


def test_every_special_number_in_every_place_of_a_system_gives_the_same_bits():
    rng = np.random.default_rng(12)
    base = requests(SOLVE_14, len(SPECIAL) * 30, seed=13, specials=0.0)
    places = rng.integers(0, 210, len(base))
    places[::3] = (np.arange(len(places[::3])) % 14) * 16  # pivots
    base[np.arange(len(base)), places] = np.tile(SPECIAL, 30)
    rtl = Rtl(SOLVE_14)
    found, refused, _ = rtl.run(base)
    expected, expected_refused = SOLVE_14.run(base)
    assert np.array_equal(found, expected)
    assert np.array_equal(refused, expected_refused)


@pytest.mark.parametrize("zero", [0x80000000, 0, 0x80000001, 1], ids=["-0", "+0", "-subnormal", "+subnormal"])
def test_zeros_of_sparse_systems_have_the_same_signs(zero):
    random = np.random.default_rng(14)
    matrices = [np.eye(14), np.diag(random.uniform(0.1, 9, 14)), np.kron(np.eye(7), [[2, 0.5], [0.5, 3]])]
    matrices += [np.kron(np.eye(7), [[2, -0.5], [-0.5, 3]]), np.tril(np.ones((14, 14))), np.triu(np.ones((14, 14)))]
    given = []
    for matrix in matrices:
        for _ in range(20):
            right = random.choice([-1.0, 1.0], 14).astype(np.float32).view(np.uint32)
            right[random.random(14) < 0.5] = zero
            left = matrix.astype(np.float32).view(np.uint32)
            left[(matrix == 0) & (random.random((14, 14)) < 0.5)] = zero
            given.append(np.concatenate([left, right[:, None]], axis=1).reshape(-1))
    given = np.array(given)
    found, refused, _ = Rtl(SOLVE_14).run(given)
    expected, expected_refused = SOLVE_14.run(given)
    assert np.array_equal(found, expected)
    assert np.array_equal(refused, expected_refused)
