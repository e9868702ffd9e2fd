"""`make vehicle`: all checks, a table, and out/vehicle.json. Names of checks, or parts of them, choose some."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from vehicle import bags, frames, launched, lifecycle, security, soak, sources, viewing  # noqa: F401
from vehicle.workshop import CHECKS, SECURITY, LeftOut, workshop
from vsense_ros.evaluate.terminal import console, progress


def run_checks(names: list[str], minutes: float) -> dict[str, Any]:
    """All checks, or those whose names have one of these texts in them."""
    chosen = [name for name in CHECKS if not names or any(part in name for part in names)]
    checks: dict[str, Any] = {}
    left_out: dict[str, str] = {}
    soak.minutes = minutes
    with progress("checks") as done:
        for number, name in enumerate(chosen, 1):
            began = time.monotonic()
            with tempfile.TemporaryDirectory(prefix="vsense_") as folder:
                try:
                    with workshop(Path(folder)) as shop:
                        figure = CHECKS[name](shop)
                    checks[name] = {"holds": True, "figure": figure}
                except LeftOut as reason:
                    left_out[name] = str(reason)
                except Exception as error:  # whatever a check stumbles over, the others are made
                    traceback.print_exc()
                    words = str(error).splitlines() or [type(error).__name__]
                    checks[name] = {"holds": False, "figure": words[0][:300]}
            if name in checks:
                checks[name]["seconds"] = round(time.monotonic() - began, 1)
            done(number / len(chosen))
    return {"checks": checks, "left_out": left_out}


def page(found: dict[str, Any]) -> str:
    """The results as a page."""
    cores = os.cpu_count()
    lines = [
        "# What was tried on the nodes from outside",
        "",
        'Made by `make vehicle VEHICLE="--page docs/vehicle.md"`, with what it printed last of each check:',
        f"{platform.system()} {platform.release()}, {cores} processors. Latency is from the stamp of an estimate to",
        "its publication; in a replay the measurement itself arrives 1 to 2 ms after its stamp.",
        "",
        "| check | holds | figure |",
        "|---|---|---|",
    ]
    for name, result in found["checks"].items():
        figure = str(result["figure"]).replace("|", "\\|")
        lines.append(f"| {name} | {'yes' if result['holds'] else 'NO'} | {figure} |")
    lines += [f"| {name} | left out | {reason} |" for name, reason in found["left_out"].items()]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="TEXT", help="only checks with one of these texts in their names")
    parser.add_argument("--soak", type=float, default=30.0, metavar="MINUTES", help="length of the soak; default: 30")
    parser.add_argument("--page", type=Path, help="also write the table for people, in Markdown")
    parser.add_argument("--output", type=Path, default=Path("out/vehicle.json"))
    arguments = parser.parse_args()
    found = run_checks(arguments.names, arguments.soak)
    if arguments.names and arguments.output.exists():  # what was not made now stays as it was
        before = json.loads(arguments.output.read_text(encoding="utf-8"))
        found = {part: {**before[part], **found[part]} for part in found}
    found["security"] = {name: one["holds"] for name, one in found["checks"].items() if name in SECURITY}
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    if arguments.page is not None:
        arguments.page.write_text(page(found), encoding="utf-8")
    from rich.table import Table
    from rich.text import Text

    table = Table("check", "holds", "figure", title="On the vehicle")
    for name, result in found["checks"].items():
        table.add_row(name, Text("yes") if result["holds"] else Text("NO", style="red"), result["figure"])
    for name, reason in found["left_out"].items():
        table.add_row(name, "left out", reason)
    console().print(table)
    failed = [name for name, result in found["checks"].items() if not result["holds"]]
    print(f"{len(found['checks']) - len(failed)} of {len(found['checks'])} hold; {arguments.output}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
