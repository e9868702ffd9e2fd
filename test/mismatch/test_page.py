"""What a reader of the report finds on it, whatever the answer is, and that it stands alone."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from marks import exam_except
from synthetic_findings import SIGNALS, effect, finding, located, segment, traces
from vsense_ros.evaluate import html_page
from vsense_ros.mismatch.answer_schema import Answer, Region, Remainder, SignalMisfit, parsed
from vsense_ros.mismatch.answer_sentence import sentence
from vsense_ros.mismatch.page import write_report
from vsense_ros.mismatch.picture import before_and_after, most_affected, when
from vsense_ros.mismatch.remarks import Evidence, remarks
from vsense_ros.mismatch.tables import effect_rows, signal_rows
from vsense_ros.mismatch.terminal import printed
from vsense_ros.mismatch.words import BADGES, in_words, percent, shown_number, shown_value

EMPTY = {"meta", "link", "br", "img"}


class Reader(HTMLParser):
    """What a page would load from elsewhere, what it says, its pictures, and whether its tags match."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.text = ""
        self.pictures: list[bytes] = []
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.feed(page)
        self.close()
        self.text = re.sub(r"\s+", " ", self.text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.text += " "
        if tag not in EMPTY:
            self.open.append(tag)
        for key, value in attrs:
            if key in ("src", "href") and not value.startswith(("data:", "#")):
                self.loads.append(value)
            if key == "src" and value.startswith("data:image/svg+xml;base64,"):
                self.pictures.append(base64.b64decode(value.partition(",")[2]))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open[-1:] != ["style"]:
            self.text += data


def point(distance: float, value: float, stretch: float = 0.0) -> dict:
    """What an effect of the road is at one place."""
    interval = [value - 0.002, value + 0.002]
    return {"stretch": stretch, "distance": distance, "value": value, "interval_90": interval}


def read(found: Answer, curves, folder) -> Reader:
    path = folder / "new" / "page.html"
    write_report(found, curves, path)
    page = path.read_text(encoding="utf-8")
    assert page.startswith("<!DOCTYPE html>")
    assert not re.search(r"url\(|@import|<script", page)
    return Reader(page)


def terminal(found) -> str:
    console = Console(width=110, record=True, force_terminal=False, highlight=False, quiet=False, file=None)
    with console.capture() as kept:
        printed(found, console)
    return re.sub(r"\s+", " ", kept.get())


@pytest.mark.parametrize("verdict", BADGES)
@pytest.mark.parametrize("held_out", exam_except([True, False], True))
def test_every_verdict_has_a_page_that_stands_alone_and_says_the_sentence(verdict, held_out, tmp_path):
    found = finding(verdict, held_out=held_out)
    reader = read(found, traces(verdict, held_out=held_out), tmp_path)
    assert reader.open == []
    assert reader.loads == []
    assert found.sentence in reader.text
    for remark in found.remarks:
        assert remark in reader.text
    for picture in reader.pictures:
        assert ElementTree.fromstring(picture).tag.endswith("svg")
    assert bool(reader.pictures) == (verdict != "not_assessable")


@pytest.mark.parametrize("verdict", BADGES)
def test_the_terminal_says_the_sentence_and_every_remark(verdict):
    found = finding(verdict)
    words = terminal(found)
    assert found.sentence in words
    assert found.remarks[0] in words


@pytest.mark.parametrize("verdict", BADGES)
def test_what_is_read_back_from_the_file_gives_the_same_page(verdict, tmp_path, monkeypatch):
    written = datetime(2026, 1, 31, 12, 0, tzinfo=UTC)  # a page tells the minute
    monkeypatch.setattr(html_page, "datetime", SimpleNamespace(now=lambda zone: written))
    found = finding(verdict)
    again = parsed(json.loads(found.written()), "explain.json")
    assert read(found, [], tmp_path).text == read(again, [], tmp_path).text


def test_names_are_text_and_neither_tags_nor_formulas(tmp_path):
    evil = "<script>alert('$x^2$')</script> [bold]"
    found = finding(
        "named",
        vehicle=evil,
        recordings=[evil],
        remarks=[evil],
        sentence=evil,
        located=located("named").with_(segments=[segment(evil, 0.0, 9.0, 1.0)]),
        effects=[effect("brake_drag", 0.4, sensor=evil, sentence=evil, accepted=True)],
    )
    reader = read(found, [replace(trace, recording=evil) for trace in traces("named")], tmp_path)
    assert "script" not in reader.tags
    assert reader.text.count(evil) >= 6
    assert evil in terminal(found)


def test_the_first_picture_is_of_the_most_affected_signal_where_no_fit_has_seen_it():
    shown = most_affected(traces("named"), list(SIGNALS))
    assert shown is not None
    assert (shown.signal, shown.recording, shown.held_out) == ("lateral_acceleration", "lap 3", True)


def test_among_windows_that_were_fitted_the_first_picture_shows_the_worst():
    curves = [trace for trace in traces("named") if not trace.held_out]
    worst = replace(curves[7], before=curves[7].measured + 9.0)
    assert most_affected([*curves[:7], worst, *curves[8:]], [worst.signal]) is worst


def test_a_course_is_drawn_as_it_is_compared_without_constant_and_slope():
    t = np.arange(0.0, 10.0, 0.04)
    course = next(trace for trace in traces("named") if trace.signal == "course")
    adrift = replace(course, t=t, measured=np.sin(t), before=np.sin(t) + 0.3 + 0.1 * t, after=np.sin(t))
    assert adrift.errors == pytest.approx((0.0, 0.0), abs=1e-9)
    assert before_and_after(adrift).startswith(b"<?xml")


def test_the_held_out_figures_are_those_of_the_fit(tmp_path):
    found = finding("named")
    text = read(found, traces("named"), tmp_path).text
    assert "−82 %" in text
    assert "on held-out recordings, which no fit has seen: from 0.462 m/s² to 0.0825 m/s²" in text
    assert "54 % of the squared error of all signals explained, held out" in text


def test_what_was_assumed_is_not_told_as_found_and_an_error_that_grows_as_growing(tmp_path):
    found = finding("named", assumed=["brake_drag"])
    effects = [one.with_(gain_training=0.14, gain_held_out=-0.2, accepted=True) for one in found.effects]
    found = found.with_(effects=effects)
    found = found.with_(sentence=sentence(found))
    assert found.sentence.startswith("Assumed, not searched for: ")
    assert "the squared error falls by 14 %, and grows by 20 % on recordings" in found.sentence
    text = read(found, traces("named"), tmp_path).text
    assert "Assumed" in text
    assert BADGES["named"].title not in text


def test_the_page_says_where_a_held_out_road_was_predicted_from_its_pieces(tmp_path):
    text = read(finding("named", by_pieces=True), traces("named"), tmp_path).text
    assert "which no fit has seen" not in text
    assert text.count("of another road, each piece as its neighbours predict it") == 2  # headline and caption


def test_the_page_says_how_far_from_a_good_model_the_extended_one_stays(tmp_path):
    found = finding("named")
    off = found.fit["speed"].held_out.with_(after=3 * SIGNALS["speed"][1])
    found = found.with_(fit=found.fit | {"speed": found.fit["speed"].with_(held_out=off)})
    text = read(found, [], tmp_path).text
    assert "3.0 × what a good model leaves: the largest error that remains, of the speed" in text


def test_without_held_out_recordings_the_page_says_what_the_proof_rests_on(tmp_path):
    text = read(finding("named", held_out=False), [], tmp_path).text
    assert "No recording was held out" in text
    assert "held-out recordings" not in text


def test_what_was_held_out_and_could_not_be_used_is_not_said_to_have_been_fitted_or_never_held_out(tmp_path):
    found = finding("named", held_out=False, held_out_unused=["lap 3"])
    text = read(found, traces("named", held_out=False), tmp_path).text
    assert "No recording was held out" not in text
    assert "Nothing of what was held out could be used: the proof rests on parts of the same recordings" in text
    assert "Fitted to lap 1, slalom $5^; not used: coast & brake, lap 3." in text


def test_a_signal_that_no_held_out_recording_has_is_shown_as_fitted_and_has_no_bar(tmp_path):
    found, curves = finding("named"), traces("named")
    bars = len(signal_rows(found)[0].bars)
    unheard = found.fit["lateral_acceleration"].with_(held_out=None)
    found = found.with_(fit=found.fit | {"lateral_acceleration": unheard})
    seen = [trace for trace in curves if not (trace.held_out and trace.signal == "lateral_acceleration")]
    text = read(found, seen, tmp_path).text
    assert "error of the lateral acceleration, on the recordings it was fitted to: from 0.420 m/s² to" in text
    assert "lateral acceleration 0.0600 m/s² 0.420 m/s² 0.0750 m/s² −82 % – – –" in text
    assert [len(row.bars) for row in signal_rows(found)[:2]] == [0, bars]


def test_each_alternative_has_a_reason_why_it_is_not_the_answer(tmp_path):
    text = read(finding("named"), [], tmp_path).text
    assert "explains less: 90 % of what the best explains, and 0.1 % besides it" in text
    assert "excluded: explains where it was fitted, but no more than chance held out" in text
    assert "Tyre underinflation, rear left" in text


def test_an_ambiguous_answer_names_all_that_remains_and_the_test_that_separates_it(tmp_path):
    found = finding("ambiguous")
    text = read(found, [], tmp_path).text
    open_answers = text.partition("leave open")[2].partition("over time")[0].partition("Fitted to")[0]
    assert "IMU roll misalignment" in open_answers
    assert "Accelerometer bias, y" in open_answers
    assert "Tyre underinflation" not in open_answers
    assert "steady turn on a banked road; watch the lateral acceleration (d′ 6.0 predicted)" in text
    assert "steady turn on a banked road; watch the lateral acceleration (d′ 6.0 predicted)" in terminal(found)


def test_what_every_explanation_has_that_remains_is_sure_and_not_left_open(tmp_path):
    ids = ("road_bank", "tyre_conicity", "steering_offset")
    rivals = [["road_bank", "tyre_conicity"], ["road_bank", "steering_offset"]]
    found = finding("ambiguous", effects=[effect(id, 0.5) for id in ids], answer_set=ids, rivals=rivals)
    text = read(found, [], tmp_path).text
    sure, _, left_open = text.partition("On this page")[0].rpartition("Sure:")[2].partition("leave open")
    assert [name in sure for name in ("Road bank", "Tyre conicity", "Steering offset")] == [True, False, False]
    assert [name in left_open for name in ("Road bank", "Tyre conicity", "Steering offset")] == [False, True, True]
    assert re.findall(r"(\w+ \w+): \w+, 90 % interval", text) == ["Road bank"]
    standings = [row.standing for row in effect_rows(found)]
    assert [standing.split()[0] for standing in standings] == ["sure:", "cannot", "cannot"]


def test_the_figures_below_the_sentence_have_the_size_that_is_furthest_from_zero(tmp_path):
    places = [("x", -0.003, (-0.05, 0.04)), ("y", -0.69, (-0.86, -0.52))]
    sizes = [{"name": name, "unit": "m", "value": v, "interval_90": limits} for name, v, limits in places]
    antenna = effect("gnss_lever_arm", 0.6, accepted=True, parameters=sizes)
    text = read(finding("named", effects=[antenna], answer_set=["gnss_lever_arm"]), [], tmp_path).text
    assert "−0.690 m GNSS lever arm: y, 90 % interval −0.860 to −0.520 m" in text


def test_before_a_test_was_designed_the_page_says_how_to_and_not_that_there_is_none(tmp_path):
    text = read(finding("ambiguous", would_separate=None, drive_next=""), [], tmp_path).text
    assert "vsense explain --next looks for the manoeuvre" in text
    assert "No test is known" not in text


def test_an_ambiguous_answer_says_with_which_of_its_effects_the_model_is_shown(tmp_path):
    ids = ("road_bank", "tyre_conicity", "steering_offset")
    rivals = [["road_bank", "tyre_conicity"], ["road_bank", "steering_offset"]]
    found = finding("ambiguous", effects=[effect(id, 0.5) for id in ids], answer_set=ids)
    of = "On this page “after” and “with what was found” mean the model with the first of them:"
    assert f"{of} IMU roll misalignment." in read(finding("ambiguous"), [], tmp_path).text
    assert f"{of} road bank and tyre conicity." in read(found.with_(rivals=rivals), [], tmp_path).text
    assert of not in read(finding("named"), [], tmp_path).text


def test_several_effects_at_once_are_all_marked_as_the_answer(tmp_path):
    pair = [effect("brake_drag", 0.5, wheel="fl", accepted=True), effect("road_bank", 0.5, accepted=True)]
    found = finding("named", effects=pair)
    text = read(found, [], tmp_path).text
    assert text.count("the answer") == 2
    assert "Brake drag, front left: angle" in text
    assert "Road bank: angle" in text


def test_gains_of_effects_that_were_found_together_are_said_to_be_those_of_both(tmp_path):
    pair = [effect("brake_drag", 0.5, wheel="fl", accepted=True), effect("road_bank", 0.5, accepted=True)]
    alone = effect("gyro_bias", 0.1)
    found = finding("named", effects=[*pair, alone], rivals=[["brake_drag", "road_bank"]])
    text = read(found, [], tmp_path).text
    assert "squared error of all signals explained, held out, by both together" in text
    assert "gains of both together, with road bank" in text
    assert "gains of both together, with brake drag" in text
    assert text.count("gains of both together") == 2
    assert "belong to all of them and do not add up" in text
    assert terminal(found).count("gains of both together") == 2
    assert "together" not in read(finding("named"), [], tmp_path).text


def test_the_gains_of_a_rival_belong_to_what_it_stands_together_with(tmp_path):
    ids = ("road_bank", "tyre_conicity", "steering_offset")
    rivals = [["road_bank", "tyre_conicity"], ["road_bank", "steering_offset"]]
    found = finding("ambiguous", effects=[effect(id, 0.5) for id in ids], answer_set=ids, rivals=rivals)
    text = read(found, [], tmp_path).text
    assert text.count("gains of both together, with road bank") == 2
    assert text.count("gains of both together, with tyre conicity") == 1


def test_a_form_is_part_of_where_an_effect_is(tmp_path):
    found = finding("named", effects=[effect("road_bank", 0.5, form="on a plane", accepted=True)])
    assert "Road bank, on a plane: angle" in read(found, [], tmp_path).text
    assert "Road bank, on a plane" in terminal(found)
    assert in_words(found.effects[0]) == "the physics of road bank, on a plane (angle 0.705°)"


def test_a_share_is_told_in_percent_with_its_sign_and_a_coefficient_as_it_is():
    def told(name: str, value: float) -> str:
        size = {"name": name, "unit": "-", "value": value, "interval_90": [0.9 * value, 1.1 * value]}
        return in_words(effect("it", 0.5, sentence="it", parameters=[size]))

    assert told("relative", 0.142) == "it (+14 %)"
    assert told("fl", -0.3) == "it (front left −30 %)"
    assert told("coefficient", 0.0051) == "it (coefficient 0.00510)"
    size = {"name": "relative", "unit": "-", "value": -0.05, "interval_90": [-0.06, -0.04]}
    places = [point(0.0, -0.03), point(50.0, 0.11)]
    slippery = effect("it", 0.5, sentence="it", parameters=[size], profile=places)
    assert in_words(slippery) == "it (between −8.0 % and +6.0 % along the road)"


def test_an_interval_of_a_share_is_in_percent_too(tmp_path):
    size = {"name": "relative", "unit": "-", "value": 0.142, "interval_90": [0.109, 0.175]}
    found = finding("named", effects=[effect("steering_ratio", 0.5, accepted=True, parameters=[size])])
    text = read(found, [], tmp_path).text
    assert "+14 % Steering ratio, 90 % interval +11 to +18 %" in text
    assert "+14 % (+11 to +18 %)" in text
    assert "relative" not in text


def test_a_size_that_changes_along_the_road_is_told_by_its_range(tmp_path):
    places = [point(50.0 * i, value) for i, value in enumerate((-0.0803, 0.0, 0.0647))]
    bank = effect("road_bank", 0.5, accepted=True, profile=places)
    assert in_words(bank) == "the physics of road bank (angle between −3.9° and +4.4° along the road)"
    found = finding("named", effects=[bank], answer_set=["road_bank"])
    text = read(found, [], tmp_path).text
    assert "−3.9° to +4.4° Road bank: angle, along the road, at 3 places" in text
    assert "angle between −3.9° and +4.4° along the road (at 3 places)" in text
    assert "angle between −3.9° and +4.4° along the road (at 3 places)" in terminal(found)


def test_base_parameters_stand_in_words_without_and_with_what_was_found(tmp_path):
    found = finding("named").with_(
        base={
            "mass": {"unit": "-", "value": -0.17, "explained": -0.012},
            "yaw inertia": {"unit": "-", "value": -0.0004, "explained": None},
            "effects.accelerometer_bias.z": {"unit": "m/s²", "value": 0.0882, "explained": 0.0},
            "effects.rolling_resistance.coefficient": {"unit": "-", "value": 0.0003, "explained": 0.0002},
        }
    )
    text = read(found, [], tmp_path).text
    assert "change of without what was found with what was found" in text
    assert "mass −17 % −1.2 %" in text
    assert "yaw inertia 0 % –" in text
    assert "accelerometer bias, z +0.0882 m/s² 0 m/s²" in text
    assert "rolling resistance, coefficient +0.000300 +0.000200" in text
    assert "effects." not in text
    assert "bent to stand in for it" in text


def test_base_parameters_have_one_column_where_none_was_fitted_with_what_was_found(tmp_path):
    text = read(finding("named"), [], tmp_path).text
    assert "change of fitted mass +6.1 %" in text
    assert "with what was found" not in text.partition("What the fit changed")[2]


def test_a_change_of_a_share_does_not_pass_for_a_relative_one(tmp_path):
    found = finding("named").with_(
        base={
            "share of the front wheels in driving": {"unit": "-", "value": 0.23, "explained": 0.27},
            "share of the front wheels in braking": {"unit": "-", "value": 0.0, "explained": None},
        }
    )
    text = read(found, [], tmp_path).text
    assert "share of the front wheels in driving +0.230 +0.270" in text
    assert "share of the front wheels in braking 0 –" in text


def test_nothing_is_said_to_be_impossible_and_nothing_is_minus_zero(tmp_path):
    none = effect("gyro_bias", -2e-5, confidence=1e-8)
    found = finding("named", effects=[effect("brake_drag", 0.5, accepted=True), none])
    text = read(found, [], tmp_path).text
    assert "< 1 %" in text
    assert "0.0 %" not in text
    assert "no more than nothing" not in text
    assert "excluded: explains nothing" in text
    assert percent(-2e-5, signed=True) == "0 %"


def test_beside_the_confidence_stands_where_it_comes_from(tmp_path):
    text = read(finding("named"), [], tmp_path).text
    assert "confidence in the name: how often such names were right in the examination" in text
    assert "BENCHMARKS.md" in text


def test_of_several_names_the_less_certain_one_gives_the_confidence(tmp_path):
    pair = [effect("brake_drag", 0.5, accepted=True), effect("road_bank", 0.5, accepted=True, confidence=0.71)]
    text = read(finding("named", effects=pair), [], tmp_path).text
    assert "71 % confidence in the less certain name" in text


def test_the_page_says_on_what_each_effect_acts(tmp_path):
    parts = [
        {"effect": "brake_drag", "acts_on": "wheel", "wheel": "rl"},
        {"effect": "road_bank", "acts_on": "road"},
    ]
    found = finding("named", located=located("named").with_(parts=parts))
    text = read(found, traces("named"), tmp_path).text
    assert "Brake drag acts on the wheel, rear left; road bank acts on the road." in text


def test_a_road_that_is_another_at_every_place_is_drawn_along_the_way(tmp_path):
    places = [point(50.0 * i, 0.01 * i, stretch) for stretch in (0.0, 1.0) for i in range(4)]
    bank = effect("road_bank", 0.5, accepted=True, profile=places)
    found = finding("named", effects=[bank], answer_set=["road_bank"])
    drawn = read(found, [], tmp_path)
    plain = read(found.with_(answer_set=[]), [], tmp_path)
    assert len(drawn.pictures) == len(plain.pictures) + 1
    assert "how much, along the way" in drawn.text


@pytest.mark.parametrize(("verdict", "file"), [("named", "road.csv"), ("ambiguous", "explain.json")])
def test_the_places_of_a_road_are_said_to_be_in_a_file_that_is_written(verdict, file, tmp_path):
    places = [point(50.0 * i, 0.01) for i in range(3)]
    bank = effect("road_bank", 0.5, accepted=verdict == "named", profile=places)
    text = read(finding(verdict, effects=[bank], answer_set=["road_bank"]), [], tmp_path).text
    assert f"Places are in {file} by the distance driven." in text
    assert ("road.csv" in text) == (file == "road.csv")


@pytest.mark.parametrize("verdict", ["named", "ambiguous"])
def test_remarks_speak_of_an_extended_vehicle_only_where_one_is_written(verdict):
    road = SimpleNamespace(effects=("road_bank",), candidates=[SimpleNamespace(along_road=True)], fit=None)
    judged = SimpleNamespace(leader=road, verdict=verdict, besides=(), other_places=tuple)
    comparisons = SimpleNamespace(lost=lambda fit: [], by_pieces=lambda fit: False)
    proof = SimpleNamespace(against=lambda leader: "", comparisons=comparisons)
    (said,) = remarks(judged, Evidence(proof, None, {"imu", "gnss_velocity"}, {}))
    assert said.startswith("its profile along the road is given by the distance driven")
    assert ("extended vehicle" in said, "road.csv" in said) == (verdict == "named",) * 2


def test_nothing_is_ever_said_to_be_certain(tmp_path):
    found = finding("named", effects=[effect("brake_drag", 0.5, accepted=True, confidence=0.99997)])
    text = read(found, [], tmp_path).text
    assert "> 99 %" in text
    assert "100 %" not in text


def test_a_simulation_that_broke_down_on_held_out_data_is_no_proof(tmp_path):
    first, _, *rest = finding("named").effects
    found = finding("named", effects=[first, effect("gyro_bias", 0.6, gain_held_out=None), *rest])
    assert "excluded: explains where it was fitted, but nothing held out" in read(found, [], tmp_path).text


def test_a_term_without_known_physics_is_not_said_to_explain_nothing_beside_what_it_explains(tmp_path):
    found = finding("unknown", effects=[effect("unmodelled", 0.42)])
    text = read(found, [], tmp_path).text
    assert "42 % left out in turn" in text
    assert "describes what is left over, and names no physics" in text


def test_physics_that_explains_more_than_the_force_that_is_told_has_its_reason(tmp_path):
    bank = effect("road_bank", 0.6, objection="it leaves the speed about as far off as it was")
    found = finding("unknown", effects=[*finding("unknown").effects, bank])
    assert "refused: it leaves the speed about as far off as it was" in read(found, [], tmp_path).text


def test_parameters_are_read_in_degrees_and_changes_in_percent():
    assert shown_value(np.pi / 180, "rad") == "1.00°"
    assert shown_value(-0.061, "-", change=True) == "−6.1 %"
    assert shown_value(0.5, "-") == "0.500"
    assert shown_value(45.04, "kg") == "45.0 kg"
    assert percent(None) == percent(float("nan")) == "–"


@given(st.floats(-1e12, 1e12).filter(lambda value: abs(value) > 1e-12))
def test_a_number_is_shown_to_three_digits(value):
    assert float(shown_number(value).replace("−", "-")) == pytest.approx(value, rel=6e-3)


def test_a_share_without_a_place_in_time_leaves_the_timeline_out():
    assert when([], traces("named")) is None


def test_a_partial_answer_says_on_page_and_in_terminal_what_is_left_over(tmp_path):
    rest = Remainder(
        level=2.4,
        signals=(SignalMisfit(name="yaw_rate", unit="rad/s", before=0.012, null=0.004),),
        region=Region(description="the error of the yaw rate grows with the speed", correlation={"speed": 0.6}),
        force=None,
    )
    found = finding("named", remainder=rest)
    for text in (read(found, [], tmp_path).text, terminal(found)):
        assert "yaw rate, 3.0 times what a good model leaves. The error of the yaw rate grows with the speed" in text
    assert "Left over" not in terminal(finding("named"))
