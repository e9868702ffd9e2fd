"""Figures of Leung 2010 in numbers: gains, tilted axes and interpolation against equations written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from studies import leung_figures as job
from studies.leung import SECTION_4_4
from studies.tasks import in_turn
from vsense_ros.assess.drives import Case, Error, Truth, readings
from vsense_ros.assess.filter_run import follow
from vsense_ros.errors import InputError
from vsense_ros.evaluate.terminal import PlainConsole
from vsense_ros.navigation.space import MOTION
from vsense_ros.navigation.thesis.dual_kkf import DUAL_KKF, dual
from vsense_ros.navigation.yaw_kkf import BIAS, COURSE


def weave(seconds: float, amplitude: float, speed: float = 5.0) -> Truth:
    """A car at constant speed whose side slip and yaw rate are sines of 8 s."""
    t = np.arange(0.0, seconds, 0.01)
    w = 2 * np.pi / 8
    lateral, lateral_rate = amplitude * np.sin(w * t), amplitude * w * np.cos(w * t)
    turn = 0.3 * np.sin(w * t) * (amplitude > 0)
    yaw = 0.3 / w * (1 - np.cos(w * t)) * (amplitude > 0)
    forces = np.column_stack([-turn * lateral, lateral_rate + turn * speed])
    spins = np.full((len(t), 4), speed / 0.29)
    return Truth(t, yaw, np.full_like(t, speed), lateral, turn, forces, forces, turn, spins)


def corrected(spread: np.ndarray, variance: float) -> tuple[np.ndarray, float]:
    """Covariance (2, 2) after its first state was measured, and the gain of that."""
    gain = spread[:, 0] / (spread[0, 0] + variance)
    return spread - np.outer(gain, spread[0]), float(gain[0])


@pytest.mark.parametrize(("definition", "held"), [(DUAL_KKF, 1.0), (dual(COURSE, held=job.DOUBTED), 100.0)])
def test_on_a_straight_the_gain_of_figure_4_20_is_that_of_riccatis_equation(definition, held) -> None:
    gain, of_fix = job.lateral_gain(weave(40.0, 0.0), SECTION_4_4, definition)
    step, speed, fix = 0.01, 5.0, SECTION_4_4.fix
    drift = 1e-10 * step
    transition = np.array([[1.0, -step], [0.0, 1.0]])
    heading, velocity = np.diag([0.05**2, BIAS**2]), np.diag([0.3**2, 2.0**2])
    expected, at_fix = [], []
    for k in range(1, 4000):
        heading = transition @ heading @ transition.T + np.diag([0.0, drift])
        velocity = transition @ velocity @ transition.T + np.diag([(0.5 * step) ** 2, drift])
        if k % 100 == 0:
            heading, _ = corrected(heading, (fix / speed) ** 2)
            velocity, found = corrected(velocity, fix**2 + speed**2 * heading[0, 0])
            at_fix.append(found)
        velocity, found = corrected(velocity, held**2)
        expected.append(found)
    between = np.isnan(of_fix)
    between[:2000] = False
    assert gain[between] == pytest.approx(np.array(expected)[between], rel=0.01)
    assert of_fix[np.isfinite(of_fix)][20:] == pytest.approx(at_fix[20:], rel=0.01)


def test_on_a_level_road_more_fixes_make_the_error_of_inertial_smaller_and_it_states_no_less_than_its_error() -> None:
    truth, errors, normalized = weave(60.0, 0.0), [], []
    for rate in (1.0, 10.0, 100.0):
        settings = replace(SECTION_4_4, fix_period=1 / rate)
        drawn = [Case(job.SHORT["ST"], seed, settings) for seed in range(3)]
        runs = [follow("inertial", truth, case, readings(truth, case))[0] for case in drawn]
        lateral = np.concatenate([run.value[200:, MOTION.index("lateral_velocity")] for run in runs])
        variance = np.concatenate([run.twist_covariance[200:, 1, 1] for run in runs])
        errors.append(np.sqrt(np.mean(lateral**2)))
        normalized.append(np.mean(lateral**2 / variance))
    assert errors == sorted(errors, reverse=True)
    assert max(normalized) < 1.5


def test_the_vertical_velocity_in_the_axes_of_the_road_is_that_of_a_turned_vector() -> None:
    random = np.random.default_rng(1)
    velocity, roll, pitch = random.normal(size=(50, 3)), *random.uniform(-0.3, 0.3, (2, 50))
    turned = Rotation.from_euler("ZYX", np.column_stack([0 * roll, pitch, roll])).apply(velocity)
    assert job.in_road_axes(velocity, roll, pitch) == pytest.approx(turned[:, 2], abs=1e-12)


def test_interpolated_before_the_correction_the_side_slip_follows_the_truth_a_fix_late() -> None:
    truth = weave(40.0, 0.5)
    still = job.replace(SECTION_4_4, force=Error(0.1, 1.0), fix=1e-3)
    estimate, at = job.before_correction(truth, Case("slalom", 0, still))
    settled = truth.t[at] > 20
    error = (estimate - truth.lateral_velocity[at])[settled]
    # A line through a sine of 8 s that is known each second is at most 1 - cos(π/8) of its size off.
    assert np.abs(error).max() < 1.2 * 0.5 * (1 - np.cos(np.pi / 8))
    assert at[-1] < len(truth.t) - 1  # of the time after the last fix nothing is known yet


def test_every_figure_prints_what_it_shows_and_what_the_thesis_says_of_it() -> None:
    assert {"4.6", "4.18", "4.20", "4.21", "4.22", "4.24", "4.43", "4.44", "4.4.7"} <= set(job.FIGURES)
    console = PlainConsole(width=120)
    for name, figure in job.FIGURES.items():
        with console.capture() as capture:
            job.show(name, {"a row": {"a column": 0.1234}}, console)
        assert "0.123" in capture.get()
        assert figure.says in capture.get()
    with pytest.raises(InputError, match=r"no figure '4\.99' in numbers; there are: 4\.6"):
        job.check(("4.99",))


def test_a_sweep_has_a_row_for_each_course_and_filter(tmp_path, monkeypatch) -> None:
    def study(cases, store, do_tasks):
        return {
            (case, name): {"lateral_velocity": {"rmse": case.errors.fix}} for case, names in cases for name in names
        }

    monkeypatch.setattr(job, "study", study)
    content = job.sweep("lateral_velocity", ("dual_kkf",), True, tmp_path, in_turn)
    assert content.rows["SD dual_kkf"] == pytest.approx({f"{v:g} m²/s²": v**0.5 for v in job.VARIANCES})
    assert job.draw("4.23", content, tmp_path).stat().st_size > 10_000
