from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_checksum import CHECKSUMS
from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_mapping import CanMapping, load_mapping
from vsense_ros.driver.samples import UNMEASURED_VARIANCE
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level

DBC = """
VERSION ""
NS_ :
BS_:
BU_: ESC SAS

BO_ 257 WHEELS: 8 ESC
 SG_ FL : 0|12@1+ (0.1,0) [0|300] "km/h" ESC
 SG_ FR : 12|12@1+ (0.1,0) [0|300] "km/h" ESC
 SG_ RL : 24|12@1+ (0.1,0) [0|300] "km/h" ESC
 SG_ RR : 36|12@1+ (0.1,0) [0|300] "km/h" ESC
 SG_ ALIVE : 48|4@1+ (1,0) [0|15] "" ESC
 SG_ CRC : 56|8@1+ (1,0) [0|255] "" ESC

BO_ 2566844672 STEER: 4 SAS
 SG_ ANGLE : 0|16@1- (0.1,0) [-780|780] "deg" ESC
"""

MAPPING = {
    "name": "test car",
    "messages": {
        "WHEELS": {
            "rate": 100,
            "timeout": 0.1,
            "latency": 0.005,
            "counter": {"signal": "ALIVE", "max_delta": 2},
            "checksum": {"algorithm": "crc8_sae_j1850"},
        },
        "STEER": {"timeout": 0.1},
    },
    "outputs": [
        {
            "kind": "joint_state",
            "topic": "vehicle/wheel_speeds",
            "message": "WHEELS",
            "field": "velocity",
            "joints": {
                f"wheel_{corner}": {"signals": corner.upper(), "unit": "km/h", "rolling_radius": 0.3}
                for corner in ("fl", "fr", "rl", "rr")
            },
        },
        {
            "kind": "joint_state",
            "topic": "vehicle/steering",
            "message": "STEER",
            "field": "position",
            "joints": {"steering_wheel": {"signals": "ANGLE", "unit": "deg", "factor": -1.0}},
        },
    ],
}
DATABASE = cantools.database.load_string(DBC, "dbc", strict=False)
SECOND = 1_000_000_000
START = 1_700_000_000.0


def decoder(**options) -> CanDecoder:
    return CanDecoder(DATABASE, CanMapping.model_validate(MAPPING), **options)


def crc8_bitwise(data: bytes) -> int:
    """CRC-8 SAE J1850 by its definition, one bit after the other."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1 ^ 0x1D) & 0xFF if crc & 0x80 else crc << 1
    return crc ^ 0xFF


def wheels(count: int, speed: float = 36.0, at: float | None = None, counter: int | None = None) -> can.Message:
    """Frame `count` of a good sender at 100 Hz; all wheels at `speed` [km/h]."""
    alive = (count if counter is None else counter) % 16
    values = dict.fromkeys(("FL", "FR", "RL", "RR"), speed) | {"ALIVE": alive, "CRC": 0}
    payload = DATABASE.encode_message("WHEELS", values, strict=False)[:7]
    return can.Message(
        timestamp=START + 0.01 * count if at is None else at,
        arbitration_id=257,
        is_extended_id=False,
        data=payload + bytes([crc8_bitwise(payload)]),
    )


def steer(count: int, angle: float) -> can.Message:
    message = DATABASE.get_message_by_name("STEER")
    return can.Message(
        timestamp=START + 0.01 * count,
        arbitration_id=message.frame_id,
        is_extended_id=True,
        data=message.encode({"ANGLE": angle}, strict=False),
    )


def health(decoder: CanDecoder, part: str, now: float) -> Diagnostic:
    (found,) = [d for d in decoder.diagnostics(round(now * SECOND)) if part in d.name]
    return found


def test_a_frame_becomes_a_sample_in_si_with_the_stamp_of_the_measurement():
    (sample,) = decoder().feed(wheels(0, 36.0))
    assert sample.topic == "vehicle/wheel_speeds"
    assert sample.kind == "sensor_msgs/msg/JointState"
    assert sample.names == ("wheel_fl", "wheel_fr", "wheel_rl", "wheel_rr")
    np.testing.assert_allclose(sample.values["velocity"], 10.0 / 0.3)
    assert sample.values["position"].size == sample.values["effort"].size == 0
    assert sample.stamp == round(START * SECOND) - 5_000_000
    assert sample.received == round(START * SECOND)


def test_a_negative_factor_turns_a_signal_around():
    (sample,) = decoder().feed(steer(0, 90.0))
    np.testing.assert_allclose(sample.values["position"], -math.pi / 2)


@given(st.integers(0, 3000))
def test_decoding_inverts_what_cantools_encodes(raw):
    (sample,) = decoder().feed(wheels(0, raw * 0.1))
    np.testing.assert_allclose(sample.values["velocity"], raw * 0.1 / 3.6 / 0.3, rtol=1e-12)


def test_an_unknown_identifier_is_ignored_and_counted():
    subject = decoder()
    assert subject.feed(can.Message(timestamp=START, arbitration_id=0x123, is_extended_id=False, data=b"\1\2")) == []
    # The same number as WHEELS, but 29 bits long.
    assert subject.feed(can.Message(timestamp=START, arbitration_id=257, is_extended_id=True, data=bytes(8))) == []
    bus = health(subject, "bus", START)
    assert bus.level == Level.OK
    assert bus.values["not in the database"] == "2"


def test_a_wrong_data_length_is_reported_and_the_frame_dropped():
    subject = decoder()
    message = wheels(0)
    message.data = message.data[:6]
    assert subject.feed(message) == []
    found = health(subject, "WHEELS", START)
    assert found.level == Level.ERROR
    assert "vehicle/wheel_speeds" in found.name
    assert "data length 6, expected 8" in found.message


def test_a_bad_checksum_is_reported_and_the_frame_dropped():
    subject = decoder()
    assert len(subject.feed(wheels(0))) == 1
    message = wheels(1)
    message.data[2] ^= 0x10
    assert subject.feed(message) == []
    assert len(subject.feed(wheels(2))) == 1
    found = health(subject, "WHEELS", START + 0.02)
    assert (found.level, found.message) == (Level.WARN, "bad checksum")
    assert health(subject, "WHEELS", START + 0.02).values["bad checksum"] == "1"


@given(st.integers(0, 6), st.integers(1, 255))
def test_no_damage_to_one_byte_passes_the_crc(byte, flip):
    message = wheels(3)
    message.data[byte] ^= flip
    assert decoder().feed(message) == []


def test_a_frozen_counter_is_reported_and_the_frame_dropped():
    subject = decoder()
    assert len(subject.feed(wheels(0))) == 1
    assert [subject.feed(wheels(i, counter=0)) for i in (1, 2, 3)] == [[], [], []]
    found = health(subject, "WHEELS", START + 0.03)
    assert found.level == Level.WARN
    assert "counter frozen" in found.message
    assert health(subject, "WHEELS", START + 0.2).level in (Level.ERROR, Level.STALE)


def test_a_jumping_counter_costs_one_frame_and_lost_frames_are_counted():
    subject = decoder()
    counters = [14, 15, 0, 2, 3, 9, 10]  # 0 follows 15; 1 is lost, which is allowed; 9 after 3 is not believed
    passed = [len(subject.feed(wheels(i, counter=c))) for i, c in enumerate(counters)]
    assert passed == [1, 1, 1, 1, 1, 0, 1]
    found = health(subject, "WHEELS", START + 0.06)
    assert found.values["counter jumping"] == "1"
    assert found.values["lost by the counter"] == "1"


def test_signals_outside_their_range_are_reported_and_dropped():
    subject = decoder()
    assert subject.feed(wheels(0, 350.0)) == []
    assert "FL out of range [0, 300]" in health(subject, "WHEELS", START).message


def test_a_silent_bus_is_stale_and_so_is_each_sensor():
    subject = decoder()
    assert {d.level for d in subject.diagnostics(round(START * SECOND))} == {Level.STALE}
    subject.feed(wheels(0))
    subject.feed(steer(0, 1.0))
    assert {d.level for d in subject.diagnostics(round(START * SECOND))} == {Level.OK}
    late = subject.diagnostics(round((START + 3) * SECOND))
    assert {d.level for d in late} == {Level.STALE}
    assert late[0].message == "bus silent for 3.00 s"


def test_missing_wheel_speeds_leave_the_steering_untouched():
    subject = decoder()
    for i in range(50):
        assert len(subject.feed(steer(i, 1.0))) == 1
    now = START + 0.49
    assert health(subject, "wheel_speeds", now).message == "never received"
    assert health(subject, "wheel_speeds", now).level == Level.STALE
    assert health(subject, "vehicle/steering", now).level == Level.OK


@pytest.mark.parametrize(
    ("offset", "reason"),
    [(-0.5, "time stamp going backwards"), (3600.0, "time stamp jumping ahead"), (-0.01, "duplicated time stamp")],
)
def test_a_wrong_time_stamp_costs_only_its_own_frame(offset, reason):
    subject = decoder()
    passed = []
    for i in range(30):
        at = START + 0.01 * i + (offset if i == 20 else 0.0)
        passed += [i] * len(subject.feed(wheels(i, at=at)))
    assert passed == [i for i in range(30) if i != 20]
    found = health(subject, "WHEELS", START + 0.3)
    assert found.level == Level.WARN
    assert reason in found.message


@pytest.mark.parametrize("offset", [-3600.0, 3600.0])
def test_a_clock_that_stays_an_hour_off_is_followed_after_a_few_frames(offset):
    subject = decoder()
    passed = [len(subject.feed(wheels(i, at=START + 0.01 * i + (offset if i >= 20 else 0.0)))) for i in range(40)]
    assert passed == [1] * 20 + [0] * 4 + [1] * 16
    found = health(subject, "WHEELS", START + 0.39 + offset)
    assert (found.level, found.message) == (Level.WARN, "clock was set to another time")


@pytest.mark.parametrize("timestamp", [math.nan, math.inf])
def test_a_frame_without_a_time_is_dropped(timestamp):
    subject = decoder()
    assert subject.feed(wheels(0, at=timestamp)) == []
    assert health(subject, "bus", START).values["without time stamp"] == "1"


def test_error_frames_are_reported():
    subject = decoder()
    subject.feed(wheels(0))
    assert subject.feed(can.Message(timestamp=START, is_error_frame=True)) == []
    assert health(subject, "bus", START).message == "error frames on the bus"


def test_what_the_interface_cannot_read_is_counted_and_reported():
    subject = decoder()
    subject.feed(wheels(0))
    subject.broken(round(START * 1e9))
    found = health(subject, "bus", START)
    assert (found.level, found.values["broken frames"]) == (Level.WARN, "1")
    assert found.message.startswith("broken frames")


def test_frames_of_other_channels_are_passed_over():
    subject = decoder(channel="can0")
    message = wheels(0)
    message.channel = "can1"
    assert subject.feed(message) == []
    message.channel = "can0"
    assert len(subject.feed(message)) == 1


@given(
    st.lists(st.tuples(st.sampled_from([257, 0x123]), st.binary(max_size=8), st.floats())),
)
def test_no_frame_whatsoever_raises(frames):
    subject = decoder()
    for identifier, data, timestamp in frames:
        subject.feed(can.Message(timestamp=timestamp, arbitration_id=identifier, is_extended_id=False, data=data))
        subject.diagnostics(0)


def test_the_rate_is_watched():
    subject = decoder()
    for i in range(40):
        subject.feed(wheels(i, at=START + 0.03 * i))
    found = health(subject, "WHEELS", START + 0.03 * 39)
    assert (found.level, found.message) == (Level.WARN, "rate 33.3 Hz, nominal 100 Hz")


def test_checksums_give_their_published_values():
    check = b"123456789"
    assert CHECKSUMS["crc8_sae_j1850"](0, check, 10) == 0x4B  # catalogue of parametrised CRC algorithms
    assert CHECKSUMS["sum"](0, check, 10) == sum(check) % 256
    assert CHECKSUMS["xor"](0, check, 10) == 0x31
    assert CHECKSUMS["toyota"](0x2E4, bytes.fromhex("be000000"), 5) == 0xA9  # a frame of the RAV4


def changed(**changes) -> dict:
    return MAPPING | changes


def test_a_mapping_to_an_unknown_message_says_which_was_meant():
    outputs = [MAPPING["outputs"][1] | {"message": "STEERS"}]
    mapping = CanMapping.model_validate(changed(outputs=outputs, messages={}))
    with pytest.raises(InputError, match="no message 'STEERS'; did you mean STEER"):
        CanDecoder(DATABASE, mapping)


def test_a_mapping_to_an_unknown_signal_says_which_there_are():
    outputs = [MAPPING["outputs"][1] | {"joints": {"steering_wheel": {"signals": "ANGEL", "unit": "deg"}}}]
    mapping = CanMapping.model_validate(changed(outputs=outputs, messages={}))
    with pytest.raises(InputError, match=r"no signal 'ANGEL'; did you mean ANGLE\?; it has ANGLE"):
        CanDecoder(DATABASE, mapping)


def test_a_unit_that_is_not_that_of_the_database_is_refused():
    outputs = [MAPPING["outputs"][1] | {"joints": {"steering_wheel": {"signals": "ANGLE", "unit": "rad"}}}]
    mapping = CanMapping.model_validate(changed(outputs=outputs, messages={}))
    with pytest.raises(InputError, match=r"gives STEER.ANGLE in 'deg', the mapping says 'rad'"):
        CanDecoder(DATABASE, mapping)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("unit: km/h", "unit: kmhh", r"line 14, outputs.0.joints.wheel_fl: unit 'kmhh' is not known"),
        (", rolling_radius: 0.3", "", r"line \d+, outputs.0: wheel_fl: velocity is in rad/s, but .* m/s"),
        (
            "rolling_radius: 0.3",
            "rolling_radius: -0.3",
            r"line 14, .*rolling_radius: .* greater than 0 \(found: -0.3\)",
        ),
        ("algorithm: xor", "algorithm: xorr", r"line 5, messages.WHEELS.checksum: .*'xorr' is not known"),
        ("    field: velocity\n", "", r"outputs.0.field: Field required"),
        ("name: car\n", "name: car\nnmae: x\n", r"line 2, nmae: Extra inputs"),
    ],
)
def test_a_bad_mapping_file_is_told_by_line_key_and_value(tmp_path, old, new, expected):
    text = """name: car
messages:
  WHEELS:
    timeout: 0.1
    checksum: {algorithm: xor}


outputs:
  - kind: joint_state
    topic: vehicle/wheel_speeds
    message: WHEELS
    field: velocity
    joints:
      wheel_fl: {signals: FL, unit: km/h, rolling_radius: 0.3}
"""
    assert old in text
    path = tmp_path / "mapping.yaml"
    path.write_text(text)
    assert load_mapping(path).name == "car"
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=expected) as error:
        load_mapping(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("text", ["", "just text", "a: [1", "\x00"])
def test_a_file_that_is_no_mapping_is_refused_in_words(tmp_path, text):
    path = tmp_path / "mapping.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"mapping.yaml: "):
        load_mapping(path)


@pytest.mark.parametrize("content", [None, b"not a database", b"\xff\xfe\x00"])
def test_a_file_that_is_no_database_is_refused_in_words(tmp_path, content):
    path = tmp_path / "car.dbc"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=r"car.dbc: "):
        read_database(path)


ROOT = Path(__file__).parents[2]


def rav4_decoder(folder: Path) -> CanDecoder:
    return CanDecoder(folder / "toyota_rav4_2017_pt_generated.dbc", ROOT / "config/can/toyota_rav4_2017.yaml")


@pytest.fixture(scope="module")
def rav4_samples(rav4, rav4_frames):
    subject = rav4_decoder(rav4)
    by_topic: dict[str, list] = {}
    for t, address, data in zip(rav4_frames["t"], rav4_frames["address"], rav4_frames["data"], strict=True):
        message = can.Message(timestamp=t, arbitration_id=int(address), is_extended_id=False, data=data.tobytes())
        for sample in subject.feed(message):
            by_topic.setdefault(sample.topic, []).append(sample)
    return by_topic, subject.diagnostics(round(rav4_frames["t"][-1] * SECOND))


def test_the_rav4s_frames_decode_to_what_its_recorder_decoded(rav4, rav4_samples):
    samples, diagnostics = rav4_samples
    log = rav4 / "segment/processed_log/CAN"
    speeds = np.array([s.values["velocity"] for s in samples["vehicle/wheel_speeds"]])
    np.testing.assert_allclose(speeds * 0.35144, np.load(log / "wheel_speed/value"), atol=1e-9)
    stamps = np.array([s.stamp for s in samples["vehicle/wheel_speeds"]]) * 1e-9
    np.testing.assert_allclose(stamps, np.load(log / "wheel_speed/t"), atol=1e-6)
    angle = np.array([s.values["position"][0] for s in samples["vehicle/steering"]])
    np.testing.assert_allclose(np.degrees(angle), np.load(log / "steering_angle/value"), atol=1e-9)
    assert [d.level for d in diagnostics] == [Level.OK] * 4
    assert all(d.values.get("dropped", "0") == "0" for d in diagnostics)


def test_the_rav4s_can_imu_follows_its_reference_in_sign_and_scale(rav4, rav4_samples):
    samples, _ = rav4_samples
    imu = samples["can/imu/data"]
    t = np.array([s.stamp for s in imu]) * 1e-9
    yaw_rate = np.array([s.values["angular_velocity"][2] for s in imu])
    acceleration = np.array([s.values["linear_acceleration"][0] for s in imu])

    phone = rav4 / "segment/processed_log/IMU"
    phone_t = np.load(phone / "gyro/t")
    inside = (phone_t > t[0] + 1) & (phone_t < t[-1] - 1)
    smooth = np.ones(21) / 21
    for mine, theirs, residual in (
        (yaw_rate, -np.load(phone / "gyro/value")[:, 2], 0.0025),  # its z is down
        (acceleration, np.load(phone / "accelerometer/value")[:, 0], 0.2),
    ):
        mine = np.interp(phone_t, t, np.convolve(mine, smooth, "same"))[inside]
        theirs = np.convolve(theirs, smooth, "same")[inside]
        assert np.std(mine - theirs) < residual < np.std(mine + theirs)
    assert np.isnan(imu[0].values["angular_velocity"]).tolist() == [True, True, False]
    assert np.isnan(imu[0].values["linear_acceleration"]).tolist() == [False, False, True]
    variances = imu[0].values["angular_velocity_covariance"].reshape(3, 3).diagonal()
    assert tuple(variances[:2]) == (UNMEASURED_VARIANCE, UNMEASURED_VARIANCE)


def test_every_damaged_byte_of_a_rav4_steering_frame_is_noticed(rav4, rav4_frames):
    row = np.flatnonzero(rav4_frames["address"] == 0x25)[0]
    for byte in range(8):
        subject = rav4_decoder(rav4)
        data = bytearray(rav4_frames["data"][row].tobytes())
        data[byte] ^= 0x40
        message = can.Message(timestamp=1.0, arbitration_id=0x25, is_extended_id=False, data=data)
        assert subject.feed(message) == []
        assert replace(health(subject, "steering", 1.0), values={}).message == "nothing usable: bad checksum"
