from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.driver import samples
from vsense_ros.driver.imu import ImuChecker, ImuSettings, XbusDecoder, encode_mtdata2, mounting_rotation
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Level
from vsense_ros.messages.recording import Sample

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
STEP = 10_000_000


def reading(i: int, rates=None, accelerations=None, at: int | None = None) -> Sample:
    """Sample `i` of a living IMU at 100 Hz: a different noise in each, exact in single precision."""
    noise = np.array([i % 7, i % 5, i % 3]) / 1024
    return samples.imu(
        "raw",
        START + i * STEP if at is None else at,
        "sensor",
        angular_velocity=noise if rates is None else rates,
        linear_acceleration=noise + np.array([0, 0, 9.8125]) if accelerations is None else accelerations,
    )


def test_a_good_sample_passes_with_the_topic_and_frame_of_the_vehicle():
    passed = ImuChecker().check(reading(1))
    assert passed is not None
    assert (passed.topic, passed.frame_id, passed.stamp) == ("imu/data", "imu_link", START + STEP)
    np.testing.assert_array_equal(passed.values["linear_acceleration"], reading(1).values["linear_acceleration"])
    np.testing.assert_allclose(passed.values["angular_velocity_covariance"].reshape(3, 3), np.eye(3) * 4e-6)


def test_a_sensor_with_axes_forward_right_down_is_turned_to_forward_left_up():
    checker = ImuChecker(ImuSettings(mounting="x,-y,-z"))
    passed = checker.check(reading(0, rates=[1.0, 2.0, 3.0], accelerations=[0.5, -0.25, -9.81]))
    assert passed is not None
    np.testing.assert_array_equal(passed.values["angular_velocity"], [1, -2, -3])
    np.testing.assert_array_equal(passed.values["linear_acceleration"], [0.5, 0.25, 9.81])


def test_covariances_turn_with_the_axes():
    sample = reading(0)
    sample.values["angular_velocity_covariance"][:] = samples.diagonal([1, 4, 9])
    passed = ImuChecker(ImuSettings(mounting="y,-x,z")).check(sample)
    assert passed is not None
    np.testing.assert_allclose(passed.values["angular_velocity_covariance"].reshape(3, 3).diagonal(), [4, 1, 9])


@pytest.mark.parametrize(
    "mounting", ["x,y", "x,y,q", "x,y,-z", "x,x,z", [[1, 0], [0, 1]], [[2, 0, 0]] * 3, "", [["a"]]]
)
def test_a_mounting_that_is_no_rotation_is_refused(mounting):
    with pytest.raises(InputError, match="IMU mounting"):
        mounting_rotation(mounting)


@pytest.mark.parametrize("where", ["rates", "accelerations"])
def test_a_nan_is_dropped_and_reported(where):
    checker = ImuChecker()
    assert checker.check(reading(0)) is not None
    assert checker.check(reading(1, **{where: [0.0, math.nan, 0.0]})) is None
    assert checker.check(reading(2)) is not None
    (found,) = checker.diagnostics(START + 2 * STEP)
    assert (found.name, found.level, found.message) == ("imu: imu/data", Level.ERROR, "not a number")


def test_constant_values_are_frozen_after_a_while_and_believed_again_when_they_move():
    checker = ImuChecker(ImuSettings(frozen_after=20))
    passed = [checker.check(reading(i, [0.0, 0, 0], [0.0, 0, 9.81])) is not None for i in range(40)]
    assert passed == [True] * 19 + [False] * 21
    (found,) = checker.diagnostics(START + 40 * STEP)
    assert (found.level, found.message) == (Level.ERROR, "nothing usable: values frozen")
    assert checker.check(reading(41)) is not None


def test_an_absent_imu_is_stale():
    checker = ImuChecker()
    assert checker.diagnostics(START)[0].message == "never received"
    checker.check(reading(0))
    (found,) = checker.diagnostics(START + SECOND)
    assert (found.level, found.message) == (Level.STALE, "silent for 1.00 s (timeout 0.2 s)")


def test_saturated_values_are_dropped_and_reported():
    checker = ImuChecker(ImuSettings(acceleration_range=20.0))
    assert checker.check(reading(0)) is not None
    assert checker.check(reading(1, accelerations=[0, 20.0, 9.8])) is None
    assert checker.diagnostics(START)[0].message == "saturated"


@pytest.mark.parametrize(
    ("offset", "reason"),
    [(-SECOND, "going backwards"), (3600 * SECOND, "jumping ahead"), (-STEP, "duplicated")],
)
def test_a_wrong_time_stamp_costs_only_its_own_sample(offset, reason):
    checker = ImuChecker()
    passed = []
    for i in range(30):
        if checker.check(reading(i, at=START + i * STEP + (offset if i == 20 else 0))):
            passed.append(i)
    assert passed == [i for i in range(30) if i != 20]
    assert reason in checker.diagnostics(START + 30 * STEP)[0].message


def test_a_time_stamp_that_no_message_can_carry_is_refused():
    checker = ImuChecker()
    assert [checker.check(reading(i, at=2**31 * SECOND + i * STEP)) for i in range(20)] == [None] * 20
    (found,) = checker.diagnostics(2**31 * SECOND)
    assert "time stamp out of range" in found.values


# XBus


def stream(count: int) -> list[bytes]:
    return [encode_mtdata2(reading(i), i) for i in range(count)]


def mtdata2(*packets: tuple[int, bytes]) -> bytes:
    """An XBus message put together by the protocol's description."""
    data = b"".join(identifier.to_bytes(2, "big") + bytes([len(p)]) + p for identifier, p in packets)
    length = bytes([len(data)]) if len(data) < 255 else b"\xff" + len(data).to_bytes(2, "big")
    message = b"\xff\x36" + length + data
    return b"\xfa" + message + bytes([(256 - sum(message) % 256) % 256])


def test_what_is_encoded_is_decoded_to_the_same_stamp_and_values():
    decoder = XbusDecoder()
    decoded = decoder.feed(b"".join(stream(5)), START)
    for i, sample in enumerate(decoded):
        assert sample.stamp == START + i * STEP
        for field in ("angular_velocity", "linear_acceleration"):
            np.testing.assert_array_equal(sample.values[field], reading(i).values[field])
    assert len(decoded) == 5
    assert {d.level for d in decoder.diagnostics(START)} == {Level.OK}


def test_a_message_built_by_the_description_of_the_protocol_is_decoded():
    rates, accelerations = (0.1, -0.2, 0.3), (1.0, -2.0, 9.5)
    utc = struct.pack(">IHBBBBBB", 250_000_000, 2023, 11, 14, 22, 13, 20, 0x07)
    message = mtdata2(
        (0x1010, utc),
        (0x2010, struct.pack(">4f", 1, 0, 0, 0)),
        (0x4023, struct.pack(">3d", *accelerations)),
        (0x8020, struct.pack(">3f", *rates)),
        (0xC020, bytes(200)),  # makes the message longer than 254 bytes
    )
    (sample,) = XbusDecoder().feed(message, 5)
    assert (sample.stamp, sample.received) == (START + 250_000_000, 5)
    np.testing.assert_allclose(sample.values["angular_velocity"], rates, rtol=1e-6)
    np.testing.assert_array_equal(sample.values["linear_acceleration"], accelerations)


def test_a_message_without_rates_marks_them_as_absent():
    (sample,) = XbusDecoder().feed(mtdata2((0x4020, struct.pack(">3f", 0, 0, 9.8))), START)
    assert sample.values["angular_velocity_covariance"][0] == -1


def by_own_clock(decoder: XbusDecoder, i: int, received: int) -> list[Sample]:
    """Message `i` of a sensor at 100 Hz that knows no UTC, whose counter wraps at message 50."""
    ticks = (2**32 - 5000 + i * 100) % 2**32
    packets = ((0x1060, ticks.to_bytes(4, "big")), (0x8020, struct.pack(">3f", i % 7, 0, 0)))
    return decoder.feed(mtdata2(*packets), received)


def test_the_sensors_own_clock_removes_the_jitter_of_arrival():
    decoder = XbusDecoder()
    jitter = np.random.default_rng(1).exponential(3e-3, 200)
    stamps = []
    for i in range(200):
        stamps += [s.stamp for s in by_own_clock(decoder, i, START + i * STEP + round(jitter[i] * SECOND))]
    error = np.array(stamps) - START - np.arange(200) * STEP
    assert np.abs(error[50:]).max() < 0.5e-3 * SECOND < jitter.std() * SECOND


@pytest.mark.parametrize("seconds", [-4.0, 0.5, 4.0, 60.0])
def test_the_sensors_own_clock_follows_a_computer_whose_clock_is_set(seconds):
    decoder = XbusDecoder()
    error = []
    for i in range(600):
        received = START + i * STEP + (round(seconds * SECOND) if i >= 300 else 0)
        error += [abs(sample.stamp - received) for sample in by_own_clock(decoder, i, received)]
    assert max(error[-180:]) < 1_000_000
    (imu,) = (d for d in decoder.diagnostics(received) if "imu/data" in d.name)
    assert "clock was set to another time" in imu.values


def test_messages_that_were_held_back_for_three_seconds_keep_the_time_of_their_measurement():
    decoder = XbusDecoder()
    error = []
    for i in range(900):
        arrival = 600 if 300 <= i < 600 else i
        error += [s.stamp - START - i * STEP for s in by_own_clock(decoder, i, START + arrival * STEP + i)]
    assert np.abs(error).max() < 1_000_000


def test_missing_packets_are_counted():
    decoder = XbusDecoder()
    messages = stream(10)
    decoder.feed(b"".join(messages[:4] + messages[7:]), START)
    imu = decoder.diagnostics(START)[1]
    assert (imu.message, imu.values["lost by the packet counter"]) == ("packets missing", "3")


def test_a_broken_or_half_message_costs_itself_alone():
    messages = stream(5)
    broken = bytearray(messages[1])
    broken[30] ^= 1
    decoder = XbusDecoder()
    decoded = decoder.feed(messages[0] + bytes(broken) + messages[2][:40] + messages[3] + messages[4], START)
    decoded += decoder.feed(bytes(100), START)
    assert [s.stamp for s in decoded] == [START + i * STEP for i in (0, 3, 4)]
    assert decoder.diagnostics(START)[0].level == Level.WARN


def garbage() -> st.SearchStrategy[bytes]:
    message = encode_mtdata2(reading(0))
    parts = st.sampled_from([b"\xfa", b"\xfa\xff", b"\xfa\xff\x36", b"\xfa\xff\x36\x20", message[:30]])
    return st.lists(st.binary(max_size=20) | parts, max_size=5).map(b"".join)


@given(st.lists(garbage(), min_size=4, max_size=4))
def test_no_valid_message_is_lost_in_garbage(noise):
    data = b"".join(more + message for more, message in zip(noise, stream(4), strict=True))
    decoder = XbusDecoder()
    decoded = decoder.feed(data, START) + decoder.feed(bytes(2100), START)
    assert [s.stamp for s in decoded] == [START + i * STEP for i in range(4)]


@given(garbage(), st.lists(st.integers(1, 50), min_size=1))
def test_it_does_not_matter_how_the_bytes_are_cut_into_chunks(noise, sizes):
    data = noise.join(stream(4))
    whole, pieces = XbusDecoder(), XbusDecoder()
    at_once = whole.feed(data, START)
    piecewise = []
    start = 0
    while start < len(data):
        size = sizes[start % len(sizes)]
        piecewise += pieces.feed(data[start : start + size], START)
        start += size
    assert [s.stamp for s in piecewise] == [s.stamp for s in at_once]
    assert pieces.diagnostics(START) == whole.diagnostics(START)


@given(st.lists(st.binary(max_size=60) | garbage(), max_size=10))
def test_no_bytes_whatsoever_raise(chunks):
    decoder = XbusDecoder()
    for chunk in chunks:
        decoder.feed(chunk, START)
    decoder.diagnostics(START)


def test_the_phone_imu_of_the_rav4_passes_through_the_protocol_in_vehicle_axes(rav4):
    folder = rav4 / "segment/processed_log/IMU"
    t = np.load(folder / "gyro/t")[:2000]
    rates = np.load(folder / "gyro/value")[:2000]
    accelerations = np.load(folder / "accelerometer/value")[:2000]
    decoder = XbusDecoder(ImuSettings(mounting="x,-y,-z", nominal_rate=104, frozen_after=50))
    decoded = []
    for i in range(len(t)):
        sample = reading(i, rates[i], accelerations[i], at=START + round((t[i] - t[0]) * SECOND))
        decoded += decoder.feed(encode_mtdata2(sample, i), sample.stamp)
    assert len(decoded) == len(t)
    found = np.array([s.values["linear_acceleration"] for s in decoded])
    np.testing.assert_allclose(found, accelerations * [1, -1, -1], rtol=1e-6)
    assert 9.0 < found[:, 2].mean() < 10.0
    assert {d.level for d in decoder.diagnostics(decoded[-1].stamp)} == {Level.OK}
