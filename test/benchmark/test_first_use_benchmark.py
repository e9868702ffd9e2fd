"""What a new machine waits for: all models of the demo made and compiled into an empty cache.

To be within 30 s of one processor: `cpu_s` is what the compilers, one after the other, and the rest took.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from vsense_ros import codegen

VEHICLES = Path(__file__).parents[2] / "config/vehicles"
PROGRAM = """
import sys
from vsense_ros.runner import Runner
from vsense_ros.files.vehicle import load_vehicle
for path in sys.argv[1:]:
    Runner(load_vehicle(path))
"""


def cpu_seconds() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@pytest.mark.benchmark(group="first use: models of the demo")
@pytest.mark.parametrize("cache", ["empty", "filled"])
@pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE other than 0")
def test_observers(benchmark: Any, tmp_path: Path, cache: str) -> None:
    paths = [str(VEHICLES / f"{name}.yaml") for name in ("rav4", "genesis", "prototype_model")]
    command = [sys.executable, "-c", PROGRAM, *paths]
    environment = os.environ | {"VSENSE_CACHE": str(tmp_path)}
    if cache == "filled":
        subprocess.run(command, env=environment, check=True)
    begun = cpu_seconds()
    benchmark.pedantic(lambda: subprocess.run(command, env=environment, check=True), rounds=1)
    benchmark.extra_info["cpu_s"] = cpu_seconds() - begun
    assert list(tmp_path.glob("car-*.so"))
