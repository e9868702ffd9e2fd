"""Numbers on a bus that are no values are never published, and cost their own signal alone."""

from __future__ import annotations

import math
import struct
from collections import Counter
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.bag.importers import import_recording
from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_mapping import CanMapping
from vsense_ros.driver.can_validity import is_no_value
from vsense_ros.driver.samples import UNMEASURED_VARIANCE
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Sample

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: X\n'
DBC = (
    HEAD
    + """BO_ 80 MOTION: 8 X
 SG_ YAW : 0|16@1- (0.01,0) [-120|120] "deg/s" X
 SG_ AY : 16|16@1- (0.01,0) [-20|20] "m/s2" X
 SG_ STEER : 32|16@1- (0.1,0) [-500|500] "deg" X
 SG_ QUALITY : 48|4@1+ (1,0) [0|15] "" X
 SG_ LEFT : 52|1@1+ (1,0) [0|1] "" X
BO_ 2566832126 EBC2: 8 X
 SG_ FRONT : 0|16@1+ (0.00390625,0) [0|0] "km/h" X
 SG_ RELATIVE : 16|8@1+ (0.0625,-7.8125) [0|0] "km/h" X
VAL_ 80 YAW 32767 "Signal_SNA" 0 "no error" ;
VAL_ 80 QUALITY 0 "undefined" 7 "good" ;
"""
)


def axis(signal: str, unit: str, **more: object) -> dict:
    return {"signals": signal, "unit": unit, "standard_deviation": 0.01, **more}


def imu(message: str = "MOTION", **axes: dict) -> dict:
    return {"kind": "imu", "topic": "imu/data", "frame_id": "imu_link", "message": message, "axes": axes}


def steering(**more: object) -> dict:
    joints = {"steering_wheel": {"signals": "STEER", "unit": "deg", **more}}
    return {
        "kind": "joint_state",
        "topic": "vehicle/steering",
        "message": "MOTION",
        "field": "position",
        "joints": joints,
    }


YAW, AY = axis("YAW", "deg/s"), axis("AY", "m/s^2")


@pytest.fixture
def decode(tmp_path: Path):
    def made(*outputs: dict, dbc: str = DBC) -> CanDecoder:
        (tmp_path / "car.dbc").write_text(dbc)
        mapping = CanMapping.model_validate({"name": "car", "outputs": outputs})
        return CanDecoder(read_database(tmp_path / "car.dbc"), mapping)

    return made


def motion(count: int, yaw: int = 100, ay: int = 200, steer: int = 300, flags: int = 7) -> can.Message:
    data = struct.pack("<hhhH", yaw, ay, steer, flags)
    return can.Message(timestamp=1000.0 + 0.01 * count, arbitration_id=80, is_extended_id=False, data=data)


def said(decoder: CanDecoder) -> str:
    return " ".join(f"{d.message} {d.values}" for d in decoder.diagnostics(1000_000_000_000))


def test_a_number_that_the_database_names_as_no_value_is_not_published(decode) -> None:
    subject = decode(imu(angular_velocity_z=YAW, linear_acceleration_y=AY))
    (sample,) = subject.feed(motion(0, yaw=32767))
    assert sample.values["angular_velocity_covariance"][0] == -1.0
    assert sample.values["linear_acceleration"][1] == pytest.approx(2.0)
    assert "YAW has no value (Signal_SNA)" in said(subject)
    (sample,) = subject.feed(motion(1, yaw=0))  # which has the name "no error"
    assert sample.values["angular_velocity"][2] == 0.0


@pytest.mark.parametrize(("raw", "taken"), [(0xFDFF, True), (0xFE00, False), (0xFEFF, False), (0xFFFF, False)])
def test_the_highest_numbers_of_j1939_are_no_values(decode, raw: int, taken: bool) -> None:
    wheel = {"signals": "FRONT", "unit": "km/h", "rolling_radius": 0.5}
    output = {"kind": "joint_state", "topic": "vehicle/wheel_speeds", "message": "EBC2", "field": "velocity"}
    subject = decode(output | {"joints": {"wheel_fl": wheel}})
    frame = can.Message(timestamp=1.0, arbitration_id=0x18FEBF0B, is_extended_id=True, data=struct.pack("<H6x", raw))
    assert len(subject.feed(frame)) == taken


@pytest.mark.parametrize(
    ("name", "expected"),
    [("SNA", True), ("Signal not available", True), ("NotAvailable", True), ("Initialisierung", True), ("INIT", True),
     ("Fehler", True), ("kein_Fehler", False), ("No Error", False), ("INVALID", True), ("valid", False),
     ("left", False), ("ERROR", True), ("undefined", True), ("ok", False), ("N/A", True), ("Snap", False),
     ("Park", False), ("finite", False), ("NoData", True)],
)  # fmt: skip
def test_names_that_say_that_there_is_no_value_are_known(name: str, expected: bool) -> None:
    assert is_no_value(name) is expected


def test_one_value_out_of_its_range_costs_itself_alone(decode) -> None:
    subject = decode(imu(angular_velocity_z=YAW, linear_acceleration_y=AY), steering())
    first, second = subject.feed(motion(0, ay=9000))
    assert first.values["linear_acceleration_covariance"][0] == -1.0
    assert first.values["angular_velocity"][2] == pytest.approx(math.radians(1.0))
    assert second.topic == "vehicle/steering"
    assert "AY out of range [-20, 20]" in said(subject)


def test_an_axis_without_a_value_is_not_measured_and_the_others_are(decode) -> None:
    subject = decode(imu(angular_velocity_z=YAW, angular_velocity_x=axis("AY", "rad/s", ignore_stated_unit=True)))
    (sample,) = subject.feed(motion(0, ay=9000))
    np.testing.assert_array_equal(np.isnan(sample.values["angular_velocity"]), [True, True, False])
    assert sample.values["angular_velocity_covariance"][0] == UNMEASURED_VARIANCE


def angles(decoder: CanDecoder, *raw: int) -> list[float | None]:
    """The steering angles [deg] that come of these numbers, None where none does."""
    found: list[float | None] = []
    for count, number in enumerate(raw):
        samples = decoder.feed(motion(count, steer=number))
        found.append(round(math.degrees(samples[0].values["position"][0]), 6) if samples else None)
    return found


def test_a_value_that_goes_steadily_beyond_its_range_is_used_and_said(decode) -> None:
    subject = decode(steering())
    assert angles(subject, 4990, 5030, 5100, 5030, 4990) == [499.0, 503.0, 510.0, 503.0, 499.0]
    assert "STEER moves steadily beyond its range [-500, 500], and is used" in said(subject)


def test_a_value_that_jumps_beyond_its_range_is_not_used_nor_what_repeats_it(decode) -> None:
    assert angles(decode(steering()), 100, 32767, 32767, 110, 6000, 120) == [10.0, None, None, 11.0, None, 12.0]


def test_a_steady_value_survives_one_wrong_one_beyond_its_range(decode) -> None:
    assert angles(decode(steering()), 4990, 5030, 32767, 5040) == [499.0, 503.0, None, 504.0]


def test_a_range_of_the_mapping_is_kept_to(decode) -> None:
    assert angles(decode(steering(range=[-500, 500])), 4990, 5030) == [499.0, None]


@pytest.mark.parametrize("values", [[7], 7, "good", ["good"]])
@pytest.mark.parametrize("place", ["signal", "output"])
def test_a_quality_flag_says_which_values_are_believed(decode, values: object, place: str) -> None:
    valid = {"valid": {"signal": "QUALITY", "values": values}}
    output = imu(angular_velocity_z=YAW) | valid if place == "output" else imu(angular_velocity_z=YAW | valid)
    subject = decode(output, steering())
    assert len(subject.feed(motion(0, flags=7))) == 2
    (left,) = subject.feed(motion(1, flags=0))
    assert left.topic == "vehicle/steering"
    assert "angular_velocity_z is not valid by QUALITY" in said(subject)


def test_a_flag_that_the_database_lacks_is_refused_in_words(decode) -> None:
    for flag, expected in (
        ({"signal": "QUALITI", "values": [7]}, "no signal 'QUALITI'; did you mean QUALITY"),
        ({"signal": "QUALITY", "values": ["goood"]}, "no value named 'goood'; did you mean good"),
    ):
        with pytest.raises(InputError, match=expected):
            decode(imu(angular_velocity_z=YAW) | {"valid": flag})


def test_a_sign_in_a_signal_of_its_own_turns_the_magnitude(decode) -> None:
    subject = decode(steering(sign={"signal": "LEFT", "negative": 0}))
    got = [subject.feed(motion(i, steer=300, flags=flags))[0] for i, flags in enumerate((0x17, 0x07))]
    np.testing.assert_allclose([s.values["position"][0] for s in got], np.radians([30.0, -30.0]))


_NUMBERS = st.integers(-(2**15), 2**15 - 1) | st.integers(4900, 5300) | st.sampled_from([32767, 2100])


@given(st.lists(st.tuples(_NUMBERS, _NUMBERS, _NUMBERS, st.integers(0, 31)), min_size=1, max_size=30))
def test_a_log_as_a_whole_gives_what_its_frames_give_one_by_one(tmp_path_factory, rows) -> None:
    folder = tmp_path_factory.getbasetemp()
    (folder / "car.dbc").write_text(DBC)
    flag = {"valid": {"signal": "QUALITY", "values": [7, 1]}, "sign": {"signal": "LEFT", "negative": 1}}
    outputs = [imu(angular_velocity_z=YAW, linear_acceleration_y=AY | flag), steering()]
    decoder = CanDecoder(folder / "car.dbc", CanMapping.model_validate({"name": "car", "outputs": outputs}))
    frames = [motion(i, *row) for i, row in enumerate(rows)]
    single: dict[str, list[Sample]] = {"imu/data": [], "vehicle/steering": []}
    for frame in frames:
        for sample in decoder.feed(frame):
            single[sample.topic].append(sample)
    receiver = decoder.receiver(80, False)
    assert receiver is not None
    data = np.array([list(frame.data) for frame in frames], np.uint8)
    for output, at, values in receiver.table(data, np.full(len(rows), 8), Counter(), Counter()):
        mine = single[output.topic]
        assert [round((s.stamp / 1e9 - 1000.0) * 100) for s in mine] == at.tolist()
        if output.topic == "vehicle/steering":
            np.testing.assert_allclose([s.values["position"][0] for s in mine], values["steering_wheel"])
            continue
        for name, field, place in (
            ("angular_velocity_z", "angular_velocity", 2),
            ("linear_acceleration_y", "linear_acceleration", 1),
        ):
            for sample, value in zip(mine, values[name], strict=True):
                if math.isnan(value):
                    assert sample.values[f"{field}_covariance"][0] == -1.0
                else:
                    assert sample.values[field][place] == pytest.approx(value)


def test_an_imported_log_says_how_often_a_signal_had_no_value(tmp_path: Path) -> None:
    (tmp_path / "car.dbc").write_text(DBC)
    (tmp_path / "car.yaml").write_text(
        "name: car\noutputs:\n  - {kind: imu, topic: imu/data, frame_id: imu_link, message: MOTION, axes: {"
        "angular_velocity_z: {signals: YAW, unit: deg/s, standard_deviation: 0.01}, "
        "linear_acceleration_y: {signals: AY, unit: m/s^2, standard_deviation: 0.1}}}\n"
    )
    with can.Logger(tmp_path / "drive.log") as logger:
        for i in range(20):
            logger(motion(i, yaw=32767 if i < 5 else 100))
    found = import_recording(tmp_path / "drive.log", dbc=tmp_path / "car.dbc", mapping=tmp_path / "car.yaml")
    assert "MOTION: YAW has no value (Signal_SNA) (5 times)" in found.notes
    imu_ = found["imu/data"]
    assert len(imu_) == 20
    np.testing.assert_array_equal(imu_.columns["angular_velocity_covariance"][:, 0] == -1.0, np.arange(20) < 5)
    np.testing.assert_allclose(imu_.columns["linear_acceleration"][:, 1], 2.0)
