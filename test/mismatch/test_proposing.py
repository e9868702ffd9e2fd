"""Sets of effects that the evidence proposes, on a model of one equation whose response to an effect is curved."""

from types import SimpleNamespace

import numpy as np
import pytest

from vsense_ros.identification.free_parameter import FreeParameter, added
from vsense_ros.identification.least_squares import fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.proposing import Proposing
from vsense_ros.mismatch.search import Search
from vsense_ros.mismatch.secants import Secants

T = np.linspace(0.0, 60.0, 400)
BASE = FreeParameter("mass", "-", 1.0, -9.0, 9.0, added("mass"))
NAMES = ("drag", "bank", "wind", "lag")
NOISE = 0.05


def candidate(name):
    size = FreeParameter(f"effects.{name}.size", "-", 1.0, -9.0, 9.0, added(f"effects.{name}.size"))
    return Candidate(name, "", (size,), name)


def response(mass, drag, bank, wind, lag):
    """The mass can stand in for most of a drag; a bank acts more than in proportion."""
    curved = bank * (1 + 0.4 * bank)
    return (mass + drag) * np.sin(T) + 0.5 * drag * np.sin(2 * T) + curved * np.cos(3 * T) + (wind + 0.3 * lag) * T / 60


class Toy:
    """Residuals of two windows."""

    at_once = 4
    layout = (("speed",), ("speed",))

    def __init__(self, **truth):
        windows = [SimpleNamespace(begin=0.0, end=60.0, run_in=0.0)] * 2
        self.predictor = SimpleNamespace(dataset=SimpleNamespace(windows=windows))
        rng = np.random.default_rng(4)
        true = response(**dict.fromkeys(("mass", *NAMES), 0.0) | truth)
        self.measured = [true + NOISE * rng.normal(size=len(T)) for _ in range(2)]

    def prepare(self, parameter_sets, near=None):
        pass

    def diverged(self, parameter_set):
        return [False, False]

    def __call__(self, parameter_set, instead=None):
        values = parameter_set.values
        made = response(values["mass"], *(values[f"effects.{name}.size"] for name in NAMES))
        return [(made - measured) / NOISE for measured in self.measured]


def proposing(**truth):
    residuals = Toy(**truth)
    start = ParameterSet({"mass": 0.0, **{f"effects.{name}.size": 0.0 for name in NAMES}})
    secants = Secants(residuals, start, fit(residuals, start, [BASE]))

    def hypothesis(candidates, fitted, share):
        return Hypothesis(candidates, fitted, share, 0.0, 0.0, 0.0, 0.0, {})

    return Proposing(secants, SimpleNamespace(hypothesis=hypothesis), [candidate(name) for name in NAMES])


@pytest.fixture(scope="module")
def two():
    return proposing(mass=0.3, drag=1.2, bank=0.8)


def test_two_effects_are_proposed_with_their_sizes_although_a_base_parameter_stands_in_for_one(two):
    first, *_ = two.proposed()
    assert sorted(first.effects) == ["bank", "drag"]
    assert first.sizes == pytest.approx({"effects.drag.size": 1.2, "effects.bank.size": 0.8}, abs=0.06)
    assert min(first.evident[effect] for effect in first.effects) > 0.9


def test_a_set_without_each_of_its_effects_is_fitted_anew(two):
    first, *_ = two.proposed()
    without = two.without_each(first)
    assert sorted(rest.effects for rest in without) == [("bank",), ("drag",)]
    assert all(rest.fit.value > first.fit.value for rest in without)


def test_a_set_with_only_some_of_its_effects_is_that_set_without_the_others(two):
    first, *_ = two.proposed()
    (without_bank,) = (rest for rest in two.without_each(first) if rest.effects == ("drag",))
    only = two.with_only(first, {"drag"})
    assert only.effects == ("drag",)
    assert only.sizes == pytest.approx(without_bank.sizes)


def test_nothing_is_proposed_where_the_base_parameters_explain_all():
    assert proposing(mass=0.5).proposed() == []


def test_what_is_nearly_as_likely_in_place_of_an_effect_is_proposed_besides():
    first, *others = proposing(wind=0.5).proposed()
    assert {first.effects, *(other.effects for other in others)} == {("wind",), ("lag",)}


def reduced(gain, effects="abcd"):
    """The sets of effects, one letter each, to which `Search.reduced` comes in its order, where one gains what `gain`
    says."""

    def known(letters):
        return SimpleNamespace(effects=tuple(letters), candidates=tuple(letters), evident=dict.fromkeys(letters, 1.0))

    search = SimpleNamespace(
        adds={}, least_whole=0.1,
        without_each=lambda one, only: [known(sorted(set(one.effects) - {out})) for out in one.effects],
        _proposing=SimpleNamespace(with_only=lambda one, stay: known(sorted(set(one.effects) & stay))),
    )  # fmt: skip
    search._adds_beyond = lambda *arguments: Search._adds_beyond(search, *arguments)
    found = Search.reduced(search, [known(effects)], lambda one: gain(set(one.effects)), lambda _: None)
    return ["".join(one.effects) for one in found]


def test_effects_that_hardly_matter_are_left_out_together():
    assert reduced(lambda effects: 0.5 * ("a" in effects)) == ["bcd", "acd", "abd", "abc", "a"]


def test_of_effects_that_stand_in_for_one_another_one_stays():
    found = reduced(lambda effects: 0.4 * ("a" in effects) + 0.3 * bool(effects & {"b", "c"}), "abc")
    assert found[:3] == ["bc", "ac", "ab"]
    assert found[3] == "a"  # what the rest gains without all that hardly matter, which is less
    assert set(found[4:]) == {"a", "c"}  # so one of them is left out, and then each matters


def test_where_every_effect_matters_each_is_left_out_once():
    assert reduced(lambda effects: 0.2 * len(effects)) == ["bcd", "acd", "abd", "abc"]
