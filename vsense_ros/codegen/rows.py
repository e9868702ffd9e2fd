"""A CasADi function of many rows of numbers, as many side by side as the processor's vectors hold."""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Sequence
from importlib import resources

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen import simd
from vsense_ros.codegen.columns import Doubles, pointer
from vsense_ros.codegen.compile import compiler, identity_of, library, vector_math

Array = NDArray[np.float64]


class OfRows:
    """The first result (n,) of a function of straight code on scalars, for each row of its arguments."""

    def __init__(self, function: ca.Function, constant: Collection[str] = ()) -> None:
        """The arguments with the names of `constant` are the same in all rows."""
        names = [function.name_in(i) for i in range(function.n_in())]
        self._constant = [name in constant for name in names]
        self._result = function.numel_out(0)
        arguments = [ca.SX.sym(name, *function.size_in(i)) for i, name in enumerate(names)]
        of_lanes = ca.Function("of_lanes", arguments, [ca.densify(function(*arguments))], {"cse": True})
        self._function, self._library = of_lanes, self._compiled(of_lanes)

    def _compiled(self, of_lanes: ca.Function) -> ctypes.CDLL | None:
        if compiler() is None:
            return None
        sizes = [of_lanes.numel_in(i) for i in range(of_lanes.n_in())]
        steps = [0 if constant else size for size, constant in zip(sizes, self._constant, strict=True)]
        constants = {
            "ARGUMENTS": len(sizes), "SIZES": ", ".join(map(str, sizes)), "STEPS": ", ".join(map(str, steps)),
            "ALL_SIZES": sum(sizes), "RESULTS": self._result,
        }  # fmt: skip
        defined = "\n".join(f"#define {name} {value}" for name, value in constants.items())
        loop = resources.files("vsense_ros.codegen").joinpath("rows.c").read_text(encoding="utf-8")
        code = f"{defined}\n{loop}"
        built = library(
            "of_rows", lambda: f"{simd.source([of_lanes])}\n{code}", vector_math(),
            identity=f"{identity_of([of_lanes])}\n{code}",
        )  # fmt: skip
        if built is None:
            return None
        loaded = ctypes.CDLL(str(built))
        loaded.of_rows.restype = None
        return loaded

    def __call__(self, *arguments: Array) -> Array:
        """(rows, n): arguments are (rows, size), those that are constant (size,)."""
        varying = (values for values, constant in zip(arguments, self._constant, strict=True) if not constant)
        rows = len(next(varying))
        if self._library is None:
            return self._plain(rows, arguments)
        result = np.empty((rows, self._result))
        dense = [np.ascontiguousarray(values, dtype=float) for values in arguments]
        self._library.of_rows(ctypes.c_longlong(rows), (Doubles * len(dense))(*map(pointer, dense)), pointer(result))
        return result

    def _plain(self, rows: int, arguments: Sequence[Array]) -> Array:
        """What `__call__` gives, without a compiler: (rows, n)."""
        columns = [np.broadcast_to(values, (rows, np.shape(values)[-1])).T for values in arguments]
        return np.array(self._function.map(rows)(*columns)).T
