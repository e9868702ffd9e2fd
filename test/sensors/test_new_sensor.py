"""A new kind of sensor is one file: whoever has to do with sensors asks the kind."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from ruamel.yaml import YAML

from ride_height import RideHeight
from vsense_ros.bag import read_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.schema import json_schema
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.data_quality import hindrance
from vsense_ros.mismatch.signals import difference
from vsense_ros.mismatch.simulation import Predictor
from vsense_ros.mismatch.windows import build_dataset
from vsense_ros.model.car.pose import angles
from vsense_ros.model.coordinates import Z
from vsense_ros.model.sensors import KINDS
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.monitor import load_limits
from vsense_ros.runner import Runner

TOPIC = "vehicle/ride_height"
SIGNALS = {"ride_height_front", "ride_height_rear"}
NOISE = 0.002  # [m]


@pytest.fixture(scope="module", autouse=True)
def known() -> Iterator[None]:
    KINDS["ride_height"] = RideHeight
    Vehicle.admit_kinds()
    yield
    del KINDS["ride_height"]
    Vehicle.admit_kinds()


@pytest.fixture(scope="module")
def file(known, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A vehicle file whose car has such a sensor."""
    yaml = YAML()
    content = yaml.load(vehicle_path("prototype_real").read_text(encoding="utf-8"))
    content["sensors"]["heights"] = {"kind": "ride_height", "ahead": 1.2, "noise": NOISE}
    content["sensors"]["torques"] = {"kind": "wheel_torques"}
    path = tmp_path_factory.mktemp("car") / "car.yaml"
    with path.open("w", encoding="utf-8") as target:
        yaml.dump(content, target)
    return path


@pytest.fixture(scope="module")
def bag(file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `vsense simulate` writes for that file."""
    path = tmp_path_factory.mktemp("bags") / "lane_change"
    result = CliRunner().invoke(
        main, ["simulate", "double_lane_change", "--vehicle", str(file), "--out", str(path)], catch_exceptions=False
    )
    assert result.exit_code == 0, result.output
    assert TOPIC in result.output
    assert "nothing reads it" not in result.output
    return path


@pytest.fixture(scope="module")
def vehicle(file: Path) -> Vehicle:
    return load_vehicle(file)


@pytest.fixture(scope="module")
def recording(bag: Path) -> Recording:
    return read_bag(bag)


def test_a_vehicle_file_may_have_it_and_what_is_wrong_with_it_is_told(vehicle: Vehicle, file: Path, tmp_path: Path):
    sensor = vehicle.sensors["heights"]
    assert isinstance(sensor, RideHeight)
    assert (sensor.ahead, sensor.behind, sensor.topic) == (1.2, 1.0, TOPIC)
    assert "RideHeight" in json_schema()["$defs"]
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(file.read_text(encoding="utf-8").replace(f"noise: {NOISE}\n", "noise: -1.0\n"), encoding="utf-8")
    with pytest.raises(InputError, match=r"sensors.heights.noise: .*greater than 0"):
        load_vehicle(wrong)


def test_a_simulation_records_what_its_equation_says_and_its_noise(recording: Recording):
    """Against the reference: height and attitude of the body, from which geometry gives the two heights."""
    heights, body = recording[TOPIC], recording["reference/odometry"]
    assert heights.names == RideHeight.joints
    x, y, z, w = body.columns["orientation"].T
    up = 2 * (x * z - w * y)
    height = body.columns["position"][:, 2]
    for column, arm in enumerate((1.2, -1.0)):
        expected = np.interp(heights.stamp, body.stamp, height + arm * up)
        error = heights.columns["position"][:, column] - expected
        assert np.std(error) == pytest.approx(NOISE, rel=0.1)
        assert abs(np.mean(error)) < 3 * NOISE / len(error) ** 0.5


def test_the_observer_uses_it_and_estimates_the_height_better(vehicle: Vehicle, recording: Recording):
    def height_deviation(car: Vehicle) -> tuple[Runner, float]:
        observer = Runner(car)
        for sample in recording.samples():
            observer.add(sample)
        return observer, float(np.sqrt(observer.filter.belief().covariance[Z, Z]))

    with_it, known = height_deviation(vehicle)
    bare = {name: sensor for name, sensor in vehicle.sensors.items() if name != "heights"}
    _, unknown = height_deviation(vehicle.model_copy(update={"sensors": bare}))
    health = with_it.health[with_it.names.index("heights")]
    assert health.used > 0.95 * len(recording[TOPIC])
    assert known < 0.8 * unknown


def error_of_pitch_over_road(output: Recording, recording: Recording) -> float:
    """Root mean square [rad]; the road of the recording is flat."""
    odometry, road, body = output["vsense/odometry"], output["vsense/road"], recording["reference/odometry"]
    pitch = angles(odometry.columns["orientation"])[:, 1] + road.columns["vector"][:, 0]
    true = np.interp(odometry.stamp, body.stamp, angles(body.columns["orientation"])[:, 1])
    return float(np.sqrt(np.mean((pitch - true) ** 2)))


def test_run_uses_it_if_the_file_has_it(bag: Path, file: Path, tmp_path: Path):
    """The car is its own plant, whose pitch over the road the observer knows to a fiftieth of a degree without it."""
    said, figures = [], []
    for vehicle, out in ((str(file), tmp_path / "with"), ("prototype_real", tmp_path / "without")):
        result = CliRunner().invoke(main, ["run", str(bag), "--vehicle", vehicle, "--out", str(out)])
        assert result.exit_code == 0, result.output
        said.append(f"heights: standard deviation {NOISE:.3g} m, of the vehicle file" in result.output)
        figures.append(error_of_pitch_over_road(read_bag(out / "output"), read_bag(bag)))
    assert said == [True, False]
    assert figures[0] != figures[1]
    assert max(figures) < np.radians(0.02)


def test_the_monitor_watches_its_components(vehicle: Vehicle):
    names = {quantity.name for quantity in Runner(vehicle).watch().quantities}
    assert {f"heights {name} innovation" for name in ("front", "rear")} <= names
    assert "heights innovation squared" in names


def test_the_search_compares_its_signals(vehicle: Vehicle, recording: Recording):
    """Simulated and measured heights differ by no more than noise and a state that is not known where windows begin.

    On straight guides, whose equations other tests compile as well: those of the tables take longer.
    """
    vehicle = vehicle.model_copy(update={"suspension": None, "linkage": None})
    predictor = Predictor(vehicle, build_dataset([recording], vehicle))
    for measured, simulated in zip(predictor.measured, predictor.simulated(predictor.start), strict=True):
        assert set(measured) >= SIGNALS
        for name, off in difference(measured, simulated).items():
            if name in SIGNALS:
                assert np.std(off) < 3 * NOISE


def test_one_that_is_frozen_is_noticed_in_its_own_words(vehicle: Vehicle, recording: Recording):
    channel = recording[TOPIC]
    stuck = channel.columns["position"].copy()
    stuck[200:900, 1] = stuck[200, 1]
    frozen = replace(channel, columns={**channel.columns, "position": stuck})
    drive = replace(recording, channels={**recording.channels, TOPIC: frozen})
    dataset = build_dataset([drive], vehicle)
    found = hindrance([drive], dataset, replace(dataset, windows=()), vehicle)
    assert found is not None
    assert "the ride height at the rear is frozen" in found.reason
    assert found.topic == TOPIC


def test_two_of_a_kind_are_one_too_many_to_compare(vehicle: Vehicle, recording: Recording):
    twin = vehicle.sensors["heights"].model_copy(update={"ahead": 0.5})
    car = vehicle.model_copy(update={"sensors": {**vehicle.sensors, "more": twin}})
    dataset = build_dataset([recording], car)
    found = hindrance([recording], dataset, replace(dataset, windows=()), car)
    assert found is not None
    assert "2 sensors of the kind ride_height" in found.reason


@pytest.mark.exam
def test_the_limits_of_the_monitor_hold_for_it(bag: Path, file: Path, tmp_path: Path):
    circle, limits = tmp_path / "circle", tmp_path / "limits.yaml"
    called = ["simulate", "steady_state_circle", "--vehicle", str(file), "--out", str(circle)]
    assert CliRunner().invoke(main, called).exit_code == 0
    called = ["monitor", str(bag), str(circle), "--vehicle", str(file), "--calibrate", str(limits)]
    result = CliRunner().invoke(main, called)
    assert result.exit_code == 0, result.output
    assert "heights front innovation" in load_limits(limits).quantities


@pytest.mark.exam
@pytest.mark.timeout(900)
def test_explain_has_it_in_its_answer(bag: Path, file: Path, tmp_path: Path):
    result = CliRunner().invoke(main, ["explain", str(bag), "--vehicle", str(file), "--report", str(tmp_path)])
    assert result.exit_code == 0, result.output
    answer = (tmp_path / "explain.json").read_text(encoding="utf-8")
    assert all(name in answer for name in SIGNALS)
