"""What the observer costs: a step with ten measurements, its parts, and whole recordings, with and without a compiler.

A step is everything that happens for an IMU message and a wheel-speed message of one instant: both are read and
checked, model and covariance move ahead, the model is linearised, six and four measurements correct 52 states, and the
instant is kept for measurements that come late.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vsense_ros.bag.importers import import_recording
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.model.car import steps
from vsense_ros.model.schema.observer_settings import EstimatedParameter
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer import estimate_samples
from vsense_ros.runner import Runner, run

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("VSENSE_DATA", ROOT / "../shared/recordings"))
VEHICLES = ROOT / "config/vehicles"
IMU, WHEELS = "imu/data", "vehicle/wheel_speeds"
PARAMETERS = {"chassis.mass": EstimatedParameter(deviation=100.0), "road.friction": EstimatedParameter(deviation=0.2)}


@pytest.fixture(scope="module")
def lane_change() -> Recording:
    return generate("double_lane_change", load_vehicle(VEHICLES / "prototype_real.yaml"), seed=1)


@pytest.fixture(params=["compiled", "without compiler"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Functions that are kept from before must not be found by what follows."""
    kept: list[Callable[[], None]] = [steps.model_functions.cache_clear, steps.sensor_functions.cache_clear]
    if request.param == "without compiler":
        monkeypatch.setenv("VSENSE_COMPILE", "0")
        for forget in kept:
            forget()
    yield request.param
    if request.param == "without compiler":
        for forget in kept:
            forget()


@pytest.fixture(params=["straight guides", "suspension tables"])
def vehicle(request: pytest.FixtureRequest) -> Vehicle:
    """The prototype, and what its suspensions move like."""
    loaded = load_vehicle(VEHICLES / "prototype_model.yaml")
    assert loaded.suspension is not None
    return loaded if request.param == "suspension tables" else loaded.model_copy(update={"suspension": None})


@pytest.fixture
def observer(way: str, vehicle: Vehicle, lane_change: Recording) -> Runner:
    return _under_way(vehicle, lane_change)


def _under_way(vehicle: Vehicle, recording: Recording) -> Runner:
    """An observer after two seconds."""
    made = Runner(vehicle, recording.map_origin)
    for sample in recording.samples(tuple(made.topics)):
        if sample.stamp > recording.start + 2_000_000_000:
            break
        made.add(sample)
    return made


def _time_steps(benchmark: Any, observer: Runner, lane_change: Recording) -> None:
    """Steps of pairs of messages of one instant."""
    imu = [s for s in lane_change.samples((IMU,)) if s.stamp > observer.stamp + 8_000_000]
    wheels = lane_change[WHEELS]
    nearest = np.searchsorted(wheels.stamp, [s.stamp for s in imu]).clip(max=len(wheels) - 1)
    pairs = iter([(a, replace(wheels.sample(int(i)), stamp=a.stamp)) for a, i in zip(imu, nearest, strict=True)])

    def step(first: Any, second: Any) -> None:
        observer.add(first)
        observer.add(second)

    benchmark.pedantic(step, setup=lambda: (next(pairs), {}), rounds=2000, warmup_rounds=100)
    assert observer.health[0].used > 2000 or benchmark.stats is None


@pytest.mark.benchmark(group="observer step: 52 states, 10 measurements")
def test_step(benchmark: Any, way: str, observer: Runner, lane_change: Recording) -> None:
    _time_steps(benchmark, observer, lane_change)


@pytest.mark.benchmark(group="SPI step: 2 parameters, 52 states, 10 measurements")
@pytest.mark.parametrize("kind", ["ekf", "ukf"])
def test_spi_step(benchmark: Any, kind: str, vehicle: Vehicle, lane_change: Recording) -> None:
    changes = {"parameters": PARAMETERS, "parameter_filter": kind}
    estimating = vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update=changes)})
    _time_steps(benchmark, _under_way(estimating, lane_change), lane_change)


@pytest.mark.benchmark(group="parts of a step")
@pytest.mark.parametrize(
    "part", ["linearize", "advance", "predict", "correct by imu", "correct by wheel_speeds", "estimate"]
)
def test_part(benchmark: Any, way: str, part: str, observer: Runner) -> None:
    ekf, car = observer.filter, observer.filter.car
    before = ekf.memory.copy()
    sensor = part.split()[-1] if part.startswith("correct") else "imu"
    variance = observer.sensors[sensor].deviations() ** 2
    value = -car.sense(sensor, np.zeros(len(variance)))[0]
    work: dict[str, Callable[[], object]] = {
        "linearize": car.linearize,
        "advance": car.advanced.call,
        "predict": lambda: ekf.predict(0.004),  # these two, and what they do to the covariance
        "estimate": lambda: list(estimate_samples(observer.snapshot())),
    }
    ekf.predict(0.004)

    def restore() -> None:
        ekf.memory[:] = before

    target = work.get(part, lambda: ekf.correct(sensor, value, variance, 100.0))
    benchmark.pedantic(target, setup=restore, rounds=1000, warmup_rounds=20)


@pytest.mark.benchmark(group="whole recordings without ROS")
@pytest.mark.parametrize("drive", ["double lane change, generated", "RAV4, comma2k19", "Genesis, one lap"])
def test_recording(benchmark: Any, way: str, drive: str, lane_change: Recording) -> None:
    if drive.startswith("double"):
        recording, name = lane_change, "prototype_model"
    else:
        path, name = {
            "RAV4, comma2k19": (DATA / "comma2k19_rav4", "rav4"),
            "Genesis, one lap": (DATA / "genesis_oxts_can/med_lap_center_8_21.mat", "genesis"),
        }[drive]
        if not path.exists():
            pytest.skip(f"no recording at {path}; VSENSE_DATA names the folder that has it")
        recording = import_recording(path)
    vehicle = load_vehicle(VEHICLES / f"{name}.yaml")
    benchmark.pedantic(run, (recording, vehicle), rounds=3 if way == "compiled" else 1)
    if benchmark.stats is not None:
        benchmark.extra_info["realtime_factor"] = recording.duration / benchmark.stats.stats.min
        benchmark.extra_info["messages"] = sum(
            len(recording[s.topic]) for s in vehicle.sensors.values() if s.topic in recording
        )
