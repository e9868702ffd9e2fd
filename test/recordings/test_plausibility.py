"""What `vsense info` finds in drives with a planted fault, and does not find in others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from marks import exam_except
from recordings import planted
from vsense_ros.bag.join import joined
from vsense_ros.checks.held import period_of_updates
from vsense_ros.checks.inspect import inspect
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording


@pytest.mark.parametrize("fault", planted.FAULTS, ids=lambda fault: fault.name)
def test_a_planted_fault_is_named(fault: planted.Fault) -> None:
    assert planted.is_named(fault, planted.drive(fault.manoeuvres[0], "prototype_real", 0))


@pytest.mark.parametrize(
    "manoeuvre",
    exam_except(
        ["double_lane_change", "steady_state_circle", "brake_in_turn", "accelerate_and_brake"],
        "double_lane_change",
        "brake_in_turn",
    ),
)
def test_nothing_is_found_in_a_clean_drive(manoeuvre: str) -> None:
    assert inspect(planted.drive(manoeuvre, "prototype_real", 0)).problems == ()


@pytest.mark.exam
def test_a_course_that_turns_before_the_car_does_is_no_late_clock() -> None:
    """At low speed a point ahead of the rear axle moves where the car will only point to later."""
    assert inspect(planted.drive("slalom", "genesis", 1)).problems == ()


def test_a_fault_is_told_of_no_other_topic() -> None:
    """Who contradicts the others is named, and nobody who is contradicted."""
    drive = planted.drive("double_lane_change", "prototype_real", 0)
    for fault in planted.FAULTS:
        if (
            fault.topic in drive
            and {"sign", "axes", "unit"} & set(fault.kinds)
            and "double_lane_change" in fault.manoeuvres
        ):
            found = inspect(planted.changed(drive, fault.topic, fault.change)).findings
            assert {finding.topic for finding in found} == {fault.topic}, fault.name


def test_a_recording_with_nothing_to_read_is_a_problem() -> None:
    drive = planted.drive("double_lane_change", "prototype_real", 0)
    odd = replace(drive["imu/data"], topic="some/imu")
    assert any("none of the topics that are read here" in p for p in inspect(Recording({"some/imu": odd})).problems)


@pytest.mark.parametrize("every", [2, 5, 10])
def test_values_that_are_held_are_told_from_those_that_rest(every: int) -> None:
    rng = np.random.default_rng(0)
    fresh = rng.normal(size=(400, 2))
    assert period_of_updates(np.repeat(fresh, every, axis=0)) == every
    assert period_of_updates(fresh) is None
    coarse = np.round(np.cumsum(rng.normal(size=(4000, 1)), axis=0) / 20)
    assert period_of_updates(coarse) is None


@pytest.mark.parametrize("offset", [0.37, -12.5, 86_400.0])
def test_loggers_with_clocks_of_their_own_are_joined_by_the_motion_that_both_tell(offset: float) -> None:
    drive = planted.drive("double_lane_change", "prototype_real", 0)
    first = replace(drive, channels={t: drive[t] for t in ("imu/data", "vehicle/steering")}, name="can")
    shift = round(offset * 1e9)
    moved = {
        t: replace(drive[t], stamp=drive[t].stamp - shift, received=drive[t].received - shift)
        for t in ("gps/fix", "gps/velocity", "vehicle/wheel_speeds")
    }
    whole = joined([first, replace(drive, channels=moved, name="gnss")])
    (note,) = [note for note in whole.notes if "are put" in note]
    found = (whole["gps/fix"].stamp[0] - drive["gps/fix"].stamp[0]) * 1e-9
    assert abs(found) < 0.05, note
    assert f"{offset:+.1f}"[:-2] in note or abs(found) < 0.05
    assert inspect(whole).problems == ()
    with pytest.raises(InputError, match=r"gnss: has gps/fix, gps/velocity, vehicle/wheel_speeds, which can has, too"):
        joined([whole, replace(drive, channels=moved, name="gnss")])


def test_recordings_without_a_common_motion_are_not_joined() -> None:
    drive = planted.drive("double_lane_change", "prototype_real", 0)
    first = replace(drive, channels={"imu/data": drive["imu/data"]}, name="imu")
    rng = np.random.default_rng(0)
    wheels = drive["vehicle/wheel_speeds"]
    noise = replace(wheels, columns={**wheels.columns, "velocity": 50 + rng.normal(size=(len(wheels), 4))})
    with pytest.raises(InputError, match="nothing in it measures the same motion as imu"):
        joined([first, replace(drive, channels={"vehicle/wheel_speeds": noise}, name="wheels")])
