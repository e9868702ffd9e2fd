"""Two checkouts are timed in turn, and the ratio of their smallest times decides."""

from __future__ import annotations

import importlib
import json
import math
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def against() -> ModuleType:
    sys.path.insert(0, str(ROOT / "tools"))
    return importlib.import_module("bench_against")


class Scripted:
    """A checkout whose times are known, and that says when it was asked."""

    def __init__(self, name: str, seconds: list[float], asked: list[str], why: str = "") -> None:
        self.name, self.times, self.asked, self.why = name, iter(seconds), asked, why

    def seconds(self, part: str) -> tuple[float, str]:
        self.asked.append(self.name)
        return (math.nan, self.why) if self.why else (next(self.times), "")


def test_each_round_begins_with_the_other_checkout_and_the_smallest_times_are_compared(against: ModuleType) -> None:
    asked: list[str] = []
    here, there = Scripted("here", [3.0, 1.0, 9.0], asked), Scripted("there", [2.0, 8.0, 4.0], asked)
    found = against.compared(here, there, "a part", 3)
    assert asked == ["here", "there", "there", "here", "here", "there"]
    assert (found.here, found.there, found.ratio) == (1.0, 2.0, 0.5)


def test_a_part_that_one_checkout_does_not_have_says_so_and_has_no_ratio(against: ModuleType) -> None:
    there = Scripted("there", [], [], "AttributeError: no such function")
    found = against.compared(Scripted("here", [1.0], []), there, "a part", 3)
    assert math.isnan(found.ratio)
    assert found.why == "does not run there: AttributeError: no such function"


def test_ratios_stand_beside_what_the_benchmarks_have_left(against: ModuleType, tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    path.write_text('{"benchmarks": [1]}')
    results = {
        "step": against.Compared(2.0, 1.0),
        "read mcap": against.Compared(1e-6, 2e-6),
        "new": against.Compared(math.nan, math.nan, "does not run there"),
    }
    against.keep(results, "abc1234", path)
    assert json.loads(path.read_text()) == {
        "benchmarks": [1],
        "against": {"step": 2.0, "read mcap": 0.5},
        "against_revision": "abc1234",
        "io": {"read mcap": 1.0},
    }


def test_the_figures_of_goals_are_ratios_of_medians_of_one_run(against: ModuleType) -> None:
    def benchmark(name: str, median: float, **figures: float) -> dict[str, object]:
        return {"name": name, "stats": {"median": median}, "extra_info": figures}

    benchmarks = [
        benchmark("test_general_filter[filterpy_ekf]", 4e-5),
        benchmark("test_error_ekf", 1e-5),
        benchmark("test_recording[compiled-RAV4, comma2k19]", 1.0, realtime_factor=30.04),
        benchmark("test_sensor_stamp_to_odometry_at_250_hz", 1.0, p50_ms=1.0, p99_ms=2.0),
    ]
    assert importlib.import_module("benchmarks").summary({"benchmarks": benchmarks}) == {
        "ratios": {"error_ekf": 0.25},
        "run_realtime": {"compiled-RAV4, comma2k19": 30.0},
        "node": {"p50_ms": 1.0, "p99_ms": 2.0},
    }


def test_the_job_of_a_part_is_one_that_takes_time(against: ModuleType, tmp_path: Path) -> None:
    parts = sys.modules["bench_parts"]
    job = parts.PARTS["live can"].make(tmp_path)
    assert 1e-7 < parts.timed(job, parts.PARTS["live can"]) < 1e-2  # [s] of one frame
