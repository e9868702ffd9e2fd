"""Fields of NMEA sentences against pynmeagps, which reads them otherwise."""

from __future__ import annotations

import datetime
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pynmeagps import NMEAReader

from vsense_ros.driver.nmea_fields import SENTENCES, fields_of

THEIR_NAMES = {
    "latitude": ("lat",),
    "longitude": ("lon",),
    "hdop": ("HDOP",),
    "altitude": ("alt",),
    "separation": ("sep",),
    "knots": ("spd", "sogn"),
    "course": ("cog", "cogt"),
    "north": ("stdLat",),
    "east": ("stdLong",),
    "up": ("stdAlt",),
    "heading": ("headingT", "headt"),
    "mode": ("posMode", "mi"),
}
NUMBER = st.one_of(st.just(""), st.decimals(0, 359, places=2).map(str))
TIME = st.one_of(st.just(""), st.times().map(lambda t: f"{t:%H%M%S}.{t.microsecond // 10000:02}"), st.just("246000.00"))
DATE = st.one_of(st.just(""), st.dates(datetime.date(1969, 1, 1), datetime.date(2068, 12, 31)).map("{:%d%m%y}".format))
LATITUDE = st.tuples(st.integers(0, 89), st.integers(0, 5_999_999)).map(lambda a: f"{a[0]:02}{a[1] / 1e5:08.5f}")
LONGITUDE = st.tuples(st.integers(0, 179), st.integers(0, 5_999_999)).map(lambda a: f"{a[0]:03}{a[1] / 1e5:08.5f}")
PLACE = (LATITUDE, st.sampled_from("NS"), LONGITUDE, st.sampled_from("EW"))
WHOLE = st.integers(1, 12).map(str)
LETTER = st.sampled_from("ADENV")
SENTENCE_OF = {
    "GGA": (TIME, *PLACE, WHOLE, WHOLE, NUMBER, NUMBER, st.just("M"), NUMBER, st.just("M"), NUMBER, WHOLE),
    "GNS": (TIME, *PLACE, LETTER, WHOLE, NUMBER, NUMBER, NUMBER, NUMBER, WHOLE),
    "RMC": (TIME, LETTER, *PLACE, NUMBER, NUMBER, DATE, NUMBER, st.just("E"), LETTER),
    "VTG": (NUMBER, st.just("T"), NUMBER, st.just("M"), NUMBER, st.just("N"), NUMBER, st.just("K"), LETTER),
    "ZDA": (TIME, WHOLE, WHOLE, st.integers(1990, 2090).map(str), st.just("00"), st.just("00")),
    "GST": (TIME, *[NUMBER] * 7),
    "HDT": (NUMBER, st.just("T")),
    "THS": (NUMBER, LETTER),
}


def as_ours(value: Any) -> Any:
    """A number of theirs as it stands in ours."""
    if isinstance(value, datetime.time):
        return ((value.hour * 60 + value.minute) * 60 + value.second) * 10**9 + value.microsecond * 1000
    return None if value == "" else value


@pytest.mark.parametrize("kind", SENTENCES)
def test_the_fields_of_a_sentence_are_those_that_pynmeagps_reads(kind: str) -> None:
    @settings(max_examples=60, deadline=None)
    @given(st.tuples(*SENTENCE_OF[kind]))
    def check(fields: tuple[str, ...]) -> None:
        theirs = NMEAReader.parse(f"$GN{kind},{','.join(fields)}*00\r\n".encode(), validate=0)
        ours = fields_of(kind, fields)
        assert ours is not None
        for name, value in ours.items():
            expected = as_ours(
                next(getattr(theirs, n) for n in (name, *THEIR_NAMES.get(name, ())) if hasattr(theirs, n))
            )
            assert value == (pytest.approx(expected, abs=1e-9) if isinstance(value, float) else expected), name

    check()


def test_a_sentence_that_is_too_short_or_has_letters_for_numbers_says_nothing() -> None:
    assert fields_of("GGA", ["123519.00", "4807.03800", "N", "01131.00000", "E", "1", "8"]) is None
    assert fields_of("HDT", ["north", "T"]) is None
