"""Estimate: a filter over a recording; curves with ±2σ and reference, forces, g–g diagram, laps, coverage."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from nicegui import ui

from vsense_ros.studio import actions, kit
from vsense_ros.studio.curves import CurveSet
from vsense_ros.studio.jobs import Job
from vsense_ros.studio.project import Drive
from vsense_ros.studio.stages.stage import Stage, state_of_job
from vsense_ros.studio.workbench import Workbench

ESTIMATE, REFERENCE, BAND = "#0b63b6", "#1b2430", "rgba(11,99,182,0.18)"
WHEELS = {"fl": "#0b63b6", "fr": "#b4540a", "rl": "#0a7a53", "rr": "#8a3ea8"}
LAPS = ("#0b63b6", "#b4540a", "#0a7a53", "#8a3ea8", "#a8123e", "#4c5a00", "#006b7d", "#6b4a2b")
SINGLE = (
    "side_slip",
    "yaw_rate",
    "speed",
    "lateral_velocity",
    "lateral_acceleration",
    "longitudinal_acceleration",
    "roll",
    "pitch",
)


def build(bench: Workbench) -> None:
    """Draw the stage."""
    missing = bench.missing(recordings=False) or ("" if bench.drives else "Open a recording first (stage Data).")
    if missing:
        kit.words(missing)
        return
    _settings(bench)
    if (job := bench.newest("estimate")) is not None:
        name = job.task.get("options", {}).get("filter") or "the filter of the vehicle"
        kit.follow(
            bench, job, f"Estimating with {name}", lambda job: show_estimate(bench, job), lambda: bench.refresh()
        )


def _settings(bench: Workbench) -> None:
    import vsense_ros as vs
    from vsense_ros.runner.catalogue import every_filter

    kept = bench.project.state.settings
    drives = {drive.path: drive.name for drive in bench.drives}
    car = vs.load_vehicle(bench.project.inside(bench.vehicle))
    filters = {"": "as the vehicle file says"} | {
        one.name: f"{one.name}: {one.title}" for one in every_filter().recommended
    }
    with kit.panel("Run"), ui.element("div").classes("vs-row wrap"):
        drive = (
            ui.select(drives, value=bench.drives[0].path, label="Recording")
            .props("dense outlined")
            .classes("vs-select")
        )
        chosen = (
            ui.select(filters, value=kept.get("filter", ""), label="Filter")
            .props("dense outlined")
            .classes("vs-select")
        )
        mend = ui.checkbox("mend signals", value=bool(kept.get("mend"))).props("dense")
        smooth = (
            ui.checkbox("smooth").props("dense").tooltip("Use the whole recording for each estimate (GNSS/INS filters)")
        )
        with ui.element("div").classes("vs-row wrap"):
            switches = {name: ui.checkbox(name, value=True).props("dense") for name in car.sensors}

        def start() -> None:
            one = next(each for each in bench.drives if each.path == drive.value)
            kept["filter"] = chosen.value
            without = [name for name, switch in switches.items() if not switch.value]
            options = {
                "recording": bench.source(one),
                "filter": chosen.value,
                "mend": mend.value,
                "without": without,
                "smooth": smooth.value,
            }
            job = bench.start("estimate", options, [one], vehicle=bench.vehicle)
            bench.project.remember("estimate", job.key)
            bench.refresh()

        run = (
            ui.button("Estimate", on_click=lambda: kit.attempt(start)).props("unelevated no-caps").classes("vs-primary")
        )
        run.props('aria-label="Estimate this recording"')


def show_estimate(bench: Workbench, job: Job) -> None:
    """Everything about one estimate."""
    result, options = job.result, job.task["options"]
    curves = bench.curves(job)
    if result["failure"]:
        with ui.element("div").classes("vs-failure").props("role=alert"):
            ui.label(result["failure"])
    if curves is None:
        return
    key = f"{job.key}/curves"
    covered = [one["within_2s"] for one in result["scores"] if one["within_2s"] is not None]
    kit.facts(
        [
            (" · ".join(result["facts"]), result["title"]),
            ("computing time", f"{result['seconds']:.1f} s"),
            ("signals with a reference", str(len(result["scores"]))),
            (
                "errors within ±2σ, median of the signals",
                f"{100 * float(np.median(covered)):.0f} %" if covered else "–",
            ),
        ]
    )
    with ui.element("div").classes("vs-columns estimate"):
        with ui.element("div"), kit.panel("Curves", "estimate, ±2σ as a band, reference dashed"):
            _board(bench, key, curves)
        with ui.element("div"):
            with kit.panel("Tyre forces from above", "at the cursor"):
                car = _outline(bench)
                kit.View(
                    "Car",
                    {
                        "set": key,
                        "loads": result["static_loads"],
                        "height": 330,
                        "time": curves.duration / 2,
                        "label": "The car from above with the force at each tyre",
                        **car,
                    },
                )
            with kit.panel("Path"):
                paths = [{"set": key, "x": "east", "y": "north", "label": "estimate"}]
                kit.View("Path", {"paths": paths, "height": 240, "label": "Estimated path"})
            if {"lateral_acceleration", "longitudinal_acceleration"} <= curves.signals.keys():
                with kit.panel("g–g diagram"):
                    kit.View(
                        "GG",
                        {
                            "set": key,
                            "x": "lateral_acceleration",
                            "y": "longitudinal_acceleration",
                            "height": 240,
                            "label": "Lateral against longitudinal acceleration",
                        },
                    )
    _tables(result)
    _export(job)
    drive = Drive(options["recording"]["path"], mapping=options["recording"]["mapping"])
    vehicle = str(job.folder / "vehicle.yaml") if options["without"] else options["vehicle"]
    kit.show_action(actions.run(vehicle, drive, options["filter"], mend=options["mend"], smooth=options["smooth"]))


def _outline(bench: Workbench) -> dict[str, float]:
    import vsense_ros as vs

    physics = vs.load_vehicle(bench.project.inside(bench.vehicle)).physics
    chassis = physics.chassis
    return {"track": physics.front.track, "wheelbase": chassis.cog_to_front_axle + chassis.cog_to_rear_axle}


def _board(bench: Workbench, key: str, curves: CurveSet) -> None:
    laps = curves.content.get("laps", [])
    far = "distance" in curves.signals
    with ui.element("div").classes("vs-row"):
        axis = ui.toggle({"time": "time", "distance": "distance"}, value="time").props(
            "dense no-caps unelevated size=sm"
        )
        axis.set_enabled(far)
        over = ui.checkbox("lay laps over one another").props("dense")
        over.set_enabled(len(laps) > 2)
        error = ui.checkbox("errors").props("dense")
        kit.words("arrow keys: cursor · + −: zoom · Home: all · shift drag: pan", "vs-wide-only")

    def spec() -> dict[str, Any]:
        return board(key, curves, axis=axis.value, laps=laps if over.value else [], errors=error.value)

    view = kit.View("Board", spec())
    for control in (axis, over, error):
        control.on_value_change(lambda: view.show(spec()))


def board(
    key: str, curves: CurveSet, *, axis: str = "time", laps: list[float] | None = None, errors: bool = False
) -> dict[str, Any]:
    """Plots of an estimate: signals with band and reference, then forces of all wheels by direction."""
    parts: list[dict[str, Any]] = [{"begin": None, "end": None, "label": "estimate", "color": ESTIMATE}]
    end = float(curves.value("distance")[-1]) if axis == "distance" else curves.duration
    if laps and len(laps) > 2:
        limits = list(itertools.pairwise(laps))
        parts = [
            {"begin": a, "end": b, "label": f"lap {i}", "color": LAPS[(i - 1) % len(LAPS)]}
            for i, (a, b) in enumerate(limits, start=1)
        ]
        marks = curves.to_distance(np.array(laps)) if axis == "distance" else np.array(laps)
        end = float(np.diff(marks).max())
    plots = [_signal_plot(key, curves, name, parts, errors) for name in SINGLE if name in curves.signals]
    if len(parts) == 1 and not errors:
        plots += _force_plots(key, curves)
    label = "distance [m]" if axis == "distance" else "time [s]"
    return {"axis": axis, "xlabel": label, "end": end, "plots": plots, "marks": []}


def _signal_plot(key: str, curves: CurveSet, name: str, parts: list[dict[str, Any]], errors: bool) -> dict[str, Any]:
    """One signal, or its error, in all parts of the drive; a whole drive has its band and the reference."""
    about = curves.signals[name]
    with_band = len(parts) == 1 and not errors
    traces: list[dict[str, Any]] = []
    for part in parts:
        trace = {"set": key, "name": f"{name}:error" if errors else name, **part}
        if with_band and f"{name}:low" in curves.signals:
            trace |= {"band": [f"{name}:low", f"{name}:high"], "fill": BAND}
        traces.append(trace)
    if with_band and f"{name}:reference" in curves.signals:
        traces.append({"set": key, "name": f"{name}:reference", "label": "reference", "color": REFERENCE, "dash": True})
    title = about["label"][:1].upper() + about["label"][1:] + (", error" if errors else "")
    return {"title": title, "unit": about["unit"], "traces": traces, "height": 118}


def _force_plots(key: str, curves: CurveSet) -> list[dict[str, Any]]:
    """The forces of all wheels, a plot for each direction."""
    plots = []
    for letter, direction in (("z", "Vertical"), ("y", "Lateral"), ("x", "Longitudinal")):
        traces = [
            {
                "set": key,
                "name": f"wheel_force_{wheel}_{letter}",
                "label": wheel.upper(),
                "color": colour,
                "width": 1.2,
                "begin": None,
                "end": None,
            }
            for wheel, colour in WHEELS.items()
            if f"wheel_force_{wheel}_{letter}" in curves.signals
        ]
        if traces:
            plots.append({"title": f"{direction} tyre force", "unit": "kN", "traces": traces, "height": 130})
    return plots


def _tables(result: dict[str, Any]) -> None:
    from vsense_ros.evaluate.wording import HEADINGS, LEGEND

    if result["scores"]:
        with kit.panel("Against the reference", LEGEND):
            rows = [(one["label"], *one["cells"]) for one in result["scores"]]
            kit.table(("signal", *HEADINGS), rows, "Scores against the reference")
    with ui.element("div").classes("vs-columns even"):
        lines = [*result["warnings"], *result["notes"]]
        if lines:
            with kit.panel("Notes"):
                kit.sentences(lines)
        if result["diagnostics"]:
            with kit.panel("Sensors and observer"):
                kinds = {"OK": "good", "WARN": "warn"}
                rows = [
                    (one["name"], kit.tag(one["level"], kinds.get(one["level"], "bad")), one["message"])
                    for one in result["diagnostics"]
                ]
                kit.table(("part", "level", "message"), rows, "Diagnostics", texts=(0, 1, 2))


def _export(job: Job) -> None:
    with ui.element("div").classes("vs-row wrap"):
        kit.words(f"The bag of the estimates is {job.folder / 'output'}.")


STAGE = Stage(
    "estimate",
    "Estimate",
    "Side slip, attitude and tyre forces of a drive, each with its standard deviation.",
    build,
    lambda bench: state_of_job(bench, "estimate", bench.missing(recordings=False) or ("" if bench.drives else "none")),
)
