"""The kernels of `hw/rtl` themselves, by Verilator: each is translated to C++ once, compiled into the user's cache, and
called through ctypes."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.kernels.base import Kernel, Words
from vsense_ros.accelerator.kernels.row_combiner import RowCombiner
from vsense_ros.cache import kept
from vsense_ros.errors import InputError

NEEDED = ("verilator", "make", "g++")
_FLAGS = "-O2 -fPIC"


def sources() -> Path:
    """The folder `hw/rtl`, of the sources or where it was installed. Raises `InputError` where it is missing."""
    package = Path(__file__).resolve().parents[1]
    candidates = [package.parent / "hw" / "rtl"]
    candidates += [parent / "share" / "vsense_ros" / "hw" / "rtl" for parent in (*package.parents, Path(sys.prefix))]
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    raise InputError(f"the hardware's sources are not installed; looked for them in {candidates[0]} and below share")


def missing() -> list[str]:
    """Which of the programs are not here that the kernels need to be simulated."""
    return [name for name in NEEDED if shutil.which(name) is None]


class Simulation:
    """A module of `hw/rtl`, simulated clock by clock. Raises `InputError` where Verilator is missing or does not take
    the sources. Not for several threads at once."""

    def __init__(self, name: str, top: str, parameters: dict[str, int], has_table: bool = False) -> None:
        self.name = name
        self._library = ctypes.CDLL(str(_built(name, top, parameters, has_table)))
        self._library.rtl_new.restype = ctypes.c_void_p
        self._library.rtl_clocks.restype = ctypes.c_uint64
        self._handle = ctypes.c_void_p(self._library.rtl_new())

    def answers(self, given: Words, words_out: int) -> tuple[Words, NDArray[np.uint8], NDArray[np.uint32]]:
        """Answers (k, words_out) to requests (k, words_in) in turn; whether each had an error, and its clocks."""
        requests = np.ascontiguousarray(given, np.uint32)
        count = len(requests)
        results = np.zeros((count, words_out), np.uint32)
        cycles, refused = np.zeros(count, np.uint32), np.zeros(count, np.uint8)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (requests, results, cycles, refused)]
        done = self._library.rtl_run(
            self._handle, pointers[0], requests.shape[1], pointers[1], words_out, count, pointers[2], pointers[3]
        )
        if done != count:
            raise RuntimeError(f"{self.name} did not end within a million clocks")
        return results, refused, cycles

    def cut(self, words: Words, clocks: int) -> None:
        """Begin with a request (k,), and reset for one clock after so many."""
        given = np.ascontiguousarray(words, np.uint32)
        self._library.rtl_cut(self._handle, ctypes.c_void_p(given.ctypes.data), given.size, clocks)

    @property
    def clocks(self) -> int:
        """Clock cycles of all requests so far, loading and unloading included."""
        return int(self._library.rtl_clocks(self._handle))

    def close(self) -> None:
        if self._handle:
            self._library.rtl_delete(self._handle)
            self._handle = ctypes.c_void_p()

    def __del__(self) -> None:
        if hasattr(self, "_handle"):
            self.close()


class Rtl(Simulation):
    """One kernel."""

    def __init__(self, kernel: Kernel, **parameters: Any) -> None:
        super().__init__(kernel.name, kernel.top, kernel.parameters | parameters, bool(kernel.table_words))
        self.kernel = kernel

    def set_table(self, table: Words) -> None:
        """The coefficients of a kernel that has some."""
        words = np.ascontiguousarray(table, np.uint32).reshape(-1)
        self._library.rtl_table(self._handle, words.ctypes.data_as(ctypes.c_void_p), ctypes.c_int(words.size))

    def run(self, words: Words) -> tuple[Words, NDArray[np.bool_], NDArray[np.uint32]]:
        """As `Kernel.run`, and the clocks that each request took."""
        results, refused, cycles = self.answers(words.reshape(-1, self.kernel.words_in), self.kernel.words_out)
        before = words.shape[:-1]
        return results.reshape(*before, -1), refused.astype(bool).reshape(before), cycles.reshape(before)


class RowCombinerRtl(Simulation):
    """The row combiner, whose programs have lengths of their own."""

    def __init__(self, lanes: int = 16) -> None:
        super().__init__(RowCombiner.name, RowCombiner.name, {"L": lanes})

    def run(self, words: Words, words_out: int) -> Words:
        """As `RowCombiner.run`, of a program whose answer has so many words."""
        return self.answers(words[None], words_out)[0][0]


def _built(name: str, top: str, parameters: dict[str, int], has_table: bool) -> Path:
    """The module's library in the cache, made where it is not there yet."""
    if lacking := missing():
        raise InputError(
            f"simulating the hardware needs {', '.join(lacking)}, which cannot be found; install what is missing "
            "(make hw-tools), or use the backend mock, which gives the same bits"
        )
    folder = sources()
    files = sorted(folder.glob("*.sv"))
    wrapper = resources.files("vsense_ros").joinpath("accelerator/rtl.cpp").read_text(encoding="utf-8")
    version = subprocess.run(["verilator", "--version"], capture_output=True, text=True, check=True).stdout
    content = [version, _FLAGS, wrapper, top, repr(sorted(parameters.items()))]
    content += [file.read_text(encoding="utf-8") for file in files]

    def make(place: Path) -> Path:
        _build(name, folder, _commands(top, parameters, has_table, files), wrapper, place)
        return place / "library.so"

    try:
        return kept(f"rtl-{name}", content, make)
    except PermissionError as error:
        raise InputError(str(error)) from None


def _commands(
    top: str, parameters: dict[str, int], has_table: bool, files: list[Path]
) -> tuple[list[str], list[str], list[str]]:
    """What translates the sources, compiles what comes of them, and links the library."""
    header = f"V{top}"
    chosen = [f"-G{name}={value}" for name, value in parameters.items()]
    defines = [f"-DTOP={header}", f'-DTOP_HEADER="{header}.h"', *(["-DHAS_TABLE"] if has_table else [])]
    root = subprocess.run(["verilator", "--getenv", "VERILATOR_ROOT"], capture_output=True, text=True, check=True)
    include = Path(root.stdout.strip()) / "include"
    threads = ["verilated_threads.o"] if (include / "verilated_threads.cpp").exists() else []
    translate = [
        "verilator", "--cc", "-O3", "--x-assign", "fast", "--x-initial", "fast", "--noassert", "-Wno-fatal",
        "-Wno-WIDTH", "-Wno-UNUSED", "--top-module", top, "-CFLAGS", _FLAGS, "--Mdir", "obj", *chosen,
        *(str(file) for file in files),
    ]  # fmt: skip
    optimise = [f"OPT_{kind}={_FLAGS}" for kind in ("FAST", "SLOW", "GLOBAL")]
    built = [f"{header}__ALL.a", "verilated.o", *threads]
    compile_it = ["make", "-s", "-C", "obj", "-f", f"{header}.mk", *optimise, *built]
    objects = [f"obj/{name}" for name in built]
    link = [
        "g++", "-shared", "-std=c++17", *_FLAGS.split(), *defines, "-Iobj", f"-I{include}", f"-I{include / 'vltstd'}",
        "rtl.cpp", *objects, "-o", "library.so", "-lpthread",
    ]  # fmt: skip
    return translate, compile_it, link


def _build(name: str, folder: Path, commands: Iterable[list[str]], wrapper: str, place: Path) -> None:
    (place / "rtl.cpp").write_text(wrapper, encoding="utf-8")
    for command in commands:
        done = subprocess.run(command, cwd=place, capture_output=True, text=True)
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip()).splitlines()
            first = next((line for line in said if "rror" in line), said[-1] if said else "nothing")
            raise InputError(f"{name} of {folder} cannot be simulated: {command[0]} said: {first}")
