"""What C says for the operations of CasADi: on numbers, and on the vectors of simd.c."""

from __future__ import annotations

import math

import casadi as ca

_LIBRARY = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log")
_ARITHMETIC = {
    ca.OP_ASSIGN: "{0}", ca.OP_NEG: "-{0}", ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}", ca.OP_INV: "1 / {0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "{0} + {0}",
}  # fmt: skip
SCALAR = _ARITHMETIC | {
    ca.OP_FABS: "fabs({0})", ca.OP_SIGN: "(double)(({0} > 0) - ({0} < 0))", ca.OP_FMIN: "{0} < {1} ? {0} : {1}",
    ca.OP_FMAX: "{0} > {1} ? {0} : {1}", ca.OP_LT: "{0} < {1}", ca.OP_LE: "{0} <= {1}", ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}", ca.OP_NOT: "!{0}", ca.OP_AND: "{0} && {1}", ca.OP_OR: "{0} || {1}",
    ca.OP_IF_ELSE_ZERO: "{0} != 0 ? {1} : 0",
    **{getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}})" for name in _LIBRARY},
    ca.OP_ATAN2: "atan2({0}, {1})", ca.OP_POW: "pow({0}, {1})", ca.OP_CONSTPOW: "pow({0}, {1})",
}  # fmt: skip
VECTOR = _ARITHMETIC | {
    ca.OP_FABS: "size_of({0})", ca.OP_SIGN: "sign_of({0})", ca.OP_FMIN: "smaller({0}, {1})",
    ca.OP_FMAX: "greater({0}, {1})", ca.OP_LT: "one_where({0} < {1})", ca.OP_LE: "one_where({0} <= {1})",
    ca.OP_EQ: "one_where({0} == {1})", ca.OP_NE: "one_where({0} != {1})", ca.OP_NOT: "one_where({0} == 0)",
    ca.OP_AND: "one_where(({0} != 0) & ({1} != 0))", ca.OP_OR: "one_where(({0} != 0) | ({1} != 0))",
    ca.OP_IF_ELSE_ZERO: "zero_unless({0} != 0, {1})",
    **{getattr(ca, f"OP_{name.upper()}"): f"lanes_{name}({{0}})" for name in _LIBRARY},
    ca.OP_ATAN2: "lanes_atan2({0}, {1})", ca.OP_POW: "lanes_pow({0}, {1})", ca.OP_CONSTPOW: "lanes_pow({0}, {1})",
}  # fmt: skip


def number(value: float) -> str:
    """A number as C reads it back, to the last bit."""
    if math.isnan(value):
        return "(double)NAN"
    return repr(float(value)) if math.isfinite(value) else f"{'-' if value < 0 else ''}(double)INFINITY"


def zeros(count: int) -> str:
    """That many zeros, where C wants to know where they are."""
    return f"(const double[{max(count, 1)}]){{0}}"
