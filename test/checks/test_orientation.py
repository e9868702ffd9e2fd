"""How the axes of a sensor lie, on a drive in closed form whose sensor is turned by each of the 24 rotations."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthetic_motion import (
    GNSS_SIGNALS,
    IMU,
    INERTIAL,
    STEERED,
    STEERING,
    WHEEL_SIGNALS,
    WHEELS,
    Array,
    Drive,
    late,
    only,
    subject_of,
)
from vsense_ros.checks.consistency import SIDES
from vsense_ros.checks.conventions import conventions
from vsense_ros.checks.finding import Finding, Kind, Scale, Turn
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.relations import signed_correlation

RATES, FORCES = ("wx", "wy", "wz"), ("ax", "ay", "az")
BOTH = ("angular_velocity", "linear_acceleration")
SIGNED_PERMUTATIONS = [
    np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)
]
ROTATIONS = [matrix for matrix in SIGNED_PERMUTATIONS if np.linalg.det(matrix) > 0]
REFLECTIONS = [matrix for matrix in SIGNED_PERMUTATIONS if np.linalg.det(matrix) < 0]
REAL = {name: values for name, values in Drive().signals().items() if name not in "xy"}


def turned(signals: dict[str, Array], matrix: Array, *vectors: tuple[str, ...]) -> dict[str, Array]:
    """What a sensor measures whose axes are the rows of a matrix, in those of the car."""
    result = dict(signals)
    for names in vectors:
        result |= dict(zip(names, matrix @ np.array([signals[name] for name in names]), strict=True))
    return result


def found(signals: dict[str, Array]) -> list[Finding]:
    return list(conventions(subject_of(signals)))


def test_nothing_is_exchanged_where_all_is_right():
    assert found(REAL) == []


@pytest.mark.parametrize("matrix", [m for m in ROTATIONS if not np.array_equal(m, np.eye(3))], ids=str)
def test_the_rotation_of_a_sensor_is_named_and_its_inverse_mends_it(matrix):
    (finding,) = found(turned(REAL, matrix, RATES, FORCES))
    assert (finding.topic, finding.kind, finding.reason) == (IMU, Kind.AXES, Reason.SENSOR_TURNED)
    assert isinstance(finding.mend, Turn)
    assert finding.mend.fields == BOTH
    np.testing.assert_array_equal(np.array(finding.mend.matrix) @ matrix, np.eye(3))


@settings(max_examples=10, deadline=None)
@given(matrix=st.sampled_from(REFLECTIONS))
def test_accelerometers_whose_axes_are_exchanged_are_named_apart_from_the_gyros(matrix):
    (finding,) = found(turned(REAL, matrix, FORCES))
    named = {
        (1.0, -1.0, 1.0): (Reason.LATERAL_REVERSED, "linear_acceleration.y"),
        (-1.0, 1.0, 1.0): (Reason.LONGITUDINAL_REVERSED, "linear_acceleration.x"),
        (-1.0, -1.0, -1.0): (Reason.FORCES_ALL_REVERSED, "linear_acceleration"),
    }
    expected = named.get(tuple(np.diag(matrix)), (Reason.FORCE_AXES_EXCHANGED, "linear_acceleration"))
    assert (finding.reason, finding.signal) == expected
    assert isinstance(finding.mend, Turn)
    np.testing.assert_array_equal(np.array(finding.mend.matrix) @ matrix, np.eye(3))


def test_accelerometers_that_are_turned_without_the_gyros_are_named_so():
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    (finding,) = found(turned(REAL, quarter @ quarter, FORCES))
    assert isinstance(finding.mend, Turn)
    # Gyros of a sensor turned by 180° about z measure the same yaw rate: both may be turned.
    assert finding.reason is Reason.SENSOR_TURNED
    downwards = np.diag([1.0, -1.0, -1.0])
    assert [f.reason for f in found(turned(REAL, downwards, FORCES))] == [Reason.FORCE_AXES_TURNED]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_gyros_alone_are_brought_so_that_the_turning_is_on_z(axis, sign):
    row = sign * np.eye(3)[axis]
    signals = only(REAL, *GNSS_SIGNALS, *WHEEL_SIGNALS)
    others = ("wx", "wy")
    rates = {RATES[axis]: sign * REAL["wz"]}
    rates |= {RATES[i]: REAL[other] for i, other in zip([i for i in range(3) if i != axis], others, strict=True)}
    result = found({**signals, **rates})
    if axis == 2 and sign > 0:
        assert result == []
        return
    (finding,) = result
    reversed_yaw_rate = (Reason.TURNS_AGAINST, "angular_velocity.z")
    expected = reversed_yaw_rate if axis == 2 else (Reason.RATE_AXES, "angular_velocity")
    assert (finding.reason, finding.signal) == expected
    assert isinstance(finding.mend, Turn)
    matrix = np.array(finding.mend.matrix)
    np.testing.assert_array_equal(matrix[2], row)
    assert np.linalg.det(matrix) == pytest.approx(1.0)


@pytest.mark.parametrize("seconds", [1.3, -1.3])
def test_the_clock_of_a_turned_sensor_plays_no_part(seconds):
    delayed = {name: v for name, v in Drive().signals(late(seconds, *INERTIAL)).items() if name not in "xy"}
    for matrix in ROTATIONS[1::5]:
        (finding,) = found(turned(delayed, matrix, RATES, FORCES))
        assert isinstance(finding.mend, Turn)
        np.testing.assert_array_equal(np.array(finding.mend.matrix) @ matrix, np.eye(3))


def test_two_axes_of_an_accelerometer_show_how_they_lie():
    exchanged = {**only(REAL, *GNSS_SIGNALS, "wz"), "ax": REAL["ay"], "ay": REAL["ax"]}
    (finding,) = found(exchanged)
    assert isinstance(finding.mend, Turn)
    np.testing.assert_array_equal(np.array(finding.mend.matrix), [[0, 1, 0], [1, 0, 0], [0, 0, 1]])


def test_a_lateral_accelerometer_alone_shows_its_sign():
    alone = only(REAL, *GNSS_SIGNALS, "wz")
    assert found({**alone, "ay": REAL["ay"]}) == []
    (finding,) = found({**alone, "ay": -REAL["ay"]})
    assert (finding.kind, finding.reason) == (Kind.SIGN, Reason.LATERAL_REVERSED)
    assert finding.mend == Turn(("linear_acceleration",), ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)))


def test_a_drive_without_braking_does_not_mend_axes_wrongly():
    half_turn = np.diag([-1.0, -1.0, 1.0])
    signals = {name: v for name, v in Drive(pushing=0.05).signals().items() if name not in "xy"}
    for finding in found(turned(signals, half_turn, RATES, FORCES)):
        if finding.mend is not None:
            assert isinstance(finding.mend, Turn)
            np.testing.assert_array_equal(np.array(finding.mend.matrix), half_turn)


def test_axes_are_not_determined_by_a_drive_without_turning_or_without_a_speed():
    half_turn = np.diag([-1.0, -1.0, 1.0])
    for drive in (Drive(turning=0.05), Drive(duration=2.2)):
        signals = {name: v for name, v in drive.signals().items() if name not in "xy"}
        assert found(turned(signals, half_turn, RATES, FORCES)) == [], drive
    slow = {name: v for name, v in Drive(speed=2.0, pushing=0.3).signals().items() if name not in "xy"}
    assert found(turned(slow, half_turn, RATES, FORCES)) == []
    assert found(turned(only(REAL, *INERTIAL), half_turn, RATES, FORCES)) == []


@pytest.mark.parametrize("name", STEERED)
def test_a_reversed_steering_angle_is_named_with_its_mend(name):
    (finding,) = found({**REAL, name: -REAL[name]})
    assert (finding.topic, finding.kind, finding.reason) == (STEERING, Kind.SIGN, Reason.TURNS_AGAINST)
    assert (finding.signal, finding.against) == (name, "gnss")
    assert finding.mend == Scale("position", -1.0, name)


def test_wheels_of_the_left_that_are_called_those_of_the_right_are_named():
    exchanged = {f"wheel_{a}{s}": REAL[f"wheel_{a}{'r' if s == 'l' else 'l'}"] for a in "fr" for s in "lr"}
    (finding,) = found({**REAL, **exchanged})
    assert (finding.topic, finding.kind, finding.reason) == (WHEELS, Kind.AXES, Reason.WHEEL_SIDES)
    assert (finding.against, finding.mend) == ("gnss", SIDES)


def test_where_the_velocity_is_in_north_east_it_is_named_beside_a_reversed_steering_and_nobody_else():
    signals = {**Drive().signals(), "steering_wheel": -REAL["steering_wheel"]}
    assert len(found(signals)) == 1
    signals["east"], signals["north"] = signals["north"], signals["east"]
    assert [finding.reason for finding in found(signals)] == [Reason.VELOCITY_EXCHANGED, Reason.TURNS_AGAINST]


@settings(max_examples=25, deadline=None)
@given(scale=st.sampled_from([-60.0, -0.1, 0.1, 60.0]), lag=st.integers(-100, 100), seed=st.integers(0, 5))
def test_a_correlation_has_the_sign_that_two_signals_have_whatever_their_size_and_lag(scale, lag, seed):
    signal = np.convolve(np.random.default_rng(seed).normal(size=1500), np.ones(10), mode="same")
    correlation = signed_correlation(scale * np.roll(signal, lag), signal, 0.02)
    assert np.sign(correlation) == np.sign(scale)
    # Signals that go along without a lag are compared without one, though a small one would fit better.
    without = abs(lag) < 10 and scale > 0 and np.corrcoef(scale * np.roll(signal, lag), signal)[0, 1] > 0.6
    assert abs(correlation) == pytest.approx(1.0, abs=0.4 if without else 0.05)


def test_a_correlation_of_too_short_signals_is_none():
    assert signed_correlation(np.array([1.0]), np.array([1.0]), 0.02) == 0.0
