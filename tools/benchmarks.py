"""Render BENCHMARKS.md from pytest-benchmark's JSON: `python tools/benchmarks.py out/bench.json BENCHMARKS.md`.

The figures that goals are set for are added to the JSON. Without it, `python tools/benchmarks.py BENCHMARKS.md`, the
scores of the examination alone are written anew.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from textwrap import fill
from typing import Any

import matplotlib
import numpy as np
from bench_against import duration
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.stats import binomtest

from vsense_ros.evaluate.picture import ESTIMATE, MUTED, STYLE


@dataclass(frozen=True)
class Step:
    """A row of the table of steps."""

    benchmark: str  # name of its test
    words: str
    target: float | None = None  # [s] at most
    thesis: str = ""


STEPS = (
    Step("test_forward_dynamics", "forward dynamics, 14 coordinates, with tyres and tables", 4e-6),
    Step("test_rigid_bodies[pinocchio_aba]", "Pinocchio `aba`: the same bodies, forces given"),
    Step("test_rigid_bodies[mujoco_step]", "MuJoCo `mj_step`: the same bodies, forces given"),
    Step("test_error_ekf", "errorEKF: 52 states, IMU and wheel speeds", 30e-6, "3.1 ms"),
    Step("test_step[compiled-suspension tables]", "the same, messages read and checked, kept for late ones"),
    Step("test_exported[-std=c99 -O3]", "errorEKF exported, `-std=c99 -O3`"),
    Step("test_exported[-std=gnu99 -O3 -march=native]", "errorEKF exported, `-std=gnu99 -O3 -march=native`"),
    Step("test_spi", "SPI: the same step, two parameters, EKF"),
    Step("test_spi_step[suspension tables-ukf]", "SPI with messages, two parameters, UKF", 90e-6, "8.4 ms"),
    Step("test_spi_step[suspension tables-ekf]", "SPI with messages, two parameters, EKF", 60e-6),
    Step("test_general_filter[filterpy_ekf]", "filterpy EKF: 42 states, 10 measurements, linear model for nothing"),
    Step("test_general_filter[filterpy_ukf]", "filterpy UKF: the same states and measurements"),
    Step("test_full_car", "full car, 29 bodies, without observer", 1e-3),
    Step("test_full_car_observer[none]", "errorEKF on the full car, in steps of 1 ms", 4e-3, "32.7 ms"),
    Step("test_full_car_observer[ukf]", "SPI on the full car, in steps of 1 ms, two parameters, UKF", 4e-3),
    Step("test_full_car_observer[ekf]", "SPI on the full car, in steps of 1 ms, two parameters, EKF", 4e-3),
)
STEPS_HEAD = """## Steps

What must be done within a time step of 4 ms, one thread, compiled. The thesis (Rodríguez 2020) ran on the 667 MHz ARM
Cortex-A9 of a Zynq-7000: elapsed time over 2500 steps of its tables at a tolerance of 1e-5, without the FPGA. That
processor is another; its times are here for context. *Ratio* is the median over that of filterpy's EKF, which was
measured in the same run: machines differ, and are noisy.

| | median | smallest | ratio | at most | thesis |
|---|---|---|---|---|---|"""
AGAINST_HEAD = """## Against {revision}

Times of this version over those of {revision}, measured in turn (`make bench-against REVISION={revision}`).

| part | ratio |
|---|---|"""
YARDSTICK = "test_general_filter[filterpy_ekf]"

# examination.json of the last release, examination.release_<number>.json of earlier ones.
EXAMINATIONS = Path("docs/benchmarks")
EXAMINATION_HEAD = """## Examination of `vsense explain`

The release split: cars that are not our model, with one effect hidden, two, none, or something outside the library, and
wrong mass, tyres and centre of gravity ([how it works](test/blind/README.md)). Shares with Wilson intervals of 95 % and
the number of cases they are of. Made by `python -m blind --split release` (`make`, `run`, and `score --json` into
`docs/benchmarks`), {which}. {note}
"""
EARLIER_HEAD = """Earlier releases, each with other seeds, answered by earlier versions: the rich manoeuvres, with the
number of cases; all sets and intervals are in `docs/benchmarks`. Some cases of the first were answered once more. The
plants of the first three let the axle of a leaning wheel carry a part of the aligning moment, which no bearing can:
with nothing hidden a longitudinal force that grows with cornering was left over. That on MuJoCo, of the first four,
rolled too far where it braked in a bend. The second release is mostly doubles and physics outside the library. The last
row counts the last {pooled} releases together, each answered by the version of its time.
"""
EARLIER_SCORES = {
    "top1": "named first",
    "wrong_among_answers": "wrong names",
    "false_alarms": "false alarms",
    "answer_set_coverage": "truth in the set",
    "answer_set_size": "size of the set",
    "unknown_recall": "`unknown`",
    "unknown_of_detectable": "`unknown`, of what can be detected",
    "recovery_p10": "recovery, tenth percentile",
    "parameter_error_median": "error of the parameter",
    "doubles_both": "both of two",
    "cpu_seconds_per_100_s": "computing per 100 s [s]",
}
SEVERAL_HEAD = """Cars with three to six of these at once, or with none, on rich and everyday manoeuvres
(`--kind several`):
"""
SEVERAL_SCORES = {
    "precision_of_names": ("names that are right", "≥ 0.95"),
    "recall_of_detectable": ("named, of what can be detected", "≥ 0.85"),
    "answers_with_a_wrong_name": ("answers with a wrong name", ""),
    "false_names_with_nothing_hidden": ("the same, with nothing hidden", "≤ 0.02"),
    "where_right": ("right wheel, axle, axis or sensor", ""),
    "size_error_median": ("error of the parameter, median", "≤ 0.05"),
    "explained_share_median": ("explained of what the hidden effects explain, held out, median", "≥ 0.92"),
    "cpu_seconds_per_100_s": ("seconds of computing per 100 s", "≤ 15"),
}
POOLED = 4  # releases that the last row counts together
SCORES = {
    "top1": ("named first, of what can be detected", "≥ 0.90"),
    "top2": ("among the first two", "≥ 0.97"),
    "wrong_among_answers": ("wrong names among answers", "≤ 0.04"),
    "false_alarms": ("false alarms with nothing hidden", "≤ 0.03"),
    "answer_set_coverage": ("truth in the answer set", "≥ 0.95"),
    "answer_set_size": ("mean size of the answer set", "≤ 1.6"),
    "inseparable_covered": ("effects that leave the same traces all in the set", ""),
    "unknown_recall": ("`unknown` where it is outside the library", "≥ 0.8"),
    "unknown_of_detectable": ("the same, of what can be detected", ""),
    "recovery_median": ("recovery, median", "≥ 0.95"),
    "recovery_p10": ("recovery, tenth percentile", "≥ 0.6"),
    "parameter_error_median": ("error of the parameter, median", "≤ 0.07"),
    "intervals_hold": ("hidden size in the 90 % interval", ""),
    "where_right": ("right wheel, axle, axis or sensor", ""),
    "doubles_both": ("both of two named", "≥ 0.75"),
    "detectable": ("share that can be detected", ""),
    "cpu_seconds_per_100_s": ("seconds of computing per 100 s", "≤ 60"),
}
ABLATIONS_HEAD = """Rich manoeuvres with a part of the method left out (`run --ablation`, on some of the cases), and the
answers held against the labels of other cases:
"""
ABLATIONS = {
    "no_refit": "without the refit",
    "no_projection": "without the projection",
    "chi2_thresholds": "χ² thresholds",
    "shuffled_labels": "labels shuffled",
}

PICTURE = Path("docs/benchmarks/bodies.png")
HEAD = """# Benchmarks

Made by `make bench`; times are those of the machine they were made on, one thread. Median and smallest of all rounds:
where the two are far apart, the machine was busy with something else.

"""


def summary(results: dict[str, Any]) -> dict[str, Any]:
    """The figures that goals are set for: `ratios` of medians to filterpy's EKF of the same run, `run_realtime` of
    whole recordings, and `node`, from a stamp to the odometry; what was not measured is not among them."""
    found = {b["name"]: b for b in results["benchmarks"]}
    steps = {
        "error_ekf": "test_error_ekf",
        "error_ekf_messages": "test_step[compiled-suspension tables]",
        "spi_ekf": "test_spi",
        "spi_ukf": "test_spi_step[suspension tables-ukf]",
    }
    ratios = {}
    if YARDSTICK in found:
        median = found[YARDSTICK]["stats"]["median"]
        ratios = {key: found[name]["stats"]["median"] / median for key, name in steps.items() if name in found}
    told = {name: b["extra_info"] for name, b in found.items()}
    return {
        "ratios": {key: round(ratio, 3) for key, ratio in ratios.items()},
        "run_realtime": {
            name.partition("[")[2].rstrip("]"): round(info["realtime_factor"], 1)
            for name, info in told.items()
            if "realtime_factor" in info
        },
        "node": next((info for info in told.values() if "p99_ms" in info), {}),
    }


def extra(info: dict[str, Any]) -> str:
    """What a benchmark told beside its time, in words."""
    words = {
        "us_per_message": "{:.2f} µs per message",
        "realtime_factor": "{:.0f} × real time",
        "messages": "{:,} messages",
    }
    told = [text.format(info[key]) for key, text in words.items() if info.get(key, 1) != 1]
    rest = ((key, value) for key, value in info.items() if key not in words and isinstance(value, int | float))
    return ", ".join(told + [f"{key.replace('_', ' ')} {value:.3g}" for key, value in rest])


def machine(found: dict[str, Any]) -> str:
    cpu = found["cpu"]
    name = cpu.get("brand_raw", cpu.get("arch", "unknown processor"))
    return f"{name}, {cpu.get('count', '?')} cores, {found['system']}, Python {found['python_version']}"


def label(benchmark: dict[str, Any]) -> str:
    """`test_part[compiled-linearize]` as `part: compiled, linearize`."""
    name, _, parameters = benchmark["name"].removeprefix("test_").partition("[")
    name = name.replace("_", " ")
    return f"{name}: {parameters.rstrip(']').replace('-', ', ')}" if parameters else name


def steps(benchmarks: list[dict[str, Any]]) -> list[str]:
    """The table of steps; rows whose benchmark did not run are left out."""
    found = {b["name"]: b["stats"] for b in benchmarks}
    rows = []
    for step in STEPS:
        if (stats := found.get(step.benchmark)) is not None:
            target = duration(step.target) if step.target else ""
            times = f"{duration(stats['median'])} | {duration(stats['min'])}"
            yardstick = found.get(YARDSTICK)
            ratio = f"{stats['median'] / yardstick['median']:.2g}" if yardstick else ""
            rows.append(f"| {step.words} | {times} | {ratio} | {target} | {step.thesis} |")
    return [STEPS_HEAD, *rows, ""] if rows else []


def against(results: dict[str, Any]) -> list[str]:
    """The table of ratios to another revision that `make bench-against` has left in the JSON."""
    ratios = results.get("against", {})
    rows = [f"| {part} | {ratio:.2f} |" for part, ratio in ratios.items()]
    return [AGAINST_HEAD.format(revision=results["against_revision"]), *rows, ""] if rows else []


def bodies(benchmarks: list[dict[str, Any]]) -> dict[str, tuple[list[int], list[float]]]:
    """Numbers of bodies and smallest times [s] of the groups whose benchmarks tell how many bodies they have."""
    found: dict[str, tuple[list[int], list[float]]] = {}
    for b in sorted(benchmarks, key=lambda b: (b["group"] or "", b["extra_info"].get("bodies", 0))):
        if "bodies" in b["extra_info"]:
            counts, times = found.setdefault(b["group"], ([], []))
            counts.append(b["extra_info"]["bodies"])
            times.append(b["stats"]["min"])
    return found


def growth(benchmarks: list[dict[str, Any]], picture: Path) -> list[str]:
    """Draws the time of a step over the number of bodies, and says how far it is from a straight line."""
    groups = bodies(benchmarks)
    if not groups:
        return []
    lines = ["## Cost of more and more bodies", "", f"![Time over the number of bodies]({picture.as_posix()})", ""]
    with matplotlib.rc_context(dict(STYLE)):
        figure = Figure(figsize=(9, 3.2), layout="constrained")
        FigureCanvasAgg(figure)
        panels = figure.subplots(1, len(groups), squeeze=False)[0]
        for panel, (group, (counts, times)) in zip(panels, groups.items(), strict=True):
            slope, rest = np.polyfit(counts, times, 1, w=1 / np.array(times))
            line = slope * np.array(counts) + rest
            off = float(np.abs(np.array(times) / line - 1).max())
            title = f"{group[0].upper()}{group[1:]}"
            panel.plot(counts, 1e6 * line, color=MUTED, linewidth=0.9, label="straight line")
            panel.plot(counts, 1e6 * np.array(times), "o", color=ESTIMATE, label="measured")
            panel.set(title=title, xlabel="bodies", ylabel="µs", xlim=(0, None), ylim=(0, None))
            panel.legend(loc="upper left")
            lines.append(f"- {title}: {duration(slope)} a body, within {100 * off:.1f} % of a straight line.")
        picture.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(picture, dpi=90)
    return [*lines, ""]


def all_scores(folder: Path) -> dict[str, Any]:
    """Those of examination.json, and those of examination.<which>.json by `which` as `earlier`."""
    found: dict[str, Any] = {"earlier": {}}
    for path in sorted(folder.glob("examination*.json")):
        scores, (*which, _) = json.loads(path.read_text(encoding="utf-8")), path.suffixes
        if which:
            found["earlier"][which[0].removeprefix(".release_").replace("_", " ")] = scores
        else:
            found |= scores
    return found


def _sets(found: dict[str, Any]) -> dict[str, Any]:
    """Scores by set of manoeuvres, the rich one first."""
    sets = {name: scores for name, scores in found.items() if isinstance(scores, dict) and "top1" in scores}
    return dict(sorted(sets.items(), key=lambda each: each[0] != "rich"))


def _columns(sets: dict[str, Any], asked: bool = False) -> list[str]:
    """A table of scores: a column for each of the `sets` by its name, and one with what is `asked` of them."""
    heads = [*(["asked of rich"] if asked else []), *sets]
    rows = [f"| | {' | '.join(heads)} |", f"|---|{'---|' * len(heads)}"]
    for score, (words, least) in SCORES.items():
        cells = [*([least] if asked else []), *(_cell(scores.get(score, {})) for scores in sets.values())]
        rows.append(f"| {words} | {' | '.join(cells)} |")
    return rows


def examination(found: dict[str, Any]) -> list[str]:
    """The scores of `python -m blind score`: a column for each set of manoeuvres; of the rich one what is left of them
    without a part of the method and with the labels of other cases; and those of earlier releases."""
    sets = _sets(found)
    which = f"answered by {found['commit']}"
    if seed := found.get("seed"):
        which = f"with the seed {seed}, {which}"
    head, intro = EXAMINATION_HEAD.format(which=which, note=found.get("note", "")).split("\n\n")
    rows = [head, "", _filled(intro), ""]
    rows += _columns({name.replace("_", " "): scores for name, scores in sets.items()}, asked=True)
    parts = {ABLATIONS[name]: _sets(part)["rich"] for name, part in found["ablations"].items() if "rich" in _sets(part)}
    if parts:
        rows += ["", ABLATIONS_HEAD, *_columns({"whole": sets["rich"]} | parts)]
    if several := found.get("several"):
        rows += ["", _filled(SEVERAL_HEAD), "", "| | asked | |", "|---|---|---|"]
        table = SEVERAL_SCORES.items()
        rows += [f"| {words} | {least} | {_cell(several.get(score, {}))} |" for score, (words, least) in table]
    if earlier := found["earlier"]:
        rows += ["", _filled(EARLIER_HEAD.format(pooled=POOLED)), "", *_earlier(earlier, found)]
    return [*rows, ""]


def _earlier(earlier: dict[str, Any], last: dict[str, Any]) -> list[str]:
    """A row for the rich manoeuvres of each release, and one of the last of them together."""
    columns = [*EARLIER_SCORES.values()]
    rows = [f"| release | by | {' | '.join(columns)} |", f"|---|---|{'---|' * len(columns)}"]
    rich = {which: (scores["commit"], _sets(scores)["rich"]) for which, scores in earlier.items()}
    rich["above"] = (last["commit"], _sets(last)["rich"])
    for which, (commit, scores) in rich.items():
        cells = [_short(scores.get(score, {})) for score in EARLIER_SCORES]
        rows.append(f"| {which} | {commit} | {' | '.join(cells)} |")
    latest = [scores for _, scores in rich.values()][-POOLED:]
    cells = [_pooled([scores.get(score, {}) for scores in latest]) for score in EARLIER_SCORES]
    return [*rows, f"| last {len(latest)} | | {' | '.join(cells)} |"]


def _short(score: dict[str, Any]) -> str:
    """A share with the counts that it is of; the value alone of what is no share."""
    if not score.get("n"):
        return "–"
    counts = f" ({round(score['value'] * score['n'])}/{score['n']})" if "low" in score else ""
    return f"{score['value']:.3g}{counts}"


def _pooled(scores: list[dict[str, Any]]) -> str:
    """Shares of several releases counted together, with the Wilson interval of 95 %."""
    counted = [score for score in scores if score.get("n") and "low" in score]
    if not counted:
        return "–"
    hits, n = sum(round(score["value"] * score["n"]) for score in counted), sum(score["n"] for score in counted)
    interval = binomtest(hits, n).proportion_ci(0.95, "wilson")
    return f"{hits / n:.3g} ({interval.low:.2f} … {interval.high:.2f}), n = {n}"


def _filled(paragraph: str) -> str:
    return fill(paragraph, 120, break_on_hyphens=False, break_long_words=False)


def _cell(score: dict[str, Any]) -> str:
    if not score.get("n"):
        return "–"
    interval = f" ({score['low']:.2f} … {score['high']:.2f})" if "low" in score else ""
    return f"{score['value']:.3g}{interval}, n = {score['n']}"


def render(results: dict[str, Any], picture: Path, scores: dict[str, Any] | None = None) -> str:
    """The page for one run of pytest-benchmark; draws its `picture`, named as seen from the page. `scores` are those of
    the examination's release split."""
    lines = [HEAD + f"Machine: {machine(results['machine_info'])}.", ""]
    lines += steps(results["benchmarks"])
    lines += against(results)
    lines += growth(results["benchmarks"], picture)
    lines += examination(scores) if scores else []
    others = [b for b in results["benchmarks"] if b["name"] not in {step.benchmark for step in STEPS}]
    ordered = sorted(others, key=lambda b: b["group"] or "")
    for group, benchmarks in groupby(ordered, key=lambda b: b["group"] or "other"):
        lines += [f"## {group[0].upper()}{group[1:]}", "", "| | median | smallest | |", "|---|---|---|---|"]
        for b in benchmarks:
            stats = b["stats"]
            times = f"{duration(stats['median'])} | {duration(stats['min'])}"
            lines.append(f"| {label(b)} | {times} | {extra(b['extra_info'])} |")
        lines.append("")
    return "\n".join(lines)


def with_examination(page: str, scores: dict[str, Any]) -> str:
    """A page with the section of the examination written anew. Raises `ValueError` where it has none."""
    head = EXAMINATION_HEAD.partition("\n")[0]
    before, found, rest = page.partition(head)
    if not found:
        raise ValueError(f"no section {head!r} in the page")
    after = rest[rest.index("\n## ") + 1 :] if "\n## " in rest else ""
    return before + "\n".join([*examination(scores), after])


if __name__ == "__main__":
    *source, target = map(Path, sys.argv[1:3])
    scores = all_scores(EXAMINATIONS)
    if source:
        results = json.loads(source[0].read_text(encoding="utf-8"))
        page = render(results, PICTURE, scores)
        source[0].write_text(json.dumps(results | summary(results), indent=2) + "\n", encoding="utf-8")
    else:
        page = with_examination(target.read_text(encoding="utf-8"), scores)
    target.write_text(page, encoding="utf-8")
    print(f"wrote {target}")
