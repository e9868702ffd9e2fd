"""Coverage of published standard deviations: on a drive whose errors are known, and on one of the repository."""

import json
from pathlib import Path

import numpy as np
import pytest

from studies import truth as job
from studies.coverage import Compared, coverage_table, within
from vsense_ros.errors import InputError
from vsense_ros.evaluate.terminal import PlainConsole
from vsense_ros.messages.recording import Channel, Recording

SEED, ROWS, DEVIATION = 5, 4000, 0.1


def odometry(topic: str, stamp: np.ndarray, lateral: np.ndarray) -> Channel:
    zero = np.zeros_like(lateral)
    columns = {
        "position": np.column_stack([zero, zero, zero]),
        "orientation": np.tile([0.0, 0.0, 0.0, 1.0], (len(zero), 1)),
        "pose_covariance": np.tile((DEVIATION**2 * np.eye(6)).ravel(), (len(zero), 1)),
        "linear": np.column_stack([zero + 10.0, lateral, zero]),
        "angular": np.column_stack([zero, zero, zero]),
        "twist_covariance": np.tile((DEVIATION**2 * np.eye(6)).ravel(), (len(zero), 1)),
    }
    return Channel(topic, "nav_msgs/msg/Odometry", stamp, stamp, columns)


def drive(scale: float) -> tuple[Recording, Recording]:
    """Estimates of the lateral velocity with errors of `scale` times the deviation that they state, and the reference;
    in its first quarter the reference is off by a metre a second."""
    stamp = np.arange(ROWS) * 10_000_000
    lateral = 0.5 * np.sin(stamp * 1e-9)
    error = scale * DEVIATION * np.random.default_rng(SEED).standard_normal(ROWS)
    off = np.where(np.arange(ROWS) < ROWS // 4, 1.0, 0.0)
    estimates = Recording({"vsense/odometry": odometry("vsense/odometry", stamp, lateral + error)})
    return estimates, Recording({"reference/odometry": odometry("reference/odometry", stamp, lateral + off)})


@pytest.mark.parametrize(("scale", "share"), [(1.0, 0.954), (2.0, 0.683)])
def test_coverage_and_nees_are_those_of_the_normal_distribution(scale: float, share: float) -> None:
    compared = Compared.of(*drive(scale), (10.0, np.inf))
    figures = compared.figures()["lateral_velocity"]
    assert figures["within_2s"] == pytest.approx(share, abs=0.02)
    assert figures["nees"] == pytest.approx(scale**2, rel=0.1)
    assert figures["rmse"] == pytest.approx(scale * DEVIATION, rel=0.05)
    assert figures["trivial"] == pytest.approx(0.5 / 2**0.5, rel=0.1)  # zero beside a sine


def test_only_what_is_within_the_window_is_scored() -> None:
    estimates, recording = drive(1.0)
    whole, late = (Compared.of(estimates, recording, window) for window in (None, (10.0, np.inf)))
    assert whole.scores["lateral_velocity"].rmse == pytest.approx(0.5, rel=0.05)  # 1 m/s in a quarter of the time
    assert late.scores["lateral_velocity"].n == pytest.approx(0.75 * ROWS, abs=1)
    assert len(within(recording, 10.0, 20.0)["reference/odometry"]) == 1001


def test_the_table_has_error_coverage_nees_and_what_costs_nothing() -> None:
    console = PlainConsole(width=110)
    with console.capture() as capture:
        console.print(coverage_table({"a drive": Compared.of(*drive(1.0), (10.0, np.inf))}))
    text = capture.get()
    assert all(heading in text for heading in ("RMSE", "in 2σ", "NEES", "trivial"))
    assert "(zero)" in text


def test_what_is_written_of_a_part_leaves_the_others_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "truth.json"
    for name, keep in (("first", False), ("second", True)):
        outcome = job.Outcome({name: Compared.of(*drive(1.0))}, {})
        job.write(job.Results({name: outcome}, [], {}), path, keep=keep)
    assert json.loads(path.read_text(encoding="utf-8"))["coverage"].keys() == {"first", "second"}


def test_a_part_that_does_not_exist_is_refused_with_those_that_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"'hill climb'.*banked_oval.*faults"):
        job.examine(tmp_path, tmp_path, tmp_path, only=["hills", "hill climb"])


def test_a_part_that_fails_or_is_not_here_is_told_and_the_others_are_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def on_bag(path: Path) -> job.Outcome | None:
        if path.name == "sine_with_dwell":
            raise ValueError("no such luck")
        return None if path.name == "double_lane_change" else job.Outcome({path.name: Compared.of(*drive(1.0))}, {})

    monkeypatch.setattr(job, "on_bag", on_bag)
    bags = ["step_steer", "sine_with_dwell", "double_lane_change"]
    results = job.examine(tmp_path, tmp_path, tmp_path, only=bags, processes=1)
    assert results.failed == {"sine_with_dwell": "ValueError: no such luck"}
    assert "double_lane_change" in results.left_out
    assert "step_steer" in results.figures()["coverage"]


@pytest.mark.exam
def test_a_recording_of_the_repository_has_coverage_forces_and_lags(tmp_path: Path) -> None:
    outcome = job.on_bag(Path(__file__).parents[2] / "bags" / "step_steer")
    results = job.Results({"step_steer": outcome}, [], {})
    job.write(results, tmp_path / "truth.json")
    content = json.loads((tmp_path / "truth.json").read_text(encoding="utf-8"))
    assert content.keys() == {"coverage", "forces", "faults", "navigation", "latency_ms"}
    yaw_rate = content["coverage"]["step_steer"]["yaw_rate"]
    assert yaw_rate.keys() == {"within_2s", "nees", "rmse", "trivial"}
    assert yaw_rate["rmse"] < yaw_rate["trivial"]
    assert len(content["forces"]["step_steer"]["nrmsd_percent"]) == 12
    assert abs(content["latency_ms"]["step_steer"]["imu/data"]) < 10.0  # its stamps are true
