"""The arithmetic units of the hardware against the processor's own binary32."""

import ctypes
import subprocess
from pathlib import Path

import numpy as np
import pytest

from linear_systems import SPECIAL
from vsense_ros.accelerator import float32
from vsense_ros.accelerator.rtl import missing, sources

pytestmark = [
    pytest.mark.exam,
    pytest.mark.skipif(bool(missing()), reason=f"needs {', '.join(missing())}: make hw-tools"),
]
HERE = Path(__file__).parents[2] / "hw" / "test"
COUNT = 200_000


@pytest.fixture(scope="module", params=[True], ids=["deep"])
def units(request, tmp_path_factory):
    """The units as a function of two arrays of words. Those of the shallow ones are body_mass's, in test_rtl.py."""
    place = tmp_path_factory.mktemp("units")
    files = [str(f) for f in (*sources().glob("fp32_*.sv"), HERE / "fp32_units.sv")]
    translate = ["verilator", "--cc", "-O3", "--noassert", "-Wno-fatal", "-Wno-WIDTH", "--top-module", "fp32_units"]
    subprocess.run([*translate, f"-GDEEP={int(request.param)}", *files], cwd=place, check=True, capture_output=True)
    made = ["make", "-s", "-f", "Vfp32_units.mk", "OPT_FAST=-O2 -fPIC", "OPT_SLOW=-fPIC", "OPT_GLOBAL=-O2 -fPIC"]
    objects = ["Vfp32_units__ALL.a", "verilated.o", "verilated_threads.o"]
    subprocess.run([*made, *objects], cwd=place / "obj_dir", check=True, capture_output=True)
    root = subprocess.run(["verilator", "--getenv", "VERILATOR_ROOT"], check=True, capture_output=True, text=True)
    include = f"{root.stdout.strip()}/include"
    link = ["g++", "-shared", "-fPIC", "-O2", "-std=c++17", "-Iobj_dir", f"-I{include}", f"-I{include}/vltstd"]
    link += [str(HERE / "fp32_units.cpp"), *(f"obj_dir/{name}" for name in objects), "-o", "units.so", "-lpthread"]
    subprocess.run(link, cwd=place, check=True, capture_output=True)
    library = ctypes.CDLL(str(place / "units.so"))
    latency = np.array([5, 6, 16] if request.param else [3, 5, 15], np.int32)

    def run(a, b):
        results = [np.zeros(a.size, np.uint32) for _ in range(3)]
        pointers = [ctypes.c_void_p(x.ctypes.data) for x in (a, b, latency, *results)]
        library.units_run(pointers[0], pointers[1], ctypes.c_long(a.size), *pointers[2:])
        return results

    return run


def check(units, a, b):
    x, y = float32.flushed(a.view(np.float32)), float32.flushed(b.view(np.float32))
    found = units(np.ascontiguousarray(a), np.ascontiguousarray(b))
    for got, expected in zip(found, (float32.multiply(x, y), float32.add(x, y), float32.divide(x, y)), strict=True):
        assert np.array_equal(got, float32.canonical(expected))


def words(random, low, high, count=COUNT, mantissa=23):
    """Numbers with exponents from low to high, and so many bits of mantissa."""
    exponent = random.integers(low, high, count, dtype=np.uint32) << 23
    fraction = random.integers(0, 2**mantissa, count, dtype=np.uint32) << (23 - mantissa)
    return exponent | fraction | random.integers(0, 2, count, dtype=np.uint32) << 31


def test_any_bits_whatever(units):
    random = np.random.default_rng(1)
    check(units, *random.integers(0, 2**32, (2, COUNT), dtype=np.uint32))


def test_numbers_of_like_size(units):
    random = np.random.default_rng(2)
    check(units, words(random, 120, 135), words(random, 120, 135))


def test_numbers_that_nearly_cancel(units):
    random = np.random.default_rng(3)
    a = words(random, 126, 130)
    check(units, a, (a + random.integers(0, 9, a.size, dtype=np.uint32) - 4) ^ np.uint32(0x80000000))


def test_ties(units):
    random = np.random.default_rng(4)
    check(units, words(random, 100, 150, mantissa=12), words(random, 100, 150, mantissa=12))


def test_results_around_the_smallest_and_the_largest_number(units):
    random = np.random.default_rng(5)
    check(units, words(random, 1, 4), words(random, 1, 130))
    check(units, words(random, 60, 70), words(random, 60, 66))
    check(units, words(random, 250, 255), words(random, 124, 255))


def test_every_pair_of_special_numbers(units):
    a, b = np.meshgrid(SPECIAL, SPECIAL)
    check(units, a.ravel(), b.ravel())
