"""Units in the spellings of files and databases, with their sizes in SI by definition."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.messages.units import QUANTITIES, canonical, contradiction, quantity_of, to_si

UNITS = [(unit, quantity) for quantity, units in QUANTITIES.items() for unit in units]
# SI definitions: BIPM, The International System of Units (2019), and NIST Special Publication 811 (2008), appendix B.
DEFINED = {
    "deg": 0.017453292519943295, "mrad": 0.001, "deg/s": 0.017453292519943295, "rpm": 0.10471975511965977,
    "mrad/s": 0.001, "deg/s²": 0.017453292519943295, "km/h": 0.2777777777777778, "mph": 0.44704,
    "kn": 0.5144444444444445, "mm/s": 0.001, "cm/s": 0.01, "g": 9.80665, "mg": 0.00980665, "cm": 0.01, "mm": 0.001,
    "ft": 0.3048, "km": 1000.0, "kN m": 1000.0, "kN": 1000.0, "kPa": 1000.0, "MPa": 1e6, "bar": 1e5,
    "psi": 6894.757293168, "ms": 0.001, "100us": 1e-4, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0,
}  # fmt: skip


@pytest.mark.parametrize(("unit", "quantity"), UNITS)
def test_every_unit_has_its_size_and_quantity(unit, quantity):
    assert canonical(unit) == unit
    assert quantity_of(unit) == quantity
    assert to_si(unit) == pytest.approx(DEFINED.get(unit, 1.0), rel=1e-12)


@given(unit=st.sampled_from([unit for unit, _ in UNITS if unit not in ("mg", "MPa", "N m", "kN", "kn", "g")]),
       around=st.sampled_from([("[", "]"), ("(", ")"), (" ", " "), (" [", "] ")]))  # fmt: skip
def test_brackets_and_blanks_around_a_unit_do_not_matter(unit, around):
    assert canonical(around[0] + unit + around[1]) == unit


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("°/s", "deg/s"), ("Â°/s", "deg/s"), ("º/s", "deg/s"), ("\ufffd/s", "deg/s"), ("KM/H", "km/h"),
        ("1 / min", "rpm"),
        ("Nm", "N m"), ("nm", None), ("kNm", "kN m"), ("kN", "kN"), ("kn", "kn"), ("mPa", None), ("MPa", "MPa"),
        ("G", "g"), ("m/s^2", "m/s²"), ("M/S2", "m/s²"), ("", "1"), ("-", "1"), ("furlong", None), ("rad/sec", "rad/s"),
        ("unit_Bar", "bar"), ("kph", "km/h"),
    ],
)  # fmt: skip
def test_spellings_of_databases_are_known_and_those_that_could_be_several_are_not(text, unit):
    assert canonical(text) == unit
    if unit is None:
        assert quantity_of(text) is None
        with pytest.raises(KeyError):
            to_si(text)


@pytest.mark.parametrize(
    ("stated", "said", "contradicts"),
    [
        ("deg", "rad", True), ("deg", "°", False), ("km/h", "kph", False), ("bar", "kPa", True),
        ("", "rad", False), ("-", "rad", False), ("1", "rad", False), (" - ", "rad", False),
        ("furlong", "rad", False), ("rad", "furlong", False), ("furlong", "league", False),
        ("rad", "1", True), ("unitless", "rad", True), ("rad", "", True),
    ],
)  # fmt: skip
def test_two_units_contradict_each_other_where_both_are_known_and_not_the_same(stated, said, contradicts):
    assert contradiction(stated, said) == contradicts
