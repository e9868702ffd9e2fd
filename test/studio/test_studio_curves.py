"""Curves by levels of detail, against what numpy says of all samples."""

from __future__ import annotations

import json
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vsense_ros.errors import InputError
from vsense_ros.studio.curves import CurveSet, CurveWriter, driven, open_curves
from vsense_ros.studio.data_routes import CurvesRequest, Trace, packed, part_of
from vsense_ros.studio.project import Project

HOUR = 360_000  # samples at 100 Hz


@pytest.fixture(scope="module")
def hour(tmp_path_factory: pytest.TempPathFactory) -> CurveSet:
    folder = tmp_path_factory.mktemp("hour")
    time = np.arange(HOUR) * 0.01
    values = np.cumsum(np.random.default_rng(1).standard_normal((30, HOUR)), axis=1)
    writer = CurveWriter(folder, name="hour")
    writer.add(time, {f"s{k}": row for k, row in enumerate(values)}, unit="m", label="walk", topic="t")
    writer.close()
    return CurveSet(folder)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(begin=st.floats(0, 3599), length=st.floats(0.05, 3600), bins=st.integers(50, 2000))
def test_no_extreme_of_what_is_shown_is_lost(hour: CurveSet, begin: float, length: float, bins: int) -> None:
    end = min(begin + length, 3600.0)
    view = hour.view("s0", begin, end, bins)
    time, value = hour.time("s0"), hour.value("s0")
    inside = (time >= begin) & (time <= end)
    if inside.any():
        assert view.low.min() <= value[inside].min()
        assert view.high.max() >= value[inside].max()
    assert len(view.time) <= 2 * bins + 3


def test_zooming_thirty_signals_of_an_hour_takes_less_than_a_tenth_of_a_second(hour: CurveSet) -> None:
    hour.view("s1", 0, 3600, 1200)  # the first look maps the files
    best = np.inf
    for _ in range(5):
        began = perf_counter()
        for k in range(30):
            hour.view(f"s{k}", 10, 3590, 1200)
        best = min(best, perf_counter() - began)
    assert best < 0.1


def test_a_curve_that_is_zoomed_in_shows_every_sample(hour: CurveSet) -> None:
    view = hour.view("s2", 100.0, 101.0, 800)
    rows = slice(9999, 10102)  # and one on each side
    assert np.array_equal(view.low, hour.value("s2")[rows])
    assert np.array_equal(view.low, view.high)


def test_absent_values_stay_absent_in_coarse_levels(tmp_path: Path) -> None:
    value = np.full(300_000, np.nan)
    value[1000:200_000] = 1.0
    writer = CurveWriter(tmp_path)
    writer.add(np.arange(300_000) * 0.01, {"held": value}, unit="", label="", topic="")
    writer.close()
    view = open_curves(tmp_path).view("held", 0, 3000, 200)
    assert np.isnan(view.low[-1])
    assert np.nanmax(view.high) == 1.0


def test_distance_is_the_integral_of_the_speed_and_inverts() -> None:
    time = np.linspace(0, 10, 1001)
    distance = driven(time, 2.0 * time)
    assert distance[-1] == pytest.approx(100.0, rel=1e-4)


def test_curves_that_are_gone_are_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no longer there"):
        open_curves(tmp_path / "gone")


def test_a_gap_breaks_the_line_and_is_not_bridged(tmp_path: Path) -> None:
    time = np.concatenate([np.arange(5000) * 0.01, 80.0 + np.arange(5000) * 0.01])
    writer = CurveWriter(tmp_path)
    writer.add(time, {"speed": np.ones(10_000)}, unit="m/s", label="speed", topic="t")
    writer.close()
    curves = open_curves(tmp_path)
    for bins in (200, 20_000):
        view = curves.view("speed", 0, 130, bins)
        (broken,) = np.flatnonzero(np.isnan(view.low))
        assert view.time[broken] == pytest.approx(49.99)
        assert view.time[broken + 1] == pytest.approx(80.0, abs=1.0)
    assert np.isnan(curves.sampled("speed", np.array([60.0]))[0])
    assert curves.sampled("speed", np.array([20.0]))[0] == 1.0


def test_curves_are_sent_as_numbers_and_a_shared_time_once(hour: CurveSet) -> None:
    views = [hour.view(name, 5.0, 900.0, 300) for name in ("s0", "s1")]
    sent = packed([{"x": view.time, "low": view.low, "high": view.high} for view in views])
    size = int.from_bytes(sent[:4], "little")
    head, numbers = json.loads(sent[4 : 4 + size]), np.frombuffer(sent[4 + size :])
    assert head[0]["x"] == head[1]["x"]
    for entry, view in zip(head, views, strict=True):
        begin, count = entry["high"]
        assert np.array_equal(numbers[begin : begin + count], view.high)


def test_the_difference_of_two_laps_is_that_of_their_values_at_the_same_distance(tmp_path: Path) -> None:
    project = Project(tmp_path)
    time = np.linspace(0, 20, 2001)
    speed = np.where(time < 10, 10.0, 20.0)
    writer = CurveWriter(project.result_folder("abc") / "curves")
    writer.add(time, {"distance": driven(time, speed), "speed": speed}, unit="", label="", topic="t")
    writer.close()
    laps = [Trace(set="abc/curves", name="speed", begin=a, end=b) for a, b in ((10.5, 20.0), (0.0, 9.5))]
    laps[0].minus = laps[1]
    (begin, end) = (5.0, 80.0)
    found = part_of(project, laps[0], CurvesRequest(axis="distance", begin=begin, end=end, bins=50, traces=laps))
    assert found["low"] == pytest.approx(np.full(100, 10.0))
