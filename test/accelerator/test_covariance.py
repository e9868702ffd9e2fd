"""The covariance in the accelerator: what its kernel makes of it, beside NumPy in double precision and the hardware."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linear_systems import SPECIAL
from vsense_ros.accelerator.covariance import AcceleratedCovariance, Map
from vsense_ros.accelerator.kernels.row_combiner import Program, RowCombiner
from vsense_ros.accelerator.rtl import RowCombinerRtl, missing
from vsense_ros.errors import InputError


def covariance_of(n, random):
    """A covariance whose deviations differ by a factor of a hundred."""
    root = random.standard_normal((n, n + 3)) * 10 ** random.uniform(-1, 1, (n, 1))
    return root @ root.T / n


def map_of(n, random):
    """Some rows of a transition, of every kind: of many columns, of two, of none but their own."""
    rows = np.sort(random.choice(n, random.integers(1, n + 1), replace=False))
    matrix = np.eye(n)[rows] * random.uniform(0.5, 1.0, (len(rows), 1))
    kind = random.integers(0, 3, len(rows))
    for k, row in enumerate(rows):
        if kind[k] == 0:
            matrix[k] += random.normal(0, 0.3, n) * (random.random(n) < 0.6)
        elif kind[k] == 1 and row + 3 < n:
            matrix[k, row + 3] = 0.1
    return Map(rows, matrix)


def largest(found, expected, before=None):
    """The largest difference, in units of both standard deviations, or of those before a correction."""
    deviation = np.sqrt((expected if before is None else before).diagonal())
    return np.max(np.abs(found - expected) / np.outer(deviation, deviation))


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 64), st.integers(0, 2**32 - 1), st.sampled_from([8, 16]))
def test_a_step_and_a_correction_are_those_of_a_kalman_filter_and_symmetric_to_the_last_bit(n, seed, lanes):
    random = np.random.default_rng(seed)
    p = covariance_of(n, random).astype(np.float32).astype(float)
    kernel = AcceleratedCovariance(n, RowCombiner(lanes).run, lanes)
    kernel.load(p)
    maps, noise = [map_of(n, random) for _ in range(2)], random.uniform(0, 1, n)
    kernel.predict(maps, np.arange(n), np.arange(n), noise)
    for one in maps:
        f = np.eye(n)
        f[one.rows] = one.matrix
        p = f @ p @ f.T
    p += np.diag(noise)
    moved = kernel.read()
    assert np.array_equal(moved, moved.T)
    assert largest(moved, p) < 1e-4
    h = random.standard_normal((random.integers(1, 7), n)) * (random.random(n) < 0.5)
    total = kernel.project(h) @ h.T + np.eye(len(h))
    kernel.subtract(np.linalg.inv(np.linalg.cholesky(total)))
    corrected, textbook = kernel.read(), p - p @ h.T @ np.linalg.solve(h @ p @ h.T + np.eye(len(h)), h @ p)
    assert np.array_equal(corrected, corrected.T)
    assert largest(corrected, textbook, p) < 1e-4


def programs(n, lanes, random, count):
    """Programs of every instruction, with special numbers now and then, and what each asks for."""
    for k in range(count):
        program = Program(n, lanes)
        if k == 0:
            program.write(0, np.zeros((RowCombiner.ROWS, n)))
        numbers = random.standard_normal((5, n)).astype(np.float32)
        if random.random() < 0.5:
            numbers.view(np.uint32)[random.integers(5), random.integers(n)] = random.choice(SPECIAL)
        program.write(int(random.integers(0, n)), numbers)
        results, terms = int(random.integers(1, lanes + 1)), int(random.integers(1, 9))
        high = (n - 1) // lanes
        low = int(random.integers(0, high + 1))
        program.combine(
            int(random.integers(64, 112)), random.standard_normal((terms, results)), random.integers(0, 48, terms),
            slots=(low, int(random.integers(low, high + 1))), keep=random.random() < 0.5, own=random.random() < 0.5,
        )  # fmt: skip
        source, to, column = int(random.integers(0, 110)), int(random.integers(0, 50)), random.random() < 0.7
        program.move(source, source if column and source < 50 else to, 9, column=column and not 50 <= source < 64)
        program.subtract_outer(int(random.integers(64, 100)), int(random.integers(1, 7)))
        places = random.choice(n * n, min(n, 20), replace=False)
        program.add(places // n, places % n, random.standard_normal(len(places)))
        first = int(random.integers(0, 100))
        yield program, first, int(random.integers(0, 28))


@pytest.mark.parametrize("n", [1, 15, 16, 17, 55, 64])
def test_results_do_not_depend_on_how_many_lanes_there_are(n):
    """Sums are made in the same order, so that every bit is the same; only the clocks differ."""
    answers = []
    for lanes in (8, 16):
        random = np.random.default_rng(n)
        kernel = AcceleratedCovariance(n, RowCombiner(lanes).run, lanes)
        kernel.load(covariance_of(n, random))
        kernel.predict([map_of(n, random), map_of(n, random)], [0], [0], [1.0])
        kernel.project(random.standard_normal((3, n)))
        kernel.subtract(np.tril(random.normal(0, 0.01, (3, 3))))
        answers.append(kernel.read())
    assert np.array_equal(*answers)


def test_a_request_without_an_end_or_of_no_columns_is_refused():
    with pytest.raises(InputError, match="no end"):
        RowCombiner().run(np.concatenate(Program(4).words))
    for columns in (0, 65):
        with pytest.raises(InputError, match="1 to 64 rows"):
            Program(columns)


@pytest.mark.exam
@pytest.mark.skipif(bool(missing()), reason=f"needs {', '.join(missing())}: make hw-tools")
@pytest.mark.parametrize("lanes", [8, 16])
def test_the_hardware_gives_the_bits_and_the_clocks_of_the_mock(lanes):
    random = np.random.default_rng(lanes)
    rtl, mock = RowCombinerRtl(lanes), RowCombiner(lanes)
    for n in (1, 7, 16, 33, 55, 64):
        for program, first, count in programs(n, lanes, random, 60):
            words = program.end(first, count)
            computed, expected = rtl.run(words, program.words_out), mock.run(words)
            assert computed[-1] == expected[-1], "clocks"
            wrong = np.flatnonzero(canonical(computed) != canonical(expected))
            assert not wrong.size, (n, wrong[:5], computed[wrong[:5]], expected[wrong[:5]])


@pytest.mark.exam
@pytest.mark.skipif(bool(missing()), reason=f"needs {', '.join(missing())}: make hw-tools")
def test_after_a_reset_of_one_clock_at_any_time_the_next_program_is_right():
    random = np.random.default_rng(3)
    rtl, n = RowCombinerRtl(16), 20
    for program, *_ in programs(n, 16, random, 60):
        cut = program.end(0, 3)
        rtl.cut(cut, int(random.integers(1, 2 * cut.size)))
        fresh, mock = Program(n), RowCombiner()
        fresh.write(0, random.standard_normal((RowCombiner.ROWS, n)))  # what was cut may have written some of it
        fresh.combine(64, random.standard_normal((3, 5)), random.integers(0, n, 3))
        fresh.subtract_outer(70, 4)
        words = fresh.end(0, 70)
        assert np.array_equal(rtl.run(words, fresh.words_out), mock.run(words))


def canonical(words):
    """Every NaN with one pattern: what is moved keeps its own."""
    return np.where(np.isnan(words.view(np.float32)), np.uint32(0x7FC00000), words)
