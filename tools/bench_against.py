"""Time this checkout beside another revision, part by part in turn: `python tools/bench_against.py REVISION [--quick]`.

Machines are busy, and no two are alike: a time alone says little, the ratio of two that were measured in turn within
a second says much. Each part of `tools/bench_parts.py` is run by one process of either checkout, this, that, that, this
…, and the smallest times are compared. The table is printed, and goes into out/bench.json as "against". The exit code
is 1 if a part has become slower by more than a tenth.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from bench_parts import PARTS

ROOT = Path(__file__).resolve().parents[1]
LARGEST = 1.1  # ratio from which on a part has become slower
QUICK = (
    "step error_ekf",
    "step spi",
    "messages one by one",
    "run sine_with_dwell",
    "command run",
    "read mcap",
    "live can",
    "live ubx",
)


@dataclass(frozen=True)
class Compared:
    """Smallest times of one part [s], of this checkout and of the other; NaN where it has no such part, with `why`."""

    here: float
    there: float
    why: str = ""

    @property
    def ratio(self) -> float:
        """Time of this checkout over that of the other."""
        return self.here / self.there


class Checkout:
    """A process that runs parts with the package of one checkout."""

    def __init__(self, tree: Path, folder: Path) -> None:
        environment = os.environ | {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, str(ROOT / "tools/bench_parts.py"), str(folder)]
        log = (folder / "log.txt").open("w", encoding="utf-8")
        self.process = subprocess.Popen(
            command, cwd=tree, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
        )

    def __enter__(self) -> Checkout:
        return self

    def __exit__(self, *exception: object) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()

    def seconds(self, part: str) -> tuple[float, str]:
        """Processor time of a part [s]; NaN and the reason where this checkout cannot run it."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(f"{part}\n")
        self.process.stdin.flush()
        line = self.process.stdout.readline()
        answer = json.loads(line) if line else {"error": "the process has ended; its log.txt says why"}
        return answer.get("seconds", math.nan), answer.get("error", "")


@contextmanager
def worktree(revision: str, folder: Path) -> Iterator[Path]:
    """A checkout of a revision, for as long as it is needed."""
    tree = folder / "tree"
    subprocess.run(["git", "-C", ROOT, "worktree", "add", "--quiet", "--detach", tree, revision], check=True)
    try:
        yield tree
    finally:
        subprocess.run(["git", "-C", ROOT, "worktree", "remove", "--force", tree], check=True)


def compared(here: Checkout, there: Checkout, part: str, rounds: int) -> Compared:
    """The smallest times of a part in some rounds, in each of which the other one begins."""
    found: dict[Checkout, list[float]] = {here: [], there: []}
    for i in range(rounds):
        for checkout in ((here, there), (there, here))[i % 2]:
            seconds, why = checkout.seconds(part)
            if why:
                where = "here" if checkout is here else "there"
                return Compared(math.nan, math.nan, f"does not run {where}: {why}")
            found[checkout].append(seconds)
    return Compared(min(found[here]), min(found[there]))


def duration(seconds: float) -> str:
    """A time in the unit that leaves one to three digits before the point."""
    for unit, scale in (("µs", 1e6), ("ms", 1e3)):
        if seconds * scale < 1000:
            return f"{seconds * scale:.3g} {unit}"
    return f"{seconds:.3g} s"


def keep(results: dict[str, Compared], revision: str, path: Path) -> None:
    """Write the ratios into out/bench.json, beside what `make bench` has left there, and what a message of each format
    takes here [µs] as "io"."""
    known = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    known["against"] = {part: round(one.ratio, 4) for part, one in results.items() if not one.why}
    known["against_revision"] = revision
    formats = {part: one for part, one in results.items() if part.startswith(("read ", "live ", "import "))}
    known["io"] = {part: round(1e6 * one.here, 3) for part, one in formats.items() if not one.why}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(known, indent=2) + "\n", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench_against", description=__doc__)
    parser.add_argument("revision", help="commit, tag or branch to compare with")
    parser.add_argument("--quick", action="store_true", help="a part of it, within two minutes")
    parser.add_argument("--parts", nargs="+", metavar="PART", help=f"only these: {', '.join(PARTS)}")
    parser.add_argument("--rounds", type=int, help="times that each part is run; default 7, with --quick 3")
    parser.add_argument("--out", type=Path, default=ROOT / "out/bench.json")
    arguments = parser.parse_args()
    parts = arguments.parts or (QUICK if arguments.quick else tuple(PARTS))
    if unknown := [part for part in parts if part not in PARTS]:
        parser.error(f"unknown parts: {', '.join(unknown)}; there are {', '.join(PARTS)}")
    rounds = arguments.rounds or (3 if arguments.quick else 7)
    named = subprocess.run(
        ["git", "-C", ROOT, "rev-parse", "--short", arguments.revision], check=True, capture_output=True, text=True
    ).stdout.strip()
    results: dict[str, Compared] = {}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        places = [folder / name for name in ("here", "there")]
        for place in places:
            place.mkdir()
        tree = stack.enter_context(worktree(named, folder))
        here, there = (stack.enter_context(Checkout(*each)) for each in zip((ROOT, tree), places, strict=True))
        print(f"{'part':<24}{'here':>10}{named:>10}{'ratio':>8}", flush=True)
        for part in parts:
            one = results[part] = compared(here, there, part, rounds)
            text = one.why or f"{duration(one.here):>10}{duration(one.there):>10}{one.ratio:>8.3f}"
            print(f"{part:<24}{text}", flush=True)
    keep(results, named, arguments.out)
    slower = [part for part, one in results.items() if one.ratio > LARGEST]
    if slower:
        print(f"slower by more than a tenth: {', '.join(slower)}")
    return 1 if slower else 0


if __name__ == "__main__":
    sys.exit(main())
