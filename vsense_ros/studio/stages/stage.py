"""What a stage of the workbench is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from vsense_ros.studio.workbench import Workbench


@dataclass(frozen=True)
class Stage:
    """One stage: its name in addresses, its title, one sentence on its purpose, `build`, which makes its page, and
    `state`, which is done, ready, running, failed or locked. One that is `light` needs no model of a car, and is shown
    before these have been imported."""

    name: str
    title: str
    purpose: str
    build: Callable[[Workbench], None]
    state: Callable[[Workbench], str]
    light: bool = False


def state_of_job(bench: Workbench, stage: str, missing: str) -> str:
    """State of a stage whose result is that of its newest job; `missing` says why it cannot run."""
    job = bench.newest(stage)
    states = {"done": "done", "running": "running", "failed": "failed", "interrupted": "failed"}
    if job is not None and str(job.status) in states:
        return states[str(job.status)]
    return "locked" if missing else "ready"
