"""GNSS bytes against the parsers of pynmeagps and pyubx2."""

from __future__ import annotations

import io
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pynmeagps import NMEAReader
from pyubx2 import UBXReader

from vsense_ros.bag.gnss_bytes import gnss_byte_stream
from vsense_ros.bag.importers import build
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording

STAMP = 1_533_226_488_299_000_000


def one(
    latitude: float,
    longitude: float,
    altitude: float = 10.0,
    enu: tuple[float, ...] = (3.0, -4.0, 0.5),
    stamp: int = STAMP,
) -> Recording:
    time = np.array([stamp])
    received = time + 200_000_000
    fix = build.fix(time, *(np.array([v]) for v in (latitude, longitude, altitude)), received=received)
    return Recording({"gps/fix": fix, "gps/velocity": build.velocity(time, np.array([enu]), received=received)})


def sentences(data: bytes) -> dict[str, object]:
    return {message.msgID: message for _, message in NMEAReader(io.BytesIO(data))}


PLACES = (
    st.floats(-89.999, 89.999),
    st.floats(-179.999, 179.999),
    st.floats(-100, 5000),
    st.tuples(*[st.floats(-60, 60)] * 3),
)


@given(*PLACES)
def test_nmea_carries_place_and_velocity(
    latitude: float, longitude: float, altitude: float, enu: tuple[float, ...]
) -> None:
    [(due, data)] = gnss_byte_stream(one(latitude, longitude, altitude, enu))
    assert due == STAMP + 200_000_000
    parsed = sentences(data)
    for name in ("RMC", "GGA"):
        assert parsed[name].lat == pytest.approx(latitude, abs=3e-9)
        assert parsed[name].lon == pytest.approx(longitude, abs=3e-9)
    assert parsed["GGA"].alt + parsed["GGA"].sep == pytest.approx(altitude, abs=6e-4)
    speed, course = parsed["RMC"].spd * 1852 / 3600, np.radians(parsed["RMC"].cog)
    np.testing.assert_allclose([speed * np.sin(course), speed * np.cos(course)], enu[:2], atol=3e-4)
    assert (parsed["RMC"].date.isoformat(), parsed["RMC"].time.isoformat()) == ("2018-08-02", "16:14:48.299000")


@given(*PLACES)
def test_ubx_carries_place_and_velocity_of_all_three_axes(
    latitude: float, longitude: float, altitude: float, enu: tuple[float, ...]
) -> None:
    [(_, data)] = gnss_byte_stream(one(latitude, longitude, altitude, enu), "ubx")
    message = UBXReader.parse(data)
    assert message.identity == "NAV-PVT"
    np.testing.assert_allclose([message.lat, message.lon], [latitude, longitude], atol=1.1e-7)
    assert message.height == pytest.approx(altitude * 1e3, abs=0.51)
    np.testing.assert_allclose([message.velE, message.velN, -message.velD], np.multiply(enu, 1e3), atol=0.51)
    moment = datetime(message.year, message.month, message.day, message.hour, message.min, message.second, tzinfo=UTC)
    assert round(moment.timestamp()) * 10**9 + message.nano == STAMP


@given(st.integers(1_500_000_000 * 10**9, 1_700_000_000 * 10**9))
def test_ubx_tells_the_time_to_the_nanosecond_and_nmea_to_the_millisecond(stamp: int) -> None:
    message = UBXReader.parse(gnss_byte_stream(one(50, 8, stamp=stamp), "ubx")[0][1])
    moment = datetime(message.year, message.month, message.day, message.hour, message.min, message.second, tzinfo=UTC)
    assert round(moment.timestamp()) * 10**9 + message.nano == stamp
    rmc = sentences(gnss_byte_stream(one(50, 8, stamp=stamp))[0][1])["RMC"]
    told = datetime.combine(rmc.date, rmc.time, UTC).timestamp()
    assert abs(told - stamp * 1e-9) < 0.6e-3


def test_no_fix_is_sent_as_no_fix() -> None:
    recording = one(np.nan, np.nan, np.nan, (np.nan,) * 3)
    parsed = sentences(gnss_byte_stream(recording)[0][1])
    assert (parsed["RMC"].status, parsed["GGA"].quality, parsed["RMC"].lat) == ("V", 0, "")
    assert UBXReader.parse(gnss_byte_stream(recording, "ubx")[0][1]).fixType == 0


def test_bytes_are_due_in_order_of_arrival(rav4: Recording) -> None:
    stream = gnss_byte_stream(rav4)
    due = [time for time, _ in stream]
    assert due == sorted(due)
    assert len(stream) == len(rav4["gps/fix"])
    parsed = sentences(b"".join(data for _, data in stream[:1]))
    assert parsed["RMC"].spd * 1852 / 3600 == pytest.approx(7.823, abs=1e-3)


def test_a_recording_without_gnss_is_an_input_error() -> None:
    with pytest.raises(InputError, match="no gps/fix"):
        gnss_byte_stream(Recording({}, "drive"))
    with pytest.raises(InputError, match="'nmea' or 'ubx'"):
        gnss_byte_stream(one(1, 1), "rtcm")
