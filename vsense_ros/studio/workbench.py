"""What the stages of one page share: the project, its jobs, and the way from one stage to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vsense_ros.errors import InputError
from vsense_ros.studio.curves import CurveSet, open_curves
from vsense_ros.studio.jobs import Job, Jobs, Status
from vsense_ros.studio.project import Drive, Project


@dataclass
class Workbench:
    """One page of the workbench. `go` shows a stage, `refresh` draws the present one anew, `uploaded` takes files that
    were sent to it."""

    project: Project
    jobs: Jobs
    go: Callable[[str], None] = lambda stage: None
    refresh: Callable[[], None] = lambda: None
    uploaded: Callable[[list[Path]], None] = lambda paths: None
    page: dict[str, Any] = field(default_factory=dict)  # what this tab remembers, such as signals that are shown

    @property
    def vehicle(self) -> str:
        """Path of the vehicle file; empty before one was chosen."""
        return self.project.state.vehicle

    @property
    def drives(self) -> list[Drive]:
        """The recordings of the project."""
        return self.project.state.drives

    def training(self) -> list[Drive]:
        """Recordings to fit to."""
        return [drive for drive in self.drives if not drive.held_out]

    def held_out(self) -> list[Drive]:
        """Recordings for validation only."""
        return [drive for drive in self.drives if drive.held_out]

    def start(
        self, kind: str, options: dict[str, Any], drives: list[Drive], *, vehicle: str = "", again: bool = True
    ) -> Job:
        """Start a job about recordings and a vehicle, whose content becomes part of its key, as `Jobs.start` does.
        Raises `InputError` for files outside of the folders that were opened."""
        files: dict[str, Path] = {}
        for i, drive in enumerate(drives):
            files[f"recording {i}"] = self.project.inside(drive.path)
            for name, extra in (("mapping", drive.mapping), ("database", drive.database)):
                if extra:
                    files[f"{name} {i}"] = self.project.inside(extra)
        if vehicle:
            files["vehicle"] = self.project.inside(vehicle)
            options = {**options, "vehicle": str(files["vehicle"])}
        return self.jobs.start(kind, options, files, again=again)

    def source(self, drive: Drive) -> dict[str, str]:
        """A recording as tasks take it."""
        return {"path": str(self.project.inside(drive.path)), "mapping": drive.mapping, "dbc": drive.database}

    def job(self, key: str) -> Job:
        """A job by its key."""
        return self.jobs.find(key)

    def newest(self, stage: str) -> Job | None:
        """The job of a stage that was started last, if there is one."""
        keys = self.project.state.results.get(stage, [])
        return self.job(keys[0]) if keys else None

    def done(self, stage: str) -> list[Job]:
        """All finished jobs of a stage, the newest first."""
        jobs = [self.job(key) for key in self.project.state.results.get(stage, [])]
        return [job for job in jobs if job.status is Status.DONE]

    def curves(self, job: Job, folder: str = "curves") -> CurveSet | None:
        """The curves of a job, if it has written any."""
        try:
            return open_curves(job.folder / folder)
        except InputError:
            return None

    def missing(self, *, recordings: bool = True, checked: bool = False) -> str:
        """Why a stage cannot run yet, as a sentence; empty if it can."""
        if not self.vehicle:
            return "Choose or write a vehicle file first (stage Car)."
        if recordings and not self.training():
            return "Open a recording first (stage Data)."
        if checked:
            return self._unchecked()
        return ""

    def _unchecked(self) -> str:
        job = self.newest("check")
        if job is None or job.status is not Status.DONE:
            return "Run Check first: what is wrong with the signals would be taken for physics."
        names = {one["path"] for one in job.result["drives"]}
        if any(str(self.project.inside(drive.path)) not in names for drive in self.drives):
            return "A recording was opened since the last check; run Check again."
        blocking = [one["name"] for one in job.result["drives"] if one["blocking"]]
        if blocking and not self.project.state.settings.get("mend"):
            return f"Check found signals that need a mend in {', '.join(blocking)}; accept the mends there first."
        return ""
