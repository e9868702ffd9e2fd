"""Compare: any two runs over one another: curves, differences, scores."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from nicegui import ui

from vsense_ros.studio import kit
from vsense_ros.studio.curves import CurveSet
from vsense_ros.studio.jobs import Job
from vsense_ros.studio.stages.estimate import REFERENCE, SINGLE
from vsense_ros.studio.stages.stage import Stage
from vsense_ros.studio.workbench import Workbench

COLOURS = ("#0b63b6", "#b4540a")
_SAME_IN_BOTH = ("trivial",)  # scores that do not depend on the run


def name_of(job: Job) -> str:
    """What tells a run from others: recording, vehicle file, filter, sensors that were switched off."""
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
            paths = [{"set": f"{job.key}/curves", "x": "east", "y": "north", "label": label, "color": colour}
                     for job, label, colour in zip((first, second), "AB", COLOURS, strict=True)]  # fmt: skip
            kit.View("Path", {"paths": paths, "height": 300, "label": "Both paths"})
    _scores(first.result, second.result)


def _choose(bench: Workbench, name: str, key: str) -> None:
    bench.page[f"run {name}"] = key
    bench.refresh()


def _board(first: Job, second: Job, a: CurveSet, b: CurveSet) -> None:
    far = "distance" in a.signals and "distance" in b.signals
    axis = ui.toggle({"time": "time", "distance": "distance"}, value="time").props("dense no-caps unelevated size=sm")
    axis.set_enabled(far)
    view = kit.View("Board", board(first, second, a, b, "time"))
    axis.on_value_change(lambda event: view.show(board(first, second, a, b, event.value)))


def board(first: Job, second: Job, a: CurveSet, b: CurveSet, axis: str) -> dict[str, Any]:
    """Plots of the signals that both runs have."""
    forces = [name for name in a.signals if name.startswith("wheel_force") and ":" not in name and name.endswith("_y")]
    plots = []
    for name in (*SINGLE, *forces):
        if name not in a.signals or name not in b.signals:
            continue
        about = a.signals[name]
        traces: list[dict[str, Any]] = [
            {"set": f"{job.key}/curves", "name": name, "label": label, "color": colour}
            for job, label, colour in zip((first, second), "AB", COLOURS, strict=True)
        ]
        if f"{name}:reference" in a.signals:
            traces.append({"set": f"{first.key}/curves", "name": f"{name}:reference", "label": "reference",
                           "color": REFERENCE, "dash": True})  # fmt: skip
        plots.append({"title": about["label"].capitalize(), "unit": about["unit"], "traces": traces, "height": 118})
    end = max(float(one.value("distance")[-1]) if axis == "distance" else one.duration for one in (a, b))
    label = "distance [m]" if axis == "distance" else "time [s]"
    return {"axis": axis, "xlabel": label, "end": end, "plots": plots, "marks": []}


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
