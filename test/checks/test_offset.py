"""Clocks of two recordings of one drive, which is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthetic_motion import WHEEL_SIGNALS, WHEELS, Drive
from vsense_ros.bag.importers import build
from vsense_ros.checks.held import period_of_updates
from vsense_ros.checks.offset import clock_offset
from vsense_ros.messages.recording import Recording

START = 1_600_000_000_000_000_000
SIGNALS = Drive().signals()


def inertial(first: int = 0, last: int = 2000, clock: float = 0.0, sign: float = 1.0) -> Recording:
    stamp = build.nanoseconds(np.arange(2000) * 0.02 + clock, START)[first:last]
    rates, forces = (np.column_stack([SIGNALS[f"{v}{axis}"] for axis in "xyz"])[first:last] for v in "wa")
    return Recording({"imu/data": build.imu(stamp, sign * rates, sign * forces)})


def wheels(first: int = 0, last: int = 2000) -> Recording:
    stamp = build.nanoseconds(np.arange(2000) * 0.02, START)[first:last]
    return Recording(
        {WHEELS: build.joints(WHEELS, stamp, "velocity", {n: SIGNALS[n][first:last] for n in WHEEL_SIGNALS})}
    )


@settings(max_examples=12, deadline=None)
@given(clock=st.floats(-5000.0, 5000.0), first=st.integers(0, 600), last=st.integers(1400, 2000))
def test_what_is_added_to_the_other_clock_is_what_it_is_behind(clock, first, last):
    found = clock_offset(wheels(), inertial(first, last, clock))
    assert found is not None
    offset, correlation = found
    assert offset == pytest.approx(-clock, abs=0.05)
    assert correlation > 0.95
    back = clock_offset(inertial(first, last, clock), wheels())
    assert back is not None
    assert back[0] == pytest.approx(-offset, abs=1e-6)


def test_other_motions_short_overlaps_and_recordings_without_a_motion_have_no_offset():

    assert clock_offset(inertial(0, 200), inertial(0, 200)) is None
    assert clock_offset(Recording({}), inertial()) is None
    assert clock_offset(inertial(), Recording({})) is None
    still = Recording(
        {
            "imu/data": build.imu(
                build.nanoseconds(np.arange(2000) * 0.02, START), np.zeros((2000, 3)), np.zeros((2000, 3))
            )
        }
    )
    assert clock_offset(inertial(), still) is None


NOISE = np.random.default_rng(0).normal(size=(240, 2))


@pytest.mark.parametrize("times", [2, 3, 5, 20])
def test_values_that_each_stand_in_so_many_rows_have_that_period(times):
    assert period_of_updates(np.repeat(NOISE, times, axis=0)[:400]) == times


def test_a_period_of_four_rows_and_more_may_be_one_more_or_less():
    rng = np.random.default_rng(1)
    for length, expected in ((5, 5), (3, None)):
        runs = length + rng.integers(-1, 2, 120)
        assert period_of_updates(np.repeat(NOISE[:120], runs, axis=0)) == expected


def test_a_torque_that_creeps_by_one_coarse_step_at_a_time_is_not_held():
    rise = 2 * np.round(0.25 * np.arange(800) + 0.05 * np.random.default_rng(3).normal(size=800))[:, None]
    assert period_of_updates(rise) is None
    by_clock = 2 * np.round(np.repeat(3 * NOISE, 4, axis=0))
    assert period_of_updates(by_clock) == 4


def test_values_that_rest_or_are_rounded_or_few_or_all_new_have_no_period():
    assert period_of_updates(NOISE) is None
    assert period_of_updates(np.zeros((200, 1))) is None
    assert period_of_updates(np.round(3 * np.sin(0.05 * np.arange(400)))[:, None]) is None
    assert period_of_updates(np.repeat(NOISE, 3, axis=0)[:40]) is None
    irregular = np.random.default_rng(2).integers(1, 9, 80)
    assert period_of_updates(np.repeat(NOISE[:80], irregular, axis=0)) is None
    sometimes_twice = np.where(np.arange(80) % 3 == 0, 6, 3)
    assert period_of_updates(np.repeat(NOISE[:80], sometimes_twice, axis=0)) == 3
