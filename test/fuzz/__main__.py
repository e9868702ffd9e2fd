"""`make fuzz`: 10⁶ inputs over everything that reads, to out/fuzz.json. Each target runs in a process of its own, whose
memory and time for each input are bounded."""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from fuzz.targets import TARGETS, fuzz

LONGEST = 20  # [s] for one input
MOST_MEMORY = 1024  # [MiB]


def child(name: str, count: int, seed: int) -> int:
    """One target; says at the end how many inputs it took and how much memory."""
    (target,) = [t for t in TARGETS if t.name == name]

    def hangs(*_: object) -> None:
        raise TimeoutError(f"no end within {LONGEST} s")

    signal.signal(signal.SIGALRM, hangs)

    def done(number: int) -> None:
        signal.alarm(4 * LONGEST)  # for 64 inputs

    done(0)
    fuzz(target, count, seed, done)
    signal.alarm(0)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps({"inputs": count, "peak_mib": round(peak)}))
    return 0 if peak <= MOST_MEMORY else 1


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="targets; default: all")
    parser.add_argument("--inputs", type=int, default=1_000_000, help="over all targets; default: 1000000")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--child", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--output", type=Path, default=Path("out/fuzz.json"))
    given = parser.parse_args()
    if given.child:
        return child(given.child[0], int(given.child[1]), given.seed)
    found: dict[str, Any] = {}
    jobs = [t for t in TARGETS if not given.names or t.name in given.names]
    running: dict[str, tuple[subprocess.Popen[str], float]] = {}
    waiting = sorted(jobs, key=lambda t: t.name not in ("importers", "observer", "MCAP", "YAML"))
    while waiting or running:
        while waiting and len(running) < (os.cpu_count() or 1):
            target = waiting.pop(0)
            count = max(1, round(given.inputs * target.share))
            command = [sys.executable, "-m", "fuzz", "--child", target.name, str(count), "--seed", str(given.seed)]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            running[target.name] = (process, time.monotonic())
        for name, (process, began) in list(running.items()):
            try:
                out, err = process.communicate(timeout=0.2)
            except subprocess.TimeoutExpired:
                continue
            del running[name]
            result = json.loads(out.splitlines()[-1]) if out.strip() else {}
            found[name] = {**result, "holds": process.returncode == 0, "seconds": round(time.monotonic() - began, 1)}
            if process.returncode:
                found[name]["broke"] = err.strip()[-3000:]
                print(f"{name}: {err[-1500:]}", file=sys.stderr)
            print(f"{name:<18} {found[name]}"[:150], flush=True)
    total = sum(result.get("inputs", 0) for result in found.values())
    print(f"{total} inputs, {sum(not r['holds'] for r in found.values())} of {len(found)} targets broke")
    given.output.parent.mkdir(parents=True, exist_ok=True)
    before = json.loads(given.output.read_text(encoding="utf-8")) if given.output.exists() else {}  # with coverage
    content = before | {"inputs": total, "targets": found}
    given.output.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    return 1 if any(not result["holds"] for result in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
