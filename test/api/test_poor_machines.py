"""Machines that lack something: one core, a disk that is full, a cache that is only read, vectors of 256 bits."""

from __future__ import annotations

import os
import platform
import resource
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vsense_ros import codegen, estimate

BAG = Path(__file__).parents[2] / "bags/step_steer"
VEHICLE = "prototype_model"
SIDE_SLIP = f"""
import numpy as np
from vsense_ros import estimate
np.save("side_slip", estimate({str(BAG)!r}, {VEHICLE!r})["side_slip"].value)
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
def test_one_core_estimates_what_several_do() -> None:
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("there is one core anyway")
    of_several = estimate(BAG, VEHICLE)["side_slip"].value
    os.sched_setaffinity(0, {min(cores)})
    try:
        of_one = estimate(BAG, VEHICLE)["side_slip"].value
    finally:
        os.sched_setaffinity(0, cores)
    assert np.array_equal(of_one, of_several)


def test_a_disk_that_is_full_is_said_and_leaves_the_results_that_were_there(tmp_path: Path) -> None:
    def full() -> None:  # no file grows beyond so much: a write fails, as it does on a full disk
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    earlier = tmp_path / "results/output/output_0.mcap"
    earlier.parent.mkdir(parents=True)
    earlier.write_bytes(b"of an earlier run")
    command = [sys.executable, "-m", "vsense_ros.cli", "run", str(BAG), "--vehicle", VEHICLE, "--out", "results"]
    done = subprocess.run(command, cwd=tmp_path, preexec_fn=full, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "vsense: results/output: File too large\n")
    assert earlier.read_bytes() == b"of an earlier run"
    assert [path.name for path in (tmp_path / "results").iterdir()] == ["output"], "nothing half-written is left"


@pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")
def test_of_a_cache_that_has_what_is_needed_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("VSENSE_CACHE", str(tmp_path))
    codegen.library("twice", "double twice(double x) { return 2 * x; }")
    before = {path: path.stat().st_mtime_ns for path in (tmp_path, *tmp_path.iterdir())}
    tmp_path.chmod(0o500)  # which stops everybody but root
    try:
        assert codegen.library("twice", "double twice(double x) { return 2 * x; }") is not None
    finally:
        tmp_path.chmod(0o700)
    assert {path: path.stat().st_mtime_ns for path in (tmp_path, *tmp_path.iterdir())} == before
    assert not caplog.records


@pytest.mark.exam
@pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")
@pytest.mark.skipif(platform.machine() != "x86_64", reason="has no vectors of that name")
def test_a_processor_without_avx2_estimates_the_same(tmp_path: Path) -> None:
    compiler = tmp_path / "cc"
    compiler.write_text(f'#!/bin/sh\nexec {codegen.compiler()} "$@" -mno-avx512f -mno-avx2 -mno-fma -mno-avx\n')
    compiler.chmod(0o700)
    environment = os.environ | {"CC": str(compiler), "VSENSE_CACHE": str(tmp_path / "cache")}
    subprocess.run([sys.executable, "-c", SIDE_SLIP], cwd=tmp_path, env=environment, check=True)
    assert list((tmp_path / "cache").glob("car-*.so"))
    expected = estimate(BAG, VEHICLE)["side_slip"].value
    np.testing.assert_allclose(np.load(tmp_path / "side_slip.npy"), expected, rtol=0, atol=1e-9)
