"""Compare: any two runs over one another: curves, differences, scores."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from nicegui import ui

from vsense_ros.studio import kit
from vsense_ros.studio.curves import CURVES, DISTANCE, CurveSet
from vsense_ros.studio.jobs import Job
from vsense_ros.studio.stages.estimate import REFERENCE, SINGLE
from vsense_ros.studio.stages.stage import Stage
from vsense_ros.studio.workbench import Workbench

Part = tuple[float | None, float | None]  # begin and end [s] of a lap; None and None for the whole drive

COLOURS = ("#0b63b6", "#b4540a")
WHOLE: Part = (None, None)
_SAME_IN_BOTH = ("trivial",)  # scores that do not depend on the run


def name_of(job: Job) -> str:
    """What distinguishes a run from others: recording, vehicle file, filter, sensors that were switched off."""
    options = job.task.get("options", {})
    parts = [
        Path(options["recording"]["path"]).name,
        Path(options["vehicle"]).stem,
        options["filter"] or "default filter",
    ]
    parts += [f"without {', '.join(options['without'])}"] if options["without"] else []
    parts += ["smoothed"] if options.get("smooth") else []
    return " · ".join(parts)


def build(bench: Workbench) -> None:
    """Draw the stage."""
    runs = {job.key: name_of(job) for job in bench.done("estimate")}
    if len(runs) < 2:
        kit.words("Two finished estimates are needed: run Estimate with another filter, file, recording or sensor set.")
        return
    keys = list(runs)
    with ui.element("div").classes("vs-row wrap"):
        pickers = []
        for name, start in (("A", keys[1]), ("B", keys[0])):
            value = bench.page.get(f"run {name}", start)
            picker = ui.select(runs, value=value if value in runs else start, label=f"Run {name}").props(
                "dense outlined"
            )
            picker.classes("vs-select wide")
            picker.on_value_change(lambda event, name=name: _choose(bench, name, event.value))
            pickers.append(picker)
    first, second = (bench.job(str(picker.value)) for picker in pickers)
    sets = [bench.curves(first), bench.curves(second)]
    if sets[0] is None or sets[1] is None:
        kit.words("The curves of one of the runs are no longer there; estimate it again.")
        return
    kit.sentences([f"A: {runs[first.key]}", f"B: {runs[second.key]}"])
    with ui.element("div").classes("vs-columns estimate"):
        with ui.element("div"), kit.panel("Curves", "A and B over one another, reference dashed"):
            _board(first, second, sets[0], sets[1])
        with ui.element("div"), kit.panel("Paths"):
            paths = [{"set": f"{job.key}/{CURVES}", "x": "east", "y": "north", "label": label, "color": colour}
                     for job, label, colour in zip((first, second), "AB", COLOURS, strict=True)]  # fmt: skip
            kit.View("Path", {"paths": paths, "height": 300, "label": "Both paths"})
    _scores(first.result, second.result)


def _choose(bench: Workbench, name: str, key: str) -> None:
    bench.page[f"run {name}"] = key
    bench.refresh()


def _board(first: Job, second: Job, a: CurveSet, b: CurveSet) -> None:
    far = "distance" in a.signals and "distance" in b.signals
    with ui.element("div").classes("vs-row wrap"):
        axis = ui.toggle({"time": "time", "distance": "distance"}, value="time")
        axis.props("dense no-caps unelevated size=sm").set_enabled(far)
        pickers = []
        for label, curves in zip("AB", (a, b), strict=True):
            count = max(len(curves.content.get("laps", [])) - 1, 0)
            laps = {0: "whole drive"} | {i: f"lap {i}" for i in range(1, count + 1)}
            picker = ui.select(laps, value=0, label=f"Part of {label}").props("dense outlined")
            picker.set_enabled(count > 1)
            pickers.append(picker)
        difference = ui.checkbox("difference B − A").props("dense")

    def spec() -> dict[str, Any]:
        parts = [_part(curves, int(picker.value)) for curves, picker in zip((a, b), pickers, strict=True)]
        return board(first, second, a, b, axis.value, parts, difference=difference.value)

    view = kit.View("Board", spec())
    for control in (axis, *pickers, difference):
        control.on_value_change(lambda: view.show(spec()))


def _part(curves: CurveSet, lap: int) -> Part:
    """Begin and end [s] of a lap; None twice for the whole drive, 0."""
    if not lap:
        return None, None
    begin, end = curves.content["laps"][lap - 1 : lap + 1]
    return float(begin), float(end)


def board(
    first: Job, second: Job, a: CurveSet, b: CurveSet, axis: str, parts: Sequence[Part] = (WHOLE, WHOLE), *,
    difference: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Plots of the signals that both runs have: of the whole drives or of one lap each, which then begin at the same
    place, or the difference of the two."""
    forces = [name for name in a.signals if name.startswith("wheel_force") and ":" not in name and name.endswith("_y")]
    whole = all(part == WHOLE for part in parts)
    plots = []
    for name in (*SINGLE, *forces):
        if name not in a.signals or name not in b.signals:
            continue
        about = a.signals[name]
        traces: list[dict[str, Any]] = [
            {"set": f"{job.key}/{CURVES}", "name": name, "label": label, "color": colour, "begin": begin, "end": end}
            for job, label, colour, (begin, end) in zip((first, second), "AB", COLOURS, parts, strict=True)
        ]
        if difference:
            traces = [{**traces[1], "label": "B − A", "minus": traces[0]}]
        elif whole and f"{name}:reference" in a.signals:
            traces.append({"set": f"{first.key}/{CURVES}", "name": f"{name}:reference", "label": "reference",
                           "color": REFERENCE, "dash": True})  # fmt: skip
        title = about["label"][:1].upper() + about["label"][1:] + (", difference" if difference else "")
        plots.append({"title": title, "unit": about["unit"], "traces": traces, "height": 118})
    end = max(_length(curves, part, axis) for curves, part in zip((a, b), parts, strict=True))
    label = "distance [m]" if axis == DISTANCE else "time [s]"
    return {"axis": axis, "xlabel": label, "end": end, "plots": plots, "marks": []}


def _length(curves: CurveSet, part: Part, axis: str) -> float:
    """Length of a part on the axis, [s] or [m]."""
    limits = np.array([part[0] or 0.0, curves.duration if part[1] is None else part[1]])
    return float(np.ptp(curves.to_distance(limits) if axis == DISTANCE else limits))


def _scores(a: dict[str, Any], b: dict[str, Any]) -> None:
    from vsense_ros.evaluate.wording import HEADINGS

    others = {one["name"]: one for one in b["scores"]}
    both = [(one, others[one["name"]]) for one in a["scores"] if one["name"] in others]
    if not both:
        return
    with kit.panel("Scores against the reference"):
        chosen = [i for i, heading in enumerate(HEADINGS) if heading not in _SAME_IN_BOTH]
        heads = ("signal", *(f"{HEADINGS[i]}, {run}" for i in chosen for run in "AB"))
        rows = [(one["label"], *(run["cells"][i] for i in chosen for run in (one, other))) for one, other in both]
        kit.table(heads, rows, "Scores of both runs")


STAGE = Stage(
    "compare", "Compare", "Two runs over one another: filters, vehicle files, sensors, recordings.", build,
    lambda bench: "ready" if len(bench.done("estimate")) > 1 else "locked",
)  # fmt: skip
