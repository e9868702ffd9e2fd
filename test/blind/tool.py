"""The tool on one case: a process of its own that is given the case's folder and cannot see the labels."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path

TIMEOUT = 1800  # [s]
ABLATIONS = ("no_refit", "no_projection", "chi2_thresholds")


@dataclass(frozen=True)
class Answer:
    """What the tool said, and what it cost."""

    explain: dict  # its explain.json; empty where it gave none
    cpu: float  # [s]
    fault: str = ""  # what it printed where it gave no answer


def command(case: Path, report: Path, *options: str) -> list[str]:
    """The tool's command line for a case."""
    recordings = json.loads((case / "case.json").read_text(encoding="utf-8"))
    line = [str(Path(sys.executable).with_name("vsense")), "explain"]
    line += [str(case / name) for name in recordings["train"]]
    line += ["--vehicle", str(case / "vehicle.yaml")]
    for name in recordings["held_out"]:
        line += ["--hold-out", str(case / name)]
    return [*line, "--report", str(report), *options]


def explain(case: Path, report: Path, hidden: Path, *options: str) -> Answer:
    """Run the tool, or take its earlier answer from `report`. `hidden` is a folder that it must not see."""
    kept = report / "answer.json"
    if kept.exists():
        stored = json.loads(kept.read_text(encoding="utf-8"))
        return Answer(stored["explain"], stored["cpu"], stored["fault"])
    shutil.rmtree(report, ignore_errors=True)
    report.mkdir(parents=True)
    answer = _run(concealed(command(case, report, *options), hidden), report)
    kept.write_text(json.dumps({"explain": answer.explain, "cpu": answer.cpu, "fault": answer.fault}), encoding="utf-8")
    return answer


def _run(line: list[str], report: Path) -> Answer:
    with (report / "printed.txt").open("w+", encoding="utf-8") as printed:
        process = subprocess.Popen(line, stdout=printed, stderr=subprocess.STDOUT, start_new_session=True)
        status, usage, end = 0, None, time.monotonic() + TIMEOUT
        while usage is None:
            done, status, found = os.wait4(process.pid, os.WNOHANG)
            usage = found if done else None
            if usage is None and time.monotonic() > end:
                os.killpg(process.pid, 9)
            time.sleep(0.05)
        process.returncode = os.waitstatus_to_exitcode(status)
        printed.seek(0)
        text = printed.read()
    try:
        found = json.loads((report / "explain.json").read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        return Answer({}, usage.ru_utime + usage.ru_stime, f"exit {process.returncode}: {error}\n{text[-2000:]}")
    return Answer(found, usage.ru_utime + usage.ru_stime)


def concealed(line: list[str], hidden: Path) -> list[str]:
    """A command line under which the folder `hidden` is empty: it is covered in a mount namespace of its own.

    Raises `RuntimeError` where the machine has no such namespaces.
    """
    if not _namespaces():
        raise RuntimeError("labels cannot be concealed here: `unshare --user --mount` does not work on this machine")
    script = 'mount -t tmpfs -o ro none "$0" && exec "$@"'
    return ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, str(hidden.resolve()), *line]


@cache
def _namespaces() -> bool:
    try:
        done = subprocess.run(["unshare", "--user", "--map-root-user", "--mount", "true"], capture_output=True)
    except FileNotFoundError:
        return False
    return done.returncode == 0
