"""Signals taken from frames by us and by cantools, and what is read of databases that are not correct."""

from __future__ import annotations

from pathlib import Path

import can
import cantools
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.driver.can import CanDecoder
from vsense_ros.driver.can_database import read_database
from vsense_ros.driver.can_mapping import CanMapping
from vsense_ros.driver.can_signal import SignalField
from vsense_ros.errors import InputError
from vsense_ros.messages.units import canonical, contradiction, quantity_of, to_si

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: X\nBO_ 1 M: 8 X\n'


@st.composite
def signals(draw: st.DrawFn) -> tuple[str, bool]:
    """A signal of any place, length, order, sign or floating point, in a DBC."""
    is_float = draw(st.booleans())
    length = draw(st.sampled_from([32, 64])) if is_float else draw(st.integers(1, 64))
    big = draw(st.booleans())
    first = draw(st.integers(0, 64 - length))
    start = 8 * (first // 8) + 7 - first % 8 if big else first
    sign = "-" if draw(st.booleans()) else "+"
    scale, offset = draw(st.sampled_from([(1, 0), (0.1, 0), (0.25, -40), (-0.5, 3)]))
    text = f' SG_ S : {start}|{length}@{0 if big else 1}{sign} ({scale},{offset}) [0|0] "" X\n'
    more = f"SIG_VALTYPE_ 1 S : {1 if length == 32 else 2};\n" if is_float else ""
    return text + more, is_float


@given(signals(), st.binary(min_size=8, max_size=8))
def test_a_signal_is_what_cantools_decodes_of_one_frame_and_of_many(signal: tuple[str, bool], data: bytes) -> None:
    database = cantools.database.load_string(HEAD + signal[0], "dbc", strict=False)
    message = database.messages[0]
    field = SignalField.of(message.signals[0], message)
    expected = message.decode(data, decode_choices=False)["S"]
    np.testing.assert_allclose(field.physical(data), expected, rtol=1e-12)
    many = np.frombuffer(data * 3, np.uint8).reshape(3, 8)
    np.testing.assert_allclose(field.physical_of(many), [expected] * 3, rtol=1e-12)


@pytest.mark.parametrize(
    ("bad", "left_out"),
    [
        ("BO_ 300000000 O: 8 X\n SG_ A : 0|8@1+ (1,0) [0|1] \"\" X\n", "0x11e1a300 is taken for one of 29 bits"),
        ("VAL_ 1 GONE 0 \"off\" ;\n", "unused VAL_"),
        ("BO_ 3 3RD: 8 X\n SG_ A : 0|8@1+ (1,0) [0|1] \"\" X\n", "3RD left out"),
        ("BO_ 1075054137 O: 8 X\n SG_ A : 0|8@1+ (1,0) [0|1] \"\" X\n", "is no identifier"),
        ("BO_ 3 O: 8 X\n SG_ 0A : 0|8@1+ (1,0) [0|1] \"\" X\n", "signal 0A of O left out"),
        ("BO_ 3 O: 8 X\n SG_ A : 0|1000000000@1+ (1,0) [0|1] \"\" X\n", "signal A of O left out"),
        ("CM_ 17 no quotes;\n", "Invalid syntax"),
    ],
)  # fmt: skip
def test_of_a_database_with_a_bad_line_the_rest_is_read_and_told(tmp_path: Path, bad: str, left_out: str) -> None:
    path = tmp_path / "car.dbc"
    path.write_text("\ufeff" + HEAD + ' SG_ S : 0|16@1- (0.1,0) [0|0] "°/s" X\n' + bad, encoding="utf-8")
    read = read_database(path)
    assert any(left_out in note for note in read.notes), read.notes
    (signal,) = read.database.get_message_by_name("M").signals
    assert (signal.name, signal.scale, signal.unit) == ("S", 0.1, "°/s")


def test_a_message_that_stands_twice_is_told_by_its_identifier(tmp_path: Path) -> None:
    path = tmp_path / "car.dbc"
    one = ' SG_ S : 0|16@1- (0.1,0) [0|0] "deg" X\n'
    path.write_text(HEAD + one + "BO_ 2 M: 8 X\n" + one, encoding="utf-8")

    def mapped(message: str) -> CanDecoder:
        steering = {"steering_wheel": {"signals": "S", "unit": "deg"}}
        output = {"kind": "joint_state", "topic": "a", "message": message, "field": "position", "joints": steering}
        return CanDecoder(path, CanMapping.model_validate({"name": "car", "outputs": [output]}))

    with pytest.raises(InputError, match="2 messages 'M'; say which: M@0x1, M@0x2"):
        mapped("M")
    frame = can.Message(timestamp=1.0, arbitration_id=2, is_extended_id=False, data=bytes(8))
    assert len(mapped("M@0x2").feed(frame)) == 1
    assert mapped("M@0x1").feed(frame) == []


def test_a_database_without_anything_intact_is_refused(tmp_path: Path) -> None:
    (tmp_path / "car.dbc").write_text("BO_ nothing\n")
    with pytest.raises(InputError, match="no message"):
        read_database(tmp_path / "car.dbc")


@pytest.mark.parametrize(
    ("text", "unit"),
    [("°", "deg"), ("Â°", "deg"), ("KPH", "km/h"), ("m/s2", "m/s²"), ("Unit_MeterPerSeconSquar", "m/s²"),
     ("RPM", "rpm"), ("[deg/s]", "deg/s"), ("\ufffd/s", "deg/s"), ("G", "g"), ("Nm", "N m"),
     ("counts", None), ("%", None)],
)  # fmt: skip
def test_units_are_known_as_people_write_them(text: str, unit: str | None) -> None:
    assert canonical(text) == unit


def test_units_contradict_only_where_both_are_known() -> None:
    assert contradiction("deg", "rad")
    assert not contradiction("degree", "°")
    assert not contradiction("counts", "rad")
    assert not contradiction("", "rad")
    assert quantity_of("kph") == "velocity"
    assert to_si("km/h") == pytest.approx(1 / 3.6)


def test_an_identifier_of_29_bits_without_the_bit_that_says_so_is_one_all_the_same(tmp_path: Path) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(
        HEAD + ' SG_ A : 0|8@1+ (1,0) [0|1] "" X\n\nBO_ 300000000 O: 8 X\n SG_ B : 0|8@1+ (1,0) [0|1] "" X\n'
    )
    database = read_database(path).database
    found = {message.name: (message.frame_id, message.is_extended_frame) for message in database.messages}
    assert found == {"M": (1, False), "O": (300_000_000, True)}
