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

from vsense_ros.errors import InputError
from vsense_ros.mismatch import answer_schema as explain_json

TIMEOUT = 1800  # [s]
KEPT = "answer.json"
UNSHARE = ("unshare", "--user", "--map-root-user", "--mount")
ABLATIONS = ("no_refit", "no_projection", "chi2_thresholds")


@dataclass(frozen=True)
class Answer:
    """What the tool said, and what it cost."""

    explain: explain_json.Answer | None  # its explain.json; None where it gave none
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
    return [*line, "--no-observer", "--report", str(report), *options]


def explain(case: Path, report: Path, *options: str, hidden: Path | None) -> Answer:
    """Run the tool, or take its earlier answer from `report`. `hidden` is a folder that it must not see."""
    if answer := earlier(report):
        return answer
    shutil.rmtree(report, ignore_errors=True)
    report.mkdir(parents=True)
    line = command(case, report, *options)
    answer = _run(concealed(line, hidden) if hidden else line, report)
    (report / KEPT).write_text(json.dumps(_content(answer)), encoding="utf-8")
    return answer


def _content(answer: Answer) -> dict:
    explain = answer.explain.as_json() if answer.explain else {}
    return {"explain": explain, "cpu": answer.cpu, "fault": answer.fault}


def earlier(report: Path) -> Answer | None:
    """The answer that `explain` has left in a folder, if there is one. Raises `InputError` for one of another version
    of the tool, whose explain.json says other things."""
    try:
        kept = json.loads((report / KEPT).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    explain = explain_json.parsed(kept["explain"], str(report / KEPT)) if kept["explain"] else None
    return Answer(explain, kept["cpu"], kept.get("fault", ""))


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
        found = explain_json.read_answer(report)
    except (OSError, InputError) as error:
        return Answer(None, usage.ru_utime + usage.ru_stime, f"exit {process.returncode}: {error}\n{text[-2000:]}")
    return Answer(found, usage.ru_utime + usage.ru_stime)


def concealed(line: list[str], hidden: Path) -> list[str]:
    """A command line under which the folder `hidden` is empty: covered in a mount namespace of its own."""
    script = 'mount -t tmpfs -o ro none "$0" && exec "$@"'
    return [*UNSHARE, "sh", "-c", script, str(hidden.resolve()), *line]


@cache
def can_conceal() -> bool:
    """True if this machine lets its users have mount namespaces."""
    try:
        return subprocess.run([*UNSHARE, "true"], capture_output=True).returncode == 0
    except FileNotFoundError:
        return False
