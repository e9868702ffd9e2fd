"""The start-up transient of a reference's heading: planted in a drive in closed form, and found again."""

import numpy as np
import pytest

from evaluate.synthetic_drives import odometry, recording
from studies.heading_transient import HeadingTransient, fit_transient, without_transient
from vsense_ros.evaluate.signals import SIGNALS, Series, read_signals
from vsense_ros.messages.recording import Recording

AMPLITUDE, BEGIN, TIME_CONSTANT, SPEED = np.radians(0.6), 15.0, 20.0, 12.0


def truth(error: float) -> tuple[np.ndarray, np.ndarray, Recording]:
    """Side slip of a winding drive, and its recording by a reference whose heading errs by this from `BEGIN` on."""
    seconds = np.arange(0.0, 300.0, 0.1)
    slip = 0.02 * np.sin(0.4 * seconds) + 0.004
    off = np.where(seconds < BEGIN, 0.0, error * np.exp(-(seconds - BEGIN) / TIME_CONSTANT))
    seen = slip - off
    motion = odometry(
        "reference/odometry", seconds, vx=SPEED * np.cos(seen), vy=SPEED * np.sin(seen), yaw=0.1 * seconds + off
    )
    return seconds, slip, recording(motion)


def estimate(stamp: np.ndarray, slip: np.ndarray) -> Series:
    noise = 0.001 * np.random.default_rng(1).standard_normal(len(slip))
    return Series(SIGNALS["side_slip"], stamp, (slip + noise)[:, None])


def test_a_transient_is_found_with_its_time_constant_beside_a_constant_mounting() -> None:
    _, slip, drive = truth(AMPLITUDE)
    reference = read_signals(drive, "reference")["side_slip"]
    found = fit_transient(estimate(reference.stamp, slip + 0.005), reference)
    assert found.amplitude == pytest.approx(AMPLITUDE, rel=0.1)
    assert found.time_constant == pytest.approx(TIME_CONSTANT, rel=0.15)
    assert found.begin == pytest.approx(BEGIN, abs=2.0)
    assert found.over == pytest.approx(BEGIN + TIME_CONSTANT * np.log(6.0), rel=0.1)


def test_a_reference_without_a_transient_is_left_nearly_as_it_is() -> None:
    _, slip, drive = truth(0.0)
    reference = read_signals(drive, "reference")["side_slip"]
    found = fit_transient(estimate(reference.stamp, slip), reference)
    assert abs(found.at(reference.stamp)).mean() < np.radians(0.01)


def test_what_is_left_without_the_transient_is_the_true_motion() -> None:
    seconds, slip, drive = truth(AMPLITUDE)
    start = int(drive["reference/odometry"].stamp[0])
    whole = without_transient(drive, HeadingTransient(start, BEGIN, float(AMPLITUDE), TIME_CONSTANT, 1.0))
    signals = read_signals(whole, "reference")
    assert signals["side_slip"].value[:, 0] == pytest.approx(slip, abs=1e-9)
    assert signals["lateral_velocity"].value[:, 0] == pytest.approx(SPEED * np.sin(slip), abs=1e-9)
    turned = np.exp(1j * signals["yaw"].value[:, 0])
    assert np.angle(turned * np.exp(-0.1j * seconds)) == pytest.approx(np.zeros_like(seconds), abs=1e-9)
