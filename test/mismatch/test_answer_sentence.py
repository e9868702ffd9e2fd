"""What the sentence of an answer, and its table of effects, say of late sensors and of signals that are missing."""

from __future__ import annotations

from typing import Any

from synthetic_findings import effect, finding
from vsense_ros.mismatch.ages import Age
from vsense_ros.mismatch.answer_schema import EffectEntry, Remainder
from vsense_ros.mismatch.answer_sentence import conditions, sentence
from vsense_ros.mismatch.beforehand import delays
from vsense_ros.mismatch.objections import LITTLE_LASTS, NO_MORE_THAN_CHANCE
from vsense_ros.mismatch.tables import effect_rows
from vsense_ros.mismatch.words import badge_of, ended, first_and_rest

LEFT_OUT = "in lap 2 the longitudinal acceleration is 0.42 times the change of the speed; is its unit wrong?"


def test_of_an_unknown_mismatch_a_late_sensor_and_a_signal_that_is_missing_are_said():
    said = conditions(finding("unknown"), delays({"accelerometer": Age(1.12, 0.06)}), [LEFT_OUT])
    assert "measurements that are older than their stamps say (accelerometer 1.12 s)." in said
    assert said.endswith(f" Left out of the comparison: {LEFT_OUT}")  # which ends with a question mark


def test_where_all_signals_are_compared_nothing_is_added():
    assert conditions(finding("named"), (), []) == ""
    late = delays({"accelerometer": Age(1.12, 0.06)})
    assert conditions(finding("named"), late, []) == ""  # as the answer names it itself


def test_a_delay_that_lags_determine_is_not_excluded_where_nothing_explains_the_rest():
    late = effect("sensor_delay", 0.0, sensor="accelerometer", accepted=True)
    rest = effect("wheel_radius", 0.1, wheel="rr", gain_left_out=0.2, gain_held_out=0.1)
    delay, radius = effect_rows(finding("unknown", effects=(late, rest)))
    assert delay.standing == "determined before any fit, by sensors of one motion"
    assert "excluded" not in radius.standing


def test_two_late_sensors_are_said_in_one_breath():
    late = [effect("sensor_delay", 0.2, sensor=name, accepted=True) for name in ("gyro", "accelerometer")]
    said = sentence(finding("named", effects=late))
    assert said.count(late[0].sentence) == 1
    assert said.count(";") == 1  # between the two sizes


def test_several_effects_are_listed_in_one_sentence_and_what_they_explain_is_said_in_the_next():
    effects = [effect(name, 0.2, accepted=True) for name in ("road_bank", "steering_ratio", "crosswind")]
    headline, rest = first_and_rest(sentence(finding("named", effects=effects)))
    assert headline.startswith(f"The model leaves out {effects[0].sentence}")
    assert f"; and {effects[2].sentence}" in headline
    assert headline.endswith(").")
    assert rest.startswith("With them the squared error falls by 20 %")
    assert first_and_rest("Nothing can be said: only 4.2 s of driving can be used.")[1] == ""


def test_where_held_out_recordings_have_no_trace_of_an_effect_that_is_said_in_place_of_zero_percent():
    antenna = effect("gnss_lever_arm", 0.29, accepted=True, gain_left_out=0.27, gain_held_out=0.002)
    said = sentence(finding("named", effects=(antenna,)))
    assert "falls by 29 %, and by 27 % where it was left out of the fit" in said
    assert "; recordings it was not fitted to have no trace of it" in said
    assert "by 0 %" not in said


def test_a_wrong_sign_and_coarse_steps_are_said_where_nothing_else_is_to_find():
    sign = "what mends obd: imu/data: the lateral acceleration is against speed times yaw rate: left is −y"
    steps = "obd, imu/data: angular_velocity.z has steps of 0.0223, which is coarse"
    found = finding("no_mismatch", recording_defects=(sign, steps))
    assert "there is nothing else to find here" in sentence(found)
    assert badge_of(found).badge == "Only the recordings are wrong"
    assert conditions(found, (), []) == f" In the recordings themselves: {sign}; {steps}."


def test_a_defect_for_which_a_signal_was_left_out_is_said_once():
    sign = "what mends obd: imu/data: the lateral acceleration is against speed times yaw rate: left is −y"
    left_out = "in obd, imu/data: the lateral acceleration is against speed times yaw rate"
    said = conditions(finding("no_mismatch", recording_defects=(sign,)), (), [left_out])
    assert said == f" Left out of the comparison: {left_out}."


def test_of_many_defects_the_sentence_says_how_many_more_there_are():
    said = conditions(finding("unknown", recording_defects=[f"steps in {i}" for i in range(8)]), (), [])
    assert said.endswith("steps in 2; and 5 more, which the remarks list.")


def test_a_question_needs_no_full_stop():
    assert [ended(said) for said in ("Is it?", "It is", "It is.")] == ["Is it?", "It is.", "It is."]


def test_an_ambiguous_answer_that_leaves_a_signal_far_off_says_that_there_is_more():
    rest = Remainder(level=2.0, signals=(), region=None, force=None)
    more = "Whichever it is, something more is left over."
    assert sentence(finding("ambiguous", remainder=rest)).endswith(more)
    assert more not in sentence(finding("ambiguous", remainder=None))


def test_what_a_short_drive_cannot_prove_is_said_to_be_possible():
    turned = effect("imu_yaw_misalignment", 0.19, objection=NO_MORE_THAN_CHANCE)
    sloping = effect("road_grade", 0.85, objection=LITTLE_LASTS)

    def said(*effects: EffectEntry, threshold: float = 0.2, **more: Any) -> str:
        return sentence(finding("unknown", effects=effects, threshold=threshold, driven_s=12.0, **more))

    assert f"It may be {turned.sentence}: that explains 19 %" in said(turned, held_out=())
    assert "on 12 s of driving chance explains up to 20 %. Longer recordings would" in said(turned, held_out=())
    assert "explains 85 %, but on 12 s of driving little of what it" in said(turned, sloping, held_out=())
    assert "It may be" not in said(turned, held_out=(), threshold=0.5)  # it explains far less than chance does
    assert "It may be" not in said(turned, held_out=(), threshold=0.03)  # there is driving enough
    assert "It may be" not in said(turned, held_out=("lap",))
