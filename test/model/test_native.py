"""Native code: what CasADi computes, whatever is put into vectors, cut into parts or multiplied in loops."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from test_simd import every_operation
from vsense_ros import codegen
from vsense_ros.codegen import native
from vsense_ros.codegen.instructions import multiplies
from vsense_ros.codegen.side_by_side import packed
from vsense_ros.codegen.values import values_of

pytestmark = pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE other than 0")

A, B, C = (ca.MX.sym(name, rows, columns) for name, rows, columns in (("a", 6, 6), ("b", 6, 3), ("c", 6, 1)))


def built(function: ca.Function, corners: codegen.Corners | None = None) -> ca.Function:
    text = codegen.native_source([function], corners)
    made = codegen.loaded("native", lambda: text, [function.name()], text)  # each text is a library of its own
    assert made is not None
    return made[0]


def row_is_corner(argument: str, element: int) -> tuple[str, int | None]:
    return (argument, element) if argument == "known" else (argument, element % 4)


ROWS = codegen.Corners(row_is_corner, {"known": [1.0, -1.0, 1.0, 0.0]})


def of_corners(same: bool) -> ca.Function:
    """(x (4), y (4), known (4)) → what each corner makes of its row, their sum, and the sum times each row. The last
    corner's equation is another if they are not all the `same`."""
    x, y, known = (ca.SX.sym(name, 4) for name in ("x", "y", "known"))
    rows = [ca.sin(known[i] * x[i]) * ca.sqrt(1 + y[i] ** 2) + ca.fmax(x[i], y[i]) for i in range(4)]
    if not same:
        rows[3] = ca.if_else(x[3] < y[3], ca.exp(x[3]), x[3] / y[3])
    total = rows[0] + rows[1] + rows[2] + rows[3]
    results = [ca.vertcat(*rows), total, ca.vertcat(*(total * x[i] + y[i ^ 1] for i in range(4)))]
    return ca.Function("corners", [x, y, known], results, ["x", "y", "known"], ["r0", "r1", "r2"])


def test_every_operation_gives_what_casadi_makes_of_it():
    function = every_operation()
    made = built(function)
    for x in np.random.default_rng(0).uniform(-3, 3, (50, 4)):
        assert_allclose(np.array(made(x)), np.array(function(x)), rtol=1e-12, atol=1e-13)


def test_every_operation_gives_the_same_at_each_of_four_corners():
    single = every_operation()
    argument = ca.SX.sym("x", 16)
    rows = [single(argument[i::4]) for i in range(4)]
    function = ca.Function("every", [argument], [ca.horzcat(*rows)], ["x"], ["r"])
    made = built(function, codegen.Corners(lambda _, element: (element // 4, element % 4)))
    for values in np.random.default_rng(1).uniform(-3, 3, (50, 4, 4)):
        expected = np.hstack([np.array(single(column)) for column in values.T])
        assert_allclose(np.array(made(values.ravel())), expected, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("same", [True, False])
@pytest.mark.parametrize("part", [1, 3, 1000])
def test_corners_side_by_side_have_what_each_has_alone(monkeypatch, same, part):
    monkeypatch.setattr(native, "PART", part)
    function = of_corners(same)
    made = built(function, ROWS)
    for x, y in np.random.default_rng(2).uniform(-2, 2, (20, 2, 4)):
        for found, expected in zip(made(x, y), function(x, y, ROWS.known["known"]), strict=True):
            assert_allclose(np.array(found), np.array(expected), rtol=1e-13, atol=1e-14)


def share_in_vectors(function: ca.Function) -> float:
    """Share of the values of a function that are computed in vectors."""
    values = values_of(function, {2: ROWS.known["known"]})
    names = [function.name_in(i) for i in range(function.n_in())]
    return len(packed(values, names, row_is_corner).lanes) / sum(map(values.computed, range(len(values.operations))))


def test_corners_that_are_alike_share_their_operations():
    assert share_in_vectors(of_corners(True)) > 0.6
    assert share_in_vectors(of_corners(False)) < 0.3


def test_corners_that_need_each_other_in_turn_are_computed_in_turn():
    x = ca.SX.sym("x", 4)
    values = [ca.sin(x[0])]
    for i in range(1, 4):
        values.append(ca.sin(x[i]) + values[-1])
    function = ca.Function("chain", [x], [ca.vertcat(*values)], ["x"], ["r"])
    made = built(function, codegen.Corners(row_is_corner))
    assert_allclose(np.array(made([0.1, 0.2, 0.3, 0.4])), np.array(function([0.1, 0.2, 0.3, 0.4])), rtol=1e-15)


def test_matrices_are_multiplied_whether_the_right_one_is_dense_or_sparse():
    s = ca.SX.sym("s", 6, 3)
    sparse = ca.Function("sparse", [s], [ca.SX(ca.Sparsity.upper(3), s[:6]), 2 * s], ["s"], ["upper", "twice"])
    upper, twice = sparse(B)
    results = [ca.mac(A, B, ca.MX.zeros(6, 3)), ca.mac(twice, upper, ca.MX.zeros(6, 3)), ca.mac(A, C, C)]
    function = ca.Function("products", [A, B, C], results, ["a", "b", "c"], ["r0", "r1", "r2"])
    assert multiplies(function, native.CORNERS)
    generator = np.random.default_rng(3)
    arguments = [generator.normal(size=shape) for shape in ((6, 6), (6, 3), (6, 1))]
    for found, expected in zip(built(function)(*arguments), function(*arguments), strict=True):
        assert_allclose(np.array(found), np.array(expected), rtol=1e-13, atol=1e-14)


def test_functions_with_one_name_are_told_apart():
    x, z = ca.SX.sym("x", 4), ca.MX.sym("z", 4)
    one, other = (ca.Function("inner", [x], [factor * x], ["x"], ["r"]) for factor in (2.0, 3.0))
    function = ca.Function("outer", [z], [one(z), other(z)], ["z"], ["r0", "r1"])
    first, second = built(function)([1.0, 2.0, 3.0, 4.0])
    assert_allclose(np.array(second), 1.5 * np.array(first))


def test_results_that_are_not_wanted_and_arguments_that_are_zero_may_be_left_out():
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 2)
    made = built(ca.Function("two", [x, y], [x + y, x - y], ["x", "y"], ["sum", "difference"]))
    buffer, call = made.buffer()
    argument, result = np.array([1.0, 2.0]), np.zeros(2)
    buffer.set_arg(0, memoryview(argument))
    buffer.set_res(1, memoryview(result))
    call()
    assert_allclose(result, [1.0, 2.0])


def test_what_has_no_counterpart_is_left_to_casadi():
    x = ca.SX.sym("x")
    assert not native.can_write(ca.Function("rounded", [x], [ca.floor(x)]))
    m, v = ca.MX.sym("m", 4, 4), ca.MX.sym("v", 4)
    assert not native.can_write(ca.Function("solve", [m, v], [ca.solve(m, v, "qr")]))


def test_matrices_of_zeros_are_results_parts_and_factors_like_any_other():
    inner = ca.Function("inner", [A], [2 * A[:, 0]])
    nothing = ca.MX.zeros(6, 3)
    parts = ca.horzsplit(ca.densify(nothing), [0, 1, 3])
    function = ca.Function(
        "nothing", [A, B], [inner(A), ca.densify(nothing), ca.densify(parts[1]), A @ B], {"cse": True}
    )
    a, b = np.arange(36.0).reshape(6, 6), np.arange(18.0).reshape(6, 3)
    for found, expected in zip(
        built(function)(a, b), (2 * a[:, :1], np.zeros((6, 3)), np.zeros((6, 2)), a @ b), strict=True
    ):
        assert_allclose(np.array(found), expected)
