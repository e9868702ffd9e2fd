"""Work in processes of its own: with progress, cancel, and results that are kept by the content they come from.

Everything that is known of a job stands in its folder, so that a second tab, a reload or a restart of the workbench
sees the same: `task.json` (what is to be done), `progress.json`, and `result.json` or `error.txt` at its end. A worker
holds a lock on `lock` while it lives; a job without lock, result and error was interrupted.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum, auto
from hashlib import sha256
from pathlib import Path
from typing import Any

from vsense_ros.files.atomic import atomic_write
from vsense_ros.studio.project import Project, content_hash, fingerprint

TASK, PROGRESS, RESULT, ERROR, LOCK, PID = "task.json", "progress.json", "result.json", "error.txt", "lock", "pid"


class Status(StrEnum):
    """State of a job."""

    RUNNING = auto()
    DONE = auto()
    FAILED = auto()
    INTERRUPTED = auto()
    ABSENT = auto()


@dataclass(frozen=True)
class Job:
    """A job by its folder, whose name is its key."""

    folder: Path

    @property
    def key(self) -> str:
        """Key of the result: a hash of what is to be done and of all files that it reads."""
        return self.folder.name

    @property
    def task(self) -> dict[str, Any]:
        """Kind and options of the job, and the hashes of the files that it reads."""
        return _json(self.folder / TASK)

    @property
    def status(self) -> Status:
        """State of the job at this moment."""
        if (self.folder / RESULT).exists():
            return Status.DONE
        if (self.folder / ERROR).exists():
            return Status.FAILED
        if not (self.folder / TASK).exists():
            return Status.ABSENT
        begun = (self.folder / LOCK).exists()
        lives = _locked(self.folder / LOCK) if begun else _alive(self.folder / PID)
        return Status.RUNNING if lives else Status.INTERRUPTED

    @property
    def share(self) -> float:
        """Share done, 0 to 1."""
        return float(_json(self.folder / PROGRESS).get("share", 0.0))

    @property
    def result(self) -> dict[str, Any]:
        """Content of the result; empty before there is one."""
        return _json(self.folder / RESULT)

    @property
    def error(self) -> str:
        """The sentence with which the job failed."""
        path = self.folder / ERROR
        return path.read_text(encoding="utf-8") if path.exists() else ""

    def cancel(self) -> None:
        """End the process of the job, and say so in its folder."""
        path = self.folder / PID
        if self.status is Status.RUNNING and path.exists():
            os.killpg(int(path.read_text()), signal.SIGKILL)
            with atomic_write(self.folder / ERROR) as file:
                file.write("Cancelled. Nothing was kept of it; run it again when you like.")


class Jobs:
    """The jobs of a project. One worker is kept waiting with everything imported, so that a job starts at once."""

    def __init__(self, project: Project) -> None:
        self.project = project
        self._spare: subprocess.Popen[str] | None = None
        self._workers: list[subprocess.Popen[str]] = []

    def prepare(self) -> None:
        """Start the waiting worker, if there is none."""
        if self._spare is None or self._spare.poll() is not None:
            environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
            self._spare = subprocess.Popen(
                [sys.executable, "-m", "vsense_ros.studio.worker"],
                stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True, env=environment,
                start_new_session=True,
            )  # fmt: skip

    def find(self, key: str) -> Job:
        """The job with a key, whether or not it exists."""
        return Job(self.project.result_folder(key))

    def key(self, kind: str, options: Mapping[str, Any], files: Mapping[str, Path]) -> str:
        """Key of a job: equal for equal options and equal content of the files."""
        return self._key(kind, options, self._hashes(kind, files))

    def _key(self, kind: str, options: Mapping[str, Any], hashes: Mapping[str, str]) -> str:
        text = json.dumps([kind, options, hashes], sort_keys=True, default=str)
        return sha256(text.encode()).hexdigest()[:20]

    def _hashes(self, kind: str, files: Mapping[str, Path]) -> dict[str, str]:
        """Hashes of the content of files; for reading them, which shall begin at once, of their sizes and times."""
        if kind == "read":
            return {name: fingerprint(path) for name, path in files.items()}
        return {name: content_hash(path, self.project.folder) for name, path in files.items()}

    def start(self, kind: str, options: Mapping[str, Any], files: Mapping[str, Path], *, again: bool = True) -> Job:
        """Start a job, unless it has been done with the same content, or is running; one that failed only `again`.
        `files` are those that it reads, by any name; paths that a task needs stand in `options`."""
        hashes = self._hashes(kind, files)
        job = self.find(self._key(kind, options, hashes))
        status = job.status
        if status in (Status.DONE, Status.RUNNING) or (status is Status.FAILED and not again):
            return job
        job.folder.mkdir(parents=True, exist_ok=True)
        for name in (ERROR, PROGRESS):
            (job.folder / name).unlink(missing_ok=True)
        with atomic_write(job.folder / TASK) as file:
            json.dump({"kind": kind, "options": dict(options), "hashes": hashes}, file, indent=1, default=str)
        self.prepare()
        worker, self._spare = self._spare, None
        assert worker is not None
        assert worker.stdin is not None
        (job.folder / LOCK).unlink(missing_ok=True)
        (job.folder / PID).write_text(str(worker.pid))
        worker.stdin.write(f"{job.folder}\n")
        worker.stdin.close()
        self._workers = [one for one in self._workers if one.poll() is None] + [worker]
        self.prepare()
        return job

    def close(self) -> None:
        """End the waiting worker; jobs that run go on."""
        if self._spare is not None and self._spare.stdin is not None:
            self._spare.stdin.close()
            self._spare = None


def _alive(pid_file: Path) -> bool:
    """True if the process of a job lives that has not taken its lock yet."""
    try:
        pid = int(pid_file.read_text())
        with suppress(ChildProcessError):  # of an earlier workbench
            if os.waitpid(pid, os.WNOHANG)[0]:
                return False
        os.kill(pid, 0)
    except (OSError, ValueError):
        return False
    return True


def _locked(path: Path) -> bool:
    try:
        with path.open("a") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _json(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content
