"""How sure an answer is."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.mismatch.judge import THRESHOLD, confidence

GAINS = st.floats(-1.0, 1.0)


@given(GAINS, GAINS, st.floats(0.0, 0.5))
def test_more_gain_makes_surer_and_a_better_rival_less_sure(gain, other, more):
    assert 0.0 < confidence(gain, other) < 1.0
    assert confidence(gain + more, other) >= confidence(gain, other)
    assert confidence(gain, other + more) <= confidence(gain, other)


def test_what_gains_no_more_than_chance_is_not_believed_and_a_clear_lead_is():
    assert confidence(THRESHOLD, 0.0) < 0.5
    assert confidence(10 * THRESHOLD, THRESHOLD) > 0.9
