"""A reference that is wrong itself: against a drive in closed form, one thing wrong with it at a time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from synthetic_motion import STEP, Array, Drive
from vsense_ros.bag.importers import build
from vsense_ros.checks.examination import findings
from vsense_ros.checks.finding import Finding, Kind
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.reference import contradictions
from vsense_ros.checks.sentences import sentences
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.recording import Recording

START = 1_600_000_000_000_000_000
SLIP = 0.02  # [rad] side slip in a usual bend
Columns = dict[str, Array]


def columns(drive: Drive, *, slip: float = SLIP, noise: float = 0.0) -> Columns:
    """What a reference says of a drive whose side slip [rad] goes with its turning."""
    signals = drive.signals()
    course = np.unwrap(np.arctan2(signals["north"], signals["east"]))
    angle = slip * signals["wz"] / 0.2
    speed = np.hypot(signals["east"], signals["north"])
    heading, zero = course - angle, 0.0 * course
    rng = np.random.default_rng(0)
    place = np.column_stack([signals["x"], signals["y"], zero]) + noise * rng.standard_normal((len(zero), 3))
    return {
        "position": place,
        "orientation": Rotation.from_euler("z", heading[:, None]).as_quat(),
        "linear": np.column_stack([speed * np.cos(angle), speed * np.sin(angle), zero]),
        "angular": np.column_stack([zero, zero, np.gradient(heading, STEP)]),
    }


def recorded(drive: Drive, reference: Columns, late: float = 0.0, slip: float = SLIP) -> Recording:
    """The drive with a gyro, and a reference whose stamps are late by a time [s]."""
    signals = drive.signals()
    signals["wz"] = columns(drive, slip=slip)["angular"][:, 2]  # the car turns, its course besides
    stamps = build.nanoseconds(np.arange(len(signals["wz"])) * STEP, START)
    rates, forces = (np.column_stack([signals[f"{kind}{axis}"] for axis in "xyz"]) for kind in "wa")
    odometry = build.channel("reference/odometry", stamps + round(late * 1e9), reference)
    return Recording({one.topic: one for one in (build.imu(stamps, rates, forces), odometry)})


def contradicting(drive: Drive, reference: Columns, late: float = 0.0, slip: float = SLIP) -> list[Finding]:
    return list(contradictions(Subject(recorded(drive, reference, late, slip)), []))


@settings(max_examples=10, deadline=None)
@given(
    heading=st.floats(-3.1, 3.1),
    turning=st.floats(0.0, 1.5),
    slip=st.floats(-0.05, 0.05),
    noise=st.floats(0.0, 0.3),
    late=st.floats(-0.2, 0.2),
)
def test_a_reference_that_agrees_with_itself_and_the_gyro_is_not_doubted(heading, turning, slip, noise, late):
    drive = Drive(heading=heading, turning=turning)
    assert contradicting(drive, columns(drive, slip=slip, noise=noise), late, slip) == []


def in_km_h(reference: Columns) -> None:
    reference["linear"] *= 3.6


def not_filled_in(reference: Columns) -> None:
    reference["linear"] *= 0.0


def forward_right(reference: Columns) -> None:
    reference["linear"][:, 1] *= -1


def in_axes_of_the_map(reference: Columns) -> None:
    turn = Rotation.from_quat(reference["orientation"])
    reference["linear"] = turn.apply(reference["linear"])


def north_and_east(reference: Columns) -> None:
    in_axes_of_the_map(reference)
    reference["linear"] = reference["linear"][:, [1, 0, 2]]


def heading_from_north(reference: Columns) -> None:
    heading = Rotation.from_quat(reference["orientation"]).as_euler("ZYX")[:, :1]
    reference["orientation"] = Rotation.from_euler("z", np.pi / 2 - heading).as_quat()


def turned_by_a_quarter(reference: Columns) -> None:
    heading = Rotation.from_quat(reference["orientation"]).as_euler("ZYX")[:, :1]
    reference["orientation"] = Rotation.from_euler("z", heading + np.pi / 2).as_quat()


def rates_in_degrees(reference: Columns) -> None:
    reference["angular"] = np.degrees(reference["angular"])


def rates_to_the_right(reference: Columns) -> None:
    reference["angular"] *= -1


FAULTS: dict[Callable[[Columns], None], tuple[Reason, str]] = {
    in_km_h: (Reason.REFERENCE_SPEED, "3.6 times"),
    not_filled_in: (Reason.REFERENCE_SPEED, "0 times"),
    forward_right: (Reason.REFERENCE_AXES, "y were to the right"),
    in_axes_of_the_map: (Reason.REFERENCE_AXES, "east and north"),
    north_and_east: (Reason.REFERENCE_AXES, "north and east"),
    heading_from_north: (Reason.REFERENCE_AXES, "clockwise"),
    turned_by_a_quarter: (Reason.REFERENCE_ANGLE, "+90°"),
    rates_in_degrees: (Reason.REFERENCE_YAW_RATE, "57.3 times"),
    rates_to_the_right: (Reason.REFERENCE_YAW_RATE, "-1 times"),
}


@pytest.mark.parametrize("spoil", FAULTS, ids=lambda spoil: spoil.__name__)
def test_a_reference_that_contradicts_itself_is_named_with_what_is_wrong(spoil):
    drive = Drive(heading=0.4)
    reference = columns(drive)
    spoil(reference)
    reason, words = FAULTS[spoil]
    found = contradicting(drive, reference)
    assert found[0].reason is reason
    assert words in sentences(found)[0]
    assert found[0].topic == "reference/odometry"


@pytest.mark.parametrize("late", [0.4, 1.0, -0.5, -2.0])
def test_a_reference_of_another_clock_than_the_gyro_is_named_with_its_lag(late):
    drive = Drive()
    (found,) = contradicting(drive, columns(drive), late)
    assert (found.kind, found.reason) == (Kind.LAG, Reason.REFERENCE_LATE)
    assert found.evidence["imu/data"] == pytest.approx(late, abs=0.06)


def test_a_reference_of_another_day_has_no_time_in_common_with_the_sensors():
    drive = Drive()
    (found,) = contradicting(drive, columns(drive), 86_400.0)
    assert found.reason is Reason.NO_COMMON_TIME


def test_an_examination_of_a_recording_includes_its_reference():
    drive = Drive()
    reference = columns(drive)
    in_km_h(reference)
    assert Reason.REFERENCE_SPEED in [one.reason for one in findings(recorded(drive, reference))]


@pytest.mark.parametrize("absent", ["position", "orientation", "linear", "angular"])
def test_a_reference_without_a_part_is_judged_by_the_others(absent):
    drive = Drive()
    reference = columns(drive)
    reference[absent] = np.full_like(reference[absent], 0.0 if absent == "orientation" else np.nan)
    assert contradicting(drive, reference) == []
