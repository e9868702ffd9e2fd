"""A reference computed from all that was measured, beside the truth of simulated drives and that of a real car."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import vsense_ros as vs
from marks import exam_except
from vsense_ros.cli import main
from vsense_ros.evaluate.metrics import align, compare
from vsense_ros.evaluate.reference import at_reference, judged_by
from vsense_ros.evaluate.signals import read_signals

BAGS = Path(__file__).parents[2] / "bags"
CAR = "prototype_real"
JUDGED = ("side_slip", "lateral_velocity", "longitudinal_velocity", "yaw", "yaw_rate", "position")


@cache
def smoothed(name: str) -> vs.Recording:
    """The smoothed motion of a bag of the repository."""
    return vs.smooth(BAGS / name, CAR).recording


def as_output(recording: vs.Recording) -> vs.Recording:
    """What was smoothed, on the topics of an estimate."""
    channels = {
        t.replace("smoothed/", "vsense/"): c for t, c in recording.channels.items() if t.startswith("smoothed/")
    }
    return replace(recording, channels={t: replace(c, topic=t) for t, c in channels.items()})


@pytest.mark.parametrize("name", exam_except(["double_lane_change", "brake_in_turn"], "double_lane_change"))
def test_errors_against_the_truth_are_as_large_as_stated_through_a_lane_change_and_a_spin(name: str) -> None:
    scores = compare(as_output(smoothed(name)), vs.read(BAGS / name))
    assert set(JUDGED) <= set(scores)
    for signal in JUDGED:
        assert scores[signal].nees < 2.5, signal  # errors of one drive are one draw, correlated over time
        assert scores[signal].within_2s > 0.8, signal


def test_the_smoothed_motion_is_nearer_to_the_truth_than_a_live_filter_and_judges_it_alike() -> None:
    bag = BAGS / "double_lane_change"
    live = vs.estimate(bag, CAR, filter="inertial")
    judged = vs.estimate(smoothed(bag.name), CAR, filter="inertial", against="smoothed")
    truth = compare(as_output(smoothed(bag.name)), vs.read(bag))
    for signal in ("side_slip", "yaw", "yaw_rate", "longitudinal_velocity"):
        assert truth[signal].rmse < 0.7 * live[signal].rmse
        assert judged[signal].rmse == pytest.approx(live[signal].rmse, rel=0.4)


def test_topics_that_are_not_in_a_recording_cannot_be_compared_with() -> None:
    recording = vs.read(BAGS / "step_steer")
    with pytest.raises(
        vs.InputError, match=r"no topic smoothed/… to compare with; there is reference with an odometry"
    ):
        judged_by(recording, "smoothed")


def test_a_recording_without_gnss_is_refused_with_what_is_missing() -> None:
    recording = vs.read(BAGS / "step_steer")
    channels = {t: c for t, c in recording.channels.items() if not t.startswith("gps/")}
    with pytest.raises(vs.InputError, match=r"never started.*waiting for a sensor that measures course"):
        vs.smooth(replace(recording, channels=channels), CAR)


@pytest.mark.slow
def test_the_command_writes_a_bag_that_run_compares_with(tmp_path: Path) -> None:
    out = tmp_path / "smoothed"
    done = CliRunner().invoke(main, ["smooth", str(BAGS / "step_steer"), "--vehicle", CAR, "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert re.search(r"rear slip +0\.0\d+ .*s²/m", done.output)
    assert "heading offset" not in done.output  # which no sensor of this car determines
    assert "smoothed/odometry" in vs.read(out)
    arguments = [
        str(out),
        "--vehicle",
        CAR,
        "--filter",
        "inertial",
        "--against",
        "smoothed",
        "--out",
        str(tmp_path / "o"),
    ]
    done = CliRunner().invoke(main, ["run", *arguments])
    assert done.exit_code == 0, done.output
    assert "Compared with the topics smoothed/…" in " ".join(done.output.split())


@pytest.mark.exam
def test_agrees_with_the_reference_of_a_real_car_within_what_both_state() -> None:
    folder = pytest.importorskip("vsense_ros.bag.datasets").data_dir() / "genesis_oxts_can"
    lap = folder / "med_lap_center_8_21.mat"
    if not lap.is_file():
        pytest.skip("the Genesis laps are not here")
    part = f"{lap}@60:160"
    moved = at_reference(as_output(vs.smooth(part, "genesis").recording), vs.load_vehicle("genesis"))
    estimates, truths = read_signals(moved, "vsense"), read_signals(vs.read(part), "reference")
    # An OxTS RT3000 by its manual: 0.1° of heading, and what that makes of a lateral velocity at 12 m/s.
    for signal, of_reference in {"yaw": np.radians(0.1), "lateral_velocity": 0.02}.items():
        aligned = align(estimates[signal], truths[signal])
        ratio = aligned.error[:, 0] ** 2 / (aligned.deviation**2 + of_reference**2)
        assert ratio.mean() < 1.5, signal
