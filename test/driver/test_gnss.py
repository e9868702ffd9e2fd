from __future__ import annotations

import datetime
import math
import struct
from collections.abc import Iterator
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pynmeagps import GET, NMEAMessage
from pyubx2 import UBXMessage, UBXReader, calc_checksum
from scipy.spatial.transform import Rotation

from vsense_ros.bag import read_bag
from vsense_ros.bag.gnss_bytes import gnss_byte_stream
from vsense_ros.bag.importers import import_recording
from vsense_ros.driver.gnss import GnssSettings, metres_between, stamp_of_day
from vsense_ros.driver.nmea import NmeaDecoder
from vsense_ros.driver.samples import UNMEASURED_VARIANCE, heading_and_tilt
from vsense_ros.driver.ubx import PositionVelocityTime, RelativePosition, UbxDecoder, fletcher
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample

SECOND = 1_000_000_000
UTC = datetime.UTC
BAGS = Path(__file__).resolve().parents[2] / "bags"
NOON = datetime.datetime(2024, 5, 17, 12, 0, 0, tzinfo=UTC)
KNOT = 1852 / 3600


def stamp(moment: datetime.datetime) -> int:
    return round(moment.timestamp() * 1000) * 1_000_000


def sentence(kind: str, **fields) -> bytes:
    return NMEAMessage("GN", kind, GET, hpnmeamode=1, **fields).serialize()


def gga(moment: datetime.datetime, latitude: float = 48.1, longitude: float = 11.5, **fields) -> bytes:
    content = {
        "lat": latitude,
        "NS": "N" if latitude >= 0 else "S",
        "lon": longitude,
        "EW": "E" if longitude >= 0 else "W",
        "quality": 1,
        "numSV": 12,
        "HDOP": 0.8,
        "alt": 500.0,
        "altUnit": "M",
        "sep": 47.0,
        "sepUnit": "M",
    }
    return sentence("GGA", time=moment.time(), **(content | fields))


def rmc(moment: datetime.datetime, speed: float = 10.0, course: float | str = 90.0, status: str = "A") -> bytes:
    return sentence(
        "RMC",
        time=moment.time(),
        status=status,
        lat=48.1,
        NS="N",
        lon=11.5,
        EW="E",
        spd=round(speed / KNOT, 6),
        cog=course,
        date=moment.date(),
    )


def time_of_week(moment: datetime.datetime) -> int:
    return round((moment - datetime.datetime(2024, 5, 12, tzinfo=UTC)).total_seconds() * 1000) % 604_800_000


def pvt(moment: datetime.datetime, **fields) -> bytes:
    content = {
        "iTOW": time_of_week(moment),
        "year": moment.year,
        "month": moment.month,
        "day": moment.day,
        "hour": moment.hour,
        "min": moment.minute,
        "second": moment.second,
        "nano": moment.microsecond * 1000,
        "validDate": 1,
        "validTime": 1,
        "fullyResolved": 1,
        "fixType": 3,
        "gnssFixOk": 1,
        "lat": 48.1,
        "lon": 11.5,
        "height": 547_000,
        "hAcc": 1414,
        "vAcc": 3000,
        "velN": 1000,
        "velE": -2000,
        "velD": 300,
        "sAcc": 200,
    }
    return UBXMessage("NAV", "NAV-PVT", GET, **(content | fields)).serialize()


def relposned(moment: datetime.datetime, **fields) -> bytes:
    content = {
        "version": 1,
        "iTOW": time_of_week(moment),
        "relPosN": 100,
        "relPosD": -10,
        "relPosLength": 101,
        "relPosHeading": 30.0,
        "accHeading": 0.2,
        "accD": 1.0,
        "gnssFixOK": 1,
        "relPosHeadingValid": 1,
    }
    return UBXMessage("NAV", "NAV-RELPOSNED", GET, **(content | fields)).serialize()


def after(seconds: float) -> datetime.datetime:
    return NOON + datetime.timedelta(seconds=seconds)


def by_topic(samples: list[Sample], topic: str) -> list[Sample]:
    return [sample for sample in samples if sample.topic == topic]


def health(decoder: NmeaDecoder | UbxDecoder, part: str, now: int) -> Diagnostic:
    (found,) = [d for d in decoder.diagnostics(now) if part in d.name]
    return found


def yaw(sample: Sample) -> float:
    return Rotation.from_quat(sample.values["orientation"]).as_euler("ZYX")[0]


# NMEA


def test_a_position_has_its_ellipsoidal_height_and_the_utc_time_of_measurement():
    decoder = NmeaDecoder()
    arrival = stamp(NOON) + 80_000_000
    (velocity,) = decoder.feed(rmc(NOON), arrival)
    (fix,) = decoder.feed(gga(after(0.1), -33.25, -70.5), arrival)
    assert (fix.topic, fix.frame_id, fix.received) == ("gps/fix", "gnss_link", arrival)
    assert fix.stamp == stamp(NOON) + 100_000_000
    values = fix.values
    assert values["latitude"][0] == pytest.approx(-33.25, abs=1e-9)
    assert values["longitude"][0] == pytest.approx(-70.5, abs=1e-9)
    assert values["altitude"][0] == pytest.approx(547.0)
    np.testing.assert_allclose(values["position_covariance"].reshape(3, 3).diagonal(), [2.4**2, 2.4**2, 3.6**2])
    assert velocity.stamp == stamp(NOON)


@pytest.mark.parametrize(("course", "east", "north"), [(90, 10, 0), (180, 0, -10), (315, -7.0711, 7.0711)])
def test_speed_and_course_become_an_east_and_north_velocity(course, east, north):
    (sample,) = NmeaDecoder().feed(rmc(NOON, 10.0, course), 0)
    assert (sample.topic, sample.frame_id) == ("gps/velocity", "map")
    np.testing.assert_allclose(sample.values["linear"], [east, north, 0.0], atol=1e-3)
    variances = sample.values["covariance"].reshape(6, 6).diagonal()
    np.testing.assert_allclose(variances, [0.01, 0.01, *[UNMEASURED_VARIANCE] * 4])


def test_standing_still_without_a_course_is_a_velocity_of_zero():
    (sample,) = NmeaDecoder().feed(rmc(NOON, 0.02, ""), 0)
    np.testing.assert_array_equal(sample.values["linear"], [0, 0, 0])


def test_positions_before_the_first_date_wait_for_it():
    decoder = NmeaDecoder()
    assert decoder.feed(gga(NOON), stamp(NOON)) == []
    samples = decoder.feed(rmc(NOON), stamp(NOON))
    assert [(s.topic, s.stamp) for s in samples] == [("gps/fix", stamp(NOON)), ("gps/velocity", stamp(NOON))]


def test_without_any_date_the_date_of_arrival_is_taken_after_a_while():
    decoder = NmeaDecoder()
    moments = [after(0.5 * i) for i in range(8)]
    samples = [s for m in moments for s in decoder.feed(gga(m), stamp(m) + 50_000_000)]
    assert [s.stamp for s in samples] == [stamp(m) for m in moments]


def test_midnight_does_not_break_the_order_of_stamps():
    decoder = NmeaDecoder()
    midnight = datetime.datetime(2024, 2, 28, 23, 59, 59, tzinfo=UTC)
    moments = [midnight + datetime.timedelta(milliseconds=200 * i) for i in range(11)]
    data = b"".join(gga(m) + rmc(m) for m in moments)
    samples = by_topic(decoder.feed(data, stamp(midnight)), "gps/fix")
    assert [s.stamp for s in samples] == [stamp(m) for m in moments]


@given(st.integers(0, 4_000_000_000), st.floats(-43000, 43000))
def test_a_time_of_day_finds_its_day_around_a_reference(seconds, offset):
    reference = seconds * SECOND
    true = reference + round(offset * 1000) * 1_000_000
    assert stamp_of_day(true % (86400 * SECOND), reference) == true


def test_accuracies_stated_by_gst_are_used():
    decoder = NmeaDecoder()
    decoder.feed(rmc(NOON), 0)
    decoder.feed(sentence("GST", time=NOON.time(), rangeRms=1.0, stdLat=0.5, stdLong=0.4, stdAlt=0.9), 0)
    (fix,) = decoder.feed(gga(NOON), 0)
    np.testing.assert_allclose(fix.values["position_covariance"].reshape(3, 3).diagonal(), [0.16, 0.25, 0.81])
    assert fix.values["position_covariance_type"] == 2


def test_gns_stands_for_gga_but_not_beside_it():
    def gns(moment: datetime.datetime) -> bytes:
        place = {"lat": 48.1, "NS": "N", "lon": 11.5, "EW": "E"}
        height = {"alt": 500.0, "sep": 47.0}
        return sentence("GNS", time=moment.time(), **place, posMode="AR", numSV=12, HDOP=0.8, **height)

    decoder = NmeaDecoder()
    samples = decoder.feed(rmc(NOON) + gns(NOON) + gga(NOON), 0)
    (fix,) = by_topic(samples, "gps/fix")
    assert fix.values["status"] == 2
    assert health(decoder, "gps/fix", 0).level == Level.OK


def test_vtg_gives_the_velocity_where_there_is_no_rmc():
    decoder = NmeaDecoder()
    zda = sentence("ZDA", time=NOON.time(), day=17, month=5, year=2024)
    vtg = sentence("VTG", cogt=0.0, cogtUnit="T", sogn=10.0, sognUnit="N", sogk=18.52, sogkUnit="K", posMode="A")
    (velocity,) = by_topic(decoder.feed(zda + gga(NOON) + vtg, 0), "gps/velocity")
    np.testing.assert_allclose(velocity.values["linear"], [0, 10 * KNOT, 0])
    assert velocity.stamp == stamp(NOON)


@pytest.mark.parametrize(
    ("heading", "baseline", "expected"), [(0, 0, 90), (90, 0, 0), (350, 0, 100), (0, 90, 0), (180, 180, 90)]
)
def test_a_dual_antenna_heading_becomes_the_vehicles_yaw_from_east(heading, baseline, expected):
    decoder = NmeaDecoder(GnssSettings(baseline_yaw=math.radians(baseline)))
    data = rmc(NOON) + gga(NOON) + sentence("HDT", headingT=heading, headingTu="T")
    (sample,) = by_topic(decoder.feed(data, 0), "gps/attitude")
    assert math.remainder(yaw(sample) - math.radians(expected), 2 * math.pi) == pytest.approx(0, abs=1e-9)
    assert sample.values["angular_velocity_covariance"][0] == -1
    assert sample.values["linear_acceleration_covariance"][0] == -1
    variances = sample.values["orientation_covariance"].reshape(3, 3).diagonal()
    assert tuple(variances[:2]) == (UNMEASURED_VARIANCE, UNMEASURED_VARIANCE)


@pytest.mark.parametrize("order", ["heading first", "position first"])
@pytest.mark.parametrize("headings", [1, 10])
def test_a_heading_has_the_time_of_its_measurement_wherever_its_sentence_stands(order, headings):
    decoder = NmeaDecoder()
    error = []
    for i in range(10 * headings):
        moment = after(i / headings)
        data = [sentence("HDT", headingT=90.0, headingTu="T")]
        if i % headings == 0:
            data[0 if order == "position first" else 1 : 0] = [rmc(moment), gga(moment)]
        for k, one in enumerate(data):  # 15 ms later each, as at a low baud rate
            samples = decoder.feed(one, stamp(moment) + 70_000_000 + 15_000_000 * k)
            error += [s.stamp - stamp(moment) for s in by_topic(samples, "gps/attitude")]
    assert error == [0] * (10 * headings - (order == "heading first"))


def test_no_fix_is_reported_and_gives_no_position():
    decoder = NmeaDecoder()
    assert decoder.feed(rmc(NOON) + gga(NOON, quality=0), 0)[1:] == []
    assert health(decoder, "gps/fix", 0).message == "nothing usable: no fix"


def drive(count: int, jump_at: int | None = None) -> Iterator[tuple[int, bytes]]:
    """Ten fixes a second at 10 m/s to the east, from fix `jump_at` on 20 m to the north."""
    for i in range(count):
        moment = after(0.1 * i)
        north = 20.0 if jump_at is not None and i >= jump_at else 0.0
        latitude, longitude, _ = pymap3d.enu2geodetic(1.0 * i, north, 0, 48.1, 11.5, 500)
        yield stamp(moment), rmc(moment) + gga(moment, float(latitude), float(longitude))


def test_a_drive_at_the_speed_that_is_measured_shows_no_jump():
    decoder = NmeaDecoder()
    for at, data in drive(30):
        decoder.feed(data, at)
    assert health(decoder, "gps/fix", at).level == Level.OK


def test_a_jump_of_20_m_is_marked_and_left_to_the_observer():
    decoder = NmeaDecoder()
    samples = [s for at, data in drive(30, jump_at=25) for s in by_topic(decoder.feed(data, at), "gps/fix")]
    assert len(samples) == 30
    found = health(decoder, "gps/fix", samples[-1].stamp)
    assert (found.level, found.message) == (Level.WARN, "position jump against the velocity")
    assert found.values["position jump against the velocity"] == "1"


@pytest.mark.parametrize(
    ("seconds", "reason"), [(-2.0, "going backwards"), (3600.0, "jumping ahead"), (-0.1, "duplicated")]
)
def test_a_wrong_time_costs_only_its_own_measurement(seconds, reason):
    decoder = NmeaDecoder()
    passed = []
    for i in range(30):
        moment = after(0.1 * i + (seconds if i == 20 else 0))
        passed += [i] * len(by_topic(decoder.feed(rmc(moment) + gga(moment), stamp(after(0.1 * i))), "gps/fix"))
    assert passed == [i for i in range(30) if i != 20]
    assert reason in health(decoder, "gps/fix", stamp(after(2.9))).message


@pytest.mark.parametrize(
    ("ahead", "told"),
    [
        (0.0, None),
        (-0.5, None),  # a slow receiver
        (0.8, "the computer's clock is 0.8 s behind the receiver's"),
        (-3.0, "the computer's clock is 3.0 s ahead of the receiver's"),
        (-1024 * 7 * 86400, "the computer's clock is 619315200.0 s ahead of the receiver's"),
    ],
)
@pytest.mark.parametrize("decoder", [NmeaDecoder, UbxDecoder])
def test_a_receiver_whose_clock_is_not_that_of_the_computer_is_told(decoder, ahead, told):
    subject = decoder()
    for i in range(20):
        moment = after(i + ahead)
        data = pvt(moment, velN=0, velE=0) if isinstance(subject, UbxDecoder) else rmc(moment, 0.0) + gga(moment)
        assert len(subject.feed(data, stamp(after(i)))) == 2
    found = [d.message.partition(":")[0] for d in subject.diagnostics(stamp(after(19))) if d.level != Level.OK]
    assert found == ([told] if told else [])


def test_a_checksum_error_costs_one_sentence_and_is_reported():
    decoder = NmeaDecoder()
    broken = bytearray(rmc(after(0.1)))
    broken[10] ^= 1
    samples = decoder.feed(rmc(NOON) + bytes(broken) + rmc(after(0.2)), stamp(NOON))
    assert [s.stamp for s in samples] == [stamp(NOON), stamp(after(0.2))]
    assert health(decoder, "link", stamp(NOON)).message == "broken frames (incomplete or wrong checksum)"


def cut(whole: bytes, fields: int) -> bytes:
    """The first `fields` fields of a sentence, with the checksum that they have."""
    content = b",".join(whole[1 : whole.index(b"*")].split(b",")[:fields])
    return b"$%s*%02X\r\n" % (content, reduce(xor, content))


@pytest.mark.parametrize(
    ("whole", "fields"),
    [
        (gga(NOON), 2),
        (gga(NOON), 1),
        (rmc(NOON), 9),
        (sentence("VTG", cogt=0.0, cogtUnit="T", sogn=10.0, sognUnit="N"), 3),
        (sentence("ZDA", time=NOON.time(), day=17, month=5, year=2024), 3),
        (sentence("GST", time=NOON.time(), rangeRms=1.0, stdLat=0.5, stdLong=0.4, stdAlt=0.9), 7),
        (sentence("GNS", time=NOON.time(), lat=48.1, NS="N", lon=11.5, EW="E", posMode="AR"), 6),
        (sentence("HDT", headingT=90.0, headingTu="T"), 1),
        (sentence("THS", headt=90.0, mi="A"), 2),
    ],
)
def test_a_short_sentence_with_a_right_checksum_is_counted_as_broken_and_costs_itself_alone(whole, fields):
    decoder = NmeaDecoder()
    decoder.feed(rmc(NOON), stamp(NOON))
    assert decoder.feed(cut(whole, fields), stamp(NOON)) == []
    assert health(decoder, "link", stamp(NOON)).values["broken frames"] == "1"
    (after_it,) = decoder.feed(rmc(after(0.2)), stamp(after(0.2)))
    assert after_it.stamp == stamp(after(0.2))


def test_a_figure_beyond_any_receiver_counts_as_an_empty_field():
    decoder = NmeaDecoder()
    decoder.feed(rmc(NOON), stamp(NOON))
    assert b",0.8," in gga(NOON)
    (fix,) = decoder.feed(cut(gga(NOON).replace(b",0.8,", b",1E200,"), 15), stamp(NOON))
    assert fix.values["position_covariance"][0] == 9.0


@pytest.mark.parametrize("year", [1960, 2039, 2263, 9999])
def test_a_date_that_no_message_can_carry_is_refused(year):
    moment = NOON.replace(year=year)
    zda = sentence("ZDA", time=moment.time(), day=17, month=5, year=year)
    vtg = sentence("VTG", cogt=0.0, cogtUnit="T", sogn=10.0, sognUnit="N")
    for decoder, data in (
        (NmeaDecoder(), (zda + gga(moment) + vtg + sentence("HDT", headingT=90.0, headingTu="T")) * 9),
        (UbxDecoder(), (pvt(moment) + relposned(moment)) * 9),
    ):
        assert decoder.feed(data, stamp(NOON)) == []
        for part in ("gps/fix", "gps/velocity", "gps/attitude"):
            assert health(decoder, part, stamp(NOON)).message == "nothing usable: time stamp out of range"


def test_faults_are_told_for_two_seconds_also_when_the_clock_is_then_set_back():
    decoder = NmeaDecoder()
    ahead = 7200 * SECOND
    broken = bytearray(rmc(NOON))
    broken[10] ^= 1
    decoder.feed(bytes(broken) + rmc(NOON, status="V") + gga(NOON, quality=0), stamp(NOON) + ahead)
    decoder.feed(rmc(after(0.1), 0.0) + gga(after(0.1)), stamp(after(0.1)) + ahead)
    # Between two ticks of a simulated clock, arrivals may be a little ahead of the report.
    for now in (after(0.0), after(0.2)):
        assert {d.level for d in decoder.diagnostics(stamp(now) + ahead)} == {Level.WARN}
    for second in range(1, 4):
        decoder.feed(rmc(after(second), 0.0) + gga(after(second)), stamp(after(second)))
    assert {d.level for d in decoder.diagnostics(stamp(after(3)))} == {Level.OK}


def test_half_a_sentence_does_not_take_the_next_one_with_it():
    samples = NmeaDecoder().feed(rmc(NOON)[:30] + rmc(after(0.2)), 0)
    assert [s.stamp for s in samples] == [stamp(after(0.2))]


def test_bytes_without_a_sentence_ask_for_baud_rate_and_protocol():
    decoder = NmeaDecoder()
    assert health(decoder, "link", 0).level == Level.STALE
    assert decoder.feed(bytes(range(256)) * 4, 0) == []
    found = health(decoder, "link", 0)
    assert found.level == Level.ERROR
    assert "baud rate" in found.message


def test_a_silent_receiver_is_stale():
    decoder = NmeaDecoder()
    decoder.feed(rmc(NOON) + gga(NOON), stamp(NOON))
    assert {d.level for d in decoder.diagnostics(stamp(NOON))} == {Level.OK}
    assert {d.level for d in decoder.diagnostics(stamp(after(10)))} == {Level.STALE}


# UBX


def test_nav_pvt_gives_position_and_velocity_with_the_receivers_accuracies():
    fix, velocity = UbxDecoder().feed(pvt(after(0.25)), 7)
    assert fix.stamp == velocity.stamp == stamp(after(0.25))
    assert fix.received == 7
    assert [fix.values[n][0] for n in ("latitude", "longitude", "altitude")] == pytest.approx([48.1, 11.5, 547.0])
    np.testing.assert_allclose(fix.values["position_covariance"].reshape(3, 3).diagonal(), [1, 1, 9], rtol=1e-3)
    np.testing.assert_allclose(velocity.values["linear"], [-2, 1, -0.3])
    np.testing.assert_allclose(velocity.values["covariance"].reshape(6, 6).diagonal()[:3], 0.04 / 3)


def test_a_negative_nanosecond_part_reaches_back_over_the_second():
    fix, _ = UbxDecoder().feed(pvt(NOON, nano=-250_000), 0)
    assert fix.stamp == stamp(NOON) - 250_000


def test_nav_relposned_gives_yaw_and_pitch_at_the_time_of_its_epoch():
    decoder = UbxDecoder()
    assert decoder.feed(relposned(NOON), 0) == []  # no date yet
    samples = decoder.feed(pvt(NOON) + relposned(after(0.1)), 0)
    (sample,) = by_topic(samples, "gps/attitude")
    assert sample.stamp == stamp(after(0.1))
    angles = Rotation.from_quat(sample.values["orientation"]).as_euler("ZYX")
    # The front antenna is 10 cm higher: nose up, which is a negative pitch in ISO 8855.
    np.testing.assert_allclose(angles, [math.radians(60), -math.asin(10 / 101), 0], atol=1e-6)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"fixType": 0}, "no fix"),
        ({"gnssFixOk": 0}, "no fix"),
        ({"validTime": 0}, "time not known"),
        ({"fullyResolved": 0}, "time not resolved: the leap seconds are not known yet"),
        ({"month": 13}, "time out of range"),
    ],
)
def test_a_solution_that_is_not_valid_is_reported_and_dropped(fields, message):
    decoder = UbxDecoder()
    assert decoder.feed(pvt(NOON, **fields), 0) == []
    assert health(decoder, "gps/velocity", 0).message == f"nothing usable: {message}"


def test_a_broken_or_half_ubx_frame_costs_itself_alone():
    decoder = UbxDecoder()
    broken = bytearray(pvt(after(0.1)))
    broken[50] ^= 1
    samples = decoder.feed(pvt(NOON) + bytes(broken) + pvt(after(0.2))[:60] + pvt(after(0.3)), stamp(NOON))
    samples += decoder.feed(bytes(100), stamp(NOON))  # what the half frame was waiting for
    assert [s.stamp for s in by_topic(samples, "gps/fix")] == [stamp(NOON), stamp(after(0.3))]
    assert health(decoder, "link", stamp(NOON)).values["broken frames"] == "2"


# Both


STREAM = [(rmc(m) + gga(m), pvt(m)) for m in (after(0.1 * i) for i in range(4))]


def test_each_decoder_finds_its_own_in_a_mixed_stream():
    data = b"".join(text + binary for text, binary in STREAM)
    stamps = [stamp(after(0.1 * i)) for i in range(4)]
    for decoder in (NmeaDecoder(), UbxDecoder()):
        assert [s.stamp for s in by_topic(decoder.feed(data, 0), "gps/fix")] == stamps
        assert health(decoder, "link", 0).level == Level.OK


def garbage() -> st.SearchStrategy[bytes]:
    """Random bytes with parts of real frames among them."""
    text, binary = STREAM[0]
    parts = st.sampled_from([b"$", b"*", b"\r\n", b"$GNRMC,", b"\xb5", b"\xb5\x62", binary[:6], binary[:40], text[:70]])
    return st.lists(st.binary(max_size=20) | parts, max_size=6).map(b"".join)


@settings(deadline=None)
@given(st.lists(garbage(), min_size=5, max_size=5), st.booleans())
def test_no_valid_frame_is_lost_in_garbage(noise, binary):
    frames = [pair[binary] for pair in STREAM]
    data = noise[0] + b"".join(frame + more for frame, more in zip(frames, noise[1:], strict=True))
    decoder = UbxDecoder() if binary else NmeaDecoder()
    samples = decoder.feed(data, 0)
    samples += decoder.feed(bytes(200), 0)  # flushes a frame that garbage only pretends to begin
    assert {stamp(after(0.1 * i)) for i in range(4)} <= {s.stamp for s in by_topic(samples, "gps/velocity")}


@settings(deadline=None)
@given(garbage(), st.lists(st.integers(1, 50), min_size=1), st.booleans())
def test_it_does_not_matter_how_the_bytes_are_cut_into_chunks(noise, sizes, binary):
    data = noise.join(pair[binary] for pair in STREAM)
    whole = UbxDecoder() if binary else NmeaDecoder()
    pieces = UbxDecoder() if binary else NmeaDecoder()
    at_once = whole.feed(data, 0)
    piecewise = []
    start = 0
    while start < len(data):
        size = sizes[start % len(sizes)]
        piecewise += pieces.feed(data[start : start + size], 0)
        start += size
    assert [(s.topic, s.stamp) for s in piecewise] == [(s.topic, s.stamp) for s in at_once]
    assert pieces.diagnostics(0) == whole.diagnostics(0)


@given(st.lists(st.binary(max_size=60), max_size=10))
def test_no_bytes_whatsoever_raise(chunks):
    for decoder in (NmeaDecoder(), UbxDecoder()):
        for chunk in chunks:
            decoder.feed(chunk, 0)
        decoder.diagnostics(0)


@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(-100, 100), st.floats(-100, 100))
def test_short_ways_on_the_ellipsoid_agree_with_pymap3d(latitude, longitude, east, north):
    to_latitude, to_longitude, _ = pymap3d.enu2geodetic(east, north, 0, latitude, longitude, 0)
    found = metres_between(latitude, longitude, float(to_latitude), float(to_longitude))
    np.testing.assert_allclose(found, [east, north], atol=0.02)


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_the_attitude_quaternion_is_that_of_yaw_pitch_roll(yaw_angle, pitch, roll):
    sample = heading_and_tilt("t", 0, "f", yaw_angle, (1, 1, 1), roll, pitch)
    expected = Rotation.from_euler("ZYX", [yaw_angle, pitch, roll])
    difference = expected.inv() * Rotation.from_quat(sample.values["orientation"])
    assert difference.magnitude() == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(("protocol", "decoder"), [("nmea", NmeaDecoder()), ("ubx", UbxDecoder())])
def test_the_rav4s_drive_passes_through_the_bytes_of_a_receiver_unchanged(rav4, protocol, decoder):
    recording = import_recording(rav4)
    stream = gnss_byte_stream(recording, protocol)
    decoded = [sample for at, data in stream for sample in decoder.feed(data, at)]
    fixes, velocities = by_topic(decoded, "gps/fix"), by_topic(decoded, "gps/velocity")
    assert [s.stamp for s in fixes] == recording["gps/fix"].stamp.tolist()
    for field, tolerance in (("latitude", 2e-7), ("longitude", 2e-7), ("altitude", 1e-3)):
        expected = recording["gps/fix"].columns[field]
        np.testing.assert_allclose([s.values[field] for s in fixes], expected, atol=tolerance)
    expected = recording["gps/velocity"].columns["linear"][:, :2]
    np.testing.assert_allclose([s.values["linear"][:2] for s in velocities], expected, atol=1e-3)
    assert {d.level for d in decoder.diagnostics(stream[-1][0])} == {Level.OK}


def test_settings_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="timeout is 0, expected a number above 0"):
        GnssSettings(timeout=0)


@given(st.binary(min_size=92, max_size=92))
def test_the_numbers_of_nav_pvt_are_those_that_pyubx2_reads(payload: bytes) -> None:
    ours = PositionVelocityTime.of(payload)
    theirs = UBXMessage("NAV", "NAV-PVT", GET, payload=payload)
    plain = ("iTOW", "year", "month", "day", "hour", "min", "second", "nano", "fixType", "height", "hAcc", "vAcc")
    for name in (*plain, "velN", "velE", "velD", "sAcc"):
        assert getattr(ours, name) == getattr(theirs, name), name
    assert (round(ours.lat * 1e-7, 12), round(ours.lon * 1e-7, 12)) == (theirs.lat, theirs.lon)
    flags = (theirs.validDate, theirs.validTime, theirs.fullyResolved)
    assert [ours.valid >> i & 1 for i in range(3)] == [*flags]
    assert (ours.flags & 1, ours.flags >> 1 & 1, ours.flags >> 6) == (
        theirs.gnssFixOk,
        theirs.diffSoln,
        theirs.carrSoln,
    )
    assert ours.flags3 & 1 == theirs.invalidLlh


def library_reads(frame: bytes) -> list[tuple[str, int, list[float]]]:
    """Topic, stamp and measurements of the samples of a NAV-PVT frame, by pyubx2 and datetime."""
    read = UBXReader.parse(frame)
    usable = read.validDate and read.validTime and read.fullyResolved and read.gnssFixOk and read.fixType in (2, 3, 4)
    try:
        second = min(read.second, 59)
        moment = datetime.datetime(read.year, read.month, read.day, read.hour, read.min, second, tzinfo=UTC)
    except ValueError:
        usable = False
    if not usable:
        return []
    at = round(moment.timestamp()) * SECOND + read.nano
    if not 0 <= at < 2**31 * SECOND:
        return []
    made = []
    if not read.invalidLlh and abs(read.lat) <= 90 and abs(read.lon) <= 180:
        made.append(("gps/fix", at, [read.lat, read.lon, read.height * 1e-3, (read.hAcc * 1e-3) ** 2 / 2]))
    speeds = [read.velE * 1e-3, read.velN * 1e-3, -read.velD * 1e-3, (read.sAcc * 1e-3) ** 2 / 3]
    return [*made, ("gps/velocity", at, speeds)]


def measurements(sample: Sample) -> tuple[str, int, list[float]]:
    values = sample.values
    fields = ("latitude", "longitude", "altitude") if sample.topic == "gps/fix" else ("linear",)
    covariance = values["position_covariance" if sample.topic == "gps/fix" else "covariance"]
    return sample.topic, sample.stamp, [*np.concatenate([values[name] for name in fields]).tolist(), covariance[0]]


@pytest.mark.parametrize("bag", ["double_lane_change", "sine_with_dwell", "hills"])
def test_a_stream_of_ubx_gives_what_pyubx2_reads_of_it(bag: str) -> None:
    decoder, count = UbxDecoder(), 0
    for received, data in gnss_byte_stream(read_bag(BAGS / bag), "ubx"):
        made = [measurements(sample) for sample in decoder.feed(data, received)]
        assert made == [(topic, at, pytest.approx(v)) for topic, at, v in library_reads(data)]
        count += len(made)
    assert count > 100


@given(
    st.tuples(st.integers(1960, 2040), st.integers(0, 13), st.integers(0, 32)),
    st.tuples(st.integers(0, 25), st.integers(0, 61), st.integers(0, 61), st.integers(-(10**9), 10**9)),
    st.tuples(st.integers(0, 7), st.integers(0, 5), st.integers(0, 1), st.integers(0, 1)),
    st.binary(min_size=92, max_size=92),
)
def test_any_nav_pvt_gives_the_samples_that_pyubx2_and_the_calendar_give(date, time, states, content) -> None:
    year, month, day = date
    hour, minute, second, nano = time
    valid, kind, fix_ok, no_position = states
    payload = bytearray(content)
    struct.pack_into("<HBBBBBB", payload, 4, year, month, day, hour, minute, second, valid)
    struct.pack_into("<iBB", payload, 16, nano, kind, payload[21] & ~1 | fix_ok)
    struct.pack_into("<H", payload, 78, payload[78] & ~1 | no_position)
    frame = UBXMessage("NAV", "NAV-PVT", GET, payload=bytes(payload)).serialize()
    made = [measurements(sample) for sample in UbxDecoder().feed(frame, 5)]
    assert made == [(topic, at, pytest.approx(v)) for topic, at, v in library_reads(frame)]


@given(st.binary(min_size=63, max_size=63))
def test_the_numbers_of_nav_relposned_are_those_that_pyubx2_reads(behind: bytes) -> None:
    payload = b"\x01" + behind  # of version 1
    ours = RelativePosition.of(payload)
    theirs = UBXMessage("NAV", "NAV-RELPOSNED", GET, payload=payload)
    assert ours.iTOW == theirs.iTOW
    assert ours.relPosD + 0.01 * ours.relPosHPD == pytest.approx(theirs.relPosD, abs=1e-9)
    assert ours.relPosLength + 0.01 * ours.relPosHPLength == pytest.approx(theirs.relPosLength, abs=1e-9)
    assert ours.relPosHeading * 1e-5 == pytest.approx(theirs.relPosHeading, abs=1e-9)
    assert (ours.accD * 0.1, ours.accHeading * 1e-5) == pytest.approx((theirs.accD, theirs.accHeading), abs=1e-6)
    assert (ours.flags & 1, ours.flags >> 8 & 1) == (theirs.gnssFixOK, theirs.relPosHeadingValid)


@given(st.binary(max_size=300))
def test_the_checksum_of_ubx_is_that_of_pyubx2(data: bytes) -> None:
    assert fletcher(data) == calc_checksum(data)


def test_an_elevation_is_as_uncertain_as_the_receiver_says_of_the_height_between_the_antennas() -> None:
    decoder = UbxDecoder()
    decoder.feed(pvt(NOON), stamp(NOON))
    (sample,) = decoder.feed(relposned(NOON, accD=5.0), stamp(NOON) + 1)  # [mm], of a metre
    assert sample.values["orientation_covariance"][4] == pytest.approx((5e-3 / 1.01) ** 2, rel=1e-6)
