"""`make vehicle`: all checks, a table, and out/vehicle.json. Names of checks, or parts of them, choose some."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

from vehicle import bags, frames, launched, lifecycle, soak, sources, viewing  # noqa: F401
from vehicle.workshop import CHECKS, LeftOut, workshop
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="TEXT", help="only checks with one of these texts in their names")
    parser.add_argument("--soak", type=float, default=30.0, metavar="MINUTES", help="length of the soak; default: 30")
    parser.add_argument("--output", type=Path, default=Path("out/vehicle.json"))
    arguments = parser.parse_args()
    found = run_checks(arguments.names, arguments.soak)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    from rich.table import Table

    table = Table("check", "holds", "figure", title="On the vehicle")
    for name, result in found["checks"].items():
        table.add_row(name, "yes" if result["holds"] else "[red]NO[/red]", result["figure"])
    for name, reason in found["left_out"].items():
        table.add_row(name, "left out", reason)
    console().print(table)
    failed = [name for name, result in found["checks"].items() if not result["holds"]]
    print(f"{len(found['checks']) - len(failed)} of {len(found['checks'])} hold; {arguments.output}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
