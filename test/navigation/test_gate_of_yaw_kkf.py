"""The straight-line gate of the yaw KKF: what shuts it for good, and that time opens it again."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from vsense_ros.estimation.filter import Array
from vsense_ros.model.sensors import GnssVelocity, Imu
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.catalogue import DEFINITIONS

STEP, GYRO, FIX = 0.01, 0.0018, 0.0224  # [s], [rad/s], [m/s] noise, as in section 4.4 of Leung 2010
NUMBERS = {"gyro_noise": GYRO, "sample_time": STEP, "straight_rate": np.radians(1.0)}


def errors(rate: float, bias: Array, turning: Array, slip: Array, speed: float, seed: int) -> tuple[Array, Array]:
    """Errors of heading and bias [rad], [rad/s] at each reading of a yaw KKF, with `rate` fixes a second."""
    sensors = {
        "imu": Imu(rate_noise=(GYRO,) * 3, gate=1e6),
        "velocity": GnssVelocity(noise=FIX, gate=1e6),
    }
    definition = DEFINITIONS["yaw_kkf"][1]
    filter = Aided("yaw_kkf", definition, NUMBERS, sensors)
    random, n = np.random.default_rng(seed), len(turning)
    yaw = np.cumsum(turning) * STEP
    course = yaw + slip
    imu = np.zeros((n, 6))
    imu[:, 2] = turning + bias + GYRO * random.standard_normal(n)
    fixes = speed * np.column_stack([np.cos(course), np.sin(course)]) + FIX * random.standard_normal((n, 2))
    filter.give_reading("imu", imu[0])
    filter.start(definition.start({**NUMBERS, "yaw": float(np.arctan2(fixes[0, 1], fixes[0, 0]))}))
    every, found = round(1 / rate / STEP), np.zeros((n, 2))
    for k in range(1, n):
        filter.give_reading("imu", imu[k])
        filter.predict(STEP)
        if k % every == 0:
            filter.correct("velocity", fixes[k], np.full(2, FIX**2))
        found[k] = filter.belief().mean[:2] - (yaw[k], bias[k])
    found[:, 0] = (found[:, 0] + np.pi) % (2 * np.pi) - np.pi
    return found[:, 0], found[:, 1]


RATES = st.sampled_from([1.0, 2.0, 5.0, 10.0, 12.5, 20.0, 25.0, 50.0])


@settings(max_examples=12, deadline=None)
@given(RATES, st.floats(-0.06, 0.06), st.floats(4.0, 30.0), st.integers(0, 1000))
@example(12.5, 0.01745, 5.0, 3)
@example(50.0, -0.04, 5.0, 0)
def test_on_a_straight_the_bias_is_learnt_whatever_it_is_and_however_often_fixes_come(
    rate: float, bias: float, speed: float, seed: int
) -> None:
    n = 3000
    yaw, off = errors(rate, np.full(n, bias), np.zeros(n), np.zeros(n), speed, seed)
    assert abs(off[-1]) < np.radians(0.1)
    assert abs(yaw[-1]) < np.radians(2.0)


@settings(max_examples=8, deadline=None)
@given(RATES, st.floats(0.02, 0.1), st.booleans(), st.integers(0, 1000))
@example(1.0, 0.02, True, 0)
@example(50.0, 0.1, False, 0)
def test_a_gate_that_has_refused_opens_after_a_time_that_the_rate_of_fixes_does_not_change(
    rate: float, jump: float, left: bool, seed: int
) -> None:
    """The gyro's bias jumps beyond the gate: heading and course come apart at that rate, to the largest side slip."""
    n, at = 6000, 1500
    bias = np.where(np.arange(n) < at, 0.005, 0.005 + (jump if left else -jump))
    yaw, off = errors(rate, bias, np.zeros(n), np.zeros(n), 15.0, seed)
    refused = abs(off[at + 200])
    assert refused > 0.8 * jump  # two seconds later the gate is still shut
    learnt = at + np.flatnonzero(np.abs(off[at:]) > np.radians(0.5))[-1]
    assert (learnt - at) * STEP < 0.25 / jump + 10.0
    assert abs(yaw[-1]) < np.radians(2.0)


@pytest.mark.parametrize(("speed", "radius", "slip"), [(5.0, 5.0, 0.3), (15.0, 30.0, -0.14), (8.0, 40.0, 0.03)])
def test_in_a_bend_the_course_is_refused(speed: float, radius: float, slip: float) -> None:
    """A car that slips goes elsewhere than it points; that is not taken for an error of the heading."""
    n = 6000
    bend = (np.arange(n) % 2000) > 1000
    turning, aside = np.where(bend, speed / radius, 0.0), np.where(bend, slip, 0.0)
    yaw, off = errors(5.0, np.full(n, 0.01), turning, aside, speed, 0)
    assert np.abs(yaw[1000:]).max() < np.radians(1.0)
    assert np.abs(off[1000:]).max() < np.radians(0.2)
