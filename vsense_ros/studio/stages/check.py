"""Check: what cannot be right in the recordings, what would mend it, calibration, and what a drive can determine."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from nicegui import ui

from vsense_ros.studio import actions, kit
from vsense_ros.studio.jobs import Job, Status
from vsense_ros.studio.stages.stage import Stage, state_of_job
from vsense_ros.studio.workbench import Workbench

_FILTER = "integrated"  # whose states are looked at, unless another is chosen
_SURE = {"certain": "bad", "likely": "warn", "undecided": "plain"}


def build(bench: Workbench) -> None:
    """Draw the stage."""
    missing = bench.missing(recordings=False) or ("" if bench.drives else "Open a recording first (stage Data).")

    def start() -> None:
        options = {"recordings": [bench.source(drive) for drive in bench.drives]}
        job = bench.start("check", options, list(bench.drives), vehicle=bench.vehicle)
        bench.project.remember("check", job.key)
        bench.refresh()

    with ui.element("div").classes("vs-row"):
        run = (
            ui.button("Run check", on_click=lambda: kit.attempt(start))
            .props("unelevated no-caps")
            .classes("vs-primary")
        )
        run.set_enabled(not missing)
        kit.words(missing)
    if (job := bench.newest("check")) is not None:
        kit.follow(bench, job, "Checking", lambda job: _show(bench, job), lambda: kit.attempt(start))
    if missing:
        return
    with ui.element("div").classes("vs-columns even"):
        _calibration(bench)
        _observability(bench)
    kit.show_action(actions.check_vehicle(bench.vehicle, bench.drives))


def _show(bench: Workbench, job: Job) -> None:
    result = job.result
    for i, drive in enumerate(result["drives"]):
        count = len(drive["findings"])
        with kit.panel(drive["name"], f"{count} to look at" if count else "nothing looks wrong"):
            if absent := drive.get("absent"):
                words = "which the vehicle file names: what needs it is estimated without it, or not at all."
                kit.words(f"This recording has no {', '.join(absent)}, {words}")
            for finding in drive["findings"]:
                _finding(bench, drive, finding, job, i)
            if drive["mends"]:
                _mends(bench, drive)
    if result["sentences"]:
        with kit.panel("Vehicle file against the recordings"):
            kit.sentences(result["sentences"], "warn")
    else:
        kit.words("The vehicle file fits the recordings.", "good")


def _finding(bench: Workbench, drive: dict[str, Any], finding: dict[str, Any], job: Job, index: int) -> None:
    with ui.element("div").classes("vs-finding"):
        tag = kit.tag(finding["confidence"], _SURE.get(finding["confidence"], "plain"))
        ui.html(tag.html, sanitize=False)
        ui.html(f"<code>{escape(finding['topic'])}</code>", sanitize=False)
        ui.label(finding["sentence"])
        place = ui.element("div").classes("vs-evidence")
        button = ui.button("Evidence", on_click=lambda: _evidence(bench, drive, finding, job, index, place))
        button.props("flat dense no-caps size=sm")


def _evidence(
    bench: Workbench, drive: dict[str, Any], finding: dict[str, Any], job: Job, index: int, place: ui.element
) -> None:
    """The curves of the topic of a finding, with its time; after a mend, these as well."""
    if len(list(place)):
        place.clear()
        return
    source = next((one for one in bench.drives if str(bench.project.inside(one.path)) == drive["path"]), None)
    curves = bench.curves(bench.job(source.key)) if source is not None and source.key else None
    with place:
        if source is None or curves is None:
            kit.words("The curves of this recording are no longer there; open it again in the stage Data.")
            return
        names = [name for name, about in curves.signals.items() if about["topic"] == finding["topic"]][:4]
        mended = f"{job.key}/{drive['mended_curves']}" if finding["mend"] else ""
        plots = []
        for name in names:
            about = curves.signals[name]
            traces = [{"set": f"{source.key}/curves", "name": name, "label": "recorded", "color": "#1b2430"}]
            if mended:
                traces.append({"set": mended, "name": name, "label": "mended", "color": "#0b63b6"})
            plots.append({"title": name, "unit": about["unit"], "traces": traces, "height": 90})
        span = finding["span"]
        marks = [{"from": span[0], "to": span[1]}] if span else []
        kit.View(
            "Board",
            {
                "axis": "time",
                "xlabel": "time [s]",
                "end": curves.duration,
                "plots": plots,
                "marks": marks,
                "group": "e",
            },
        )


def _mends(bench: Workbench, drive: dict[str, Any]) -> None:
    kit.sentences([f"{mend['topic']}: {mend['words']}" for mend in drive["mends"]])
    accepted = ui.checkbox(
        "Accept these mends in all further steps", value=bool(bench.project.state.settings.get("mend"))
    )

    def accept(value: bool) -> None:
        bench.project.state.settings["mend"] = value
        bench.project.save()
        bench.refresh()

    accepted.on_value_change(lambda event: accept(bool(event.value)))


def _calibration(bench: Workbench) -> None:
    target = bench.project.folder / "cars" / f"{Path(bench.vehicle).stem.removesuffix('_calibrated')}_calibrated.yaml"

    def start() -> None:
        drives = bench.training()
        options = {"recordings": [bench.source(drive) for drive in drives], "target": str(target)}
        job = bench.start("calibrate", options, drives, vehicle=bench.vehicle)
        bench.project.remember("calibrate", job.key)
        bench.refresh()

    def show(job: Job) -> None:
        rows = []
        for one in job.result["quantities"]:
            known = one["determined"]
            rows.append(
                (
                    one["name"],
                    f"{one['before']:.4g}",
                    f"{one['after']:.4g}" if known else "–",
                    f"{one['deviation']:.2g}",
                    one["unit"],
                    kit.tag("determined", "good") if known else kit.tag("stays", "plain"),
                )
            )
        kit.table(("quantity", "before", "after", "± σ", "unit", ""), rows, "Calibration", texts=(0, 4, 5))
        kit.sentences([f"To drive next: {advice}." for advice in job.result["drive_next"]])
        ui.button("Use this car", on_click=lambda: use_car(bench, job.result["target"])).props(
            "unelevated no-caps dense"
        )

    with kit.panel(
        "Latencies, mountings, radii, steering", "calibrated by the recordings, references are not looked at"
    ):
        ui.button("Calibrate", on_click=lambda: kit.attempt(start)).props("flat no-caps dense")
        if (job := bench.newest("calibrate")) is not None:
            kit.follow(bench, job, "Calibrating", show, lambda: kit.attempt(start))
        kit.show_action(actions.calibrate(bench.vehicle, bench.training(), str(target)))


def use_car(bench: Workbench, path: str) -> None:
    """Go on with another vehicle file."""
    bench.project.state.vehicle = path
    bench.project.save()
    ui.notify(f"The car is now {Path(path).name}", position="bottom-right")
    bench.refresh()


def _observability(bench: Workbench) -> None:
    from vsense_ros.navigation.catalogue import FILTERS

    with kit.panel("What this drive can determine", "share of each deviation that the drive leaves"):
        names = [family.name for family in FILTERS.recommended]
        chosen = ui.select(
            names, value=bench.page.get("observed", _FILTER if _FILTER in names else names[0]), label="Filter"
        )
        chosen.props("dense outlined").classes("vs-select")

        def start() -> None:
            drive = bench.drives[0]
            bench.page["observed"] = chosen.value
            options = {"recordings": [bench.source(drive)], "filter": chosen.value}
            job = bench.start("observe", options, [drive], vehicle=bench.vehicle)
            bench.project.remember("observe", job.key)
            bench.refresh()

        def show(job: Job) -> None:
            rows = []
            for state in job.result["states"]:
                left, at = state["left"], state["at"]
                known = at is not None
                would = min(state["would"], key=state["would"].get) if state["would"] else ""
                words = f"determined after {at:.1f} s: {state['motion']}" if known else f"to do: {would or 'unknown'}"
                bar = kit.bar(1 - left, f"{100 * (1 - left):.0f} % determined", "" if known else "warn")
                rows.append((state["name"].replace("_", " "), bar, f"{100 * left:.0f} %", words))
            kit.table(("state", "determined", "σ left", ""), rows, "Observability", texts=(0, 1, 3))

        ui.button("Look", on_click=lambda: kit.attempt(start)).props("flat no-caps dense")
        if (job := bench.newest("observe")) is not None:
            kit.follow(bench, job, "Looking at what is observable", show, lambda: kit.attempt(start))
        kit.show_action(actions.observability(bench.vehicle, bench.drives[0], chosen.value))


def _state(bench: Workbench) -> str:
    missing = bench.missing(recordings=False) or ("" if bench.drives else "no recording")
    job = bench.newest("check")
    if not missing and job is not None and job.status is Status.DONE and bench.missing(recordings=False, checked=True):
        return "failed"
    return state_of_job(bench, "check", missing)


STAGE = Stage(
    "check",
    "Check",
    "What cannot be right in the signals, and what would put it right, before anything is fitted.",
    build,
    _state,
)
