"""From CasADi expressions to something that runs fast: the virtual machine, or compiled C as a cache.

Without a C compiler everything runs on CasADi's virtual machine. With one, functions are compiled on first use into
the user's cache folder, under a name made from their expressions; a failed build is reported once and never fatal.
Set `VSENSE_COMPILE=0` to stay on the virtual machine.
"""

from __future__ import annotations

import ctypes
import logging
import os
import platform
import shutil
import subprocess
from collections.abc import Callable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import TypeVar
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.cache import digest_of, kept
from vsense_ros.codegen import native

# Below -O2 GCC leaves the upper halves of vector registers dirty, after which the functions of libm run at a quarter of
# their speed on some processors.
FLAGS = ("-O3", "-march=native", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math")
log = logging.getLogger(__name__)

Expression = TypeVar("Expression", ca.SX, ca.MX)

_libraries: WeakKeyDictionary[ca.Function, Path] = WeakKeyDictionary()  # where functions are that were compiled
_broken: set[str] = set()  # compilers that failed in this process: reported once, not tried again


def compiler() -> str | None:
    """The C compiler to use, or None: `$CC`, else cc, gcc or clang on the path; none with `VSENSE_COMPILE=0`."""
    if os.environ.get("VSENSE_COMPILE", "1") == "0":
        return None
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        if name and (path := shutil.which(name)):
            return path
    return None


def library(
    name: str, source: str | Callable[[], str], flags: Sequence[str] = (), *, identity: str = ""
) -> Path | None:
    """C source compiled into a shared library in the cache, with more `flags`, or None where that is impossible.

    Where writing the source takes long, `source` is the function that writes it: it is called only if the cache has
    nothing that this version of the project has written with this `identity`, which must differ wherever what is
    written does.
    """
    cc = compiler()
    if cc is None or cc in _broken:
        return None

    def make(folder: Path) -> Path:
        text = source if isinstance(source, str) else source()
        (folder / "source.c").write_text(text, encoding="utf-8")
        command = [cc, *FLAGS, "source.c", "-o", "library.so", *flags, "-lm"]
        subprocess.run(command, cwd=folder, check=True, capture_output=True, timeout=600)
        return folder / "library.so"

    try:
        content = (source,) if isinstance(source, str) else (identity, ca.CasadiMeta.version(), _generator())
        return kept(name, (cc, *FLAGS, *flags, _processor(), *content), make)
    except (OSError, subprocess.SubprocessError) as error:
        _broken.add(cc)
        log.warning("compiling %s failed, continuing without compiled code: %s%s", name, error, _said(error))
        return None


def _generator() -> str:
    """What has the form of the C that is written: the code of this package."""
    return digest_of(Path(__file__).parent)


def _said(error: Exception) -> str:
    """The first line of what the compiler reported."""
    output = getattr(error, "stderr", None) or b""
    lines = output.decode(errors="replace").strip().splitlines()
    return f" ({lines[0]})" if lines else ""


def _processor() -> str:
    """What the machine code is made for: a cache that is shared between machines must not be mixed up."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line for line in lines if line.startswith(("flags", "Features")))
    except (OSError, StopIteration):
        return platform.machine()


def expanded(function: ca.Function) -> ca.Function:
    """A function as straight code on scalars, with common subexpressions computed once."""
    return function if function.is_a("SXFunction", False) else function.expand(function.name(), {"cse": True})


def compiled(name: str, functions: Sequence[ca.Function]) -> list[ca.Function]:
    """Functions compiled together into one library where that is possible, else as they are."""
    if compiler() is None:
        return list(functions)

    def source() -> str:
        own_functions: list[ca.Function] = []
        casadi_code = ca.CodeGenerator("others.c", {"with_header": False})
        for function in functions:
            (own_functions.append if native.can_write(function) else casadi_code.add)(function)
        return native.source(own_functions) + (casadi_code.dump() if len(own_functions) < len(functions) else "")

    names = [function.name() for function in functions]
    return loaded(name, source, names, identity_of(functions)) or list(functions)


def identity_of(functions: Sequence[ca.Function]) -> str:
    """A text that differs wherever functions do: expressions are compared as CasADi serialises them, which takes a
    hundredth of the time of writing them as C."""
    parts = [f"{function.name()} {function.serialize()}" for function in functions]
    return sha256("\n".join(parts).encode()).hexdigest()


def vector_math() -> tuple[str, ...]:
    """Flags with which simd.c uses sine and the like for vectors: glibc on x86 has them."""
    present = platform.machine() == "x86_64" and platform.libc_ver()[0] == "glibc"
    return ("-DVECTOR_MATH", "-lmvec") if present else ()


def loaded(name: str, source: Callable[[], str], names: Sequence[str], identity: str) -> list[ca.Function] | None:
    """Functions with these names, which `source` writes as C if the cache has none with this `identity`; None where
    that is impossible."""
    built = library(name, source, vector_math(), identity=identity)
    if built is None:
        return None
    try:
        external_functions = [ca.external(function, str(built)) for function in names]
    except RuntimeError as error:  # a cache on a file system from which nothing may be executed, or a damaged file
        log.warning("%s cannot be loaded, continuing without compiled code: %s", built, str(error).splitlines()[-1])
        return None
    _libraries.update(dict.fromkeys(external_functions, built))
    return external_functions


class Entry(ctypes.Structure):
    """A compiled function with its arguments, results and working memory, for C: `struct kernel` of kernel.c."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("function", "arguments", "results", "integers", "numbers")]


class Kernel:
    """A CasADi function bound to fixed arrays: calling it reads its arguments and writes its results in place.

    A bound call costs under a microsecond beyond the arithmetic, an ordinary CasADi call some seventy. Results are
    arrays `results[i]` of the output's shape in column-major order; structural zeros are filled in. They stand one
    after the other in `memory`, if that is given.
    """

    def __init__(
        self,
        function: ca.Function,
        arguments: Sequence[NDArray[np.float64]],
        memory: NDArray[np.float64] | None = None,
    ) -> None:
        for i, argument in enumerate(arguments):
            if argument.size != function.nnz_in(i):
                raise ValueError(
                    f"{function.name()}: argument {i} ({function.name_in(i)}) needs {function.nnz_in(i)} elements, "
                    f"got {argument.size}"
                )
        shapes = [function.size_out(i) for i in range(function.n_out())]
        ends = np.cumsum([rows * columns for rows, columns in shapes]).tolist()
        flat = np.split(np.zeros(ends[-1]) if memory is None else memory, ends[:-1])
        self.results = [part.reshape(shape, order="F") for part, shape in zip(flat, shapes, strict=True)]
        self._buffer, self.call = function.buffer()
        self._keep = (function, list(arguments))
        self._flat = flat
        for i, argument in enumerate(arguments):
            if argument.size:
                self._buffer.set_arg(i, memoryview(argument))  # type: ignore[call-arg, arg-type]
        for i, result in enumerate(self.results):
            if function.nnz_out(i) != result.size:
                raise ValueError(f"{function.name()}: output {i} must be dense")
            self._buffer.set_res(i, memoryview(flat[i]))  # type: ignore[call-arg, arg-type]

    call: Callable[[], None]

    def entry(self) -> Entry | None:
        """The kernel for calls from C, or None if the function is not compiled. It is valid as long as the kernel
        lives."""
        function, arguments = self._keep
        path = _libraries.get(function)
        if path is None:
            return None
        library = ctypes.CDLL(str(path))
        sizes = [ctypes.c_longlong() for _ in range(4)]
        getattr(library, f"{function.name()}_work")(*map(ctypes.byref, sizes))
        count_in, count_out, integers, numbers = (size.value for size in sizes)
        self._work = (
            (ctypes.c_void_p * count_in)(*(a.ctypes.data for a in arguments)),
            (ctypes.c_void_p * count_out)(*(r.ctypes.data for r in self._flat)),
            (ctypes.c_longlong * max(integers, 1))(),
            (ctypes.c_double * max(numbers, 1))(),
        )
        address = ctypes.cast(getattr(library, function.name()), ctypes.c_void_p).value
        return Entry(address, *(ctypes.addressof(part) for part in self._work))


def function(
    name: str, arguments: Sequence[Expression], results: Sequence[Expression], names: Sequence[str]
) -> ca.Function:
    """A CasADi function with dense outputs, as `Kernel` needs them."""
    outputs = [ca.densify(r) for r in results]
    return ca.Function(
        name, list(arguments), outputs, list(names), [f"r{i}" for i in range(len(outputs))], {"cse": True}
    )
