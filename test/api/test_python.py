"""`import vsense_ros as vs`: recordings, estimates and files for other programs, as a person uses them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import vsense_ros as vs
from vsense_ros.api.estimation import prepare
from vsense_ros.bag import write_bag
from vsense_ros.cli import main
from vsense_ros.runner.run import run

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "step_steer"
CAR = "prototype_model"
HEAVY = ("casadi", "scipy", "pandas", "polars", "xarray", "matplotlib", "asammdf", "pyarrow")


@pytest.fixture(scope="module")
def result() -> vs.Result:
    with pytest.warns(vs.RecordingWarning) if prepare(BAG, CAR).warnings else _nothing():
        return vs.estimate(f"{BAG}@0:4", CAR, filter="error_ekf")


def _nothing():
    from contextlib import nullcontext

    return nullcontext()


def test_the_import_loads_nothing_heavy():
    code = f"import sys, vsense_ros; print(*[name for name in {HEAVY!r} + ('numpy',) if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == ""


def test_every_public_name_is_there_and_says_what_it_is():
    for name in vs.__all__:
        assert getattr(vs, name).__doc__, name
    assert set(vs.__all__) <= set(dir(vs))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        vs.nothing  # noqa: B018


def test_a_recording_is_read_whole_or_in_part_and_an_unknown_one_is_refused(tmp_path):
    whole, part = vs.read(BAG), vs.read(f"{BAG}@1:3")
    assert whole.duration > 9
    assert part.duration == pytest.approx(2.0, abs=0.3)
    assert vs.read(whole) is whole
    (tmp_path / "picture.bin").write_bytes(bytes(200))
    with pytest.raises(vs.InputError, match="no importer knows this"):
        vs.read(tmp_path / "picture.bin")


def test_views_of_a_recording_agree_with_its_channels_and_with_each_other():
    recording = vs.read(BAG)
    frame, polars_frame, dataset = recording.to_pandas(), recording.to_polars(), recording.to_xarray()
    name = "imu/data/angular_velocity.z"
    column = frame[f"{name} [rad/s]"].dropna()
    imu = recording["imu/data"]
    np.testing.assert_array_equal(column.to_numpy(), imu.columns["angular_velocity"][:, 2])
    np.testing.assert_allclose(column.index, (imu.stamp - recording.first_stamp) * 1e-9, atol=1e-9)
    np.testing.assert_array_equal(polars_frame[f"{name} [rad/s]"].drop_nulls().to_numpy(), column.to_numpy())
    np.testing.assert_array_equal(dataset[name].dropna("time").values, column.to_numpy())
    assert dataset[name].attrs["units"] == "rad/s"
    assert frame.attrs["start_ns"] == recording.first_stamp
    assert "vehicle/wheel_speeds/velocity.wheel_fl [rad/s]" in frame
    assert "gps/fix/latitude [deg]" in frame


def test_info_finds_what_looks_wrong_and_what_would_mend_it(tmp_path):
    recording = vs.read(BAG)
    gyro = recording["imu/data"]
    reversed_rates = {**gyro.columns, "angular_velocity": -gyro.columns["angular_velocity"]}
    channels = {**recording.channels, "imu/data": type(gyro)(**{**vars(gyro), "columns": reversed_rates})}
    write_bag(tmp_path / "wrong", type(recording)(channels))
    found = vs.info(tmp_path / "wrong")
    assert any(problem.startswith("imu/data") for problem in found.problems)
    assert not vs.info(BAG).mends


def test_a_result_has_signals_with_sigma_units_reference_and_coverage(result):
    slip = result["side_slip"]
    assert slip.unit == "rad"
    assert slip.value.shape == slip.time.shape == slip.stamp.shape == slip.sigma.shape == slip.reference.shape
    known = np.isfinite(slip.error)
    np.testing.assert_allclose(slip.error[known], (slip.value - slip.reference)[known], atol=1e-12)
    assert np.sqrt(np.mean(slip.error[known] ** 2)) == pytest.approx(slip.rmse, rel=0.1)
    inside = np.mean(np.abs(slip.error[known]) < 2 * slip.sigma[known])
    assert inside == pytest.approx(slip.coverage, abs=0.05)
    assert result["position"].value.shape == (len(slip.time), 2)
    with pytest.raises(KeyError, match="side_slip"):
        result["side_slipp"]


def test_a_result_is_what_the_runner_estimates(result):
    recording = vs.read(f"{BAG}@0:4")
    plain = run(recording, vs.load_vehicle(CAR), "error_ekf").output["vsense/odometry"]
    np.testing.assert_array_equal(plain.columns["linear"], result.output["vsense/odometry"].columns["linear"])
    np.testing.assert_array_equal(plain.columns["angular"][:, 2], result["yaw_rate"].value)


def test_a_data_frame_has_names_with_units(result):
    frame = result.to_dataframe()
    for name in ("side_slip [rad]", "side_slip_sigma [rad]", "side_slip_reference [rad]", "side_slip_error [rad]"):
        assert name in frame
    assert "wheel_force_fl_z [N]" in frame
    np.testing.assert_array_equal(frame["yaw_rate [rad/s]"].to_numpy(), result["yaw_rate"].value)


@pytest.mark.slow
def test_a_result_prints_the_table_of_the_command(result, tmp_path):
    done = CliRunner().invoke(
        main, ["run", str(BAG), "--vehicle", CAR, "--filter", "error_ekf", "--out", str(tmp_path)]
    )
    assert done.exit_code == 0, done.output
    whole = vs.estimate(BAG, CAR, filter="error_ekf")
    rows = [line for line in str(whole).splitlines() if line.startswith(("side slip", "yaw rate", "speed"))]
    assert len(rows) >= 3
    for row in rows:
        assert row.rstrip() in done.output


@pytest.mark.slow
def test_a_picture_is_drawn_and_written(result, tmp_path):
    figure = result.plot(tmp_path / "lap.png")
    assert (tmp_path / "lap.png").read_bytes().startswith(b"\x89PNG")
    assert len(figure.axes) > 8


def test_a_filter_step_by_step_gives_what_a_run_of_the_recording_gives():
    """A loop that gives the samples of a recording one by one, as numbers, gets the estimates of the recording."""
    recording, car = vs.read(f"{BAG}@0:4"), vs.load_vehicle(CAR)
    expected = run(recording, car, "error_ekf").output["vsense/odometry"]
    filter = vs.Filter(car, filter="error_ekf", map_origin=recording.map_origin)
    start = recording.first_stamp
    by_topic = {sensor.topic: name for name, sensor in car.sensors.items()}
    for sample in recording.samples(tuple(topic for topic in by_topic if topic in recording)):
        name = by_topic[sample.topic]
        value = _numbers(sample)
        filter.correct(name, value, time=(sample.stamp - start) * 1e-9)
    last = expected.columns["linear"][-1]
    assert filter.started
    assert filter.units["side_slip"] == "rad"
    assert filter.state["longitudinal_velocity"] == pytest.approx(last[0], abs=0.02)
    assert filter.state["lateral_velocity"] == pytest.approx(last[1], abs=0.02)
    assert 0 < filter.sigma["side_slip"] < 0.1


def _numbers(sample):
    values = sample.values
    if sample.kind == "sensor_msgs/msg/Imu":
        return [*values["angular_velocity"], *values["linear_acceleration"]]
    if sample.kind == "sensor_msgs/msg/JointState":
        field = next(field for field in ("position", "velocity", "effort") if len(values[field]))
        return dict(zip(sample.names, values[field], strict=True))
    if sample.kind == "sensor_msgs/msg/NavSatFix":
        return [values[name][0] for name in ("latitude", "longitude", "altitude")]
    return values["linear"]


def test_a_filter_predicts_without_measurements_and_knows_less_then():
    recording, car = vs.read(f"{BAG}@0:4"), vs.load_vehicle(CAR)
    filter = vs.Filter(car, filter="error_ekf")
    assert not filter.started
    assert filter.state == {}
    by_topic = {sensor.topic: name for name, sensor in car.sensors.items()}
    for sample in recording.samples(tuple(topic for topic in by_topic if topic in recording)):
        filter.correct(by_topic[sample.topic], _numbers(sample), time=(sample.stamp - recording.first_stamp) * 1e-9)
    before, time = dict(filter.sigma), filter.time
    place = np.array([filter.state["position_x"], filter.state["position_y"]])
    speed = filter.state["speed"]
    for _ in range(50):
        filter.step(0.01)
    assert filter.time == pytest.approx(time + 0.5)
    went = np.hypot(*(np.array([filter.state["position_x"], filter.state["position_y"]]) - place))
    assert went == pytest.approx(0.5 * speed, rel=0.1)
    assert filter.sigma["longitudinal_velocity"] > before["longitudinal_velocity"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda f: f.correct("radar", [1.0]), "no sensor 'radar'; the filter uses"),
        (lambda f: f.correct("imu", [1.0] * 7), "imu gives 6 numbers, found 7"),
        (lambda f: f.correct("wheel_speeds", [1.0] * 4, sigma=0.1), "takes no sigma"),
        (lambda f: f.correct("imu", [1.0] * 6, sigma=-0.1), "takes one positive sigma or 6"),
        (lambda f: f.step(-0.1), "expected seconds, 0 or more"),
    ],
)
def test_a_filter_says_what_is_wrong_with_a_call(call, words):
    filter = vs.Filter(CAR, filter="error_ekf")
    with pytest.raises(vs.InputError, match=words):
        call(filter)


def test_a_steering_angle_as_one_number_is_that_of_the_steering_wheel():
    filter = vs.Filter(CAR, filter="error_ekf")
    filter.correct("steering", [0.1], time=0.1)
    (line,) = (one for one in filter.diagnostics if one.name == "steering")
    assert "no usable" not in line.message


def test_a_vehicle_and_a_filter_that_do_not_exist_are_named_with_those_that_do():
    with pytest.raises(vs.InputError, match="genesis"):
        vs.load_vehicle("gensis")
    with pytest.raises(vs.InputError, match="did you mean 'error_ekf'"):
        vs.estimate(BAG, CAR, filter="eror_ekf")
    with pytest.raises(vs.InputError, match="for a GNSS/INS filter"):
        vs.estimate(BAG, CAR, smooth=True)


def test_a_vehicle_is_made_from_catalogue_values_checked_and_written(tmp_path):
    new = vs.new_vehicle(1395, 2.63, 1.54, "205/55R16 91V", axle_load_front=820, name="Golf")
    assert vs.check(new.vehicle).is_good
    new.write(tmp_path / "golf.yaml")
    assert vs.load_vehicle(tmp_path / "golf.yaml") == new.vehicle
    assert vs.check(tmp_path / "golf.yaml").vehicle == new.vehicle
    with pytest.raises(vs.InputError, match="--tyre"):
        vs.new_vehicle(1395, 2.63, 1.54, None)


def test_a_calibrated_vehicle_has_what_the_drive_determines():
    found = vs.calibrate([ROOT / "bags" / "hills"], CAR)
    changed = {one.name for one in found.quantities if one.determined}
    assert any(name.startswith("rolling radius") for name in changed)
    assert found.before == vs.load_vehicle(CAR)
    assert found.vehicle != found.before
