"""A process that does one job: it waits for the folder of the job on its standard input, and writes the result there.

`python -m vsense_ros.studio.worker` imports what jobs need while it waits, so that a job begins at once.
"""

from __future__ import annotations

import fcntl
import json
import os
import select
import sys
import time
import traceback
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from vsense_ros.errors import InputError
from vsense_ros.extras import explained
from vsense_ros.files.atomic import atomic_write
from vsense_ros.studio.jobs import ERROR, LOCK, PROGRESS, RESULT, TASK

_PAUSE = 0.2  # [s] between two reports of progress


def progress_in(folder: Path) -> Callable[[float], None]:
    """A function that writes the share done into the folder of a job, a few times in a second at most."""
    written = [0.0]

    def report(share: float) -> None:
        now = time.monotonic()
        if now - written[0] >= _PAUSE:
            written[0] = now
            with atomic_write(folder / PROGRESS) as file:
                json.dump({"share": float(share)}, file)

    return report


def run_job(folder: Path) -> None:
    """Do the job in a folder; what it ends with is written there, never raised."""
    from vsense_ros.studio.tasks import task_of

    with (folder / LOCK).open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        task: dict[str, Any] = json.loads((folder / TASK).read_text(encoding="utf-8"))
        began = time.monotonic()
        try:
            with warnings.catch_warnings(), explained():
                warnings.simplefilter("ignore")
                result = task_of(task["kind"])(task["options"], folder, progress_in(folder))
        except (InputError, OSError) as error:
            _fail(folder, str(error))
        except Exception as error:
            (folder / "log.txt").write_text(traceback.format_exc(), encoding="utf-8")
            _fail(folder, f"This failed unexpectedly ({type(error).__name__}: {error}). Details: {folder / 'log.txt'}")
        else:
            result["seconds"] = round(time.monotonic() - began, 3)
            with atomic_write(folder / RESULT) as file:
                json.dump(result, file, default=float)


def _fail(folder: Path, sentence: str) -> None:
    with atomic_write(folder / ERROR) as file:
        file.write(sentence)


def main() -> None:
    """Wait for one folder, import what jobs need in the meantime, and do the job in it; without one, end."""
    from vsense_ros.bag.importers import importers
    from vsense_ros.studio.tasks import TASKS, task_of

    os.nice(5)
    first, *others = (partial(task_of, kind) for kind in TASKS)
    steps: list[Callable[[], object]] = [first, importers, *others]
    for prepare in steps:
        if select.select([sys.stdin], [], [], 0)[0]:
            break
        prepare()
    line = sys.stdin.readline().strip()
    if line:
        run_job(Path(line))


if __name__ == "__main__":
    main()
