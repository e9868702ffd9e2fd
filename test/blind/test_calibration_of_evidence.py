"""What decides about evidence is found again from answers that were drawn with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from blind import evidence
from blind.score import Result
from blind.tool import Answer
from vsense_ros.mismatch.answer_schema import Likely, LikelySize, parsed
from vsense_ros.mismatch.thresholds import THRESHOLDS

EXAMPLE = Path(__file__).parents[2] / "docs/examples/genesis/explain.json"


def _result(hidden: list[str], *likely: Likely) -> Result:
    """An answer with what the evidence says, about a car in which these are hidden."""
    answer = parsed(json.loads(EXAMPLE.read_text(encoding="utf-8")), "the example").with_(evidence=likely)
    return Result({"hidden": [{"id": id} for id in hidden], "acceptable": []}, Answer(answer, 1.0), None)


def _found(results: list[Result]) -> dict[str, float]:
    return {curve.name: curve.best for curve in evidence.curves(results, "public")}


@pytest.mark.parametrize("drawn", [0.05, 0.2])
def test_what_every_car_has_a_little_of_is_how_sizes_scatter_without_what_the_prior_has_added(drawn):
    rng, prior, known = np.random.default_rng(0), THRESHOLDS.little, 0.1
    measured = rng.normal(0.0, drawn, 1500) + rng.normal(0.0, known, 1500)
    variance = 1 / (known**-2 + prior**-2)  # of a normal size with a normal prior
    sizes = [
        LikelySize(name="z", likeliest=float(one * variance / known**2), deviation=variance**0.5, prior=prior)
        for one in measured
    ]
    likely = Likely(effect="gyro_scale", probability=0.0, sizes=tuple(sizes))
    assert _found([_result([], likely)])["little"] == pytest.approx(drawn, rel=0.2)


def test_the_least_gain_is_the_smallest_above_which_names_are_right():
    there, absent = (Likely(effect=id, probability=0.99, sizes=(), adds=a) for id, a in (("a", 0.035), ("b", 0.025)))
    assert _found([_result(["a"], there, absent)])["evident_gain"] == 0.03
    doubtful = absent.with_(probability=0.5)
    assert _found([_result(["a"], there, doubtful)])["evident_gain"] == evidence.GAINS[0]


def test_odds_are_those_with_which_effects_are_there_as_often_as_stated():
    likely = [_result(["a"] if i < 2 else [], Likely(effect="a", probability=0.5, sizes=())) for i in range(10)]
    before, after = THRESHOLDS.odds / (1 - THRESHOLDS.odds), 0.2 / 0.8  # in place of even odds
    expected = before * after / (1 + before * after)
    assert _found(likely)["odds"] == pytest.approx(expected, rel=0.3)
