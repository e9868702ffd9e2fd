"""Explain: which physics the model of the car lacks, how sure that is, where it acts, and what to drive next."""

from __future__ import annotations

from html import escape
from shutil import copyfile
from typing import Any

from nicegui import ui

from vsense_ros.studio import actions, kit
from vsense_ros.studio.curves import CURVES
from vsense_ros.studio.jobs import Job
from vsense_ros.studio.stages.check import use_car
from vsense_ros.studio.stages.stage import Stage, state_of_job
from vsense_ros.studio.workbench import Workbench

_VERDICTS = {
    "named": ("named", "good"),
    "ambiguous": ("ambiguous", "warn"),
    "unknown": ("unknown physics", "warn"),
    "no_mismatch": ("no mismatch", "good"),
    "not_assessable": ("not assessable", "bad"),
}
_MOST_EFFECTS = 12


def build(bench: Workbench) -> None:
    """Draw the stage."""
    missing = bench.missing(checked=True)
    mend = bool(bench.project.state.settings.get("mend"))
    with ui.element("div").classes("vs-row wrap"):
        by_lap = ui.checkbox("cut into laps", value=bool(bench.page.get("by_lap"))).props("dense")
        observe = ui.checkbox("run the observer with the answer", value=bool(bench.page.get("observe", False))).props(
            "dense"
        )

        def start() -> None:
            drives, proof = bench.training(), bench.held_out()
            bench.page |= {"by_lap": by_lap.value, "observe": observe.value}
            options = {
                "recordings": [bench.source(one) for one in drives],
                "held_out": [bench.source(one) for one in proof],
                "by_lap": by_lap.value,
                "mend": mend,
                "observe": observe.value,
            }
            job = bench.start("explain", options, [*drives, *proof], vehicle=bench.vehicle)
            bench.project.remember("explain", job.key)
            bench.refresh()

        run = (
            ui.button("Explain", on_click=lambda: kit.attempt(start)).props("unelevated no-caps").classes("vs-primary")
        )
        run.set_enabled(not missing)
        run.props('aria-label="Explain these recordings"')
        names = ", ".join(drive.name for drive in bench.training()) or "no recording"
        proof = ", ".join(drive.name for drive in bench.held_out()) or "none"
        kit.words(missing or f"fitted to {names}; held out: {proof}")
    if (job := bench.newest("explain")) is not None:
        kit.follow(bench, job, "Searching for the physics", lambda job: _show(bench, job), lambda: kit.attempt(start))
    if not missing:
        kit.show_action(
            actions.explain(
                bench.vehicle, bench.training(), bench.held_out(), by_lap=by_lap.value, mend=mend, observe=observe.value
            )
        )


def _show(bench: Workbench, job: Job) -> None:
    from vsense_ros.mismatch.answer_schema import parsed
    from vsense_ros.mismatch.words import first_and_rest

    answer = parsed(job.result["answer"], job.key)
    word, kind = _VERDICTS[answer.verdict]
    with kit.panel("The answer"):
        ui.html(kit.tag(word, kind).html, sanitize=False)
        first, rest = map(escape, first_and_rest(answer.sentence))
        ui.html(f"<p><b>{first}</b></p><p>{rest}</p>", sanitize=False).classes("vs-answer")
        kit.sentences(answer.remarks)
        with ui.element("div").classes("vs-row"):
            use = ui.button("Use this car", on_click=lambda: _use(bench, job)).props("unelevated no-caps dense")
            use.set_enabled(bool(job.result["vehicle"]))
            kit.words(
                f"computed in {job.result['seconds']:.0f} s"
                if job.result["vehicle"]
                else "No effect is named, so there is no vehicle file to use."
            )
    _effects(answer)
    with ui.element("div").classes("vs-columns even"):
        _rivals(answer)
        _fit(answer)
    _where(bench, answer)
    _next(answer, job.result)


def _effects(answer: Any) -> None:
    effects = sorted(answer.effects, key=lambda one: (not one.accepted, -one.confidence, -one.gain_left_out))[
        :_MOST_EFFECTS
    ]
    if not effects:
        return
    with kit.panel("Effects", "how probable each is, what it explains where it was not fitted, and its size"):
        rows = []
        for one in effects:
            name = one.id.replace("_", " ") + (f" ({one.place})" if one.place else "")
            size = "; ".join(
                f"{p.name.replace('_', ' ')} {p.value:.3g} [{p.interval_90[0]:.3g}, {p.interval_90[1]:.3g}] "
                f"{p.unit.removeprefix('-')}"
                for p in one.parameters[:2]
            )
            gain = one.gain_held_out if one.gain_held_out is not None else one.gain_left_out
            verdict = (
                kit.tag("named", "good") if one.accepted else kit.tag("possible", "warn") if one.answer_set else ""
            )
            rows.append(
                (
                    name,
                    kit.bar(one.confidence, f"probability {one.confidence:.2f}"),
                    f"{100 * one.confidence:.0f} %",
                    kit.bar(max(gain, 0), f"explains {100 * gain:.0f} %"),
                    f"{100 * gain:.0f} %",
                    size,
                    verdict or one.objection[:160],
                )
            )
        heads = ("effect", "probability", "", "explains", "", "size, 90 % interval", "")
        kit.table(heads, rows, "Effects", texts=(0, 1, 3, 5, 6))


def _rivals(answer: Any) -> None:
    if not answer.rivals:
        return
    with kit.panel("Best explanations side by side"):
        known = {one.id: one for one in answer.effects}
        rows = []
        for number, ids in enumerate(answer.rivals, start=1):
            gains = [known[id].gain_left_out for id in ids if id in known]
            held = [known[id].gain_held_out for id in ids if id in known and known[id].gain_held_out is not None]
            words = " and ".join(id.replace("_", " ") for id in ids)
            gain = max(gains, default=0.0)
            rows.append(
                (
                    str(number),
                    words,
                    kit.bar(max(gain, 0), f"{gain:.2f}"),
                    f"{100 * gain:.0f} %",
                    f"{100 * max(held):.0f} %" if held else "–",
                )
            )
        kit.table(("", "effects", "left out", "", "held out"), rows, "Rival explanations", texts=(0, 1, 2))


def _fit(answer: Any) -> None:
    if not answer.fit:
        return
    with kit.panel("Error by signal", "root mean square; before: base parameters fitted, after: with what was named"):
        rows = []
        for name, one in answer.fit.items():
            held = one.held_out
            rows.append(
                (
                    name.replace("_", " "),
                    f"{one.training.before:.3g}",
                    f"{one.training.after:.3g}",
                    f"{held.before:.3g}" if held else "–",
                    f"{held.after:.3g}" if held else "–",
                    one.unit,
                )
            )
        heads = ("signal", "before", "after", "held out, before", "after", "unit")
        kit.table(heads, rows, "Errors by signal", texts=(0, 5))


def _where(bench: Workbench, answer: Any) -> None:
    segments = answer.located.segments[:6]
    if not segments:
        return
    with kit.panel("When and where", answer.located.region.description if answer.located.region else ""):
        rows = [
            (
                one.recording,
                f"{one.begin:.1f} … {one.end:.1f}",
                kit.bar(one.share, f"{one.share:.2f}"),
                f"{100 * one.share:.0f} %",
            )
            for one in segments
        ]
        kit.table(("recording", "time [s]", "share of the error", ""), rows, "When the error occurs", texts=(0, 1, 2))
        for name in dict.fromkeys(one.recording for one in segments):
            _place(bench, name, [{"from": one.begin, "to": one.end} for one in segments if one.recording == name])


def _place(bench: Workbench, name: str, marks: list[dict[str, float]]) -> None:
    """Path and speed of a recording, with the windows of the largest error marked in both."""
    drive = next((one for one in bench.drives if one.key and bench.job(one.key).result.get("name") == name), None)
    curves = bench.curves(bench.job(drive.key)) if drive is not None else None
    if drive is None or curves is None or not {"north", "speed"} <= curves.signals.keys():
        return
    key = f"{drive.key}/{CURVES}"
    with ui.element("div").classes("vs-columns even"):
        paths = [{"set": key, "x": "east", "y": "north", "label": drive.name}]
        label = f"Path of {name} with the windows of the largest error; the cursor of the curve beside it is shown"
        kit.View("Path", {"paths": paths, "marks": marks, "group": f"where {name}", "height": 200, "label": label})
        trace = {"set": key, "name": "speed", "label": "speed", "color": "#0b63b6"}
        title = f"{name}: speed, windows with the largest error marked"
        plot = {"title": title, "unit": "m/s", "traces": [trace], "height": 160}
        board = {"axis": "time", "xlabel": "time [s]", "end": curves.duration, "plots": [plot], "marks": marks}
        kit.View("Board", {**board, "group": f"where {name}"})


def _next(answer: Any, result: dict[str, Any]) -> None:
    test = answer.would_separate
    lines = []
    if test is not None:
        lines.append(
            f"Drive {test.manoeuvre} ({test.id}): it separates {test.pair[0].replace('_', ' ')} from "
            f"{test.pair[1].replace('_', ' ')} by {test.d_prime:.1f} standard deviations, seen best in {test.signal}."
        )
    if result["no_test"]:
        lines.append(result["no_test"])
    lines += [f"{one.id.replace('_', ' ')}: {one.reason}" for one in answer.out_of_reach[:8]]
    if lines:
        with kit.panel("What to drive next, and what these recordings cannot determine"):
            kit.sentences(lines)


def _use(bench: Workbench, job: Job) -> None:
    target = bench.project.folder / "cars" / f"explained_{job.key[:6]}.yaml"
    copyfile(job.result["vehicle"], target)
    use_car(bench, str(target))


STAGE = Stage(
    "explain",
    "Explain",
    "Which physics the model of the car lacks, proven on drives that it was not fitted to.",
    build,
    lambda bench: state_of_job(bench, "explain", bench.missing(checked=True)),
)
