"""The scorer asked about answers whose scores are known, and the conditions under which the tool works."""

from __future__ import annotations

import json
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.stats import binomtest

pytest.importorskip("mujoco", reason="MuJoCo is one of the plants: make venv installs it")

from blind import cases, observing, oracle, picture, score, tool
from blind.__main__ import SEALS, main
from blind.effects import EFFECTS
from blind.observing import Observed
from blind.oracle import Best
from blind.outside import OUTSIDE
from blind.score import Result
from blind.tool import Answer
from mismatch.synthetic_findings import effect, finding
from vsense_ros.errors import InputError
from vsense_ros.mismatch import answer_schema as explain_json
from vsense_ros.mismatch import thresholds
from vsense_ros.mismatch.answer_schema import Errors, ObserverComparison, ObserverFigures, SignalErrors


def _result(
    hidden, verdict, ranked=(), *, kind="effect", answer_set=None, gain=0.5, after=0.4, acceptable=(), several=False
) -> Result:
    """An answer that names the first of the ranked effects, or all of them if they are `several`."""
    label = {
        "kind": kind,
        "manoeuvres": "rich",
        "acceptable": list(acceptable),
        "hidden": [{"id": name, "where": "", "parameters": {"area": 0.3}} for name in hidden],
    }
    area = {"name": "area", "unit": "m²", "value": 0.33, "interval_90": [0.29, 0.37]}
    explain = finding(
        verdict,
        effects=[
            effect(name, 0.5, parameters=[area], accepted=verdict == "named" and (several or name == ranked[0]))
            for name in ranked
        ],
        answer_set=ranked if answer_set is None else answer_set,
        fit={"yaw_rate": _yaw_rate(1.0, after)},
    )
    best = Best(gain, {"yaw_rate": 0.2}) if hidden else None
    return Result(label, Answer(explain, 1.0), best)


def _yaw_rate(before: float, after: float) -> SignalErrors:
    errors = Errors(before=before, after=after)
    return SignalErrors(unit="rad/s", training=errors, held_out=errors)


def _keep(report: Path, explain: explain_json.Answer) -> None:
    """Leave an answer where the tool's earlier ones are."""
    report.mkdir(parents=True, exist_ok=True)
    (report / tool.KEPT).write_text(json.dumps({"explain": explain.as_json(), "cpu": 1.0}), encoding="utf-8")


def test_a_tool_that_is_always_right_scores_one():
    found = score.of_set(
        [
            _result(["aero_drag"], "named", ["aero_drag"], after=0.2),
            _result([], "no_mismatch", kind="nothing"),
            _result(["trailer"], "unknown", kind="outside"),
        ]
    )
    for name in ("top1", "top2", "answer_set_coverage", "unknown_recall", "recovery_median"):
        assert found[name]["value"] == 1.0, name
    assert found["wrong_among_answers"]["value"] == found["false_alarms"]["value"] == 0.0
    assert found["parameter_error_median"]["value"] == pytest.approx(0.1)


def test_a_wrong_name_counts_as_wrong_wherever_it_is_said():
    found = score.of_set(
        [
            _result(["aero_drag"], "named", ["road_grade", "aero_drag"]),
            _result([], "named", ["road_grade"], kind="nothing"),
            _result(["trailer"], "named", ["road_grade"], kind="outside"),
            _result(["gyro_bias"], "named", ["gyro_bias"]),
        ]
    )
    assert found["wrong_among_answers"]["value"] == 0.75
    assert found["false_alarms"]["value"] == 1.0
    assert found["top1"]["value"] == 0.5
    assert found["top2"]["value"] == 1.0
    assert found["unknown_recall"]["value"] == 0.0


def test_silence_on_what_even_the_true_effect_cannot_show_costs_nothing():
    found = score.of_set([_result(["camber_thrust"], "no_mismatch", gain=0.01), _result(["gyro_bias"], "no_mismatch")])
    assert found["top1"]["n"] == 1
    assert found["detectable"]["value"] == 0.5


def _told(report: Path, gain: float, *effects: str, unseen: float | None = None) -> None:
    unseen = gain if unseen is None else unseen
    _keep(report, finding("named", effects=[effect(id, gain, gain_held_out=unseen) for id in effects], fit={}))


@pytest.mark.parametrize(
    ("alone", "alone_unseen", "detectable"),
    [(0.5, 0.6, True), (0.59, 0.6, False), (0.5, 0.69, False)],
    ids=["adds to both", "adds nothing in training", "adds nothing where it was not fitted"],
)
def test_two_effects_can_be_detected_where_each_adds_to_the_other(tmp_path, alone, alone_unseen, detectable):
    _told(tmp_path, 0.6, "aero_drag", "gyro_bias", unseen=0.7)
    _told(tmp_path / "without_aero_drag", 0.1, "gyro_bias")
    _told(tmp_path / "without_gyro_bias", alone, "aero_drag", unseen=alone_unseen)
    best = oracle.best(tmp_path, ["aero_drag", "gyro_bias"])
    assert best.detectable == detectable
    assert (best.detects("aero_drag"), best.detects("gyro_bias")) == (True, detectable)


@pytest.mark.parametrize(("left", "detectable"), [(1.0, True), (1.45, True), (1.49, False), (1.6, False)])
def test_what_is_outside_the_library_can_be_detected_where_the_same_drive_without_it_fits_better(
    tmp_path, left, detectable
):
    _keep(tmp_path, finding("no_mismatch", misfit=left))
    found = oracle.best_without(Answer(finding("unknown", misfit=1.5), 1.0), tmp_path)
    assert found.detectable == detectable
    assert oracle.best_without(Answer(finding("not_assessable"), 1.0), tmp_path) is None
    assert oracle.best_without(Answer(None, 1.0), tmp_path) is None


def test_naming_one_of_two_that_cannot_be_told_apart_is_not_wrong_but_does_not_cover_them():
    twins = ("imu_roll_misalignment", "accelerometer_bias")
    found = score.of_set(
        [
            _result(["accelerometer_bias"], "named", twins[:1], kind="inseparable", acceptable=twins),
            _result(["accelerometer_bias"], "ambiguous", twins, kind="inseparable", acceptable=twins),
        ]
    )
    assert found["wrong_among_answers"]["value"] == 0.0
    assert found["inseparable_covered"]["value"] == 0.5


def test_naming_both_of_two_that_cannot_be_told_apart_is_wrong_where_one_is_hidden():
    twins = ("aero_drag", "rolling_resistance")
    result = _result(["aero_drag"], "named", twins, kind="inseparable", acceptable=twins, several=True)
    found = score.of_set([result])
    assert found["wrong_among_answers"]["value"] == 1.0
    assert found["inseparable_covered"]["value"] == 0.0


def test_a_choice_without_the_truth_is_wrong():
    found = score.of_set(
        [
            _result(["aero_drag"], "ambiguous", ["road_grade", "brake_drag"]),
            _result(["aero_drag"], "ambiguous", ["road_grade", "aero_drag"]),
        ]
    )
    assert found["wrong_among_answers"]["value"] == 0.5
    assert found["answer_set_coverage"]["value"] == 0.5
    assert found["answer_set_size"]["value"] == 2.0


def test_both_of_a_double_must_be_accepted():
    pair = ["gyro_bias", "aero_drag"]
    one, both = (_result(pair, "named", pair, kind="double", several=several) for several in (False, True))
    assert score.of_set([one, both])["doubles_both"]["value"] == 0.5


def test_of_several_defects_names_are_counted_one_by_one_and_only_those_that_could_be_known():
    """Two of three could: one of these is named, with a name that is wrong beside it."""
    answer = _result(
        ["gyro_bias", "aero_drag", "camber_thrust"], "named", ["gyro_bias", "brake_drag"], kind="several", several=True
    )
    adds = {"gyro_bias": 0.2, "aero_drag": 0.05, "camber_thrust": 0.01}
    found = score.of_several(
        [replace(answer, best=replace(answer.best, adds=adds)), _result([], "no_mismatch", kind="several")]
    )
    assert found["precision_of_names"] == score.share([True, False])
    assert found["recall_of_detectable"] == score.share([True, False])
    assert found["detectable"] == score.share([True, True, False])
    assert found["false_names_with_nothing_hidden"] == score.share([False])
    assert found["size_error_median"] == {"value": pytest.approx(0.1), "n": 1}
    assert found["explained_share_median"] == {"value": pytest.approx(0.75), "n": 1}


def test_the_observer_counts_where_something_is_named_and_it_was_run(tmp_path):
    """Better in one of four; likelier in two, of which one is by other noise levels alone; in one it does not start."""

    def answer(observed: Observed | None, *names: str) -> Result:
        result = _result(["gyro_bias"], "named" if names else "unknown", names, kind="several", several=True)
        return replace(result, observed=observed)

    def figures(log_likelihood: float) -> ObserverFigures:
        return ObserverFigures(log_likelihood=log_likelihood, sensors={}, errors={}, reference=None)

    def kept(name: str, improved: bool, rises: float, fault: str = "") -> Observed | None:
        compared = ObserverComparison(
            recordings=("way home",), held_out=True, messages=9, improved=improved, sentence="It was watched.",
            as_it_was=figures(1.0), retuned=figures(1.0), extended=figures(1.0 + rises),
        )  # fmt: skip
        (tmp_path / name).mkdir()
        content = {"observer": None if fault else compared.as_json(), "fault": fault}
        (tmp_path / name / observing.OBSERVED).write_text(json.dumps(content), encoding="utf-8")
        return observing.observed(tmp_path / name)

    found = score.of_several(
        [
            answer(kept("better", True, 0.2), "gyro_bias"),
            answer(kept("by noise", False, 0.1), "gyro_bias"),
            answer(kept("worse", False, -0.1), "gyro_bias"),
            answer(kept("silent", False, 0.0, "no steering angle"), "gyro_bias"),
            answer(observing.observed(tmp_path / "not run"), "gyro_bias"),
            answer(kept("nothing named", True, 0.1)),
        ]
    )
    assert found["observer_better"] == score.share([True, False, False, False])
    assert found["observer_likelier"] == score.share([True, True, False, False])


def test_a_confidence_is_reliable_where_as_many_are_there_as_it_says(tmp_path):
    def stated(confidence: float, hidden: bool) -> Result:
        result = _result(["gyro_bias" if hidden else "aero_drag"], "named", ["gyro_bias"])
        entry = effect("gyro_bias", 0.5, confidence=confidence, accepted=True)
        return replace(result, answer=Answer(finding("named", effects=[entry]), 1.0))

    results = [*(stated(0.7, i < 7) for i in range(10)), *(stated(0.1, i < 1) for i in range(10))]
    bins = score.reliability(results)
    assert score.brier(results) == pytest.approx((0.7 * 0.3 + 0.1 * 0.9) / 2)  # a variance where it is reliable
    assert [(each["stated"], each["right"]["value"], each["right"]["n"]) for each in bins] == [
        (pytest.approx(0.1), 0.1, 10), (pytest.approx(0.7), 0.7, 10),
    ]  # fmt: skip
    assert "confidence that is stated" in picture.reliability(bins, tmp_path / "drawn.svg").read_text(encoding="utf-8")


def test_cases_with_several_defects_are_scored_by_themselves():
    one, many = (_result(["gyro_bias"], "named", ["gyro_bias"], kind=kind) for kind in ("effect", "several"))
    found = score.all_sets([one, many])
    assert found["rich"]["top1"]["n"] == found["several"]["named"]["n"] == 1


def test_intervals_hold_where_the_hidden_size_lies_in_them():
    result = _result(["brake_drag"], "named", ["brake_drag"])
    result.label["hidden"][0]["parameters"] = {"rl": 60.0}

    def stated(*interval: float) -> Result:
        torque = {"name": "torque", "unit": "N m", "value": 50.0, "interval_90": interval}
        explain = finding("named", effects=[effect("brake_drag", 0.5, wheel="rl", parameters=[torque])])
        return replace(result, answer=Answer(explain, 1.0))

    assert score.intervals_hold(stated(41.0, 59.0)) == [False]
    assert score.intervals_hold(stated(40.0, 61.0)) == [True]
    assert score.relative_errors([stated(40.0, 61.0)]) == pytest.approx([0.2])


def test_recovery_is_what_was_gained_of_what_could_be_gained():
    assert score.recovery(_result(["aero_drag"], "named", ["aero_drag"], after=0.6)) == pytest.approx(0.5)


@pytest.mark.parametrize(("hits", "n"), [(0, 12), (3, 20), (59, 60), (60, 60)])
def test_the_interval_is_that_of_scipy(hits, n):
    interval = binomtest(hits, n).proportion_ci(0.95, "wilson")
    assert score.wilson(hits, n) == pytest.approx((interval.low, interval.high), abs=2e-5)


def test_shuffled_labels_keep_the_answers_and_the_labels_of_each_set():
    results = [_result([name], "named", [name]) for name in list(EFFECTS)[:12]]
    mixed = score.shuffled(results)
    assert [r.answer for r in mixed] == [r.answer for r in results]
    assert sorted(next(iter(r.truth)) for r in mixed) == sorted(next(iter(r.truth)) for r in results)
    assert score.of_set(mixed)["top1"]["value"] < 0.5


def test_the_tool_cannot_read_the_labels(tmp_path):
    if not tool.can_conceal():
        pytest.skip("no user namespaces on this machine")
    labels = tmp_path / "labels"
    labels.mkdir()
    (labels / "labels.json").write_text("secret", encoding="utf-8")
    reading = [sys.executable, "-c", f"print(open({str(labels / 'labels.json')!r}).read())"]
    assert subprocess.run(reading, capture_output=True, text=True, check=True).stdout.strip() == "secret"
    concealed = subprocess.run(tool.concealed(reading, labels), capture_output=True, text=True)
    assert concealed.returncode != 0
    assert "secret" not in concealed.stdout
    assert (labels / "labels.json").read_text(encoding="utf-8") == "secret"


def test_the_seals_are_those_of_the_labels():
    known = dict(line.split()[::-1] for line in SEALS.read_text(encoding="utf-8").splitlines())
    assert known == {split: cases.seal(cases.labels_text(cases.all_cases(split))) for split in cases.SEEDS}


def test_no_release_has_the_cases_of_an_earlier_one():
    """They would have been looked at."""
    assert cases.SEEDS["release"] not in cases.SPENT
    assert len(set(cases.SPENT)) == len(cases.SPENT)
    files = (Path(__file__).parents[2] / "docs/benchmarks").glob("examination*.json")
    scored = [seed for file in files if (seed := json.loads(file.read_text(encoding="utf-8")).get("seed"))]
    assert set(scored) <= {*cases.SPENT, cases.SEEDS["release"]}
    assert len(set(scored)) == len(scored) >= 2


def test_the_page_of_benchmarks_has_the_scores_that_are_kept(monkeypatch):
    root = Path(__file__).parents[2]
    monkeypatch.syspath_prepend(str(root / "tools"))  # where a script finds its neighbours
    tool = runpy.run_path(str(root / "tools/benchmarks.py"))
    page = (root / "BENCHMARKS.md").read_text(encoding="utf-8")
    assert tool["with_examination"](page, tool["all_scores"](root / "docs/benchmarks")) == page
    with pytest.raises(ValueError, match="no section"):
        tool["with_examination"]("# Benchmarks\n", {})


@pytest.mark.parametrize("split", cases.SEEDS)
def test_a_split_has_what_the_examination_asks_for(split):
    every = cases.all_cases(split)
    for manoeuvres in ("rich", "everyday", "cruise"):
        single = [c.hidden for c in every if c.kind == "effect" and c.manoeuvres == manoeuvres]
        assert sorted({h[0][0] for h in single}) == sorted(EFFECTS)
        assert len({h[0] for h in single}) == 3 * len(EFFECTS)
    count = {kind: sum(c.kind == kind for c in every) for kind in ("nothing", "double", "outside", "inseparable")}
    assert count["nothing"] >= 60
    assert count["double"] >= 30
    assert count["outside"] >= 20
    assert count["inseparable"] > 0
    assert len({c.plant for c in every}) >= 2
    assert len({c.tyre for c in every}) >= 4
    assert len({(c.hidden, c.seed) for c in every}) == len(every)


@pytest.mark.parametrize("split", cases.SEEDS)
def test_several_defects_are_those_that_real_recordings_have(split):
    several = [c for c in cases.all_cases(split) if c.kind == "several"]
    hidden = [{name for name, _ in c.hidden} for c in several if c.hidden]
    assert len(hidden) >= 100
    assert {len(names) for names in hidden} == {3, 4, 5, 6}
    assert all(len(names & set(cases.DEFECTS_OF_SENSORS)) >= 2 for names in hidden)
    assert not any(len(names & group) > 1 for names in hidden for group in cases.APART)
    assert {round(1 / c.recorder.gnss_period) for c in several} == {1, 2, 5, 10, 25}
    assert len({c.recorder.coarse for c in several}) >= 3
    of_sensors = [len(names & set(cases.DEFECTS_OF_SENSORS)) / len(names) for names in hidden]
    assert 0.4 < np.mean(of_sensors) < 0.9


def test_the_splits_share_no_case():
    seeds = [{c.seed for c in cases.all_cases(split)} for split in cases.SEEDS]
    assert not set.intersection(*seeds)


def test_trust_finds_again_how_often_clear_and_narrow_leads_are_right():
    rng = np.random.default_rng(4)
    leads = np.exp(rng.normal(0.3, 0.7, 4000))
    right = rng.random(4000) < 0.9 / (1 + leads**-3.0)
    assert score.trust(leads, right) == (pytest.approx(0.9, abs=0.03), pytest.approx(3.0, rel=0.15))


def test_what_calibration_finds_is_written_with_the_number_of_names_it_came_from(tmp_path):
    file = tmp_path / "thresholds.yaml"
    shutil.copy(thresholds.FILE, file)
    stated = np.arange(200) < 100
    right = np.where(stated, np.arange(200) % 10 > 0, np.arange(200) % 20 == 0)  # nine in ten, and one in twenty
    found = score.calibrated(np.full(200, 50.0), right, stated, "public")
    thresholds.write(found, file)
    written = thresholds.read(file)
    assert (written.clear_name, written.refused) == (pytest.approx(0.9, abs=0.02), 0.05)
    assert replace(written, clear_name=0.0, by_lead=0.0, refused=0.0) == replace(
        thresholds.THRESHOLDS, clear_name=0.0, by_lead=0.0, refused=0.0
    )
    assert "public split, 100 names of which 90 are right, by `python -m blind calibrate`" in file.read_text()


def test_effects_have_the_ids_that_the_tool_answers_with():
    assert len(EFFECTS) == 35
    assert not set(EFFECTS) & set(OUTSIDE)


def test_an_answer_that_is_there_is_not_asked_for_again(tmp_path):
    report = tmp_path / "report"
    report.mkdir()
    stored = {"explain": finding("named").as_json(), "cpu": 3.0, "fault": ""}
    (report / "answer.json").write_text(json.dumps(stored), encoding="utf-8")
    assert tool.explain(Path("none"), report, hidden=tmp_path) == Answer(finding("named"), 3.0)
    (report / "answer.json").write_text(json.dumps(stored | {"explain": {"verdict": "named"}}), encoding="utf-8")
    with pytest.raises(InputError, match=r"answer\.json: of an earlier version"):
        tool.earlier(report)


def test_a_tool_that_fails_is_reported_with_what_it_printed(tmp_path):
    report = tmp_path / "report"
    report.mkdir()
    answer = tool._run([sys.executable, "-c", "raise SystemExit('no such option')"], report)
    assert answer.explain is None
    assert "no such option" in answer.fault


STUB = """
import json, pathlib, sys
words = sys.argv[1:]
report = pathlib.Path(words[words.index("--report") + 1])
name = words[words.index("--assume") + 1] if "--assume" in words else "gyro_bias"
said = json.loads(pathlib.Path(words[words.index("--template") + 1]).read_text())
said["effects"][0]["id"] = name
said["answer_set"] = [name]
(report / "explain.json").write_text(json.dumps(said))
"""


def test_the_runner_goes_from_cases_to_figures(tmp_path, monkeypatch):
    if not tool.can_conceal():
        pytest.skip("no user namespaces on this machine")
    out = tmp_path / "public"
    (out / "labels").mkdir(parents=True)
    every = cases.all_cases("public")
    (out / "labels" / "labels.json").write_text(cases.labels_text(every), encoding="utf-8")
    template = tmp_path / "template.json"
    named = effect("gyro_bias", 0.4, accepted=True, parameters=[])
    template.write_text(finding("named", effects=[named], fit={"yaw_rate": _yaw_rate(2.0, 1.0)}).written())
    line = [sys.executable, "-c", STUB, "--template", str(template)]
    monkeypatch.setattr(tool, "command", lambda case, report, *o: [*line, "--report", str(report), *o])
    words = ["--out", str(tmp_path), "--cases", "8", "--processes", "1"]
    run = CliRunner().invoke(main, [*words, "run"], catch_exceptions=False)
    assert run.exit_code == 0, run.output
    scored = CliRunner().invoke(main, [*words, "score", "--json", str(tmp_path / "blind.json")], catch_exceptions=False)
    assert scored.exit_code == 0, scored.output
    figures = json.loads((tmp_path / "blind.json").read_text(encoding="utf-8"))
    single = [c for c in every[:8] if c.kind == "effect" and c.manoeuvres == "rich"]
    right = sum(c.hidden[0][0] == "gyro_bias" for c in single)
    assert figures["rich"]["top1"]["n"] == len(single)
    assert figures["rich"]["top1"]["value"] == pytest.approx(right / len(single))
    assert "shuffled_labels" in figures["ablations"]


def test_changed_labels_are_not_scored(tmp_path):
    labels = tmp_path / "public" / "labels"
    labels.mkdir(parents=True)
    (labels / "labels.json").write_text("{}", encoding="utf-8")
    result = CliRunner().invoke(main, ["--out", str(tmp_path), "score"])
    assert result.exit_code == 1
    assert "missing or changed" in result.output


@pytest.mark.parametrize(("option", "there"), [("--kind", "nothing"), ("--set", "everyday")])
def test_a_kind_or_set_that_is_not_there_is_told_with_those_that_are(option, there, tmp_path):
    result = CliRunner().invoke(main, ["--out", str(tmp_path), option, "nonsense", "make"])
    assert result.exit_code == 2
    assert option in result.output
    assert there in result.output
    assert not list(tmp_path.iterdir())


@pytest.mark.exam
def test_untold_cases_have_the_recordings_and_labels_of_those_they_come_from(tmp_path):
    source, quiet = tmp_path / "stated" / "public", tmp_path / "quiet" / "public"
    every = cases.all_cases("public")
    case = source / "cases" / every[0].number
    for name in ("train", "held_out"):
        (case / name / "drive").mkdir(parents=True)
    (case / "case.json").write_text("{}", encoding="utf-8")
    (case / "vehicle.yaml").write_text(
        "sensors: {imu: {kind: imu}, torques: {kind: wheel_torques}}\n", encoding="utf-8"
    )
    (source / "labels" / "oracle").mkdir(parents=True)
    (source / "labels" / "labels.json").write_text(cases.labels_text(every), encoding="utf-8")
    words = ["--out", str(tmp_path / "stated"), "untold", "wheel_torques", "--to", str(tmp_path / "quiet")]
    result = CliRunner().invoke(main, words, catch_exceptions=False)
    assert "1 cases without wheel_torques" in result.output
    view = quiet / "cases" / every[0].number
    assert (view / "train" / "drive").is_dir()
    assert "wheel_torques" not in (view / "vehicle.yaml").read_text(encoding="utf-8")
    assert (quiet / "labels" / "labels.json").exists()
    assert not (quiet / "labels" / "oracle").exists()
    assert CliRunner().invoke(main, [*words[:-4], "untold", "sonar", "--to", str(tmp_path)]).exit_code == 1
