"""The compiled usual case of a CAN message, against the arithmetic that its settings say, bit by bit."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vsense_ros.driver.can_usual import UsualValue, usual_values

LENGTH = 8
VALUES = {
    "unsigned": UsualValue(False, 3, 0xFFF, 0, 0.1, -40.0, -40.0, 200.0, 1 / 3.6, 0.0, -10.0, 40.0, 0.31),
    "signed": UsualValue(True, 16, 0xFFFF, 0x8000, 0.01, 0.0, -320.0, 319.9, math.pi / 180, 0.2, -math.inf, 4.0, 1.0),
    "falling": UsualValue(False, 0, 0xFF, 0, -0.5, 7.0, -math.inf, 5.0, -1.0, 0.0, -math.inf, 100.0, 1.0),
    "codes": UsualValue(True, 0, 0xF, 0, 1.0, 0.0, 0.0, 14.0, 1.0, 0.0, 0.0, math.inf, 1.0, frozenset({7, 15})),
    "never": UsualValue(False, 0, 0xF, 0, 1.0, 100.0, 0.0, 14.0, 1.0, 0.0, 0.0, math.inf, 1.0),
}


def expected(value: UsualValue, data: bytes) -> float | None:
    raw = int.from_bytes(data, "big" if value.big_endian else "little") >> value.shift & value.mask
    raw -= value.mask + 1 if raw & value.sign else 0
    physical = raw * value.scale + value.offset
    si = value.gain * physical + value.addend
    usual = value.lowest <= physical <= value.highest and value.least <= si <= value.most and raw not in value.codes
    return si / value.divisor if usual else None


@pytest.mark.parametrize("name", VALUES)
def test_a_compiled_value_is_that_of_its_settings_and_none_where_it_is_not_usual(name: str) -> None:
    value = VALUES[name]
    compiled = usual_values([[value]], LENGTH)
    for data in np.random.default_rng(1).integers(0, 256, (3000, LENGTH), dtype=np.uint8):
        number = expected(value, data.tobytes())
        assert compiled(data.tobytes()) == (None if number is None else ((number,),))


def test_outputs_keep_their_order_and_one_unusual_value_costs_all() -> None:
    first, second = VALUES["unsigned"], VALUES["signed"]
    compiled = usual_values([[first, second], [second]], LENGTH)
    for data in np.random.default_rng(2).integers(0, 256, (1000, LENGTH), dtype=np.uint8):
        one, other = (expected(value, data.tobytes()) for value in (first, second))
        absent = one is None or other is None
        assert compiled(data.tobytes()) == (None if absent else ((one, other), (other,)))
