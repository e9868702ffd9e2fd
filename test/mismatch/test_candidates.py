"""What a fit may change of an effect, and how far."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from hidden import having, prototype
from vsense_ros.mismatch.candidates import candidates
from vsense_ros.model.effects import EVERY, Effects

CAR = having(prototype(), tyre_underinflation={"fl": 0.3}, accelerometer_bias={"y": 0.7})
VALUES = {f"effects.{id}.{name}": f.default for id, kind in EVERY.items() for name, f in kind.model_fields.items()}
VALUES |= CAR.values()
SIZES = {f"{k.name} {k.form}": k for c in candidates(values=CAR.values()) for k in c.free_parameters}


@given(st.sampled_from(sorted(SIZES)), st.floats(0.0, 1.0))
def test_an_effect_at_the_bound_of_its_size_is_one_that_a_vehicle_file_may_have(name, share):
    parameter = SIZES[name]
    offset = parameter.high if share == 1.0 else parameter.low + share * (parameter.high - parameter.low)
    effects: dict[str, dict[str, float]] = {}
    for dotted, value in parameter.apply(VALUES, offset).items():
        _, effect, field = dotted.split(".")
        effects.setdefault(effect, {})[field] = value
    assert TypeAdapter(Effects).validate_python(effects)
