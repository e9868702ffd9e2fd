"""Who is wrong, where some sources contradict others."""

from __future__ import annotations

from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.checks.blame import who_is_wrong

NAMES = tuple("abcde")


@given(wrong=st.sets(st.sampled_from(NAMES), max_size=2))
def test_a_minority_whose_signs_are_reversed_is_named(wrong):
    pairs = {(one, other): (one in wrong) == (other in wrong) for one, other in combinations(NAMES, 2)}
    found = who_is_wrong(pairs, {}, reversed_signs=True)
    assert set(found.wrong) == wrong
    assert found.undecided == ()


@given(late=st.sampled_from(NAMES))
def test_the_one_that_is_late_against_all_others_is_named(late):
    pairs = {pair: late not in pair for pair in combinations(NAMES, 2)}
    assert who_is_wrong(pairs, {}) == who_is_wrong(dict(reversed(pairs.items())), {})
    assert who_is_wrong(pairs, {}).wrong == (late,)


def test_two_that_contradict_each_other_are_both_doubted():
    assert who_is_wrong({("a", "b"): False}, {}).undecided == ("a", "b")
    assert who_is_wrong({("a", "b"): False, ("b", "c"): True}, {}).wrong == ("a",)


def test_of_two_the_one_that_is_trusted_less_is_wrong():
    assert who_is_wrong({("a", "b"): False}, {"a": 0.5}).wrong == ("a",)


def test_where_all_agree_nobody_is_wrong():
    found = who_is_wrong(dict.fromkeys(combinations(NAMES, 2), True), {})
    assert (found.wrong, found.undecided) == ((), ())


def test_two_that_agree_may_be_reversed_together_but_are_not_late_together():
    pairs = {("a", "b"): True, ("a", "c"): False, ("b", "c"): False}
    trusted = {"c": 3.0}
    assert who_is_wrong(pairs, trusted, reversed_signs=True).wrong == ("a", "b")
    assert who_is_wrong(pairs, trusted).wrong == ("c",)
