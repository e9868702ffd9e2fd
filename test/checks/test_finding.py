"""Findings, their transformations and sentences."""

from __future__ import annotations

from string import Formatter

import numpy as np
import pytest

from vsense_ros.bag.importers import build
from vsense_ros.checks import (
    clocks,
    consistency,
    frames,
    held,
    inspect,
    motion,
    offset,
    relations,
    units,
    values,
    watch,
)
from vsense_ros.checks.finding import Confidence, Finding, Kind, Rename, Scale, Turn
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import USUAL_TOPICS, Role, topics_of
from vsense_ros.checks.sentences import mend_in_words, sentence, sentences
from vsense_ros.checks.setting import described
from vsense_ros.messages.recording import Channel

SETTINGS = [
    type(m.SETTINGS)
    for m in (clocks, consistency, frames, held, inspect, motion, offset, relations, units, values, watch)
]


def imu(rows: int = 5) -> Channel:
    vectors = np.random.default_rng(0).normal(size=(2, rows, 3))
    return build.imu(np.arange(rows) * 10_000_000, vectors[0], vectors[1])


@pytest.mark.parametrize("reason", Reason)
def test_every_reason_has_a_sentence_without_a_hole(reason):
    fields = {name for _, name, _, _ in Formatter().parse(reason.value) if name}
    own = {"signal", "against", "begin", "duration", "given", "undecided", "behind"}
    numbers = {name for _, name, form, _ in Formatter().parse(reason.value) if name and form} - own
    finding = Finding(
        "imu/data", Kind.UNIT, reason, "angular_velocity.z", "gnss", span=(1.0, 3.5),
        evidence=dict.fromkeys(numbers, 2.0), names=dict.fromkeys(fields - own - numbers, "x"),
    )  # fmt: skip
    text = sentence(finding)
    assert text
    assert "{" not in text
    assert "nan" not in text.lower().replace("is nan in", "")


def test_a_finding_is_said_after_the_name_of_its_topic():
    finding = Finding("imu/data", Kind.SIGN, Reason.TURNS_AGAINST, "angular_velocity.z", "gnss")
    (text,) = sentences([finding])
    assert text == "imu/data: the yaw rate is against the turning of the GNSS course: expected positive to the left"


def test_where_an_axis_alone_is_driven_along_both_explanations_are_said():
    finding = Finding("imu/data", Kind.SIGN, Reason.LATERAL_REVERSED, confidence=Confidence.UNDECIDED)
    assert sentence(finding).endswith("or the IMU is turned by 180° about z")


def test_lags_are_said_with_their_side():
    finding = Finding("a", Kind.LAG, Reason.LATE, evidence={"b": 0.3, "c": -0.25})
    assert sentence(finding) == "lies 0.30 s behind b, 0.25 s ahead of c: is its clock or its latency wrong?"


def test_a_rotation_and_its_transpose_are_the_identity():
    rows = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))
    turn = Turn(("angular_velocity",), rows)
    there = turn.apply(imu())
    assert np.array_equal(there.columns["angular_velocity"], imu().columns["angular_velocity"] @ np.array(rows).T)
    back = Turn(turn.fields, tuple(zip(*rows, strict=True))).apply(there)
    assert np.array_equal(back.columns["angular_velocity"], imu().columns["angular_velocity"])


def test_an_absent_axis_stays_absent_where_it_comes_to():
    channel = imu()
    channel.columns["angular_velocity"][:, 1] = np.nan
    turned = Turn(("angular_velocity",), ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))).apply(channel)
    assert np.isnan(turned.columns["angular_velocity"][:, 0]).all()
    assert np.isfinite(turned.columns["angular_velocity"][:, 1:]).all()


def test_a_scale_of_one_joint_leaves_the_others():
    stamp = np.arange(4) * 10_000_000
    joints = build.joints(
        "vehicle/steering", stamp, "position", {"steering_wheel": np.ones(4), "road_wheel_front": np.ones(4)}
    )
    scaled = Scale("position", -1.0, "steering_wheel").apply(joints)
    assert scaled.columns["position"].tolist() == [[-1.0, 1.0]] * 4
    assert Rename((("steering_wheel", "other"),)).apply(joints).names == ("other", "road_wheel_front")


def test_what_nothing_mends_is_no_mend():
    with pytest.raises(ValueError, match="expected a finding with a transformation, found none for NO_GRAVITY"):
        mend_in_words(Finding("imu/data", Kind.UNIT, Reason.NO_GRAVITY))


@pytest.mark.parametrize("settings", SETTINGS)
def test_every_number_by_which_checks_decide_has_unit_meaning_and_source(settings):
    assert all(all(texts) for texts in described(settings).values())


class Sensor:
    def __init__(self, kind: str, topic: str) -> None:
        self.kind, self.topic = kind, topic


def test_topics_are_those_of_the_vehicle_file_and_usual_where_it_has_none():
    topics = topics_of([Sensor("wheel_speeds", "bus/wheels"), Sensor("imu", "imu/front"), Sensor("imu", "imu/rear")])
    assert (topics[Role.WHEELS], topics[Role.IMU]) == ("bus/wheels", "imu/front")
    assert topics[Role.STEERING] == USUAL_TOPICS[Role.STEERING]
