"""Data: recordings of every format, their signals as a tree, timeline, map and curves; mappings; joining."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from nicegui import ui

from vsense_ros.errors import InputError
from vsense_ros.files.names import harmless
from vsense_ros.studio import actions, kit
from vsense_ros.studio.curves import CURVES, GLANCE
from vsense_ros.studio.jobs import Job, Status
from vsense_ros.studio.project import Drive
from vsense_ros.studio.stages.stage import Stage
from vsense_ros.studio.workbench import Workbench

_AT_FIRST = (
    "imu/data/angular_velocity.z",
    "imu/data/linear_acceleration.y",
    "vehicle/steering",
    "vehicle/wheel_speeds",
    "speed",
)
_MOST_PLOTS = 14
# Ticks all signals of a topic with the first box, and sends the names of all signals that are ticked.
_TICKED = """(event) => {
    const box = event.target, boxes = event.currentTarget.querySelectorAll("input[value]:not([data-all])");
    if (box.dataset.all !== undefined)
        for (const one of box.closest("details").querySelectorAll("input")) one.checked = box.checked;
    emit([...boxes].filter((one) => one.checked).map((one) => one.value));
}"""
_LOOK = 0.1  # [s] between two looks whether curves have been written
_ROW_LOOK = 0.5  # [s] between two looks whether a recording in the list has been read


def build(bench: Workbench) -> None:
    """Draw the stage."""
    _opening(bench)
    if not bench.drives:
        kit.words("No recording yet. Choose one of the folders that were opened, or drop files on the field above.")
        return
    for drive in bench.drives:
        _read(bench, drive)
    names = {drive.path: drive.name for drive in bench.drives}
    shown = bench.page.get("drive")
    shown = shown if shown in names else bench.drives[0].path
    with kit.panel("Recordings"):
        for drive in list(bench.drives):
            _row(bench, drive, drive.path == shown)
        if len(bench.drives) > 1:
            _joining(bench)
    drive = next(one for one in bench.drives if one.path == shown)
    if drive.key:
        job = bench.job(drive.key)
        kit.follow(
            bench, job, f"Reading {drive.name}", lambda job: _show(bench, drive, job), lambda: _again(bench, drive)
        )
        if job.status is Status.RUNNING:
            _first_look(bench, job)
        if job.status is Status.FAILED:
            _mapping(bench, drive)
    kit.show_action(actions.info(drive))


def _first_look(bench: Workbench, job: Job) -> None:
    """Curves of a recording that is being read, as soon as there are any: parts of a large one, then all of it."""
    with kit.panel("Curves", "a first look at parts that lie evenly over the recording; the rest is being read") as box:
        view = kit.View("Board", {"axis": "time", "end": 1.0, "plots": [], "marks": []})
    box.set_visibility(False)
    drawn: list[str] = []

    def look() -> None:
        folder = next((name for name in (CURVES, GLANCE) if bench.curves(job, name) is not None), "")
        curves = bench.curves(job, folder) if folder else None
        if curves is None or folder in drawn:
            return
        drawn.append(folder)
        box.set_visibility(True)
        shown = bench.page.setdefault("signals", _at_start(curves.signals))
        view.show(board(f"{job.key}/{folder}", curves.signals, shown, curves.duration))

    ui.timer(_LOOK, look)


def _opening(bench: Workbench) -> None:
    known = {drive.path for drive in bench.drives}
    choice = {path: name for path, name in bench.project.recordings().items() if path not in known}
    with ui.element("div").classes("vs-row"):
        chosen = ui.select(choice, label="Open a recording of an opened folder", with_input=True)
        chosen.props("dense outlined").classes("vs-select")
        chosen.on_value_change(lambda event: _open(bench, event.value or ""))
        words = "Drop recordings, databases (.dbc) and mappings here, or choose them"
        kit.file_input(bench, words, "", lambda paths: _uploaded(bench, paths))


def _open(bench: Workbench, *paths: str) -> None:
    """Open recordings that are not open yet."""
    new = [path for path in paths if path and path not in {drive.path for drive in bench.drives}]
    bench.drives.extend(map(Drive, new))
    if new:
        bench.page["drive"] = new[0]
        bench.project.save()
    bench.refresh()


def _uploaded(bench: Workbench, paths: list[Path]) -> None:
    others = [path for path in paths if path.suffix.lower() in (".dbc", ".yaml", ".yml")]
    for path in others:
        ui.notify(f"{path.name} is kept in the project; choose it at the recording that needs it", position="top")
    _open(bench, *(str(path) for path in paths if path not in others))


def _read(bench: Workbench, drive: Drive) -> None:
    """Start reading a recording, unless it has been read with this content, or could not be: the stage is drawn anew
    whenever a job ends, so that a log without a mapping would be read for ever."""

    def start() -> None:
        job = bench.start("read", bench.source(drive), [drive], again=not drive.key)
        if job.key != drive.key:
            drive.key = job.key
            bench.project.save()

    kit.attempt(start)


def _again(bench: Workbench, drive: Drive) -> None:
    drive.key = ""
    bench.refresh()


def _row(bench: Workbench, drive: Drive, current: bool) -> None:
    """A recording with its state, which follows its reading."""
    row = ui.element("div").classes(f"vs-drive {'current' if current else ''}")

    def draw() -> bool:
        job = bench.job(drive.key) if drive.key else None
        status = job.status if job is not None else Status.FAILED
        row.clear()
        with row:
            _content(bench, drive, job, status)
        return status is Status.RUNNING

    def look() -> None:
        if bench.job(drive.key).status is not Status.RUNNING:
            timer.deactivate()
            draw()

    if draw():
        timer = ui.timer(_ROW_LOOK, look)


def _content(bench: Workbench, drive: Drive, job: Job | None, status: Status) -> None:
    name = ui.button(drive.name, on_click=lambda: _select(bench, drive)).props("flat dense no-caps")
    name.tooltip(drive.path)
    if job is not None and status is Status.DONE:
        result = job.result
        ui.label(f"{result['duration']:.1f} s").classes("vs-number")
        ui.label(f"{len(result['topics'])} topics").classes("vs-number")
        problems = result["problems"]
        ui.label(f"{problems} to look at" if problems else "nothing looks wrong").classes(
            "warn" if problems else "good"
        )
    else:
        ui.label(status)
    held = ui.checkbox("held out", value=drive.held_out).props("dense")
    held.tooltip("Kept for validation: Identify and Explain do not fit to it")
    held.on_value_change(lambda event: _hold_out(bench, drive, bool(event.value)))
    remove = ui.button("Remove", on_click=lambda: _remove(bench, drive)).props("flat dense no-caps size=sm")
    remove.props(f'aria-label="Remove {escape(drive.name)}"')


def _select(bench: Workbench, drive: Drive) -> None:
    bench.page["drive"] = drive.path
    bench.page.pop("signals", None)
    bench.refresh()


def _hold_out(bench: Workbench, drive: Drive, value: bool) -> None:
    drive.held_out = value
    bench.project.save()
    bench.refresh()


def _remove(bench: Workbench, drive: Drive) -> None:
    bench.drives.remove(drive)
    bench.project.save()
    bench.refresh()


def _joining(bench: Workbench) -> None:
    target = bench.project.folder / "recordings" / f"{harmless(Path(bench.drives[0].path).stem)}_joined"

    def start() -> None:
        sources = [bench.source(drive) for drive in bench.drives]
        options = {"recordings": sources, "target": str(target), "keep_times": keep.value}
        job = bench.start("join", options, list(bench.drives))
        bench.project.remember("join", job.key)
        bench.refresh()

    def joined(job: Job) -> None:
        kit.sentences(job.result["notes"] or ["Their clocks agree."])
        ui.button("Use the joined recording", on_click=lambda: _use_joined(bench, job.result["target"])).props(
            "flat no-caps dense"
        )

    with ui.expansion("Join all: several loggers of one drive").props("dense"):
        kit.words("The offsets between their clocks are estimated from the motion that all of them measure.")
        keep = ui.checkbox("their clocks agree already: shift none").props("dense")
        ui.button("Join", on_click=lambda: kit.attempt(start)).props("unelevated no-caps dense")
        if (job := bench.newest("join")) is not None:
            kit.follow(bench, job, "Joining", joined, lambda: kit.attempt(start))
        kit.show_action(actions.join(bench.drives, str(target)))


def _use_joined(bench: Workbench, target: str) -> None:
    bench.project.state.drives = []
    _open(bench, target)


def _mapping(bench: Workbench, drive: Drive) -> None:
    """What a recording whose columns are not known needs: a database, and a mapping that is proposed and confirmed."""
    uploads = bench.project.folder / "uploads"
    with kit.panel("Which column is what?", "a proposal to be looked at line by line, then confirmed"):
        databases = {
            str(path): path.name for place in (uploads, Path(drive.path).parent) for path in place.glob("*.dbc")
        }
        database = ui.select({"": "none", **databases}, value=drive.database, label="Database of a CAN log")
        database.props("dense outlined").classes("vs-select")

        def ask() -> None:
            drive.database = database.value or ""
            options = {**bench.source(drive), "mapping": ""}
            job = bench.start("propose", options, [drive])
            bench.project.remember("propose", job.key)
            bench.refresh()

        def proposed(job: Job) -> None:
            kit.sentences(job.result["remarks"])
            text = (
                ui.textarea(value=job.result["text"]).props('outlined autogrow aria-label="Mapping"').classes("vs-yaml")
            )
            ui.button("Use this mapping", on_click=lambda: confirm(text.value)).props("unelevated no-caps dense")

        def confirm(text: str) -> None:
            path = bench.project.folder / "uploads" / f"{harmless(drive.name)}.mapping.yaml"
            path.write_text(text, encoding="utf-8")
            for one in bench.drives:  # logs of one logger have the same columns
                if one is drive or _lacks_mapping(bench, one, Path(drive.path).suffix):
                    one.mapping, one.database, one.key = str(path), database.value or "", ""
            bench.project.save()
            bench.refresh()

        ui.button("Propose a mapping", on_click=lambda: kit.attempt(ask)).props("flat no-caps dense")
        if (job := bench.newest("propose")) is not None and job.task["options"]["path"] == drive.path:
            kit.follow(bench, job, "Looking at the columns", proposed, lambda: kit.attempt(ask))


def _lacks_mapping(bench: Workbench, drive: Drive, ending: str) -> bool:
    """True for a recording with a name of this ending that could not be read without a mapping."""
    failed = bool(drive.key) and bench.job(drive.key).status is Status.FAILED
    return failed and not drive.mapping and Path(drive.path).suffix == ending


def _show(bench: Workbench, drive: Drive, job: Job) -> None:
    result = job.result
    curves = bench.curves(job)
    if curves is None:
        raise InputError(f"{drive.name}: its curves are no longer there; remove it and open it again")
    kit.sentences(result["notes"][:6])
    with ui.element("div").classes("vs-columns data"):
        with ui.element("div"):
            with kit.panel("Signals", "those that are ticked are shown"):
                _tree(bench, curves.signals)
            with kit.panel("Path"):
                paths = [{"set": f"{job.key}/{CURVES}", "x": "east", "y": "north", "label": drive.name}]
                if "north" in curves.signals:
                    kit.View("Path", {"paths": paths, "label": f"Path of {drive.name}", "height": 280})
                else:
                    kit.words("There is no position in this recording.")
        with ui.element("div"):
            with kit.panel("Timeline of the sensors", "gaps are white; held values are named"):
                ui.html(timeline(result), sanitize=False).classes("vs-timeline")
            with kit.panel("Curves", "drag to zoom, double click shows all, arrow keys move the cursor"):
                shown = bench.page.setdefault("signals", _at_start(curves.signals))
                spec = board(f"{job.key}/{CURVES}", curves.signals, shown, curves.duration)
                bench.page["board"] = kit.View("Board", spec)


def _at_start(signals: dict[str, Any]) -> list[str]:
    known = [name for name in signals if name.startswith(_AT_FIRST)]
    return known[:8] or list(signals)[:3]


def board(key: str, signals: dict[str, Any], shown: list[str], end: float) -> dict[str, Any]:
    """Plots of some signals of a recording, those of one topic and unit in one plot."""
    plots: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for name in shown:
        if (about := signals.get(name)) is None:  # of another recording
            continue
        plots.setdefault((about["topic"], about["unit"]), []).append(
            {"set": key, "name": name, "label": about["label"]}
        )
    colours = ("#0b63b6", "#b4540a", "#0a7a53", "#8a3ea8", "#a8123e", "#4c5a00", "#006b7d", "#6b4a2b")
    made = []
    for (topic, unit), traces in list(plots.items())[:_MOST_PLOTS]:
        for i, trace in enumerate(traces):
            trace["color"] = colours[i % len(colours)]
        made.append({"title": topic, "unit": unit, "traces": traces, "height": 130})
    return {"axis": "time", "xlabel": "time [s]", "end": end, "plots": made, "marks": []}


def _tree(bench: Workbench, signals: dict[str, Any]) -> None:
    """All signals by topic, to be ticked; a topic is open if one of its signals is shown."""
    topics: dict[str, list[str]] = {}
    for name, about in signals.items():
        topics.setdefault(about["topic"], []).append(name)
    shown = set(bench.page.setdefault("signals", _at_start(signals)))
    parts = []
    for topic, names in topics.items():
        boxes = "".join(_box(name, signals[name], name in shown) for name in names)
        every = '<label><input type="checkbox" data-all> all of them</label>' if len(names) > 1 else ""
        opened = "open" if shown & set(names) else ""
        parts.append(f"<details {opened}><summary>{escape(topic)}</summary>{every}{boxes}</details>")
    tree = ui.html("".join(parts), sanitize=False).classes("vs-tree")
    tree.on("change", lambda event: _ticked(bench, signals, event.args), js_handler=_TICKED)


def _box(name: str, about: dict[str, Any], shown: bool) -> str:
    unit = f" [{escape(about['unit'])}]" if about["unit"] else ""
    checked = "checked" if shown else ""
    value = f'value="{escape(name)}" {checked}'
    return f'<label><input type="checkbox" {value}> {escape(about["label"])}{unit}</label>'


def _ticked(bench: Workbench, signals: dict[str, Any], names: list[str]) -> None:
    bench.page["signals"] = [name for name in signals if name in names]
    view = bench.page.get("board")
    if view is not None:
        first = view._props["spec"]
        key = first["plots"][0]["traces"][0]["set"] if first["plots"] else bench.page["set"]
        bench.page["set"] = key
        view.show(board(key, signals, bench.page["signals"], first["end"]))


def timeline(result: dict[str, Any]) -> str:
    """A bar for each topic over the time of the recording, with its rate, and white where it has gaps."""
    end = max([result["duration"], *(one["end"] for one in result["topics"])]) or 1.0
    rows = []
    for one in result["topics"]:
        gaps = "".join(
            f'<u style="left:{100 * start / end:.2f}%;width:{max(100 * length / end, 0.15):.2f}%"></u>'
            for start, length in one["gaps"]
        )
        left, width = 100 * one["begin"] / end, 100 * (one["end"] - one["begin"]) / end
        rate = f"{one['rate']:.4g} Hz" if one["rate"] == one["rate"] else "–"
        held = ", ".join(f"{name} held for {count} messages" for name, count in one["held"].items())
        gap_words = f"{len(one['gaps'])} gaps" if one["gaps"] else ""
        words = ", ".join(filter(None, (rate, gap_words, held)))
        kind = "warn" if one["problems"] else ""
        rows.append(
            f'<div class="vs-lane"><span>{escape(one["topic"])}</span><span class="lane {kind}" role="img" '
            f'aria-label="{escape(one["topic"])}: {escape(words)}"><i style="left:{left:.2f}%;width:{width:.2f}%"></i>'
            f"{gaps}</span><span>{escape(words)}</span></div>"
        )
    return "".join(rows)


STAGE = Stage(
    "data",
    "Data",
    "Recordings of every format: what was measured, how often, where, and what is missing.",
    build,
    lambda bench: "done" if bench.drives else "ready",
    light=True,
)
