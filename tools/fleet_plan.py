"""A plan for a night of many drives, as arithmetic: `python tools/fleet_plan.py docs/scaling.md`.

What one drive costs is read in the table of that page, which `tools/scaling.py` measured. The night is then simulated
drive by drive with machines that are taken away, first with 200 drives, and the overhead of the scheduler is measured
with as many tasks that do nothing. The section of the page is written anew, and printed.
"""

from __future__ import annotations

import heapq
import re
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, log
from pathlib import Path

import numpy as np

from vsense_ros.fleet.fleet import Member, NoAnswer, Result, explain_fleet, workers

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / "bags/double_lane_change"
BAG_LENGTH = 12.1  # [s], as `vsense info` says
TITLE = "## A fleet: many drives in a night"


@dataclass(frozen=True)
class Night:
    """What is asked for, and what the machines are: assumptions, to be replaced by those of whoever plans."""

    drives: int = 100_000
    length: float = 900.0  # [s] of a drive; of longer ones as much is fitted
    hours: float = 8.0  # from the first drive to the last answer
    busy: float = 0.8  # [-] share of the night in which a core works: starting, reading and the tail take the rest
    cores: int = 64  # of a machine, and
    memory: float = 256.0  # its memory [GB]
    price: float = 0.04  # [US$] of a core for an hour, of machines that may be taken away
    taken_away: float = 0.05  # [1/h] of machines
    spread: float = 0.35  # [-] deviation of the logarithm of the time that drives of one length take
    shard: int = 500  # drives of one job
    answer: int = 300_000  # [byte] of result.json, tables and page of a drive


@dataclass(frozen=True)
class Drive:
    """What one drive takes: processor time [s], memory of its process [GB] and its file [byte]."""

    seconds: float
    memory: float
    size: float


def measured(page: str, length: float) -> Drive:
    """One drive of a length [s]: by the line through what `explain` took for the shortest and the longest recording of
    the page; memory is that of the longest, with what its preparation takes for this length."""
    found: dict[str, list[list[float]]] = {}
    row = re.compile(r"^\| ([a-z ]+) \| (\d+) s \| ([\d.]+) s \| [\d.]+ ms \| (\d+) MB \| (\d+) MB \|$", re.MULTILINE)
    for job, *numbers in row.findall(page):
        found.setdefault(job, []).append([float(number) for number in numbers])
    (first, at_first, *_), (last, at_last, memory, _) = found["explain"][0], found["explain"][-1]
    rate = (at_last - at_first) / (last - first)
    prepared = [(seconds, used) for seconds, _, used, _ in found["prepare explain"]]
    used = np.interp(length, [seconds for seconds, _ in prepared], [megabytes for _, megabytes in prepared])
    size = sum(path.stat().st_size for path in BAG.iterdir()) / BAG_LENGTH * length
    return Drive(at_last + rate * (length - last), max(memory, float(used)) / 1e3, size)


@dataclass(frozen=True)
class Simulated:
    """A night: hours until the last answer, share of the cores' time that was of use, and drives begun again."""

    hours: float
    useful: float
    repeated: int


def simulated(night: Night, drive: Drive, drives: int, cores: int, seed: int = 1) -> Simulated:
    """Drives one after the other on each core; a core that is taken away loses its drive, which is begun again, and is
    there again after five minutes."""
    random = np.random.default_rng(seed)
    mean = log(drive.seconds) - night.spread**2 / 2
    waiting = np.sort(random.lognormal(mean, night.spread, drives)).tolist()  # the longest first, as pop takes them
    free = [(0.0, core) for core in range(cores)]
    heapq.heapify(free)
    useful, repeated, end = sum(waiting), 0, 0.0
    while waiting:
        now, core = heapq.heappop(free)
        seconds = waiting.pop()
        until_taken = random.exponential(3600 / night.taken_away)
        if until_taken < seconds:
            repeated += 1
            waiting.append(seconds)
            heapq.heappush(free, (now + until_taken + 300, core))
            continue
        heapq.heappush(free, (now + seconds, core))
        end = max(end, now + seconds)
    return Simulated(end / 3600, useful / (end * cores), repeated)


def _nothing(member: Member, out: Path, progress: Callable[[float], None]) -> Result:
    progress(1.0)
    return Result(key="", vehicle=member.name, recordings=(), outcome=NoAnswer(verdict="failed", sentence="nothing"))


def overhead(drives: int) -> float:
    """Time that the scheduler, with two processes of this machine, takes for a task that does nothing [s]."""
    fleet = [Member(f"car_{i}", None, {}, {}) for i in range(drives)]
    with tempfile.TemporaryDirectory() as folder, workers(None, 2) as client:
        client.submit(time.sleep, 0.0).result()
        begun = time.perf_counter()
        explain_fleet(fleet, Path(folder), client, _nothing)
        return (time.perf_counter() - begun) / drives


def section(page: str, night: Night) -> str:
    """The plan, with its arithmetic."""
    drive = measured(page, night.length)
    core_hours = night.drives * drive.seconds / 3600
    cores = ceil(core_hours / night.hours / night.busy)
    fitting = min(night.cores, int(night.memory / drive.memory))
    machines = ceil(cores / fitting)
    read, rate = night.drives * drive.size, night.drives * drive.size / (night.hours * 3600)
    written = night.drives * night.answer
    lost = night.drives * night.taken_away * drive.seconds / 3600
    small_cores = max(1, ceil(200 * drive.seconds / 3600 / night.hours / night.busy))
    small = simulated(night, drive, 200, small_cores)
    whole = simulated(night, drive, night.drives, cores)
    each = overhead(200)
    shards = ceil(night.drives / night.shard)
    rows = [
        ("one drive", f"{night.length:.0f} s", "assumed; `explain` fits no more of a longer one"),
        ("its file", f"{drive.size / 1e6:.0f} MB", f"the bag of {BAG_LENGTH} s, its size times the length"),
        ("its processor time", f"{drive.seconds:.0f} s", "the line through the table above"),
        ("its memory", f"{drive.memory:.2f} GB", "the table above"),
        ("read in all", f"{read / 1e12:.1f} TB", f"{night.drives:,} × {drive.size / 1e6:.0f} MB"),
        ("network", f"{rate / 1e6:.0f} MB/s", f"in {night.hours:g} h"),
        ("written", f"{written / 1e9:.0f} GB", f"{night.answer / 1e3:.0f} kB an answer"),
        ("processors", f"{core_hours:,.0f} core hours", f"{night.drives:,} × {drive.seconds:.0f} s"),
        ("cores", f"{cores:,}", f"in {night.hours:g} h, {100 * night.busy:.0f} % of it busy"),
        ("machines", f"{machines}", f"{night.cores} cores and {night.memory:g} GB, which hold {fitting} processes"),
        ("cost", f"{core_hours / night.busy * night.price:,.0f} US$", f"{night.price:g} US$ a core and hour"),
        ("begun again", f"{lost:.0f}", f"{100 * night.taken_away:g} % of the machines taken away in an hour"),
        ("jobs", f"{shards}", f"of {night.shard} drives each"),
        (
            "200 drives, simulated",
            f"{small.hours:.1f} h",
            f"{small_cores} cores, {100 * small.useful:.0f} % of their time of use, {small.repeated} begun again",
        ),
        (
            f"{night.drives:,} drives, simulated",
            f"{whole.hours:.1f} h",
            f"{cores:,} cores, {100 * whole.useful:.0f} % of their time of use, {whole.repeated} begun again",
        ),
        (
            "scheduler",
            f"{1e3 * each:.0f} ms a drive",
            f"200 tasks that do nothing; one scheduler would keep {drive.seconds / each:,.0f} cores busy",
        ),
    ]
    return "\n".join([
        TITLE, "",
        "Printed by `python tools/fleet_plan.py docs/scaling.md`, which says what it assumes: put your own there.",
        "", "| | | from |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in rows), "",
        f"- *Scheduling*: jobs of {night.shard} drives, each `vsense explain --fleet FOLDER --report OUT` with its own",
        "  scheduler and workers on one machine, so that no scheduler sees more than one machine: an array of a batch",
        "  system, longest drives first. A cluster that there is already is given by `--scheduler`.",
        "- *Failure*: what is finished is kept by drive. A job that lost its machine is started again and does the",
        "  rest: a drive whose key is unchanged is read, not computed. A drive that ends its process is tried once",
        "  more, alone, then reported as failed, and never stops others; as those that are tried again take their turn",
        "  one after the other, jobs are small.",
        "- *More machines than one*: `dask ssh --nthreads 1 --nworkers 64 HOST…` (or `SSHCluster` of `distributed`) on",
        "  a network that nobody else reaches begins a scheduler, whose address `--scheduler` takes; all see one",
        "  folder.",
        "- *Bytes*: a drive is read once, by the process that explains it, and nothing is shared but its vehicle file.",
        "",
    ])  # fmt: skip


def with_section(page: str, text: str) -> str:
    """The page with this section as its last one, in place of an earlier one."""
    return page.split(TITLE)[0].rstrip() + "\n\n" + text


def main() -> None:
    path = Path(sys.argv[1])
    page = path.read_text(encoding="utf-8")
    text = section(page, Night())
    path.write_text(with_section(page, text), encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
