"""What may be said of explanations, and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from operator import itemgetter
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.identification.free_parameter import FreeParameter
from vsense_ros.identification.least_squares import Fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.mismatch.candidates import Candidate
from vsense_ros.mismatch.confidence import confidence, interval
from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.objections import OUTDONE
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.verdict import Judged, Ranked, judge

GAINS = st.floats(-1.0, 1.0)


@given(GAINS, GAINS, st.floats(0.0, 0.5))
def test_more_gain_makes_surer_and_a_better_rival_less_sure(gain, other, more):
    assert 0.0 < confidence(gain, other) < 1.0
    assert confidence(gain + more, other) >= confidence(gain, other)
    assert confidence(gain, other + more) <= confidence(gain, other)


def test_what_gains_no_more_than_chance_is_not_believed_and_a_clear_lead_is():
    least = THRESHOLDS.least_gain
    assert confidence(least, 0.0) < 0.5
    assert confidence(10 * least, least) == pytest.approx(THRESHOLDS.clear_name, rel=0.01)
    assert confidence(10 * least, least) > 0.8


@given(st.floats(0.1, 2000.0), st.floats(1.0, 10.0))
def test_chance_explains_more_of_less_driving_but_never_less_than_of_much(driven, times):
    asked = THRESHOLDS.least_gain_on
    assert asked(driven) >= asked(times * driven) >= THRESHOLDS.least_gain
    assert asked(THRESHOLDS.short_driving / times) == pytest.approx(times * THRESHOLDS.least_gain)


@dataclass
class Made:
    """What recordings that no fit has seen would say, told."""

    left: float = 1.0  # of the residuals after any effect, in deviations
    base: Fit = field(default_factory=lambda: FITTED)

    @property
    def fitted(self) -> Made:
        return self

    def gain(self, hypothesis: Hypothesis) -> float:
        return -0.1 if hypothesis.name.strip() in GROWN else hypothesis.cv_gain

    def proven(self, hypothesis: Hypothesis) -> float:
        return min(hypothesis.gain, hypothesis.cv_gain)

    def proven_beyond(self, hypothesis: Hypothesis, known: Hypothesis) -> float:
        return self.proven(hypothesis) - self.proven(known)

    def unmended(self, hypothesis: Hypothesis) -> str:
        return "roll_rate" if hypothesis.name.strip() in UNMENDED else ""

    def own_unmended(self, hypothesis: Hypothesis, known: Hypothesis | None = None) -> str:
        return self.unmended(hypothesis)

    def nearer(self, one: Hypothesis, other: Hypothesis) -> list[tuple[float, float]]:
        return []

    def disagreement(self, hypothesis: Hypothesis, known: Hypothesis | None = None) -> float:
        return 1.5 if hypothesis.name.strip() in ODD else 0.1

    def level(self, residuals: object) -> float:
        return self.left

    def worst(self, residuals: object = None) -> float:
        return 1.0

    def something_unexplained(self) -> bool:
        return False


FITTED = Fit(ParameterSet({}), (), np.zeros(0), [np.full(100, 2.0)], [np.zeros((100, 0))], 0.0)
ODD = ("effect of another size in each recording", "drag + effect of another size in each recording")
UNMENDED = ("effect that mends another signal",)
GROWN = ("effect with which one drive goes far wrong",)


def explaining(effect: str, gain: float, elsewhere: float, keep: float = 0.5) -> Hypothesis:
    candidates = tuple(Candidate(one, "", (), one) for one in effect.split(" + "))
    return Hypothesis(candidates, FITTED, keep, gain, elsewhere, elsewhere, 0.0, {})


def said(*hypotheses: Hypothesis, **proof: float) -> tuple[str, tuple[str, ...]]:
    judged = judge(hypotheses, (), Made(**proof))
    return judged.verdict, tuple(e.name.strip() for e in judged.rivals)


def test_a_gain_that_lasts_elsewhere_is_named_and_one_that_does_not_is_not():
    assert said(explaining("drag", 0.5, 0.45)) == ("named", ("drag",))
    assert said(explaining("drag", 0.5, 0.1)) == ("no_mismatch", ())


def test_of_many_sizes_along_a_road_those_that_do_not_last_in_training_suit_what_was_held_out_by_chance():
    class Suited(Made):
        comparisons = SimpleNamespace(on_another_road=False, by_pieces=lambda fitted: False)

        def gain(self, hypothesis: Hypothesis) -> float:
            return 0.5

        def proven(self, hypothesis: Hypothesis) -> float:
            return min(hypothesis.gain, 0.5)

    everywhere = explaining("slope", 0.5, 0.1)
    place = FreeParameter("slope@0", "rad", 0.1, -1.0, 1.0, lambda values, offset: {}, place=("slope", 0.0))
    fitted = replace(FITTED, free_parameters=(place,), offsets=np.array([0.2]), slopes=[np.zeros((100, 1))])
    profile = Candidate("slope", "along the road", (place,), "slope")
    along = replace(everywhere, candidates=(profile,), fit=fitted, deviations={place.name: 0.01})
    assert judge([everywhere], (), Suited()).verdict == "named"
    assert judge([along], (), Suited()).verdict == "no_mismatch"
    assert judge([replace(along, cv_gain=0.4)], (), Suited()).verdict == "named"


def test_what_makes_the_whole_of_what_was_held_out_worse_is_no_explanation_even_if_most_of_it_is_better():
    worse = explaining(GROWN[0], 0.5, 0.45)
    assert said(worse) == ("no_mismatch", ())
    assert judge((), [worse], Made()).verdict == "no_mismatch"
    force = explaining("force", 0.3, 0.3)
    assert judge((), [worse, force], Made()).leader == force


def test_what_spoils_in_some_drives_a_good_part_of_what_it_gains_in_others_is_no_explanation():
    drag = explaining("drag", 0.5, 0.45)
    assert said(replace(drag, spoilt=0.1)) == ("named", ("drag",))
    assert said(replace(drag, spoilt=0.3)) == ("no_mismatch", ())


@pytest.mark.parametrize(
    ("hypothesis", "words"),
    [
        (explaining("drag", 0.01, 0.01), "no more than chance"),
        (explaining("drag", 0.5, 0.1), "lasts where it was not fitted"),
        (explaining(GROWN[0], 0.5, 0.45), "lasts where it was not fitted"),
        (replace(explaining("drag", 0.5, 0.45), spoilt=0.3), "spoils in some drives"),
        (explaining(UNMENDED[0], 0.5, 0.45), "leaves the roll rate about as far off as it was"),
        (explaining(ODD[0], 0.5, 0.45), "disagree in its size"),
        (explaining("drag", 0.5, 0.45), ""),
    ],
)
def test_what_is_refused_is_told_why(hypothesis, words):
    (one,) = judge([hypothesis], (), Made()).ranked
    assert one.hypothesis is hypothesis
    assert words in one.objection
    assert bool(words) == bool(one.objection)


def test_what_explains_as_much_is_said_besides_even_if_it_is_itself_unproven():
    drag, slope = explaining("drag", 0.5, 0.45), explaining(UNMENDED[0], 0.5, 0.42)
    assert said(drag, slope) == ("ambiguous", ("drag", UNMENDED[0]))
    assert said(slope) == ("no_mismatch", ())


def test_what_explains_less_is_excluded():
    assert said(explaining("drag", 0.9, 0.9), explaining("slope", 0.8, 0.8)) == ("named", ("drag",))


def test_what_explains_most_of_it_cannot_be_excluded_and_half_of_it_can():
    assert said(explaining("drag", 0.3, 0.3), explaining("slope", 0.22, 0.22)) == ("ambiguous", ("drag", "slope"))
    assert said(explaining("drag", 0.3, 0.3), explaining("slope", 0.15, 0.15)) == ("named", ("drag",))


def test_what_the_base_parameters_take_up_almost_whole_needs_more_gain():
    assert said(explaining("drag", 0.04, 0.04, keep=0.5))[0] == "named"
    assert said(explaining("drag", 0.04, 0.04, keep=0.15))[0] == "no_mismatch"
    assert said(explaining("drag", 0.05, 0.05, keep=0.05))[0] == "named"  # at most half as much again is asked for


def test_where_much_is_left_over_what_mends_the_signals_that_it_changes_is_named_as_a_part():
    drag = explaining("drag", 0.5, 0.5)
    assert not judge([drag], (), Made()).partial
    part = judge([drag], (), Made(left=2.5))
    assert (part.verdict, part.leader, part.partial) == ("named", drag, True)
    assert said(explaining("drag", 0.08, 0.08), left=2.5) == ("no_mismatch", ())
    assert said(explaining(UNMENDED[0], 0.5, 0.5), left=2.5) == ("no_mismatch", ())


def test_of_a_partial_answer_each_effect_is_needed():
    drag, both = explaining("drag", 0.5, 0.5), explaining("drag + slope", 0.505, 0.505)
    assert judge([drag, both], (), Made(left=2.5)).leader == drag
    more = explaining("drag + slope", 0.6, 0.6)
    assert judge([drag, more], (), Made(left=2.5)).leader == more


def test_physics_that_leaves_something_over_is_told_before_a_term_that_explains_hardly_more():
    drag, force = explaining("drag", 0.3, 0.3), explaining("force", 0.32, 0.32)
    assert judge([drag], [force], Made(left=2.5)).leader == drag
    clearly = explaining("force", 0.4, 0.4)
    assert judge([drag], [clearly], Made(left=2.5)).leader == clearly


def test_an_effect_in_whose_size_recordings_disagree_is_not_it_but_something_is_there():
    odd = explaining(ODD[0], 0.5, 0.5)
    assert said(odd) == ("unknown", ())
    assert said(odd, explaining("drag", 0.2, 0.2)) == ("unknown", ())
    assert said(explaining("drag", 0.3, 0.3), explaining(ODD[1], 0.5, 0.5)) == ("named", ("drag",))


def validated(base: Fit, layout: list[list[str]]) -> Validation:
    """On a fit to windows with these signals, with nothing held out."""
    validation = Validation.__new__(Validation)
    validation.base, validation.fitted, validation.residuals = base, SimpleNamespace(layout=layout), None
    validation.comparisons = SimpleNamespace(training=lambda fit: (base.residuals, fit.residuals))
    validation.leaves_a_trace = lambda _: True
    validation.thresholds = THRESHOLDS
    return validation


def test_recordings_agree_in_what_they_have_and_disagree_in_what_only_looks_like_it():
    """Half of what one window lacks, put into both where the other lacks nothing, gains 1 - 0.25 - 0.25 of its square;
    another size in each would gain as much again."""
    change = np.random.default_rng(1).normal(size=200)
    layout = [["yaw_rate"], ["yaw_rate"]]

    def at_odds(*hidden: float) -> float:
        before = replace(FITTED, residuals=[-size * change for size in hidden])
        after = replace(FITTED, residuals=[(0.5 - size) * change for size in hidden])
        validation = validated(before, layout)
        return validation.disagreement(replace(explaining("drag", 0.5, 0.5), fit=after))

    assert at_odds(0.5, 0.5) == 0.0
    assert at_odds(1.0, 0.0) == pytest.approx(1.0)


def test_beside_a_known_explanation_what_others_leave_where_an_effect_changes_next_to_nothing_does_not_count():
    """An offset that is right in the signal that it is of, and a fifth of that change in another signal, which is far
    off for another reason."""
    noise = np.random.default_rng(1).normal(size=(2, 200))

    def at_odds(elsewhere: float, known: bool) -> float:
        shift = np.concatenate([np.ones(200), np.full(200, elsewhere)])
        left = np.concatenate([0.0 * noise[0], 2.0 + noise[1]])
        before, after = replace(FITTED, residuals=[left - shift]), replace(FITTED, residuals=[left])
        validation = validated(before, [["longitudinal_acceleration", "pitch_rate"]])
        first = replace(explaining("grade", 0.5, 0.5), fit=before)
        return validation.disagreement(replace(explaining("offset", 0.5, 0.5), fit=after), first if known else None)

    assert at_odds(0.2, known=True) == 0.0
    assert at_odds(0.2, known=False) > THRESHOLDS.disagreement  # where nothing else is known, it does
    assert at_odds(0.4, known=True) > THRESHOLDS.disagreement  # and of a signal that changes by more


def test_a_further_effect_that_explains_little_is_named_where_the_evidence_is_sure_of_it():
    one, both = explaining("drag", 0.5, 0.5), explaining("drag + bank", 0.515, 0.515)
    assert said(one, both) == ("named", ("drag",))
    assert said(one, replace(both, evident={"drag": 1.0, "bank": 0.8})) == ("named", ("drag",))
    sure = replace(both, evident={"drag": 1.0, "bank": 0.99})
    assert said(one, sure) == ("named", ("drag + bank",))
    judged = judge([one, sure], (), Made())
    assert judged.confidence(sure, "bank") == pytest.approx(0.99 * THRESHOLDS.clear_name)
    assert said(one, replace(sure, gain=0.505, cv_gain=0.505)) == ("named", ("drag",))


def test_what_the_evidence_excludes_beside_what_it_has_found_is_not_named_and_a_remark_is_left():
    """A bias of a gyro, beside which an axle that steers itself by 0.07°/kN was named (case 0035 of a release)."""
    bias, both = explaining("bias", 0.5, 0.5), explaining("bias + toe", 0.7, 0.7)
    assert said(bias, both) == ("named", ("bias + toe",))
    judged = judge([bias, both], (), Made(), improbable=frozenset({"toe"}))
    assert (judged.verdict, judged.leader, judged.besides) == ("named", bias, ("toe",))


def test_a_rival_that_leaves_a_signal_further_off_and_none_nearer_is_excluded_however_much_else_is_left_over():
    """Speeds are far off for a reason that nobody knows; of the acceleration one leaves half as much as the other."""
    fitted = Residuals.__new__(Residuals)
    fitted.layout = [["speed", "longitudinal_acceleration", "yaw_rate"]]

    class Compared(Validation):
        def __init__(self) -> None:
            self.fitted, self.residuals = fitted, None
            self.comparisons = SimpleNamespace(training=lambda fit: (fit.residuals, fit.residuals))

    class Known(Made):
        def nearer(self, one: Hypothesis, other: Hypothesis) -> list[tuple[float, float]]:
            return Compared().nearer(one, other)

    def found(speed: float, acceleration: float, yaw_rate: float) -> Fit:
        return replace(FITTED, residuals=[np.repeat([speed, acceleration, yaw_rate], 100)])

    def excluded(one: Fit, other: Fit) -> bool:
        pair = [
            replace(explaining(name, gain, gain), fit=fit)
            for name, gain, fit in (("turned", 0.6, one), ("offset", 0.59, other))
        ]
        return judge(pair, (), Known()).rivals == (pair[0],)

    assert excluded(found(7.0, 1.0, 1.0), found(7.0, 1.5, 1.0))
    assert excluded(found(7.0, 1.0, 1.0), found(6.9, 1.5, 1.0))  # no nearer, but for next to nothing
    assert not excluded(found(7.0, 1.0, 1.0), found(7.0, 1.05, 1.0))
    assert not excluded(found(7.0, 1.0, 1.5), found(7.0, 1.5, 1.0))  # one signal for another


def test_what_every_explanation_that_remains_has_is_sure_and_told_as_such():
    shared = [explaining(f"offset + turned + {other}", 0.7, 0.7) for other in ("rolling", "grade")]
    judged = judge(shared, (), Made())
    assert (judged.verdict, judged.sure) == ("ambiguous", frozenset({"offset", "turned"}))
    assert judge([explaining("offset", 0.7, 0.7)], (), Made()).sure == frozenset({"offset"})
    assert judge([explaining("offset", 0.01, 0.01)], (), Made()).sure == frozenset()


def test_a_part_of_an_explanation_in_doubt_is_no_rival_of_what_all_of_them_share():
    """Two effects are sure, and of two others one is there as well, which beside the first of these explains more than
    the second does."""
    sure = explaining("coupled + ratio", 0.38, 0.38)
    whole = [explaining(f"coupled + ratio + {other}", g, g) for other, g in (("drag", 0.48), ("grade", 0.49))]
    parts = [explaining(f"coupled + {other}", g, g) for other, g in (("drag", 0.37), ("grade", 0.36))]
    judged = judge([explaining("coupled", 0.2, 0.2), sure, *parts, *whole], (), Made())
    assert (judged.verdict, judged.leader, judged.besides) == ("named", sure, ("drag", "grade"))


def test_what_the_base_fit_need_no_longer_stand_in_for_counts_as_gained():
    """Equal drives, and a base parameter that was turned by three deviations at a cost of ten each squared, and no
    longer is: 90 beside what the change itself gains."""
    change = np.random.default_rng(1).normal(size=200)
    mass = FreeParameter("mass", "-", 0.1, -1.0, 1.0, lambda values, offset: {})
    turned = replace(FITTED, free_parameters=(mass,), offsets=np.array([0.3]), weight=10.0)
    before = replace(turned, residuals=[-change, 0 * change])
    after = replace(turned, offsets=np.zeros(1), residuals=[-0.5 * change, 0.5 * change])
    hypothesis = replace(explaining("drag", 0.5, 0.5), fit=after)
    gained = 0.5 * float(change @ change)
    assert validated(before, [["yaw_rate"]] * 2).disagreement(hypothesis) == pytest.approx(gained / (gained + 90))


def test_of_many_windows_one_may_disagree():
    """Three windows agree in a change to the last; in the fourth it should have been the opposite."""
    change = np.random.default_rng(1).normal(size=200)

    def odds(*multiples: float) -> float:
        before = replace(FITTED, residuals=[-multiple * change for multiple in multiples])
        after = replace(FITTED, residuals=[(1 - multiple) * change for multiple in multiples])
        validation = validated(before, [["yaw_rate"]] * len(multiples))
        return validation.disagreement(replace(explaining("drag", 0.5, 0.5), fit=after))

    assert odds(1.0, 1.0, 1.0, -1.0) == pytest.approx(0.0, abs=1e-9)
    assert odds(1.0, 1.0, -1.0, -1.0) > 1.0
    assert odds(1.0, 1.0, -1.0) > 1.0  # these are not many


def test_the_worst_signal_is_to_be_mended_where_it_is_worst():
    def mends(unseen: dict[str, float], then: dict[str, float]) -> bool:
        told = SimpleNamespace(
            worst=lambda off: max(off.values()),
            furthest=lambda off: max(off.items(), key=itemgetter(1)),
            deviations=lambda off: off,
        )
        validation = SimpleNamespace(
            thresholds=THRESHOLDS,
            worst=2.5,
            fitted=told,
            residuals=told,
            comparisons=SimpleNamespace(
                held_out=lambda fit: (unseen, then),
                training=lambda fit: ({"wheels": 2.5, "yaw rate": 1.0}, fit.residuals),
            ),
        )
        return not Validation.unmended(validation, SimpleNamespace(fit=SimpleNamespace(residuals={"wheels": 1.2})))

    assert mends({"roll rate": 0.9}, {"roll rate": 0.95})
    assert not mends({"roll rate": 2.6}, {"roll rate": 2.7})
    assert not mends({"roll rate": 2.6}, {"roll rate": 2.5})
    assert mends({"roll rate": 2.6}, {"roll rate": THRESHOLDS.signal_off - 0.01})
    assert mends({"roll rate": 12.0}, {"roll rate": 7.0})


@pytest.mark.parametrize(
    ("left", "whole", "gain", "told"),
    [
        ([0.0, 0.0, 0.0, 6.0], -1.25, 1.0, True),
        ([0.0, 0.0, 6.0], -2.0, -2.0, False),
        ([1.0, 1.0, 1.0, 1.0], 0.75, 0.75, False),
    ],
)
def test_of_many_windows_the_one_that_speaks_most_against_an_effect_does_not_count(left, whole, gain, told):
    windows = [SimpleNamespace(name=f"drive {i}", begin=0.0, end=9.0) for i in range(len(left))]
    validation = validated(FITTED, [])
    validation.residuals = SimpleNamespace(predictor=SimpleNamespace(dataset=SimpleNamespace(windows=windows)))
    validation.comparisons.held_out = lambda fit: (
        [np.full(100, 2.0) for _ in left],
        [np.full(100, off) for off in left],
    )
    found = explaining("wind", 0.5, 0.5)
    assert validation.gain(found) == pytest.approx(whole)
    assert validation.gains(found).of_most == pytest.approx(gain)
    assert validation.against(found).startswith("drive 3: from 0 to 9 s") == told


@pytest.mark.parametrize(
    ("first", "joint", "adds"),
    [
        ([1.0, 1.0, 1.0, 1.0], [0.5, 0.5, 0.5, 0.5], 0.75 * 0.25),
        ([1.0, 1.0, 1.0, 6.0], [0.5, 0.5, 0.5, 7.0], 0.75 * 0.25),  # a drive at the limit, which goes wrong for both
        ([1.0, 1.0, 1.0, 1.0], [0.0, 1.0, 1.0, 1.9], (4.0 - 5.61) / 16.0),  # one that only what joins makes worse
    ],
)
def test_what_joins_is_compared_on_the_windows_that_the_first_effect_is_judged_by(first, joint, adds):
    validation, left = validated(FITTED, []), {"drag": first, "drag + road": joint}
    found = {name: replace(explaining(name, 1.0, 1.0), fit=replace(FITTED)) for name in left}
    names = {id(one.fit): name for name, one in found.items()}
    validation.residuals = SimpleNamespace()
    validation.comparisons.held_out = lambda fit: (
        [np.full(100, 2.0) for _ in first], [np.full(100, off) for off in left[names[id(fit)]]]
    )  # fmt: skip
    assert validation.proven(found["drag + road"]) > validation.proven(found["drag"])
    assert validation.proven_beyond(found["drag + road"], found["drag"]) == pytest.approx(adds)


def unfinished(left: float) -> Made:
    """Held-out recordings where a signal is still off after the first effect."""
    return type("Unfinished", (Made,), {"worst": lambda self, residuals=None: left})()


def test_a_second_effect_is_named_where_it_adds_clearly_more_than_any_other_would():
    one, two = explaining("drag", 0.5, 0.5), explaining("drag + bank", 0.6, 0.6)
    small = explaining("drag + bank", 0.515, 0.515)  # 3 % of what drag leaves
    enough = explaining("drag + bank", 0.525, 0.525)
    assert said(one, two) == ("named", ("drag + bank",))
    assert said(one, small) == ("named", ("drag",))
    assert said(one, enough) == ("named", ("drag + bank",))
    judged = judge((one, two, explaining("drag + wind", 0.56, 0.56)), (), Made())
    assert (judged.verdict, judged.rivals, judged.besides) == ("named", (one,), ("bank", "wind"))
    assert said(one, two, explaining("grade + bank", 0.59, 0.59)) == ("ambiguous", ("drag + bank", "grade + bank"))


def test_a_second_effect_that_explains_what_the_form_of_a_large_first_one_may_leave_is_not_told():
    large = explaining("drag", 0.93, 0.93)
    assert said(large, explaining("drag + bank", 0.938, 0.938)) == ("named", ("drag",))
    assert said(large, explaining("drag + bank", 0.943, 0.943)) == ("named", ("drag + bank",))


def test_what_explains_half_as_much_beside_the_first_effect_does_not_count_if_the_second_leaves_it_nothing():
    gyro, both = explaining("gyro", 0.44, 0.44), explaining("gyro + offset", 0.78, 0.78)
    pair, all_three = explaining("gyro + cone", 0.68, 0.68), explaining("gyro + cone + offset", 0.78, 0.78)
    assert said(gyro, both, pair) == ("named", ("gyro",))
    assert said(gyro, both, pair, all_three) == ("named", ("gyro + offset",))


def test_a_second_effect_counts_against_what_the_first_leaves_and_not_against_how_far_off_the_car_was():
    large = explaining("radius", 0.92, 0.92)
    assert said(large, explaining("radius + yaw", 0.94, 0.94)) == ("named", ("radius + yaw",))
    assert said(large, explaining("radius + yaw", 0.925, 0.925)) == ("named", ("radius",))


def test_what_adds_nothing_to_another_that_adds_to_it_is_excluded():
    drag, slope = explaining("drag", 0.5, 0.5), explaining("slope", 0.45, 0.45)
    assert said(drag, slope) == ("ambiguous", ("drag", "slope"))
    assert said(drag, slope, explaining("drag + slope", 0.505, 0.505)) == ("named", ("drag",))
    united = judge([drag, slope, explaining("drag + slope", 0.505, 0.505)], (), Made())
    assert united.adds(slope) == pytest.approx(0.005)
    assert united.adds(drag) is None
    both_add = explaining("drag + slope", 0.515, 0.515)
    assert said(drag, slope, both_add) == ("ambiguous", ("drag", "slope"))
    alike = explaining("slope", 0.492, 0.492)  # what drag adds to it might be chance
    assert said(drag, alike, explaining("drag + slope", 0.505, 0.505)) == ("ambiguous", ("drag", "slope"))


def test_what_something_near_it_explains_clearly_better_is_no_rival_of_a_leader_that_it_shares_less_with():
    """With the leader it shares an effect that alone explains little, so that it seems to explain most of the same."""
    drag, pair = explaining("drag", 0.3, 0.3), explaining("drag + slope", 0.7, 0.7)
    leader, far = explaining("drag + bank + wind", 0.83, 0.83), explaining("drag + slope + ply", 0.76, 0.76)
    assert said(drag, pair, leader, far) == ("ambiguous", (leader.name, far.name))
    near, all_four = (
        explaining("drag + slope + wind", 0.81, 0.81),
        explaining("drag + bank + wind + slope", 0.8305, 0.8305),
    )
    assert said(drag, pair, leader, near, far) == ("ambiguous", (leader.name, near.name))
    assert said(drag, pair, leader, near, far, all_four) == ("named", (leader.name,))


def test_what_explains_something_else_is_no_rival_even_if_nobody_knows_what_it_is():
    """Two look alike and explain about as much as a third, beside which each explains as much again."""
    sure, one, like = explaining("pitch", 0.14, 0.14), explaining("roll", 0.137, 0.137), explaining("bank", 0.12, 0.12)
    alike = explaining("roll + bank", 0.15, 0.15)
    pairs = explaining("pitch + roll", 0.28, 0.28), explaining("pitch + bank", 0.26, 0.26)
    judged = judge([sure, one, like, alike, *pairs], (), Made())
    assert (judged.verdict, judged.leader) == ("named", sure)
    assert judged.besides == ("bank", "roll")
    overlap = explaining("pitch + roll", 0.16, 0.16)  # roll adds little of what it explains alone
    assert said(sure, one, overlap) == ("ambiguous", ("pitch", "roll"))


def test_a_third_effect_adds_to_any_two_even_if_the_two_are_in_doubt():
    one, *pairs = (explaining(name, g, g) for name, g in (("drag", 0.5), ("drag + bank", 0.6), ("drag + wind", 0.59)))
    assert said(one, *pairs, explaining("drag + bank + wind", 0.61, 0.61)) == ("named", ("drag",))
    all_three = explaining("drag + bank + wind", 0.8, 0.8)
    assert said(one, *pairs, all_three) == ("named", (all_three.name,))


def test_three_effects_of_which_no_two_explain_a_car_are_named():
    levels = (3.5, 2.4, 1.0)
    gains = {"drag": 0.4, "drag + bank": 0.7, "drag + bank + wind": 0.95}
    fits = [replace(FITTED, residuals=[np.full(100, level)]) for level in levels]
    several = [replace(explaining(name, g, g), fit=fit) for (name, g), fit in zip(gains.items(), fits, strict=True)]
    proof = type("Several", (Made,), {"level": lambda self, residuals: residuals[0][0]})()
    judged = judge(several, (), proof)
    assert (judged.verdict, judged.leader) == ("named", several[-1])


def test_an_effect_mends_the_worst_signal_beyond_what_a_road_shakes():
    """On a rough road the vertical acceleration is off for any model: what mends the yaw rate need not mend it."""
    off = {"vertical_acceleration": 3.0, "yaw_rate": 2.0}, {"vertical_acceleration": 3.001, "yaw_rate": 0.5}
    residuals = Residuals.__new__(Residuals)
    residuals.deviations = lambda rows: off[int(rows[0][0])]
    base, fitted = (replace(FITTED, residuals=[np.array([float(i)])]) for i in range(2))
    validation = validated(base, [])
    validation.fitted = residuals
    assert residuals.furthest(base.residuals)[0] == "yaw_rate"
    assert not validation.unmended(replace(explaining("wind", 0.5, 0.5), fit=fitted))


def test_where_a_signal_is_still_off_a_second_effect_is_named_that_explains_much_of_it():
    one = explaining("drag", 0.5, 0.5)
    much, other = explaining("drag + bank", 0.9, 0.9), explaining("drag + wind", 0.8, 0.8)
    assert judge((one, much, other), (), unfinished(2.0)).leader == much
    assert judge((one, much, other), (), unfinished(1.0)).leader == one


def test_of_two_effects_the_second_is_excluded_by_what_it_adds_to_the_first_alone():
    bank = explaining("bank", 0.5, 0.5)
    found, other = explaining("bank + ratio", 0.9, 0.9), explaining("bank + gyro", 0.75, 0.75)
    judged = judge((bank, found, other), (), unfinished(2.0))
    assert (judged.verdict, judged.rivals) == ("named", (found,))
    assert judged.confidence(found, "ratio") == pytest.approx(confidence(0.8, 0.5))  # of what the bank leaves
    assert judged.without(found, "ratio") is bank
    assert judged.without(found, "bank") is None  # a ratio alone was not fitted
    assert judged.without(bank, "bank") is None
    assert judged.confidence(bank, "bank") == confidence(0.5, 0.0)
    assert judged.confidence(other, "gyro") <= THRESHOLDS.refused
    near = explaining("bank + gyro", 0.87, 0.87)
    assert judge((bank, found, near), (), unfinished(2.0)).rivals == (found, near)


def test_a_small_second_effect_that_nothing_else_comes_near_is_as_sure_as_what_it_explains_of_what_is_left():
    """It is named because it explains a tenth of that, so that it is not told to be hardly there."""
    bank, both = explaining("bank", 0.85, 0.85), explaining("bank + wind", 0.865, 0.865)
    judged = judge((bank, both), (), unfinished(1.0))
    assert (judged.verdict, judged.rivals) == ("named", (both,))
    assert judged.confidence(both, "wind") == pytest.approx(confidence(0.1, 0.0))
    assert judged.confidence(both, "wind") > 0.5


def test_a_smaller_second_effect_that_cannot_be_told_from_another_leaves_the_first_named():
    bank = explaining("bank", 0.6, 0.6)
    pairs = [explaining(f"bank + {other}", 0.8, 0.8) for other in ("ratio", "gyro")]
    judged = judge((bank, *pairs), (), unfinished(2.0))
    assert (judged.verdict, judged.rivals, judged.besides) == ("named", (bank,), ("gyro", "ratio"))


def test_a_small_gain_that_several_effects_give_alike_is_in_doubt_and_not_chance():
    assert said(*(explaining(name, 0.04, 0.04) for name in ("wind", "bank"))) == ("ambiguous", ("wind", "bank"))
    assert said(explaining("wind", 0.04, 0.04)) == ("named", ("wind",))
    assert said(*(explaining(name, 0.02, 0.02) for name in ("wind", "bank"))) == ("no_mismatch", ())


def test_effects_in_doubt_are_told_beside_a_term_that_explains_as_much_and_not_beside_one_that_explains_more():
    alike = [explaining(name, 0.055, 0.055) for name in ("drag", "slope")]
    judged = judge(alike, [explaining("force", 0.06, 0.06)], Made())
    assert (judged.verdict, [e.name.strip() for e in judged.rivals]) == ("ambiguous", ["drag", "slope"])
    assert judge(alike, [explaining("force", 0.12, 0.12)], Made()).verdict == "unknown"


def test_what_is_asked_for_is_what_the_thresholds_say():
    drag = explaining("drag", 0.2, 0.2)
    assert judge([drag], (), Made()).verdict == "named"
    strict = replace(THRESHOLDS, least_gain=0.25)
    assert judge([drag], (), Made(), thresholds=strict).verdict == "no_mismatch"
    assert judge([drag], (), Made(), least_gain=0.25).verdict == "no_mismatch"
    certain = replace(THRESHOLDS, clear_name=0.6)
    assert judge([drag], (), Made(), thresholds=certain).confidence(drag, "drag") == pytest.approx(0.6, abs=1e-3)


def test_an_effect_that_a_term_explains_clearly_better_is_refused_with_that_reason():
    drag = explaining("drag", 0.7, 0.7)
    outdone = judge([drag], [explaining("force", 0.78, 0.78)], Made())
    assert (outdone.verdict, outdone.objection_to(drag)) == ("unknown", OUTDONE)
    enough = judge([drag], [explaining("force", 0.76, 0.76)], Made())
    assert (enough.verdict, enough.objection_to(drag)) == ("named", "")


def test_a_place_that_explains_as_much_as_the_best_one_is_told_beside_it():
    drag = {
        wheel: FreeParameter(wheel, "N m", 10.0, 0.0, 500.0, lambda values, offset: {}) for wheel in ("fl", "fr", "rl")
    }
    found = [
        replace(explaining("drag", gain, gain), candidates=(Candidate("drag", where, free_parameters, "drag"),))
        for gain, where, free_parameters in (
            (0.5, "fl", (drag["fl"],)), (0.5, "fl and fr", (drag["fl"], drag["fr"])), (0.49, "fr", (drag["fr"],)),
            (0.2, "rl", (drag["rl"],)),
        )
    ]  # fmt: skip
    judged = Judged("named", found[0], (found[0],), (Ranked(found[0], ""),), tuple(found), {e: e.gain for e in found})
    assert judged.other_places() == ("fr",)


def test_where_the_fitted_car_gets_lost_on_its_own_recordings_something_is_left_over():
    lost = type("Lost", (Made,), {"something_unexplained": lambda self: True})()
    found = explaining("wind", 0.01, 0.01)
    assert judge((found,), (), lost).verdict == "unknown"
    assert judge((found,), (), Made()).verdict == "no_mismatch"
    alike = [explaining(name, 0.05, 0.05) for name in ("wind", "bank")]
    assert judge(alike, (), lost).verdict == "ambiguous"


@pytest.mark.parametrize(
    ("torque", "deviation", "verdict"), [(1.0, 0.1, "no_mismatch"), (5.0, 1.0, "named"), (5.0, 4.0, "no_mismatch")]
)
def test_an_effect_of_next_to_no_size_or_one_that_might_be_zero_is_not_told(torque, deviation, verdict):
    parameter = FreeParameter("torque", "N m", 10.0, -100.0, 100.0, lambda values, offset: {"torque": offset})
    found = replace(
        explaining("brake_drag", 0.2, 0.2),
        candidates=(Candidate("brake_drag", "", (parameter,), "a brake that drags"),),
        fit=replace(FITTED, free_parameters=(parameter,), offsets=np.array([torque])),
        deviations={"torque": deviation},
    )
    assert judge((found,), (), Made()).verdict == verdict


@pytest.mark.parametrize(("worst", "left_over"), [(1.48, False), (1.8, True)])  # the first with nothing hidden
def test_a_signal_further_off_than_any_of_a_car_with_nothing_hidden_says_that_something_is_left_over(worst, left_over):
    dataset = SimpleNamespace(dropped=())
    fitted = SimpleNamespace(predictor=SimpleNamespace(dataset=dataset))
    validation = SimpleNamespace(worst=worst, fitted=fitted, thresholds=THRESHOLDS)
    assert Validation.something_unexplained(validation) == left_over


@pytest.mark.parametrize(("mended", "verdict"), [(True, "named"), (False, "no_mismatch")])
def test_a_signal_that_one_size_for_all_of_the_road_leaves_off_may_be_how_the_road_changes(mended, verdict):
    level = explaining("effect that mends another signal", 0.2, 0.2)
    changing = explaining("bank of another size at every place" if mended else level.name, 0.5, -0.1)
    judged = judge((level,), (), Made(), lambda hypothesis: changing)
    assert (judged.verdict, judged.leader) == (verdict, level if mended else None)  # what is told is what lasts


@given(st.floats(-10.0, 10.0), st.floats(0.0, 5.0))
def test_an_interval_is_about_its_size_and_wider_than_what_the_windows_agree_in(value, spread):
    low, high = interval(value, spread)
    assert (low + high) / 2 == pytest.approx(value, abs=1e-9)
    assert (high - low) / 2 >= 1.64 * max(spread, THRESHOLDS.size_error * abs(value))
    assert interval(value, spread, left=0.5) == (low, high)
    assert np.diff(interval(value, spread, left=3.0)) >= high - low  # what else is left out shifts a size as well


def test_of_a_set_the_effect_that_is_likelier_absent_than_present_is_not_named_but_said_besides():
    drag = explaining("drag", 0.5, 0.5)
    both, instead = explaining("drag + slope", 0.6, 0.6), explaining("drag + wind", 0.61, 0.58)
    # The wind explains hardly less beside the drag, but leaves a signal further off, so that it is no rival.
    judged = judge([drag, both, instead], (), Nearer())
    assert judged.verdict == "named"
    assert judged.doubted == ()
    assert all(judged.confidence(judged.leader, id) >= THRESHOLDS.least_confidence for id in judged.leader.effects)
    certain = judge([drag, both], (), Nearer())
    assert certain.leader is both


class Nearer(Made):
    """Recordings in which a wind leaves signals further off than a slope does."""

    def nearer(self, one: Hypothesis, other: Hypothesis) -> list[tuple[float, float]]:
        return [(1.0, 0.0)] if "wind" in other.name else [(0.0, 1.0)]


def test_no_effect_is_named_that_is_likelier_absent_than_present():
    chance = THRESHOLDS.least_gain
    assert said(explaining("slope", 1.01 * chance, 1.01 * chance)) == ("no_mismatch", ())
    assert said(explaining("slope", 1.1 * chance, 1.1 * chance)) == ("named", ("slope",))


def test_of_two_that_explain_nearly_all_the_one_that_leaves_half_as_much_is_named_with_confidence():
    slope, wind = explaining("slope", 0.99, 0.99), explaining("wind", 0.98, 0.98)
    judged = judge([slope, wind], (), Made())
    assert (judged.verdict, judged.leader) == ("named", slope)
    assert judged.confidence(slope, "slope") > 0.8


def test_a_size_that_may_be_zero_is_doubted_whatever_it_explains():
    size = FreeParameter("effects.drag.size", "m", 1.0, -9.0, 9.0, lambda values, offset: {})
    candidate = Candidate("brake_drag", "", (size,), "drag")
    fitted = replace(FITTED, free_parameters=(size,), offsets=np.array([2.0]), slopes=[np.zeros((100, 1))])
    sharp = Hypothesis((candidate,), fitted, 0.5, 0.5, 0.5, 0.5, 0.0, {size.name: 0.1})
    judged = judge([sharp], (), Made())
    assert (judged.verdict, judged.doubted) == ("named", ())
    assert judged.led_by(replace(sharp, deviations={size.name: 2.0}), Made()).doubted == ("brake_drag",)


def test_a_road_that_changes_gives_way_to_one_size_that_leaves_no_more_than_a_good_model():
    class Level(Made):
        comparisons = SimpleNamespace(on_another_road=False, by_pieces=lambda fitted: False)

        def worst_after(self, hypothesis: Hypothesis) -> float:
            return 0.9 if hypothesis.effects == ("drag",) else 1.3

    place = FreeParameter("slope@0", "rad", 0.1, -1.0, 1.0, lambda values, offset: {}, place=("slope", 0.0))
    fitted = replace(FITTED, free_parameters=(place,), offsets=np.array([0.2]), slopes=[np.zeros((100, 1))])
    hilly = replace(
        explaining("slope", 0.9, 0.9), candidates=(Candidate("slope", "along the road", (place,), "slope"),),
        fit=fitted, deviations={place.name: 0.01},
    )  # fmt: skip
    assert judge([hilly, explaining("drag", 0.7, 0.7)], (), Level()).leader.effects == ("drag",)
    assert judge([hilly, explaining("wind", 0.7, 0.7)], (), Level()).leader is hilly
