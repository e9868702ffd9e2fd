"""Identify: parameters of the car from the recordings, with intervals before and after, and their convergence."""

from __future__ import annotations

from typing import Any

from nicegui import ui

from vsense_ros.studio import actions, kit
from vsense_ros.studio.jobs import Job
from vsense_ros.studio.stages.check import use_car
from vsense_ros.studio.stages.stage import Stage, state_of_job
from vsense_ros.studio.workbench import Workbench

MODELS = {
    "best": "best: 4 degrees of freedom, with wheel speeds",
    "single_track": "single_track: with a speed",
}


def build(bench: Workbench) -> None:
    """Draw the stage."""
    missing = bench.missing(checked=True)
    with ui.element("div").classes("vs-row wrap"):
        model = ui.select(MODELS, value=bench.page.get("model", "best"), label="Model").props("dense outlined")
        model.classes("vs-select")
        model.on_value_change(lambda event: bench.page.update(model=event.value))

        def start() -> None:
            drives, proof = bench.training(), bench.held_out()
            bench.page["model"] = model.value
            options = {
                "recordings": [bench.source(one) for one in drives],
                "held_out": [bench.source(one) for one in proof],
                "model": model.value,
            }
            job = bench.start("identify", options, [*drives, *proof], vehicle=bench.vehicle)
            bench.project.remember("identify", job.key)
            bench.refresh()

        run = (
            ui.button("Identify", on_click=lambda: kit.attempt(start)).props("unelevated no-caps").classes("vs-primary")
        )
        run.set_enabled(not missing)
        run.props('aria-label="Identify the car"')
        names = ", ".join(drive.name for drive in bench.training()) or "no recording"
        proof = ", ".join(drive.name for drive in bench.held_out()) or "none"
        kit.words(missing or f"fitted to {names}; held out: {proof}")
    if (job := bench.newest("identify")) is not None:
        kit.follow(bench, job, "Identifying", lambda job: _show(bench, job), lambda: kit.attempt(start))
    if not missing:
        kit.show_action(actions.identify(bench.vehicle, bench.training(), bench.held_out(), model.value))


def _show(bench: Workbench, job: Job) -> None:
    result = job.result
    with ui.element("div").classes("vs-row"):
        ui.button("Use this car", on_click=lambda: _use(bench, job)).props("unelevated no-caps dense")
        kit.words(f"computed in {result['seconds']:.0f} s; the file is {result['vehicle']}")
    with kit.panel("Parameters", "grey line: before; bar: one standard deviation about the identified value"):
        rows = []
        for one in result["rows"]:
            before, after, deviation = one["before"], one["after"], one["deviation"]
            percent = round(100 * (after / before - 1)) if before else None
            change = "–" if percent is None else f"{percent:+d} %" if percent else "0 %"
            kind = (
                ("determined", "good")
                if one["determined"]
                else ("sensor", "plain")
                if one.get("of_sensor")
                else ("not determined", "warn")
            )
            rows.append(
                (
                    one["name"].replace("_", " "),
                    kit.number(before, 4),
                    kit.number(after, 4),
                    kit.number(deviation, 2),
                    one["unit"].removeprefix("-"),
                    change,
                    _interval(before, after, deviation),
                    kit.tag(*kind),
                )
            )
        heads = ("parameter", "before", "after", "± σ", "unit", "change", "", "")
        kit.table(heads, rows, "Identified parameters", texts=(0, 4, 6, 7))
    with ui.element("div").classes("vs-columns even"):
        if len(result["passes"]) > 1:
            with kit.panel("Convergence", "each parameter by pass over the drives, from the vehicle file to the last"):
                _convergence(result)
        with ui.element("div"):
            if result["fits"]:
                with kit.panel("Fit of the model alone", "1 − error / σ of the signal; 1 is perfect"):
                    fits = [
                        (
                            f"{name}{' (held out)' if name in result.get('held_out', []) else ''}",
                            output.replace("_", " "),
                            f"{before:.3f}",
                            f"{after:.3f}",
                            kit.bar(after, f"{after:.3f}"),
                        )
                        for name, outputs in result["fits"].items()
                        for output, (before, after) in outputs.items()
                    ]
                    kit.table(("recording", "signal", "before", "after", ""), fits, "Fit", texts=(0, 1, 4))
            if result["sentences"]:
                with kit.panel("What to know"):
                    kit.sentences(result["sentences"])


def _interval(before: float, after: float, deviation: float) -> kit.Markup:
    reach = max(abs(after - before) + deviation, 1.5 * deviation, abs(before) * 0.05) or 1.0
    low, high = min(before, after) - reach, max(before, after) + reach

    def place(x: float) -> float:
        return 100 * min(1.0, max(0.0, (x - low) / (high - low)))

    left, right = place(after - deviation), place(after + deviation)
    words = f"before {before:.4g}, after {after:.4g} plus or minus {deviation:.2g}"
    return kit.Markup(
        f'<span class="vs-interval" role="img" aria-label="{words}"><s style="left:{place(before):.1f}%"></s>'
        f'<u style="left:{left:.1f}%;width:{max(right - left, 1):.1f}%"></u>'
        f'<b style="left:{place(after):.1f}%"></b></span>'
    )


def _convergence(result: dict[str, Any]) -> None:
    cells = []
    for i, one in enumerate(result["rows"]):
        values = [row[i] for row in result["passes"]]
        low, high = min(values), max(values)
        width = (high - low) or 1.0
        points = " ".join(
            f"{4 + 112 * k / max(len(values) - 1, 1):.1f},{34 - 28 * (v - low) / width:.1f}"
            for k, v in enumerate(values)
        )
        name = one["name"].replace("_", " ")
        limits = f"{kit.number(values[0], 3)} → {kit.number(values[-1], 3)} {one['unit'].removeprefix('-')}"
        cells.append(
            f'<figure><svg viewBox="0 0 120 38" role="img" '
            f'aria-label="{name} from {limits}">'
            f'<polyline points="{points}"/></svg><figcaption>{name}<br>{limits}</figcaption></figure>'
        )
    ui.html("".join(cells), sanitize=False).classes("vs-sparks")


def _use(bench: Workbench, job: Job) -> None:
    from shutil import copyfile

    target = bench.project.folder / "cars" / f"identified_{job.key[:6]}.yaml"
    copyfile(job.result["vehicle"], target)
    use_car(bench, str(target))


STAGE = Stage(
    "identify",
    "Identify",
    "Distribution of mass, roll and tyres of the car, from the recordings, with intervals.",
    build,
    lambda bench: state_of_job(bench, "identify", bench.missing(checked=True)),
)
