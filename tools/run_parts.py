"""Where the time of a run goes, in µs a message: `python tools/run_parts.py bags/double_lane_change prototype_model`.

Every call of a part is timed without the parts that it calls, and the median of its calls stands for all of them, as a
busy machine interrupts some for a long time. What C does alone is an upper bound of how fast a run can be without
another method. With `--into PAGE` the table is a section of that page.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import vsense_ros as vs
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.playing import play
from vsense_ros.runner.run import Collected, topics_in
from vsense_ros.runner.runner import Runner

TITLE = "## A run, by its parts"
INTERVAL = 9_990_000  # [ns] between estimates
PARTS = {  # by what they belong to: names of methods, from the runner on
    "steps, compiled": ("filter.advance",),
    "corrections, compiled": ("filter.correct",),
    "what late messages have done again, compiled": ("filter.repeat",),
    "past of the filter": ("_timeline.add", "_timeline.catch_up"),
    "intake": ("intake.examine", "intake.timing", "intake.believe"),
    "judges and lags": ("judges.before", "judges.hear", "judges.settle", "latency.hear_first"),
    "vote": ("vote.correct", "vote.decide", "vote.due"),
    "what the runner does with a message besides": ("take",),
    "estimates": ("incomplete_snapshot",),
}
COMPILED = tuple(part for part in PARTS if part.endswith("compiled"))
READING, COLUMNS = "reading in order of arrival", "columns of the output"


@dataclass
class Clock:
    """Times of calls by part [s], without those of calls within them."""

    found: dict[str, list[float]] = field(default_factory=dict)
    _within: list[float] = field(default_factory=lambda: [0.0])

    def timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, timed."""
        found, within = self.found.setdefault(part, []), self._within

        def call(*arguments: Any, **named: Any) -> Any:
            within.append(0.0)
            begun = time.perf_counter()
            try:
                return function(*arguments, **named)
            finally:
                passed = time.perf_counter() - begun
                found.append(passed - within.pop())
                within[-1] += passed

        return call

    def of(self, part: str, messages: int) -> float:
        """Time of a part for a message [µs]."""
        times = self.found.get(part) or [0.0]
        return 1e6 * float(np.median(times)) * len(times) / messages


def measured(recording: Recording, car: Vehicle) -> tuple[dict[str, float], int]:
    """Time of each part for a message [µs], and the number of messages."""
    clock, runner = Clock(), Runner(car, recording.map_origin)
    for part, methods in PARTS.items():
        for method in methods:
            *way, name = method.split(".")
            owner: Any = runner
            for step in way:
                owner = getattr(owner, step)
            setattr(owner, name, clock.timed(f"{part}: {method}", getattr(owner, name)))
    collected = Collected(runner.adapter)
    runner.adapter.columns = clock.timed(COLUMNS, runner.adapter.columns)  # type: ignore[method-assign]
    played = play(runner, recording, topics_in(recording, runner.topics))
    following = clock.timed(READING, lambda: next(played, "end"))
    last, messages = 0, 0
    while following() is None:
        messages += 1
        if runner.started and runner.stamp >= last + INTERVAL:
            last = runner.stamp
            collected.add(runner.incomplete_snapshot())
    times = {part: sum(clock.of(f"{part}: {m}", messages) for m in methods) for part, methods in PARTS.items()}
    return times | {part: clock.of(part, messages) for part in (READING, COLUMNS)}, messages


def section(source: str, recording: Recording, car: Vehicle) -> str:
    """The table."""
    measured(recording, car)  # what is compiled is there then
    times, messages = measured(recording, car)
    whole, compiled = sum(times.values()), sum(times[part] for part in COMPILED)
    spans = [1e6 * recording.duration / messages / each for each in (whole, compiled)]
    rows = sorted(times.items(), key=lambda row: -row[1])
    return "\n".join([
        TITLE, "",
        f"Made by `python tools/run_parts.py {source}`: {messages:,} messages in {recording.duration:.1f} s, in",
        "the order of their arrival, with an estimate every 10 ms. Each part is without the parts that it calls.",
        "Timing them adds some microseconds to the sum.", "",
        "| part | for a message |", "|---|---|", *(f"| {part} | {micros:.1f} µs |" for part, micros in rows),
        f"| together | {whole:.1f} µs |", "",
        f"That is {spans[0]:.0f} × real time. What is compiled takes {compiled:.1f} µs of it: with nothing around it",
        f"the same filter would run at {spans[1]:.0f} × real time, beyond which a step itself must become cheaper.", "",
    ])  # fmt: skip


def into(page: str, text: str, title: str = TITLE) -> str:
    """The page with this section before the one that followed an earlier one, or else before the last."""
    if title in page:
        before, _, rest = page.partition(title)
        after = rest[rest.index("\n## ") :] if "\n## " in rest else ""
    else:
        at = page.rindex("\n## ")
        before, after = page[:at], page[at:]
    return before.rstrip() + "\n\n" + text + after


def main() -> None:
    parser = argparse.ArgumentParser(prog="run_parts", description=__doc__)
    parser.add_argument("recording")
    parser.add_argument("vehicle")
    parser.add_argument("--seconds", type=float, help="of the recording [s]; default: all")
    parser.add_argument("--into", type=Path, metavar="PAGE")
    arguments = parser.parse_args()
    try:
        recording, car = vs.read(arguments.recording), vs.load_vehicle(arguments.vehicle)
    except InputError as error:
        sys.exit(f"run_parts: {error}")
    if arguments.seconds:
        end = min(int(c.received[0]) for c in recording.channels.values() if len(c)) + int(arguments.seconds * 1e9)
        channels = {topic: channel.select(channel.received < end) for topic, channel in recording.channels.items()}
        recording = replace(recording, channels=channels)
    text = section(f"{arguments.recording} {arguments.vehicle}", recording, car)
    print(text)
    if arguments.into is not None:
        arguments.into.write_text(into(arguments.into.read_text(encoding="utf-8"), text), encoding="utf-8")


if __name__ == "__main__":
    main()
