"""Files for other programs, read back by libraries that are not ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import vsense_ros as vs
from vsense_ros.api.saving import save
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.cli import main
from vsense_ros.evaluate.signals import SIGNALS, make_series, read_signals
from vsense_ros.messages.estimates import side_slip
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.table import Column, Table

ROOT = Path(__file__).parents[2]
BAG = ROOT / "bags" / "step_steer"
START = 1_700_000_000_123_456_789


def output() -> Recording:
    """An output bag with a side slip that is not known at its first time, as of a car at rest."""
    stamp = START + np.arange(5, dtype=np.int64) * 10_000_000
    vector = np.column_stack([np.sin(np.arange(5.0)) / 3, [np.inf, 0.1, 0.02, 0.02, 0.01], np.zeros(5)])
    sample = side_slip(START, vector)
    channel = Channel(sample.topic, sample.kind, stamp, stamp, dict(sample.values), sample.frame_id)
    return Recording({sample.topic: channel}, "lap")


@pytest.fixture
def run_folder(tmp_path) -> Path:
    write_bag(tmp_path / "run" / "output", output())
    return tmp_path / "run"


def exported(source: Path, target: Path) -> Path:
    done = CliRunner().invoke(main, ["export-results", str(source), "--to", str(target)])
    assert done.exit_code == 0, done.output
    return target


def expected() -> tuple[np.ndarray, np.ndarray]:
    series = read_signals(output(), "vsense")["side_slip"]
    assert series.deviation is not None
    return series.value[:, 0], series.deviation


def test_a_csv_is_read_by_pandas_with_units_and_all_digits(run_folder, tmp_path):
    pandas = pytest.importorskip("pandas", reason="needs requirements/tables.txt")
    frame = pandas.read_csv(exported(run_folder, tmp_path / "lap.csv"))
    value, sigma = expected()
    assert list(frame) == ["time [s]", "stamp [ns]", "side_slip [rad]", "side_slip_sigma [rad]"]
    np.testing.assert_allclose(frame["side_slip [rad]"], value, rtol=1e-15)
    np.testing.assert_array_equal(frame["side_slip_sigma [rad]"], sigma)
    assert frame["stamp [ns]"].tolist()[0] == START
    assert frame["time [s]"].iloc[-1] == pytest.approx(0.04)


def test_a_parquet_file_is_read_by_pyarrow_with_its_units(run_folder, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs requirements/formats.txt")
    table = parquet.read_table(exported(run_folder, tmp_path / "lap.parquet"))
    value, sigma = expected()
    np.testing.assert_array_equal(table["side_slip [rad]"].to_numpy(), value)
    np.testing.assert_array_equal(table["side_slip_sigma [rad]"].to_numpy(), sigma)
    assert table.schema.field("side_slip [rad]").metadata[b"unit"] == b"rad"


def test_a_mat_file_is_read_by_scipy_with_its_units(run_folder, tmp_path):
    from scipy.io import loadmat

    content = loadmat(exported(run_folder, tmp_path / "lap.mat"), simplify_cells=True)
    value, sigma = expected()
    np.testing.assert_array_equal(content["side_slip"], value)
    np.testing.assert_array_equal(content["side_slip_sigma"], sigma)
    assert content["units"]["side_slip"] == "rad"
    assert content["stamp"][0] == START


def test_an_mf4_file_is_read_by_asammdf_with_units_and_start(run_folder, tmp_path):
    asammdf = pytest.importorskip("asammdf", reason="needs requirements/formats.txt")
    value, _ = expected()
    with asammdf.MDF(exported(run_folder, tmp_path / "lap.mf4")) as file:
        signal = file.get("side_slip")
        np.testing.assert_array_equal(signal.samples, value)
        np.testing.assert_allclose(signal.timestamps, np.arange(5) * 0.01, atol=1e-9)
        assert signal.unit == "rad"
        assert file.header.start_time.timestamp() == pytest.approx(START * 1e-9, abs=1e-3)


def test_an_mcap_file_is_read_as_the_bag_was(run_folder, tmp_path):
    target = exported(run_folder, tmp_path / "lap.mcap")
    assert target.is_file()
    again = vs.read(target)
    before = read_bag(run_folder / "output")
    assert again.digest() == before.digest()


@pytest.mark.parametrize("ending", [".csv", ".parquet", ".mat", ".mf4"])
def test_a_recording_without_estimates_gives_all_its_signals(ending, tmp_path):
    for library in ("pyarrow", "asammdf", "pandas"):
        pytest.importorskip(library, reason="needs requirements/all.txt")
    recording = vs.read(f"{BAG}@0:1")
    vs.export_results(recording, tmp_path / f"drive{ending}")
    rate = recording["imu/data"].columns["angular_velocity"][:, 2]
    np.testing.assert_allclose(_yaw_rates(tmp_path / f"drive{ending}"), rate, rtol=1e-15)


def _yaw_rates(path: Path) -> np.ndarray:
    """Values of the gyro's z axis, by the library that people use for a format."""
    import asammdf
    import pandas
    from scipy.io import loadmat

    name = "imu/data/angular_velocity.z [rad/s]"
    if path.suffix == ".csv":
        return pandas.read_csv(path)[name].dropna().to_numpy()
    if path.suffix == ".parquet":
        return pandas.read_parquet(path)[name].dropna().to_numpy()
    if path.suffix == ".mat":
        content = loadmat(path, simplify_cells=True)["imu_data"]
        assert content["units"]["angular_velocity_z"] == "rad/s"
        return content["angular_velocity_z"]
    with asammdf.MDF(path) as file:
        return file.get("imu/data/angular_velocity.z").samples


def test_names_that_matlab_cannot_have_become_ones_that_it_can(tmp_path):
    from scipy.io import loadmat

    columns = tuple(
        Column(name, "1", np.ones(2)) for name in ("a b", "a.b", "time", "2nd", "ä", "long" * 30, "long" * 31)
    )
    save(tmp_path / "x.mat", Recording({}), [Table("t", np.array([1, 2]), columns)])
    names = [name for name in loadmat(tmp_path / "x.mat") if not name.startswith("__")]
    assert len(names) == len(columns) + 3
    assert all(name.isidentifier() and len(name) <= 63 for name in names)


@pytest.mark.parametrize(
    ("target", "words"),
    [("lap.xls", "no format has the ending"), ("nowhere/lap.csv", "there is no folder"), ("lap", "no format has")],
)
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_read(target, words, run_folder, tmp_path):
    done = CliRunner().invoke(main, ["export-results", str(run_folder), "--to", str(tmp_path / target)])
    assert done.exit_code == 2
    assert words in done.output


def test_a_recording_without_messages_is_refused(tmp_path):
    with pytest.raises(vs.InputError, match="no message in it"):
        vs.export_results(Recording({}, "empty"), tmp_path / "empty.csv")


def test_the_table_of_a_signal_has_what_a_series_has():
    channel = output()["vsense/sideslip"]
    series = make_series(SIGNALS["side_slip"], channel, channel.columns["vector"][:, :1])
    (column,) = [one for one in channel.table().columns if one.name.endswith("/angle")]
    assert column.unit == series.signal.unit
    np.testing.assert_array_equal(column.value, series.value[:, 0])
