"""Numbers in the formats of an inertial sensor, and positions against the velocity of a receiver."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vsense_ros.driver.gnss import DAY, GnssChannels, GnssSettings, metres_between, stamp_of_day
from vsense_ros.driver.imu import ImuSettings, XbusDecoder

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND


def mtdata2(*packets: tuple[int, bytes]) -> bytes:
    """An XBus message put together by the protocol's description."""
    data = b"".join(identifier.to_bytes(2, "big") + bytes([len(p)]) + p for identifier, p in packets)
    message = b"\xff\x36" + bytes([len(data)]) + data
    return b"\xfa" + message + bytes([(256 - sum(message) % 256) % 256])


def fixed_16_32(value: float) -> bytes:
    whole = int(np.floor(value))
    return struct.pack(">Ih", round((value - whole) * 2**32), whole)


# By the two lowest bits of an identifier (Xsens, MT Low Level Communication Protocol): how a number is written.
FORMATS = {
    0: lambda value: struct.pack(">f", value),
    1: lambda value: struct.pack(">i", round(value * 2**20)),
    2: fixed_16_32,
    3: lambda value: struct.pack(">d", value),
}


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("fields", [(0x4020, 0x8020), (0x4040, 0x8040)], ids=["usual", "high rate"])
def test_a_number_is_read_in_each_of_the_four_formats(form, fields):
    forces, rates = (1.25, -2.5, 9.8125), (0.125, -0.25, 0.5)
    packets = [
        (identifier + form, b"".join(FORMATS[form](value) for value in values))
        for identifier, values in zip(fields, (forces, rates), strict=True)
    ]
    (sample,) = XbusDecoder().feed(mtdata2(*packets), START)
    np.testing.assert_allclose(sample.values["linear_acceleration"], forces, atol=1e-6)
    np.testing.assert_allclose(sample.values["angular_velocity"], rates, atol=1e-6)


@given(st.tuples(*[st.floats(-2.0, 2.0)] * 3), st.sampled_from([1.0, -1.0]))
def test_an_increment_of_rotation_over_its_period_is_the_rate_of_scipy(rates, sign):
    turn = Rotation.from_rotvec(0.01 * np.array(rates)).as_quat(scalar_first=False)
    quaternion = sign * np.array([turn[3], *turn[:3]])
    speed = (0.01, -0.02, 0.098)
    packets = (0x4013, struct.pack(">3d", *speed)), (0x8033, struct.pack(">4d", *quaternion))
    (sample,) = XbusDecoder(ImuSettings(nominal_rate=100.0)).feed(mtdata2(*packets), START)
    np.testing.assert_allclose(sample.values["angular_velocity"], rates, atol=1e-9)
    np.testing.assert_allclose(sample.values["linear_acceleration"], 100 * np.array(speed), atol=1e-9)


def channels(**settings: float) -> GnssChannels:
    return GnssChannels(GnssSettings(**settings))  # type: ignore[arg-type]


def driven(step: float, speed: tuple[float, float], extra: tuple[float, float], count: int = 6) -> GnssChannels:
    """A receiver that moves at a speed [m/s] to east and north, and `extra` metres more at its last fix."""
    made = channels()
    latitude, longitude = 48.0, 11.0
    east_degree, north_degree = metres_between(48.0, 11.0, 48.0, 12.0)[0], metres_between(48.0, 11.0, 49.0, 11.0)[1]
    for i in range(count):
        stamp = START + round(i * step * SECOND)
        made.velocity(stamp, stamp, *speed, 0.0, (0.01, 0.01, 0.01))
        more = extra if i == count - 1 else (0.0, 0.0)
        made.fix(
            stamp, stamp, latitude + (speed[1] * i * step + more[1]) / north_degree,
            longitude + (speed[0] * i * step + more[0]) / east_degree, 500.0, (1.0, 1.0, 4.0), 0, 1, 2,
        )  # fmt: skip
    return made


@pytest.mark.parametrize("step", [0.1, 0.25, 2.0])
@pytest.mark.parametrize("speed", [(40.0, 0.0), (0.0, -40.0), (25.0, 25.0)])
@pytest.mark.parametrize(("share", "jumps"), [(0.0, 0), (0.9, 0), (-0.9, 0), (1.1, 1), (-1.1, 1)])
def test_a_position_jumps_where_it_is_farther_from_the_way_of_the_velocity_than_the_limit(step, speed, share, jumps):
    limit = GnssSettings().jump_limit
    for extra in ((share * limit, 0.0), (0.0, share * limit)):
        made = driven(step, speed, extra)
        assert made.fix_monitor.doubts["position jump against the velocity"] == jumps


def test_without_a_fresh_velocity_no_position_jumps():
    made = channels()
    for i, latitude in enumerate((48.0, 48.1, 48.2)):
        stamp = START + i * SECOND
        made.fix(stamp, stamp, latitude, 11.0, 500.0, (1.0, 1.0, 4.0), 0, 1, 2)
    assert not made.fix_monitor.doubts
    made.velocity(START - 4 * SECOND, START, 0.0, 0.0, 0.0, (1.0, 1.0, 1.0))
    made.fix(START + 3 * SECOND, START + 3 * SECOND, 48.3, 11.0, 500.0, (1.0, 1.0, 4.0), 0, 1, 2)
    assert not made.fix_monitor.doubts
    made.velocity(START, START, 0.0, 0.0, 0.0, (1.0, 1.0, 1.0))
    made.fix(START + 4 * SECOND, START + 4 * SECOND, 48.4, 11.0, 500.0, (1.0, 1.0, 4.0), 0, 1, 2)
    assert made.fix_monitor.doubts["position jump against the velocity"] == 1


@pytest.mark.parametrize(
    ("latitude", "longitude", "altitude", "taken"),
    [
        (90.0, 180.0, 0.0, True), (-90.0, -180.0, 0.0, True), (90.1, 0.0, 0.0, False), (0.0, 180.1, 0.0, False),
        (np.nan, 0.0, 0.0, False), (0.0, np.nan, 0.0, False), (0.0, 0.0, np.nan, False), (0.0, 0.0, np.inf, False),
    ],
)  # fmt: skip
def test_a_position_out_of_range_is_a_fault(latitude, longitude, altitude, taken):
    made = channels()
    found = made.fix(START, START, latitude, longitude, altitude, (1.0, 2.0, 3.0), 0, 1, 2)
    assert bool(found) == taken
    assert made.fix_monitor.faults["position out of range"] == (not taken)
    if taken:
        assert found[0].values["position_covariance"].reshape(3, 3).diagonal().tolist() == [1.0, 2.0, 3.0]


@given(reference=st.integers(10 * DAY, 20 * DAY), time_of_day=st.integers(0, DAY - 1))
def test_the_moment_of_a_time_of_day_is_the_nearest_one(reference, time_of_day):
    found = stamp_of_day(time_of_day, reference)
    assert found % DAY == time_of_day
    assert abs(found - reference) <= DAY // 2
