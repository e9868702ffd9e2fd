"""Functions of C with loops over the corners, compiled and held against CasADi, which knows of none."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Hashable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.codegen import Corners, compiler
from vsense_ros.codegen.c99 import c_function
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.car import steps
from vsense_ros.model.car.car import car_of

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler here")


def a_car_like_function(order: tuple[int, ...]) -> tuple[ca.Function, Corners]:
    """Four corners at x with a parameter for each axle; what they do together, what each does to the one beside it, and
    results in an `order` of their own."""
    x, p, side = ca.SX.sym("x", 4), ca.SX.sym("p", 2), ca.SX.sym("side", 4)
    own = ca.vertcat(*(ca.sin(x[i]) * p[i // 2] + side[i] * x[i] for i in range(4)))
    beside = ca.vertcat(*(own[i] - 0.5 * own[i ^ 1] for i in range(4)))
    together = ca.sqrt(1 + ca.sumsqr(beside))
    after = ca.vertcat(*(ca.fmax(own[i], 0) / together + own[(i + 1) % 4] * 3 for i in range(4)))
    results = [ca.vertcat(*(after[i] for i in order)), together, ca.horzcat(beside, own).T]
    function = ca.Function("f", [x, p, side], results, ["x", "p", "side"], ["r0", "r1", "r2"])

    def alike(argument: str, element: int) -> tuple[Hashable, int | None]:
        return argument, element if argument == "x" else None

    return function, Corners(alike, {"side": (1.0, -1.0, 0.5, -2.0)})


def compiled(source: str, folder: Path) -> ctypes.CDLL:
    text = "#include <math.h>\n" + source.replace("static void f(", "void f(")
    (folder / "f.c").write_text(text)
    warnings = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    cc = compiler()
    assert cc is not None
    subprocess.run([cc, "-O2", *warnings, "-shared", "-fPIC", "f.c", "-o", "f.so", "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "f.so"))


@needs_compiler
@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (2, 0, 3, 1)])
def test_loops_over_the_corners_compute_what_casadi_does(order: tuple[int, ...], tmp_path: Path) -> None:
    function, corners = a_car_like_function(order)
    source = c_function(function, ["r0", "r1", "r2"], "f", corners)
    assert source.count("for (int c = 0; c < 4; c++)") == 1
    library = compiled(source, tmp_path)

    @given(st.lists(st.floats(-10, 10), min_size=4, max_size=4), st.lists(st.floats(-10, 10), min_size=2, max_size=2))
    def same(x: list[float], p: list[float]) -> None:
        arrays = [np.array(x), np.array(p), *(np.zeros(function.nnz_out(i)) for i in range(3))]
        library.f(*(array.ctypes.data_as(ctypes.c_void_p) for array in arrays))
        expected = function(x, p, list(corners.known["side"]))
        for mine, other in zip(arrays[2:], expected, strict=True):
            np.testing.assert_allclose(mine, np.asarray(other).ravel(order="F"), rtol=1e-12, atol=1e-12)

    same()


@pytest.mark.exam
def test_the_equations_of_a_corner_stand_in_the_export_once() -> None:
    car = car_of(load_vehicle(vehicle_path("prototype_model"))).corners_alike
    linearize = next(f for f in steps.functions_of(car) if f.name() == "linearize")
    results = [f"r{i}" for i in range(linearize.n_out())]
    looped = c_function(linearize, results, corners=steps.corners_of(car))
    straight = c_function(linearize, results)
    assert looped.count(";") < 0.5 * straight.count(";")
    assert "placement" not in looped


@needs_compiler
def test_products_of_few_rows_and_of_nothing_are_those_of_casadi(tmp_path: Path) -> None:
    """Products of one row and of three, begun with zeros and with numbers; and zeros that another function gets."""
    a, b, c = ca.MX.sym("a", 1, 5), ca.MX.sym("b", 5, 3), ca.MX.sym("c", 3, 3)
    x, y = ca.SX.sym("x", 1, 3), ca.SX.sym("y", 1, 3)
    around = ca.Function("around", [x, y], [2 * x + y, ca.SX(0, 1)])
    doubled = around(ca.mac(a, b, ca.MX.zeros(1, 3)), ca.MX.zeros(1, 3))[0]
    function = ca.Function("f", [a, b, c], [ca.mac(doubled, c, doubled), ca.mac(c, c, c)], ["a", "b", "c"], ["r", "s"])
    source = c_function(function, ["r", "s"], "f")
    assert source.count("double sum") == 3, "products are loops"
    library = compiled(source, tmp_path)
    given = [np.random.default_rng(1).normal(size=matrix.shape) for matrix in (a, b, c)]
    expected = [np.asarray(value) for value in function(*given)]
    arrays = [np.asfortranarray(value) for value in (*given, *map(np.zeros_like, expected))]
    library.f(*(array.ctypes.data_as(ctypes.c_void_p) for array in arrays))
    for mine, other in zip(arrays[3:], expected, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-12)
