"""Checksums, containers, parameter groups and samples of the drivers, by their definitions and by SciPy."""

from __future__ import annotations

from collections import Counter

import can
import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vsense_ros.driver import samples
from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_checksum import CHECKSUMS
from vsense_ros.driver.can_container import contained
from vsense_ros.driver.can_mapped_signal import Signal
from vsense_ros.driver.can_mapping import CanMapping

CHECK = b"123456789"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("crc8_sae_j1850", 0x4B),  # the check value of the catalogue of parametrised CRC algorithms (Cook)
        ("sum", sum(CHECK) % 256),
        ("xor", 0x31),
        ("toyota", (0x34 + 0x12 + 9 + sum(CHECK)) % 256),
    ],
)
def test_a_checksum_is_what_its_definition_says_of_the_usual_text(name, expected):
    assert CHECKSUMS[name](0x1234, CHECK, 9) == expected


@given(payload=st.binary(min_size=1, max_size=8), bit=st.integers(0, 63), frame_id=st.integers(0, 0x7FF))
def test_a_single_wrong_bit_changes_each_checksum(payload, bit, frame_id):
    place = bit % (8 * len(payload))
    wrong = bytearray(payload)
    wrong[place // 8] ^= 1 << place % 8
    for name, checksum in CHECKSUMS.items():
        right = checksum(frame_id, payload, 8)
        assert 0 <= right < 256
        assert checksum(frame_id, bytes(wrong), 8) != right, name


@given(st.lists(st.tuples(st.integers(1, 2**24 - 1), st.binary(max_size=20)), max_size=5), st.integers(0, 3))
def test_messages_come_out_of_a_container_as_they_were_put_in(parts, padding):
    data = b"".join(header.to_bytes(3, "big") + bytes([len(part)]) + part for header, part in parts)
    assert list(contained(data + bytes(padding))) == parts
    assert list(contained(data + bytes(8))) == parts


def test_a_message_that_is_cut_off_is_left_out():
    whole = b"\x00\x00\x05\x02ab"
    assert list(contained(whole + b"\x00\x00\x06\x04abc")) == [(5, b"ab")]
    assert list(contained(whole + b"\x00\x00\x06\x03abc")) == [(5, b"ab"), (6, b"abc")]
    assert list(contained(b"\x00\x00\x07\x00")) == [(7, b"")]


# Two parameter groups of J1939 with a source, one of them to all, and a message with 11 bits.
DBC = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 2364539902 EEC: 8 X
 SG_ ANGLE : 0|16@1- (0.001,0) [-30|30] "rad" X
BO_ 2348809982 OTHER: 8 X
 SG_ VALUE : 0|16@1- (0.001,0) [-30|30] "rad" X
BO_ 2147483902 ZERO: 8 X
 SG_ ZERO_ANGLE : 0|16@1- (0.001,0) [-30|30] "rad" X
BO_ 80 SHORT: 4 X
 SG_ SMALL : 0|16@1- (0.001,0) [-30|30] "rad" X
 SG_ CHECK : 24|8@1+ (1,0) [0|255] "" X
"""
EEC, OTHER, ZERO = 2364539902 & 0x1FFF_FFFF, 2348809982 & 0x1FFF_FFFF, 2147483902 & 0x1FFF_FFFF


def decoder(message: str, signal: str, **checks: object) -> CanDecoder:
    output = {
        "kind": "joint_state", "topic": "vehicle/steering", "message": message, "field": "position",
        "joints": {"steering_wheel": {"signals": signal, "unit": "rad"}},
    }  # fmt: skip
    mapping = CanMapping.model_validate({"name": "car", "outputs": [output], "messages": {message: checks}})
    return CanDecoder(cantools.database.load_string(DBC, "dbc", strict=False), mapping)


def test_a_parameter_group_is_heard_from_the_first_unit_that_sends_it():
    subject = decoder("EEC", "ANGLE")
    first, second = (EEC & ~0xFF) | 0x13, (EEC & ~0xFF) | 0x27
    assert subject.receiver(first, True) is not None
    assert subject.receiver(second, True) is None
    assert subject.receiver(first ^ 0x0400_0000, True) is not None  # another priority
    assert subject.receiver(first & 0x7FF, False) is None
    assert subject.receiver((first & ~0xFF00) | 0x1200, True) is None  # another group


def test_a_group_is_not_heard_in_a_message_that_the_database_has_by_itself_nor_in_one_of_eleven_bits():
    subject = decoder("ZERO", "ZERO_ANGLE")
    assert subject.receiver(OTHER, True) is None
    assert subject.receiver(0x013, False) is None  # its upper bits are those of group zero
    assert subject.receiver(80, False) is None
    assert subject.receiver((ZERO & ~0xFF) | 0x13, True) is not None


def test_frames_of_a_log_with_a_bad_checksum_are_counted_and_the_others_used():
    checks = {"checksum": {"algorithm": "sum"}}
    subject = decoder("SHORT", "SMALL", **checks)
    values = [100, -200, 300, 400]
    rows = []
    for i, value in enumerate(values):
        data = value.to_bytes(2, "little", signed=True) + b"\x07"
        rows.append(data + bytes([(sum(data) + (i in (1, 3))) % 256]))
    receiver = subject.receiver(80, False)
    assert receiver is not None
    faults: Counter[str] = Counter()
    frames = np.frombuffer(b"".join(rows), np.uint8).reshape(4, 4)
    ((_, at, found),) = receiver.table(frames, np.full(4, 4), faults, Counter())
    assert at.tolist() == [0, 2]
    assert found["steering_wheel"].tolist() == pytest.approx([0.1, 0.3])
    assert faults == {"SHORT: bad checksum": 2}
    one_by_one = decoder("SHORT", "SMALL", **checks)
    taken = [
        bool(one_by_one.feed(can.Message(timestamp=1000.0 + i, arbitration_id=80, is_extended_id=False, data=row)))
        for i, row in enumerate(rows)
    ]
    assert taken == [True, False, True, False]


def fix(**latitude: object) -> dict[str, object]:
    signal = {"unit": "rad"}
    return {
        "kind": "gnss_fix", "message": "SHORT",
        "latitude": {"signals": "SMALL", **signal, **latitude}, "longitude": {"signals": "SMALL", **signal},
    }  # fmt: skip


@pytest.mark.parametrize("deviation", [None, 2.5])
def test_the_covariance_of_a_position_is_known_where_the_mapping_states_a_deviation(deviation):
    more = {} if deviation is None else {"standard_deviation": deviation}
    mapping = CanMapping.model_validate({"name": "car", "outputs": [fix(**more)]})
    subject = CanDecoder(cantools.database.load_string(DBC, "dbc", strict=False), mapping)
    data = (700).to_bytes(2, "little") + bytes(2)
    (sample,) = subject.feed(can.Message(timestamp=1000.0, arbitration_id=80, is_extended_id=False, data=data))
    assert sample.values["latitude"][0] == pytest.approx(np.degrees(0.7))
    covariance = sample.values["position_covariance"].reshape(3, 3)
    assert sample.values["position_covariance_type"][0] == (0.0 if deviation is None else 2.0)
    assert covariance[1, 1] == (0.0 if deviation is None else deviation**2)
    assert (covariance.any()) == (deviation is not None)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"unit": "furlong"}, "is not known; known are"),
        ({"unit": "rad", "factor": 0.0}, "factor is 0.0"),
        ({"unit": "rad", "factor": np.inf}, "factor is inf"),
        ({"unit": "rad", "range": (1.0, 1.0)}, "expected .lowest, highest."),
        ({"unit": "rad", "rolling_radius": 0.3}, "needs a unit of speed over ground"),
    ],
)
def test_a_signal_that_cannot_be_is_refused_with_what_was_expected(fields, message):
    with pytest.raises(ValueError, match=message):
        Signal(signals=("a",), **fields)


def test_a_signal_has_the_unit_of_its_quantity_and_of_wheels_with_a_radius_that_of_a_spin():
    speed = Signal(signals=("a",), unit="km/h")
    assert (speed.si_unit, speed.output_unit) == ("m/s", "m/s")
    assert speed.to_si == pytest.approx(1 / 3.6)
    wheel = Signal(signals="a", unit="mph", rolling_radius=0.3)
    assert (wheel.signals, wheel.si_unit, wheel.output_unit) == (("a",), "m/s", "rad/s")


@given(st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)))
def test_heading_and_tilt_are_the_rotation_of_scipy(angles):
    yaw, pitch, roll = angles
    sample = samples.heading_and_tilt("t", 1, "f", yaw, (1.0, 2.0, 3.0), roll=roll, pitch=pitch)
    mine = Rotation.from_quat(sample.values["orientation"])
    assert (mine.inv() * Rotation.from_euler("ZYX", [yaw, pitch, roll])).magnitude() == pytest.approx(0.0, abs=1e-7)
    assert sample.values["orientation_covariance"].reshape(3, 3).diagonal().tolist() == [1.0, 2.0, 3.0]
    assert sample.values["angular_velocity_covariance"][0] == -1.0


def test_vectors_that_are_absent_are_marked_and_covariances_that_are_unknown_are_zero():
    made = samples.imu("t", 1, "f", angular_velocity=[1, 2, 3], linear_acceleration=[4, 5, 6],
                       linear_acceleration_covariance=samples.diagonal([1, 2, 3]), received=9)  # fmt: skip
    assert made.values["orientation"].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert made.values["orientation_covariance"].tolist() == [-1.0] + [0.0] * 8
    assert made.values["angular_velocity"].tolist() == [1.0, 2.0, 3.0]
    assert not made.values["angular_velocity_covariance"].any()
    assert made.values["linear_acceleration_covariance"].tolist() == [1, 0, 0, 0, 2, 0, 0, 0, 3]
    assert made.received == 9
    ignored = samples.imu("t", 1, "f", linear_acceleration_covariance=np.eye(3).ravel())
    assert ignored.values["linear_acceleration_covariance"][0] == -1.0
