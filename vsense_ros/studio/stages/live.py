"""Drive live: the topics of a running observer, or a recording played as if it were one."""

from __future__ import annotations

import json

from nicegui import ui

from vsense_ros.studio import kit
from vsense_ros.studio.jobs import Job, Status
from vsense_ros.studio.stages.stage import Stage
from vsense_ros.studio.workbench import Workbench


def build(bench: Workbench) -> None:
    """Draw the stage."""

    def start() -> None:
        job = bench.jobs.start("listen", {"namespace": namespace.value.strip()}, {})
        bench.project.remember("listen", job.key)
        bench.refresh()

    with ui.element("div").classes("vs-row wrap"):
        namespace = ui.input("Namespace of the observer", placeholder="/").props("dense outlined")
        ui.button("Listen", on_click=lambda: kit.attempt(start)).props("unelevated no-caps").classes("vs-primary")
        kit.words("Foxglove shows the same topics with more layouts: vsense view.")
    if (job := bench.newest("listen")) is not None:
        kit.follow(bench, job, "Listening to the topics vsense/…", lambda job: None, lambda: kit.attempt(start))
        if job.status is Status.RUNNING:
            _growing(bench, job)
            return
    _play(bench)


def _growing(bench: Workbench, job: Job) -> None:
    """Curves of the observer that runs, drawn anew when more of them has been written."""
    from vsense_ros.studio.stages.estimate import board
    from vsense_ros.studio.tasks.live import LIVE

    with kit.panel("What the observer publishes", "the last seconds; ±2σ as a band"):
        waiting = kit.words("No estimate has been heard yet.")
        view = kit.View("Board", {"axis": "time", "end": 1.0, "plots": [], "marks": [], "group": "live"})
    shown = [""]

    def look() -> None:
        path = job.folder / LIVE
        if not path.exists():
            return
        newest = json.loads(path.read_text(encoding="utf-8"))
        curves = bench.curves(job, newest["set"])
        if newest["set"] == shown[0] or curves is None or not curves.signals:
            return
        shown[0] = newest["set"]
        waiting.set_visibility(False)
        view.show({**board(f"{job.key}/{newest['set']}", curves), "group": "live"})

    ui.timer(1.0, look)


def _play(bench: Workbench) -> None:
    """Play the newest estimate: the cursor runs at the pace of the drive, and all views follow."""
    done: list[Job] = bench.done("estimate")
    if not done:
        kit.words("Without a running observer, an estimate can be played here as if it were live (stage Estimate).")
        return
    from vsense_ros.studio.stages.estimate import board

    job = done[0]
    curves = bench.curves(job)
    if curves is None:
        return
    key = f"{job.key}/curves"
    with ui.element("div").classes("vs-row"):
        kit.words(job.result["title"])
        for name, speed in (("Play", 1.0), ("Play ×5", 5.0), ("Stop", 0.0)):
            ui.button(
                name, on_click=lambda speed=speed: ui.run_javascript(f"VSense.play({speed}, {curves.duration:.3f})")
            ).props("flat dense no-caps")
    with ui.element("div").classes("vs-columns estimate"):
        with ui.element("div"), kit.panel("Curves", "the last ten seconds follow the cursor while it plays"):
            kit.View("Board", board(key, curves))
        with ui.element("div"):
            with kit.panel("Tyre forces from above"):
                kit.View("Car", {"set": key, "loads": job.result["static_loads"], "height": 330,
                                 "label": "The car from above with the force at each tyre"})  # fmt: skip
            with kit.panel("Path"):
                paths = [{"set": key, "x": "east", "y": "north", "label": "estimate"}]
                kit.View("Path", {"paths": paths, "height": 240, "label": "Path"})


STAGE = Stage(
    "live", "Drive live", "The topics of a running observer, by the same views; Foxglove stays.", build,
    lambda bench: "ready",
)  # fmt: skip
