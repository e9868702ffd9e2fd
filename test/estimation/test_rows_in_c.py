"""Linear combinations of rows in C, for every width of vectors that this processor has, against NumPy."""

from __future__ import annotations

import ctypes
import platform
from importlib import resources

import numpy as np
import pytest

from vsense_ros import codegen

_CALL = """
void combined(int rows, int width, double *out, int stride, int count, const double *factor, const double *terms) {
    const double *term[64];
    for (int k = 0; k < count; k++) term[k] = terms + k * width;
    combine_rows(rows, width, out, stride, count, factor, 1, rows, term);
}
double multiplied(const double *a, const double *b) { return dot(STATES, a, b); }
double corrected(struct innovation *found, double *p, double *error) { return update(found, p, error, 1, 1e9); }
void combined_row(double *out, const double *factor, const double *const *row) { combine(STATES, out, 1, factor, row); }
"""
_WITHOUT = ((), ("-mno-avx512f",), ("-mno-avx",)) if platform.machine() == "x86_64" else ((),)


@pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")
@pytest.mark.parametrize("flags", _WITHOUT, ids=" ".join)
@pytest.mark.parametrize("size", [1, 3, 7, 9, 13, 52, 61])
def test_sums_of_rows_are_matrix_products(size: int, flags: tuple[str, ...]) -> None:
    algebra = resources.files("vsense_ros").joinpath("estimation/algebra.c").read_text(encoding="utf-8")
    path = codegen.library("rows", f"#define STATES {size}\n{algebra}{_CALL}", flags)
    assert path is not None
    library, random = ctypes.CDLL(str(path)), np.random.default_rng(size)
    for rows in (1, 2, 3, 5, 14):
        for count in (0, 1, 6):
            out, factor = random.normal(size=(rows, size + 2)), random.normal(size=(count, rows))
            terms = random.normal(size=(count, size))
            expected = out.copy()
            expected[:, :size] += factor.T @ terms
            addresses = [ctypes.c_void_p(array.ctypes.data) for array in (out, factor, terms)]
            library.combined(rows, size, addresses[0], size + 2, count, *addresses[1:])
            np.testing.assert_allclose(out, expected, rtol=0, atol=1e-13)
            assert np.array_equal(out[:, size:], expected[:, size:]), "nothing behind the rows is touched"
