"""GNSS/INS filters as C99: the same calls to the sources and to the filter in Python, on a recording."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from marks import exam_except
from vsense_ros import codegen
from vsense_ros.bag.importers import build, import_recording
from vsense_ros.cli.common import every_filter
from vsense_ros.errors import InputError
from vsense_ros.export import c, filters
from vsense_ros.export.check import FLAGS, WARNINGS
from vsense_ros.export.check import build as compiled
from vsense_ros.export.filters_check import Exported, compare
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import GnssAttitude
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.navigation.car_numbers import car_numbers
from vsense_ros.navigation.catalogue import DEFINITIONS, FILTERS
from vsense_ros.navigation.reading_use import usable

ROOT = Path(__file__).resolve().parents[2]
OF_CAR = ("error_ekf", "spi")  # which test_c.py compares
NOT_WRITTEN = {
    "dekf": "a reference to compare with",
    "cekf": "a reference to compare with",
    "ukf": "a reference to compare with",
    "full_error_ekf": "29 bodies",
    "full_spi": "29 bodies",
    "mekf_2b_particles": "random numbers",
}
WRITTEN = [name for name in every_filter().names if name not in (*OF_CAR, *NOT_WRITTEN)]
KEPT = "triple_kkf"  # a cascade
needs_compiler = pytest.mark.skipif(codegen.compiler() is None, reason="needs a C compiler and VSENSE_COMPILE not 0")


@cache
def car() -> Vehicle:
    """With two antennas."""
    found = load_vehicle(vehicle_path("prototype_model"))
    return found.model_copy(update={"sensors": {**found.sensors, "heading": GnssAttitude(noise=0.02)}})


@cache
def drive() -> Recording:
    """A double lane change, with a heading at each fix."""
    found = import_recording(ROOT / "bags" / "double_lane_change")
    truth, fixes = found["reference/odometry"], found["gps/velocity"].stamp
    rows = np.searchsorted(truth.stamp, fixes).clip(max=len(truth) - 1)
    x, y, z, w = truth.columns["orientation"][rows].T
    heading = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    heading += 0.02 * np.random.default_rng(0).standard_normal(len(rows))
    level = np.zeros_like(heading)
    quaternion = np.column_stack([level, level, np.sin(heading / 2), np.cos(heading / 2)])
    covariance = np.tile(0.02**2 * np.eye(3).ravel(), (len(rows), 1))
    columns = {"orientation": quaternion, "orientation_covariance": covariance}
    antennas = build.channel("gps/attitude", fixes, columns)
    return replace(found, channels={**found.channels, "gps/attitude": antennas})


@needs_compiler
@pytest.mark.parametrize("name", exam_except(WRITTEN, KEPT))
def test_the_sources_do_on_a_recording_what_the_filter_in_python_does(name: str, tmp_path: Path) -> None:
    filters.write(car(), name, tmp_path)
    difference = compare(car(), name, tmp_path, drive())
    assert difference.predictions > 1000
    assert difference.corrections > 1000
    assert difference.largest < 1e-9
    assert difference.placed == 1  # C went on by itself from the start


def repeated(recording: Recording, times: int) -> Recording:
    """A drive so many times in a row, at least 10 ms apart."""
    stamps = [channel.stamp for channel in recording.channels.values() if len(channel)]
    period = max(int(one[-1]) for one in stamps) - min(int(one[0]) for one in stamps) + 10_000_000
    later = np.arange(times) * period

    def after(values: np.ndarray) -> np.ndarray:
        return (later[:, None] + values[None]).ravel()

    channels = {
        topic: replace(
            channel,
            stamp=after(channel.stamp),
            received=after(channel.received),
            columns={key: np.concatenate([value] * times) for key, value in channel.columns.items()},
        )
        for topic, channel in recording.channels.items()
    }
    return replace(recording, channels=channels)


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("name", exam_except(["triple_kkf", "integrated_kf_a"], "triple_kkf"))
def test_a_filter_in_single_precision_stays_by_the_double_one_however_long_the_drive(name: str, tmp_path: Path) -> None:
    filters.write(car(), name, tmp_path, single=True)
    assert "double" not in (tmp_path / f"{name}.h").read_text()
    once = compare(car(), name, tmp_path, drive(), single=True)
    often = compare(car(), name, tmp_path, repeated(drive(), 3), single=True)
    assert often.predictions > 2.5 * once.predictions
    assert often.placed == once.placed
    assert 0 < once.largest < 2e-2
    assert often.state < 3 * once.state + 1e-4


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("name", ["triple_kkf", "heading_bank"])
def test_compilers_have_no_warning_for_a_filter(name: str, single: bool, compiler: str, tmp_path: Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed here")
    filters.write(car(), name, tmp_path, single=single)
    for source in filters.sources(name, tmp_path):
        command = [compiler, *FLAGS[1:], *WARNINGS, "-fsyntax-only", str(source)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", NOT_WRITTEN)
def test_a_filter_that_cannot_be_written_is_refused_with_its_reason(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=NOT_WRITTEN[name]):
        filters.write(car(), name, tmp_path) if name in FILTERS.names else c.with_filter(car(), name)
    assert not list(tmp_path.iterdir())


@needs_compiler
@pytest.mark.parametrize("name", exam_except(["dual_kkf", "mekf_2c", "heading_bank", "integrated_kf_a"], "mekf_2c"))
def test_a_filter_in_c_begins_as_that_in_python(name: str, tmp_path: Path) -> None:
    filters.write(car(), name, tmp_path)
    library = compiled(tmp_path, FLAGS, filters.sources(name, tmp_path))
    definition, numbers = DEFINITIONS[name][1], car_numbers(car(), usable(car().sensing()).values())
    ours, there = definition.make(numbers), definition.make(numbers)
    ours.start(definition.start(numbers))
    memory = np.full(len(ours.memory), np.nan)
    Exported(library, memory, {}).start()
    struct = there.at(np.zeros_like(memory))  # type: ignore[attr-defined]
    struct.memory[:] = memory
    found, expected = struct.belief(), ours.belief()
    assert np.isfinite(memory).all()
    np.testing.assert_allclose(found.mean, expected.mean, rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-14, atol=1e-14)


@pytest.mark.exam
@needs_compiler
def test_a_comparison_finds_sources_of_another_car(tmp_path: Path) -> None:
    physics = car().physics
    chassis = physics.chassis.model_copy(update={"mass": 1.5 * physics.chassis.mass})
    heavier = car().model_copy(update={"physics": physics.model_copy(update={"chassis": chassis})})
    filters.write(heavier, "integrated_kf_a", tmp_path)
    assert compare(car(), "integrated_kf_a", tmp_path, drive()).largest > 1e-3


@needs_compiler
@pytest.mark.parametrize("value", exam_except([np.nan, np.inf], np.nan))
def test_c_takes_a_reading_that_is_none_as_python_does(value: float, tmp_path: Path) -> None:
    filters.write(car(), "triple_kkf", tmp_path)
    channels = dict(drive().channels)
    for topic, field in (("vehicle/wheel_speeds", "velocity"), ("gps/velocity", "linear")):
        columns = {key: np.array(one) for key, one in channels[topic].columns.items()}
        columns[field][len(columns[field]) // 4 :: 2, 0] = value
        channels[topic] = replace(channels[topic], columns=columns)
    difference = compare(car(), "triple_kkf", tmp_path, replace(drive(), channels=channels))
    assert difference.corrections > 1000
    assert difference.largest < 1e-9


_TWO_FILTERS = """
#include <cmath>
#include <cstdio>
#include "fast/dual_kkf.h"
#include "slow/dual_kkf.h"
int main() {
    fast_filter f; slow_filter s;
    fast_start(&f); slow_start(&s);
    const double fix[] = FAST_VARIANCE_IMU;
    const int refused = !fast_predict(&f, -0.004) + !fast_predict(&f, NAN) + !slow_predict(&s, INFINITY);
    std::printf("%d %d %.17g %d\\n", fast_predict(&f, 0.01), slow_predict(&s, 0.02), fix[0], refused);
}
"""


@needs_compiler
def test_two_filters_in_one_program_of_c_plus_plus_have_their_own_names(tmp_path: Path) -> None:
    compiler = codegen.compiler() or ""
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed here")
    objects = []
    for prefix in ("fast", "slow"):
        folder = tmp_path / prefix
        filters.write(car(), "dual_kkf", folder, prefix)
        for source in filters.sources("dual_kkf", folder):
            objects.append(str(folder / f"{source.stem}.o"))
            command = [compiler, "-std=c99", "-O0", "-c", str(source), "-o", objects[-1]]
            subprocess.run(command, check=True, capture_output=True)
    (tmp_path / "two.cpp").write_text(_TWO_FILTERS)
    program = str(tmp_path / "two")
    subprocess.run(["g++", f"-I{tmp_path}", str(tmp_path / "two.cpp"), *objects, "-o", program, "-lm"], check=True)
    printed = subprocess.run([program], check=True, capture_output=True, text=True).stdout.split()
    assert printed[:2] == ["1", "1"]
    imu = car().sensing()["imu"]
    assert float(printed[2]) == pytest.approx(imu.deviations()[0] ** 2, rel=1e-15)
    assert printed[3] == "3"
