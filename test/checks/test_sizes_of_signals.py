"""Units and sizes: of each signal alone, and against the motion of a drive in closed form."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synthetic_motion import (
    GNSS_SIGNALS,
    GRAVITY,
    IMU,
    POSITION,
    STEERING,
    VELOCITY,
    WHEEL_SIGNALS,
    WHEELS,
    Array,
    Drive,
    only,
    recorded,
    subject_of,
)
from vsense_ros.bag.importers import build
from vsense_ros.checks.finding import Confidence, Finding, Kind, Scale
from vsense_ros.checks.motion import SETTINGS as CAR
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.subject import Subject
from vsense_ros.checks.units import (
    brake_pressure,
    gravity,
    position_range,
    rolling,
    steering_range,
    steering_size,
    yaw_rate,
)

ROWS = 100
STAMP = build.nanoseconds(np.arange(ROWS) * 0.02, 1_600_000_000_000_000_000)


def at_rest(*forces: float) -> Subject:
    return recorded(build.imu(STAMP, np.zeros((ROWS, 3)), np.tile(np.array(forces, float), (ROWS, 1))))


@pytest.mark.parametrize("size", [1.0, 0.92, 1.08, 0.05, 0.85, 1.2, 7.0, 8.4, 11.2, 12.0, 98.0])
def test_the_size_of_a_specific_force_at_rest_is_gravity_or_tells_what_it_is(size):
    expected = None
    if abs(size - 1) < 0.1:
        expected = Reason.FORCE_IN_G
    elif size < 1.0:
        expected = Reason.NO_GRAVITY
    elif abs(size - GRAVITY) > 1.5:
        expected = Reason.FORCE_SIZE
    found = list(gravity(at_rest(0.0, 0.0, size), []))
    assert [finding.reason for finding in found] == ([] if expected is None else [expected])
    for finding in found:
        assert (finding.kind, finding.confidence) == (Kind.UNIT, Confidence.CERTAIN)
        assert finding.evidence["size"] == pytest.approx(size)
        in_g = Scale("linear_acceleration", GRAVITY, given="g", expected="m/s²")
        assert finding.mend == (in_g if expected is Reason.FORCE_IN_G else None)


@pytest.mark.parametrize("axis", ["+x", "-x", "+y", "-y", "-z"])
@pytest.mark.parametrize("unit", [1.0, GRAVITY])
def test_the_axis_of_gravity_is_named_in_either_unit(axis, unit):
    forces = np.zeros(3)
    forces["xyz".index(axis[1])] = unit if axis[0] == "+" else -unit
    (finding,) = [f for f in gravity(at_rest(*forces), []) if f.reason is Reason.GRAVITY_AXIS]
    assert finding.names == {"axis": axis}
    assert finding.evidence["size"] == pytest.approx(forces.sum())
    assert finding.kind is Kind.AXES


def test_forces_without_gravity_lie_on_no_axis_and_absent_ones_are_not_judged():
    assert [f.reason for f in gravity(at_rest(0.3, 0.0, 0.0), [])] == [Reason.NO_GRAVITY]
    assert list(gravity(at_rest(np.nan, np.nan, np.nan), [])) == []
    assert list(gravity(at_rest(np.nan, 0.0, 9.81), [])) == []
    assert list(gravity(recorded(), [])) == []


def reasons(found: list[Finding]) -> list[Reason]:
    return [finding.reason for finding in found]


def driven(
    change: Callable[[dict[str, Array]], Mapping[str, Array]], radius: float | None = None, **drive: float
) -> Subject:
    return subject_of(change(only(Drive(**drive).signals(), *GNSS_SIGNALS, "wz", *WHEEL_SIGNALS)), radius=radius)


def wheels_by(factor: float) -> Callable[[dict[str, Array]], Mapping[str, Array]]:
    return lambda s: {name: v * factor if name in WHEEL_SIGNALS else v for name, v in s.items()}


UNITS = {"m/s": CAR.rolling_radius, "km/h": CAR.rolling_radius * 3.6, "rpm": 60 / (2 * np.pi), "deg/s": 180 / np.pi}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("radius", [None, CAR.rolling_radius])
def test_the_unit_of_wheel_speeds_is_named_with_what_takes_it_to_radians(unit, radius):
    (finding,) = rolling(driven(wheels_by(UNITS[unit]), radius), [])
    assert (finding.topic, finding.kind, finding.reason) == (WHEELS, Kind.UNIT, Reason.WHEELS_UNIT)
    assert finding.against == VELOCITY
    assert isinstance(finding.mend, Scale)
    assert (finding.mend.given, finding.mend.expected) == (unit, "rad/s")
    assert finding.mend.factor * UNITS[unit] == pytest.approx(1.0, rel=1e-6)
    assert finding.evidence["ratio"] == pytest.approx(CAR.rolling_radius / UNITS[unit], rel=0.01)


def test_speeds_are_divided_by_the_radius_of_the_car_where_that_is_known():
    (finding,) = rolling(driven(wheels_by(CAR.rolling_radius), 0.4), [])
    assert isinstance(finding.mend, Scale)
    assert finding.mend.factor == pytest.approx(1 / 0.4)


@pytest.mark.parametrize(
    ("rolls_at", "known", "expected"),
    [
        (0.32, None, []), (0.22, None, []), (0.55, None, []),
        (0.15, None, [Reason.WHEELS_RADIUS]), (0.75, None, [Reason.WHEELS_RADIUS]),
        (0.15, 0.16, []), (0.15, 0.14, []), (0.15, 0.3, [Reason.WHEELS_RADIUS]),
    ],
)  # fmt: skip
def test_a_ratio_that_is_no_radius_of_a_car_is_named_unless_the_vehicle_file_says_so(rolls_at, known, expected):
    found = list(rolling(driven(wheels_by(CAR.rolling_radius / rolls_at), known), []))
    assert reasons(found) == expected
    assert all(finding.evidence["ratio"] == pytest.approx(rolls_at, rel=0.01) for finding in found)


def test_wheels_that_turn_backwards_are_reversed_and_their_unit_is_still_looked_at():
    (sign,) = rolling(driven(wheels_by(-1.0)), [])
    assert (sign.kind, sign.reason, sign.mend) == (Kind.SIGN, Reason.WHEELS_BACKWARDS, Scale("velocity", -1.0))
    assert sign.evidence["ratio"] == pytest.approx(-CAR.rolling_radius, rel=0.01)
    assert reasons(list(rolling(driven(wheels_by(-CAR.rolling_radius)), []))) == [
        Reason.WHEELS_BACKWARDS,
        Reason.WHEELS_UNIT,
    ]


def test_a_radius_is_not_determined_by_wheels_that_slip():
    def slipping(s: dict[str, Array]) -> dict[str, Array]:
        slip = 1.0 + 0.4 * np.sin(np.arange(len(s["east"])) * 0.05)
        return {name: v * slip * CAR.rolling_radius if name in WHEEL_SIGNALS else v for name, v in s.items()}

    assert list(rolling(driven(slipping), [])) == []


def test_a_small_wheel_and_an_antenna_beside_the_car_in_a_bend_are_not_taken_for_km_per_hour():
    in_kmh = wheels_by(CAR.rolling_radius * 3.6)
    t = np.arange(0.0, 40.0, 0.02)
    for turning, expected in ((0.0, [Reason.WHEELS_UNIT]), (0.3, [])):
        bend = {
            "east": 12 * np.cos(turning * t), "north": 12 * np.sin(turning * t),
            **dict.fromkeys(WHEEL_SIGNALS, 0 * t + 12 / CAR.rolling_radius),
        }  # fmt: skip
        assert reasons(list(rolling(subject_of(in_kmh(bend)), []))) == expected


def test_a_circle_on_which_an_antenna_may_be_faster_than_the_wheels_is_no_reason_to_doubt_the_radius():
    """An antenna 1.4 m outwards on a circle of 10 m is faster than the car by 14 %; on a straight it is not."""
    t = np.arange(0.0, 40.0, 0.02)
    for turning, expected in ((0.0, [Reason.WHEELS_RADIUS_OF_FILE]), (1.0, [])):
        along = {"east": 11.4 * np.cos(turning * t), "north": 11.4 * np.sin(turning * t)}
        drive = {**along, **dict.fromkeys(WHEEL_SIGNALS, 0 * t + 10.0 / CAR.rolling_radius)}
        assert reasons(list(rolling(subject_of(drive, radius=CAR.rolling_radius), []))) == expected


def test_a_small_wheel_that_slips_while_the_car_brakes_all_the_time_is_not_taken_for_km_per_hour():
    """A wheel of 0.269 m with a slip of 2 % rolls at 0.2746 m, 1 % from km/h."""
    t = np.arange(0.0, 10.0, 0.02)
    for braking, expected in ((0.0, [Reason.WHEELS_UNIT]), (2.0, [])):
        speed = 30.0 - braking * t
        drive = {"east": speed, "north": 0 * t, **dict.fromkeys(WHEEL_SIGNALS, speed / 0.2746)}
        assert reasons(list(rolling(subject_of(drive), []))) == expected


@settings(max_examples=10, deadline=None)
@given(heading=st.floats(-3, 3))
def test_findings_of_wheels_do_not_depend_on_where_a_drive_leads(heading):
    (finding,) = rolling(driven(wheels_by(CAR.rolling_radius), heading=heading), [])
    assert finding.evidence["ratio"] == pytest.approx(1.0, rel=0.01)


def by_gyro(factor: float, *names: str) -> Subject:
    signals = Drive().signals()
    signals["wz"] = factor * signals["wz"]
    return subject_of(only(signals, "wz", *names))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("factor", "by_gnss", "by_wheels"),
    [
        (180 / np.pi, Reason.RATE_IN_DEGREES, Reason.RATE_IN_DEGREES),
        (28.0, Reason.RATE_SIZE, Reason.RATE_SIZE), (120.0, Reason.RATE_SIZE, Reason.RATE_SIZE),
        (1.9, None, None), (2.1, Reason.RATE_SIZE, None), (3.3, Reason.RATE_SIZE, Reason.RATE_SIZE),
        (0.54, None, None), (0.46, Reason.RATE_SIZE, None), (0.27, Reason.RATE_SIZE, Reason.RATE_SIZE),
    ],
)  # fmt: skip
def test_the_size_of_a_yaw_rate_is_judged_by_gnss_and_more_gently_by_wheels(factor, by_gnss, by_wheels, sign):
    for names, expected in ((GNSS_SIGNALS, by_gnss), (WHEEL_SIGNALS, by_wheels)):
        found = list(yaw_rate(by_gyro(sign * factor, *names), []))
        assert reasons(found) == ([] if expected is None else [expected])
        for finding in found:
            assert (finding.topic, finding.signal) == (IMU, "angular_velocity.z")
            assert finding.evidence["ratio"] == pytest.approx(factor, rel=0.03)
            degrees = Scale("angular_velocity", np.pi / 180, given="deg/s", expected="rad/s")
            assert finding.mend == (degrees if expected is Reason.RATE_IN_DEGREES else None)


def test_a_yaw_rate_that_is_unlike_the_turning_has_no_size():
    signals = only(Drive().signals(), *GNSS_SIGNALS, "wz", "wx")
    signals["wz"] = 57.3 * (signals["wz"] + 2 * signals["wx"])
    assert list(yaw_rate(subject_of(signals), [])) == []
    straight = only(Drive(turning=0.02).signals(), *GNSS_SIGNALS, "wz")
    straight["wz"] = 57.3 * straight["wz"]
    assert list(yaw_rate(subject_of(straight), [])) == []


def steered(**angles: float) -> Subject:
    shape = np.sin(np.arange(ROWS) * 0.1)
    values = {name: largest * shape / np.abs(shape).max() for name, largest in angles.items()}
    return recorded(build.joints(STEERING, STAMP, "position", values))


@pytest.mark.parametrize(
    ("angles", "named"),
    [
        ({"steering_wheel": 14.9}, []), ({"steering_wheel": 15.1}, ["steering_wheel"]),
        ({"steering_wheel": -15.1}, ["steering_wheel"]), ({"road_wheel_front": 1.19}, []),
        ({"road_wheel_front": 1.21}, ["road_wheel_front"]),
        ({"steering_wheel": 400.0, "road_wheel_front": 0.5}, ["steering_wheel"]),
    ],
)  # fmt: skip
def test_a_steering_angle_that_no_car_reaches_is_in_degrees(angles, named):
    found = list(steering_range(steered(**angles), []))
    assert [finding.signal for finding in found] == named
    for finding in found:
        assert (finding.reason, finding.confidence) == (Reason.STEERING_RANGE, Confidence.CERTAIN)
        assert finding.evidence["largest"] == pytest.approx(abs(angles[finding.signal]))
        assert finding.mend == Scale("position", np.pi / 180, finding.signal, "deg", "rad")


@pytest.mark.parametrize("name", ["steering_wheel", "road_wheel_front"])
@pytest.mark.parametrize(("factor", "named"), [(1.0, False), (-1.0, False), (57.3, True), (-57.3, True)])
def test_a_steering_angle_that_is_large_for_how_the_car_turns_is_in_degrees(name, factor, named):
    signals = Drive(turning=0.2).signals()
    subject = subject_of({**only(signals, *GNSS_SIGNALS), name: 0.5 * factor * signals[name]})
    subject.recording = recorded(build.joints(STEERING, STAMP, "position", {name: np.full(ROWS, 0.1)})).recording
    found = list(steering_range(subject, []))
    assert reasons(found) == ([Reason.STEERING_SIZE] if named else [])
    for finding in found:
        assert finding.mend == Scale("position", np.pi / 180, name, "deg", "rad")
        assert finding.evidence["ratio"] > (2.0 if name == "road_wheel_front" else 40.0)


@pytest.mark.parametrize("others", [GNSS_SIGNALS, (*WHEEL_SIGNALS, "wz")])
@pytest.mark.parametrize(
    ("name", "factor", "named"),
    [
        ("steering_wheel", 1.0, False), ("steering_wheel", 6 / 16, False), ("steering_wheel", -25 / 16, False),
        ("steering_wheel", 1 / 16, True),  # that of the road wheels
        ("steering_wheel", 1 / 8 / np.pi, True),  # a share of two turns
        ("road_wheel_front", 1.0, False), ("road_wheel_front", 16.0, True),
    ],
)  # fmt: skip
def test_a_steering_angle_in_which_no_car_turns_so_is_another_part_s(name, factor, named, others):
    signals = Drive(turning=0.2).signals()
    subject = subject_of({**only(signals, *others), name: factor * signals[name]})
    found = list(steering_size(subject, []))
    assert reasons(found) == ([Reason.STEERING_TURNS] if named else [])
    assert [finding.signal for finding in found] == [name] * named
    assert list(steering_size(subject, found)) == []


@pytest.mark.parametrize(("others", "named"), [((), True), (("wz",), False), (GNSS_SIGNALS, False)])
def test_where_a_car_goes_straight_ahead_the_slip_of_its_wheels_is_not_held_against_the_steering(others, named):
    """Without GNSS and a gyro, it is not known that the car goes straight ahead."""
    slipping, straight = Drive(turning=0.2).signals(), Drive(turning=0.005).signals()
    signals = {**only(slipping, *WHEEL_SIGNALS), **only(straight, *others)}
    found = list(steering_size(subject_of({**signals, "steering_wheel": 0.1 * slipping["steering_wheel"]}), []))
    assert reasons(found) == ([Reason.STEERING_TURNS] if named else [])


def test_a_steering_angle_that_is_unlike_the_turning_has_no_size():
    signals = Drive().signals()
    subject = subject_of({**only(signals, *GNSS_SIGNALS), "steering_wheel": 1000 * signals["wx"]})
    subject.recording = steered(steering_wheel=1.0).recording
    assert list(steering_range(subject, [])) == list(steering_size(subject, [])) == []


def fixes(latitude: float, longitude: float) -> Subject:
    zero = np.zeros(ROWS)
    return recorded(build.fix(STAMP, zero + latitude, zero + longitude, zero))


@pytest.mark.parametrize(
    ("latitude", "longitude", "expected"),
    [
        (48.0, 11.0, None), (-48.0, -179.0, None), (89.0, 0.0, None),
        (91.0, 11.0, Reason.POSITION_RANGE), (-91.0, 11.0, Reason.POSITION_RANGE), (48.0, 181.0, Reason.POSITION_RANGE),
        (0.84, 0.19, Reason.POSITION_ZERO), (-0.84, -3.1, Reason.POSITION_ZERO), (0.0, 0.0, Reason.POSITION_ZERO),
        (1.7, 0.2, None), (0.84, 3.3, None),
    ],
)  # fmt: skip
def test_coordinates_that_are_no_degrees_are_named(latitude, longitude, expected):
    found = list(position_range(fixes(latitude, longitude), []))
    assert reasons(found) == ([] if expected is None else [expected])
    for finding in found:
        assert (finding.topic, finding.kind, finding.confidence) == (POSITION, Kind.UNIT, Confidence.CERTAIN)
        assert finding.evidence == {"latitude": abs(latitude), "longitude": abs(longitude)}


def test_fixes_without_coordinates_are_not_judged():
    assert list(position_range(fixes(np.nan, np.nan), [])) == []
    assert list(position_range(recorded(), [])) == []


@pytest.mark.parametrize(
    ("largest", "named"), [(0.4, False), (0.6, True), (120.0, True), (999.0, True), (1001.0, False)]
)
def test_a_brake_pressure_that_brakes_nothing_is_in_another_unit(largest, named):
    pressure = np.linspace(-2e6, largest, ROWS)
    channel = build.joints("vehicle/brake_pressure", STAMP, "effort", {"wheel_fl": pressure})
    found = list(brake_pressure(recorded(channel), []))
    assert reasons(found) == ([Reason.PRESSURE_SIZE] if named else [])
    assert all(finding.evidence == {"largest": largest} for finding in found)
    without = build.joints("vehicle/brake_pressure", STAMP, "position", {"wheel_fl": pressure})
    assert list(brake_pressure(recorded(without), [])) == []
