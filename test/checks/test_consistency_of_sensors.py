"""Signs and axes by which sensors contradict each other, on drives in closed form with one of them made wrong."""

from __future__ import annotations

import numpy as np
import pytest

from synthetic_motion import (
    GNSS_SIGNALS,
    GRAVITY,
    IMU,
    POSITION,
    STEERED,
    STEERING,
    VELOCITY,
    WHEEL_SIGNALS,
    WHEELS,
    Array,
    Drive,
    motion_by,
    only,
    subject_of,
)
from vsense_ros.checks.consistency import (
    SIDES,
    axes_in_plane,
    gyro_axes,
    reversed_turning,
    turning,
    wheel_ratios,
)
from vsense_ros.checks.finding import Confidence, Finding, Kind, Scale
from vsense_ros.checks.reason import Reason

FORCES = "linear_acceleration"
LEFT_AND_RIGHT = {"wheel_fl": "wheel_fr", "wheel_fr": "wheel_fl", "wheel_rl": "wheel_rr", "wheel_rr": "wheel_rl"}


def reversed_(signals: dict[str, Array], *names: str) -> dict[str, Array]:
    return {name: -values if name in names else values for name, values in signals.items()}


def mirrored(signals: dict[str, Array]) -> dict[str, Array]:
    """The drive as a mirror shows it: all that is to the left is to the right."""
    return reversed_(
        {LEFT_AND_RIGHT.get(name, name): values for name, values in signals.items()},
        "north", "y", "wx", "wz", "ay", *STEERED,
    )  # fmt: skip


@pytest.mark.parametrize("change", [dict, mirrored])
def test_sensors_that_turn_alike_are_right_to_either_side(change):
    subject = subject_of(change(Drive().signals()))
    for check in (turning, gyro_axes, axes_in_plane, wheel_ratios):
        assert list(check(subject, [])) == [], check.__name__


def test_swapping_left_and_right_of_the_whole_drive_swaps_the_sign_of_every_turning():
    one, other = motion_by(Drive().signals()), motion_by(mirrored(Drive().signals()))
    assert one.turns.keys() == other.turns.keys()
    for name, turn in one.turns.items():
        np.testing.assert_allclose(other.turns[name], -turn, atol=1e-9)


WRONG = {
    "wz": ({"wz"}, (IMU, Kind.SIGN, Reason.TURNS_AGAINST, "angular_velocity.z", None)),
    "steering_wheel": (
        {"steering_wheel"},
        (STEERING, Kind.SIGN, Reason.TURNS_AGAINST, "steering_wheel", Scale("position", -1.0, "steering_wheel")),
    ),
    "road_wheel_front": (
        {"road_wheel_front"},
        (STEERING, Kind.SIGN, Reason.TURNS_AGAINST, "road_wheel_front", Scale("position", -1.0, "road_wheel_front")),
    ),
    "north": ({"north"}, (VELOCITY, Kind.FRAME, Reason.COURSE_AGAINST, "", None)),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("change", [dict, mirrored])
def test_who_turns_against_the_others_is_named(name, change):
    wrong, expected = WRONG[name]
    signals = {name: values for name, values in Drive().signals().items() if name not in "xy"}
    subject = subject_of(change(reversed_(signals, *wrong)))
    (finding,) = turning(subject, [])
    assert (finding.topic, finding.kind, finding.reason, finding.signal, finding.mend) == expected
    assert finding.against not in ("", name)


def test_wheels_whose_sides_are_exchanged_are_named_with_what_exchanges_them_again():
    signals = {LEFT_AND_RIGHT.get(name, name): values for name, values in Drive().signals().items()}
    (finding,) = turning(subject_of(signals), [])
    assert (finding.topic, finding.kind, finding.reason, finding.mend) == (WHEELS, Kind.AXES, Reason.WHEEL_SIDES, SIDES)
    assert dict(SIDES.names) == LEFT_AND_RIGHT


def test_a_position_whose_course_turns_against_the_others_is_named_where_there_is_no_velocity():
    signals = reversed_(Drive().signals(), "y")
    del signals["east"], signals["north"]
    (finding,) = turning(subject_of(signals), [])
    assert (finding.topic, finding.kind, finding.reason) == (POSITION, Kind.AXES, Reason.POSITION_COURSE_AGAINST)


def test_a_velocity_that_is_blamed_already_is_not_blamed_again():
    signals = {name: values for name, values in Drive().signals().items() if name not in "xy"}
    subject = subject_of(reversed_(signals, "north"))
    assert list(turning(subject, [Finding(VELOCITY, Kind.FRAME, Reason.VELOCITY_EXCHANGED)])) == []
    assert [f.topic for f in turning(subject, [Finding(POSITION, Kind.JUMP, Reason.POSITION_JUMPS)])] == [VELOCITY]


def test_of_two_that_contradict_each_other_the_one_that_is_trusted_less_is_wrong():
    signals = only(reversed_(Drive().signals(), "wz"), *GNSS_SIGNALS, "wz")
    assert reversed_turning(motion_by(signals)) == {"gyro": "gnss"}


def test_a_car_that_does_not_turn_contradicts_nobody():
    subject = subject_of(reversed_(Drive(turning=0.05).signals(), "wz"))
    assert list(turning(subject, [])) == []
    assert list(turning(subject_of(only(Drive().signals(), "wz")), [])) == []


@pytest.mark.parametrize(("axis", "sign"), [("wx", 1.0), ("wx", -1.0), ("wy", 1.0), ("wy", -1.0)])
@pytest.mark.parametrize("names", [(*GNSS_SIGNALS,), WHEEL_SIGNALS])
def test_the_axis_of_the_gyro_that_the_car_turns_about_is_named(axis, sign, names):
    signals = Drive().signals()
    signals[axis], signals["wz"] = sign * signals["wz"], signals[axis]
    (finding,) = gyro_axes(subject_of(only(signals, *names, "wx", "wy", "wz")), [])
    assert (finding.topic, finding.kind, finding.reason) == (IMU, Kind.AXES, Reason.TURN_AXIS)
    assert finding.names == {"axis": axis[1]}
    assert finding.evidence["correlation"] > 0.95


@pytest.mark.parametrize(
    "change",
    [
        lambda s: {**s, "wx": s["wz"]},  # axis z turns as well
        lambda s: {**s, "wx": 3.0 * s["wz"], "wz": s["wx"]},  # more than the car turns
        lambda s: {**s, "wx": 0.3 * s["wz"], "wz": s["wx"]},  # less than it
        lambda s: {**s, "wx": s["wz"] + 4 * s["wx"], "wz": s["wx"]},  # something else beside
        lambda s: {name: values for name, values in s.items() if name != "wz"},
    ],
)
def test_an_axis_is_not_that_of_the_turning_where_z_is_or_its_size_or_shape_is_another(change):
    assert list(gyro_axes(subject_of(change(Drive().signals())), [])) == []


def test_a_car_that_hardly_turns_shows_no_axis():
    signals = Drive(turning=0.12).signals()
    signals["wx"], signals["wz"] = signals["wz"], signals["wx"]
    assert list(gyro_axes(subject_of(signals), [])) == []


# What the accelerometer measures, of the forward and left acceleration.
PLANE = {
    Reason.FORCES_REVERSED: (((-1, 0), (0, -1)), Kind.AXES, FORCES),
    Reason.LATERAL_REVERSED: (((1, 0), (0, -1)), Kind.SIGN, f"{FORCES}.y"),
    Reason.LONGITUDINAL_REVERSED: (((-1, 0), (0, 1)), Kind.SIGN, f"{FORCES}.x"),
    Reason.FORCES_EXCHANGED: (((0, 1), (1, 0)), Kind.AXES, FORCES),
    Reason.FORCES_QUARTER_TURN: (((0, 1), (-1, 0)), Kind.AXES, FORCES),
    Reason.FORCES_EXCHANGED_REVERSED: (((0, -1), (-1, 0)), Kind.AXES, FORCES),
}


def felt(signals: dict[str, Array], matrix: object, scale: float = 1.0, offset: float = 0.0) -> dict[str, Array]:
    along, left = scale * np.array(matrix, float) @ np.array([signals["ax"], signals["ay"]]) + offset
    return {**signals, "ax": along, "ay": left}


@pytest.mark.parametrize("reason", PLANE)
@pytest.mark.parametrize("scale", [1.0, 1 / GRAVITY])
def test_the_axes_of_an_accelerometer_in_the_plane_are_named_in_either_unit(reason, scale):
    matrix, kind, signal = PLANE[reason]
    (finding,) = axes_in_plane(subject_of(felt(Drive().signals(), matrix, scale)), [])
    assert (finding.topic, finding.kind, finding.reason, finding.signal) == (IMU, kind, reason, signal)
    assert finding.confidence is Confidence.LIKELY
    assert finding.evidence["ratio"] == pytest.approx(scale, rel=0.05)
    assert finding.evidence["error"] < 0.2 < finding.evidence["error_as_it_is"]


def test_a_quarter_turn_to_the_other_side_is_one_as_well():
    (finding,) = axes_in_plane(subject_of(felt(Drive().signals(), ((0, -1), (1, 0)))), [])
    assert finding.reason is Reason.FORCES_QUARTER_TURN


def test_a_tilted_accelerometer_is_right_and_one_in_g_is_named():
    signals = Drive().signals()
    assert list(axes_in_plane(subject_of(felt(signals, np.eye(2), offset=0.8)), [])) == []
    (finding,) = axes_in_plane(subject_of(felt(signals, np.eye(2), 1 / GRAVITY)), [])
    assert (finding.kind, finding.reason, finding.signal) == (Kind.UNIT, Reason.FORCES_TENTH, FORCES)
    noise = np.random.default_rng(0).normal(size=(2, len(signals["ax"])))
    unlike = {**signals, "ax": noise[0], "ay": noise[1]}
    assert list(axes_in_plane(subject_of(unlike), [])) == []


@pytest.mark.parametrize(
    ("drive", "names", "reason"),
    [
        (Drive(pushing=0.0), ("ay",), Reason.LATERAL_REVERSED),
        (Drive(turning=0.0), ("ax",), Reason.LONGITUDINAL_REVERSED),
    ],
)
def test_where_an_axis_alone_is_driven_along_a_turned_sensor_may_be_a_reversed_axis(drive, names, reason):
    for more in ((), ("ax", "ay")):
        signals = reversed_(drive.signals(), *names, *more)
        signals = {**signals, "wz": drive.signals()["wz"]}
        (finding,) = axes_in_plane(subject_of(signals), [])
        assert (finding.reason, finding.confidence) == (reason, Confidence.UNDECIDED)


def test_a_lateral_acceleration_alone_is_judged_by_the_turning():
    signals = only(reversed_(Drive().signals(), "ay"), *GNSS_SIGNALS, "ay", "wz")
    (finding,) = axes_in_plane(subject_of(signals), [])
    assert (finding.topic, finding.reason) == (IMU, Reason.LATERAL_REVERSED)
    assert list(axes_in_plane(subject_of(only(Drive().signals(), *GNSS_SIGNALS, "ay", "wz")), [])) == []


def test_accelerations_are_not_judged_by_a_source_that_is_doubted_or_a_drive_that_is_too_slow_or_short():
    signals = felt(Drive().signals(), ((-1, 0), (0, -1)))
    everyone = [Finding(topic, Kind.SIGN, Reason.TURNS_AGAINST) for topic in (IMU, VELOCITY, WHEELS)]
    assert list(axes_in_plane(subject_of(signals), everyone)) == []
    assert list(axes_in_plane(subject_of(signals), everyone[:2])) != []
    jumps = [Finding(topic, Kind.JUMP, Reason.SIGNAL_JUMPS) for topic in (IMU, VELOCITY, WHEELS)]
    assert list(axes_in_plane(subject_of(signals), jumps)) != []
    short = {name: values[:110] for name, values in signals.items()}
    assert list(axes_in_plane(subject_of(short), [])) == []
    calm = felt(Drive(turning=0.1, pushing=0.1).signals(), ((-1, 0), (0, -1)))
    assert list(axes_in_plane(subject_of(calm), [])) == []


def test_a_gyro_in_degrees_per_second_judges_the_accelerometer_in_its_own_unit():
    signals = Drive().signals()
    signals["wz"] = np.degrees(signals["wz"])
    assert list(axes_in_plane(subject_of(signals), [])) == []
    (finding,) = axes_in_plane(subject_of(reversed_(signals, "ay")), [])
    assert finding.reason is Reason.LATERAL_REVERSED


@pytest.mark.parametrize(
    ("factor", "kind"), [(0.5, Kind.UNIT), (1.2, Kind.UNIT), (-1.0, Kind.SIGN), (0.93, None), (1.07, None)]
)
@pytest.mark.parametrize("name", WHEEL_SIGNALS)
def test_a_wheel_that_turns_otherwise_than_the_others_is_named_with_its_ratio(name, factor, kind):
    signals = Drive().signals()
    signals[name] = factor * signals[name]
    found = list(wheel_ratios(subject_of(signals), []))
    if kind is None:
        assert found == []
        return
    (finding,) = found
    assert (finding.topic, finding.kind, finding.reason, finding.signal) == (WHEELS, kind, Reason.WHEEL_RATIO, name)
    assert finding.evidence["ratio"] == pytest.approx(factor, rel=0.02)


def test_wheels_are_not_compared_where_there_are_two_or_the_car_stands():
    signals = Drive().signals()
    signals["wheel_fl"] = 0.5 * signals["wheel_fl"]
    assert list(wheel_ratios(subject_of(only(signals, "wheel_fl", "wheel_fr")), [])) == []
    slow = Drive(speed=2.0, pushing=0.3).signals()
    slow["wheel_fl"] = 0.5 * slow["wheel_fl"]
    assert list(wheel_ratios(subject_of(slow), [])) == []
    short = {name: values[:100] for name, values in signals.items()}
    assert list(wheel_ratios(subject_of(short), [])) == []
    backwards = reversed_(Drive().signals(), *WHEEL_SIGNALS)
    assert list(wheel_ratios(subject_of(backwards), [])) == []
