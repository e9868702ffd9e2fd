"""How the cost of `vsense explain` grows: `python tools/explain_growth.py docs/scaling.md`.

Over the number of candidates, of the effects that are hidden, and of the processes that share a fleet. Each row is
measured in a process of its own, on a double lane change that is generated for it. The table is a section of the page.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import run_parts

import vsense_ros as vs
from vsense_ros.bag import write_bag
from vsense_ros.files.vehicle import save_vehicle
from vsense_ros.fleet import fleet
from vsense_ros.manoeuvre import generate
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch import explain as explaining
from vsense_ros.mismatch.candidates import Candidate, candidates

TITLE = "## Explaining, by candidates, effects and workers"
VEHICLE, MANOEUVRE = "prototype_model", "double_lane_change"
HIDDEN = {  # sizes that leave traces on this drive
    "imu_yaw_misalignment": {"angle": 0.06},
    "steering_offset": {"angle": 0.02},
    "wheel_radius": {"fl": 0.02},
}
EVERY = (8, 4, 2, 1)  # which of the library's candidates are offered: every so manieth
WORKERS, DRIVES = (1, 2), 4


@dataclass(frozen=True)
class Cost:
    """What a row is about, the time that passed and the processor time [s], and what was answered."""

    what: str
    passed: float
    processor: float
    answer: str


def driven(effects: int, seed: int = 1) -> Recording:
    """A drive of the car with the first so many of the effects."""
    car = vs.load_vehicle(VEHICLE)
    raw = car.model_dump()
    raw["physics"]["effects"] = dict(list(HIDDEN.items())[:effects])
    return generate(MANOEUVRE, type(car).model_validate(raw), seed)


def processor_time() -> float:
    """Processor time of this process and of those that it has waited for [s]."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def by_candidates(every: int) -> Cost:
    """One effect is hidden, and some of the library are offered."""
    offered = 0

    def some(*arguments: Any) -> tuple[Candidate, ...]:
        nonlocal offered
        there = tuple(c for i, c in enumerate(candidates(*arguments)) if not i % every or c.effect in list(HIDDEN)[:1])
        offered = len(there)
        return there

    vars(explaining)["candidates"] = some
    cost = by_effects(1)
    return Cost(f"{offered} candidates", cost.passed, cost.processor, cost.answer)


def by_effects(effects: int) -> Cost:
    """So many effects are hidden."""
    recording = driven(effects)
    begun, before = time.perf_counter(), processor_time()
    answer = vs.explain(recording, VEHICLE, observe=False).answer
    found = ", ".join(effect.id for effect in answer.accepted)
    cost = time.perf_counter() - begun, processor_time() - before
    return Cost(f"{effects} effects", *cost, f"{answer.verdict} {found}".strip())


def by_workers(workers: int) -> Cost:
    """A fleet of some drives with one effect each, shared by so many processes of this machine."""
    with tempfile.TemporaryDirectory() as folder:
        cars, out = Path(folder) / "cars", Path(folder) / "out"
        for i in range(DRIVES):
            (cars / f"car_{i}").mkdir(parents=True)
            write_bag(cars / f"car_{i}" / "drive", driven(1, seed=i))
        save_vehicle(cars / fleet.VEHICLE_FILE, vs.load_vehicle(VEHICLE))
        out.mkdir()
        begun, before = time.perf_counter(), processor_time()
        with fleet.workers(None, workers) as client:
            results = fleet.explain_fleet(fleet.members(cars), out, client)
        passed = time.perf_counter() - begun
    verdicts = [result.outcome.verdict for result in results]
    said = ", ".join(f"{verdicts.count(each)} {each}" for each in sorted(set(verdicts)))
    return Cost(f"{DRIVES} drives, workers: {workers}", passed, processor_time() - before, said)


ROWS = {
    **{f"candidates {every}": (by_candidates, every) for every in EVERY},
    **{f"effects {count}": (by_effects, count) for count in range(len(HIDDEN) + 1)},
    **{f"workers {count}": (by_workers, count) for count in WORKERS},
}


def in_process_of_its_own(row: str) -> Cost:
    done = subprocess.run([sys.executable, __file__, "--row", row], check=True, stdout=subprocess.PIPE, text=True)
    return Cost(**json.loads(done.stdout.splitlines()[-1]))


def section(costs: list[Cost]) -> str:
    """The table."""
    return "\n".join([
        TITLE, "",
        f"Made by `python tools/explain_growth.py docs/scaling.md`: a generated {MANOEUVRE.replace('_', ' ')} of 12 s,",
        f"with none or some of {', '.join(HIDDEN)} hidden in the car, in this order.",
        "With fewer candidates than the library has, the one that is hidden is among them. Processor time is that of",
        "all processes; on a machine that is busy with something else more time passes.", "",
        "| | processor time | time that passed | answer |", "|---|---|---|---|",
        *(f"| {c.what} | {c.processor:.1f} s | {c.passed:.1f} s | {c.answer} |" for c in costs), "",
    ])  # fmt: skip


def measured() -> list[Cost]:
    """All rows, each of which is printed when it is there."""
    costs = []
    in_process_of_its_own("effects 0")  # what is compiled is there then
    for row in ROWS:
        costs.append(in_process_of_its_own(row))
        print(costs[-1], flush=True)
    return costs


def main() -> None:
    parser = argparse.ArgumentParser(prog="explain_growth", description=__doc__)
    parser.add_argument("page", type=Path, nargs="?")
    parser.add_argument("--row", choices=ROWS)
    arguments = parser.parse_args()
    if arguments.row:
        function, number = ROWS[arguments.row]
        print(json.dumps(asdict(function(number))))
        return
    text = section(measured())
    if arguments.page is not None:
        page = run_parts.into(arguments.page.read_text(encoding="utf-8"), text, TITLE)
        arguments.page.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
