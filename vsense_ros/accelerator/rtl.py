"""The kernels of `hw/rtl` themselves, by Verilator: each is translated to C++ once, compiled into the user's cache, and
called through ctypes."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import sys
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.accelerator.kernels.base import Kernel, Words
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


class Rtl:
    """One kernel, simulated clock by clock. Raises `InputError` where Verilator is missing or does not take the
    sources. Not for several threads at once."""

    def __init__(self, kernel: Kernel, **parameters: Any) -> None:
        self.kernel = kernel
        self._library = ctypes.CDLL(str(_built(kernel, kernel.parameters | parameters)))
        self._library.rtl_new.restype = ctypes.c_void_p
        self._library.rtl_clocks.restype = ctypes.c_uint64
        self._handle = ctypes.c_void_p(self._library.rtl_new())

    def set_table(self, table: Words) -> None:
        """The coefficients of a kernel that has some."""
        words = np.ascontiguousarray(table, np.uint32).reshape(-1)
        self._library.rtl_table(self._handle, words.ctypes.data_as(ctypes.c_void_p), ctypes.c_int(words.size))

    def run(self, words: Words) -> tuple[Words, NDArray[np.bool_], NDArray[np.uint32]]:
        """As `Kernel.run`, and the clocks that each request took."""
        kernel = self.kernel
        given = np.ascontiguousarray(words, np.uint32).reshape(-1, kernel.words_in)
        count = len(given)
        results = np.zeros((count, kernel.words_out), np.uint32)
        cycles, refused = np.zeros(count, np.uint32), np.zeros(count, np.uint8)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (given, results, cycles, refused)]
        done = self._library.rtl_run(
            self._handle, pointers[0], kernel.words_in, pointers[1], kernel.words_out, count, pointers[2], pointers[3]
        )
        if done != count:
            raise RuntimeError(f"{kernel.name} did not end within a million clocks")
        before = words.shape[:-1]
        return results.reshape(*before, -1), refused.astype(bool).reshape(before), cycles.reshape(before)

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


def _built(kernel: Kernel, parameters: dict[str, int]) -> Path:
    """The kernel's library in the cache, made where it is not there yet."""
    if lacking := missing():
        raise InputError(
            f"simulating the hardware needs {', '.join(lacking)}, which cannot be found; install what is missing "
            "(make hw-tools), or use the backend mock, which gives the same bits"
        )
    folder = sources()
    files = sorted(folder.glob("*.sv"))
    wrapper = resources.files("vsense_ros").joinpath("accelerator/rtl.cpp").read_text(encoding="utf-8")
    version = subprocess.run(["verilator", "--version"], capture_output=True, text=True, check=True).stdout
    content = [version, _FLAGS, wrapper, kernel.top, repr(sorted(parameters.items()))]
    content += [file.read_text(encoding="utf-8") for file in files]

    def make(place: Path) -> Path:
        _build(kernel, parameters, folder, files, wrapper, place)
        return place / "library.so"

    try:
        return kept(f"rtl-{kernel.name}", content, make)
    except PermissionError as error:
        raise InputError(str(error)) from None


def _build(
    kernel: Kernel, parameters: dict[str, int], folder: Path, files: list[Path], wrapper: str, place: Path
) -> None:
    top = f"V{kernel.top}"
    (place / "rtl.cpp").write_text(wrapper, encoding="utf-8")
    chosen = [f"-G{name}={value}" for name, value in parameters.items()]
    defines = [f"-DTOP={top}", f'-DTOP_HEADER="{top}.h"', *(["-DHAS_TABLE"] if kernel.table_words else [])]
    root = subprocess.run(["verilator", "--getenv", "VERILATOR_ROOT"], capture_output=True, text=True, check=True)
    include = Path(root.stdout.strip()) / "include"
    threads = ["verilated_threads.o"] if (include / "verilated_threads.cpp").exists() else []
    translate = [
        "verilator", "--cc", "-O3", "--x-assign", "fast", "--x-initial", "fast", "--noassert", "-Wno-fatal",
        "-Wno-WIDTH", "-Wno-UNUSED", "--top-module", kernel.top, "-CFLAGS", _FLAGS, "--Mdir", "obj", *chosen,
        *(str(file) for file in files),
    ]  # fmt: skip
    optimise = [f"OPT_{kind}={_FLAGS}" for kind in ("FAST", "SLOW", "GLOBAL")]
    compile_it = ["make", "-s", "-C", "obj", "-f", f"{top}.mk", *optimise, f"{top}__ALL.a", "verilated.o", *threads]
    objects = [f"obj/{name}" for name in (f"{top}__ALL.a", "verilated.o", *threads)]
    link = [
        "g++", "-shared", "-std=c++17", *_FLAGS.split(), *defines, "-Iobj", f"-I{include}", f"-I{include / 'vltstd'}",
        "rtl.cpp", *objects, "-o", "library.so", "-lpthread",
    ]  # fmt: skip
    for command in (translate, compile_it, link):
        done = subprocess.run(command, cwd=place, capture_output=True, text=True)
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip()).splitlines()
            first = next((line for line in said if "rror" in line), said[-1] if said else "nothing")
            raise InputError(f"{kernel.name} of {folder} cannot be simulated: {command[0]} said: {first}")
