"""How large compiled sources are said to be."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from vsense_ros.export.measuring import size_of

SOURCE = """
static const double table[1000] = {1};
static double variables[500];
__attribute__((noinline)) static double deep(int i) {
    volatile double numbers[512];
    numbers[i] = table[i];
    return numbers[i];
}
__attribute__((noinline)) static double shallow(int i) {
    volatile double numbers[64];
    numbers[i] = variables[i];
    return numbers[i] + deep(i);
}
double called(int i);
double called(int i) { return shallow(i) + shallow(i + 1); }
double other(int i);
double other(int i) {
    volatile double numbers[256];
    numbers[i] = 1;
    variables[i] = numbers[i];
    return variables[i];
}
"""


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_stack_is_that_of_the_deepest_path_of_calls_and_variables_are_data(tmp_path: Path) -> None:
    source = tmp_path / "sized.c"
    source.write_text(SOURCE, encoding="utf-8")
    size = size_of([source], ["gcc", "-O1", "-std=gnu99"])
    assert 8000 < size.code < 9000
    assert size.data == 4000
    assert size.stack is not None
    red_zone = 128  # bytes below its stack that a function of x86-64 may use, if it calls no other
    assert 8 * (512 + 64) - red_zone <= size.stack < 8 * (512 + 64) + 100
