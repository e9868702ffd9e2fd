"""What a person at a terminal sees: progress bars and tables."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from math import isnan
from typing import IO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from vsense_ros.checks.inspect import Inspection
from vsense_ros.evaluate.drive import Drive
from vsense_ros.evaluate.signals import SIGNALS
from vsense_ros.evaluate.wording import HEADINGS, balance_in_words, named, score_cells
from vsense_ros.files.names import printable

PIPE_WIDTH = 110  # of lines that go into a file or a pipe


class PlainConsole(Console):
    """A console to which brackets mean nothing, and whose texts cannot steer the terminal: names of topics, vehicles
    and files are what somebody else wrote."""

    def __init__(self, *, stderr: bool = False, width: int | None = None, file: IO[str] | None = None) -> None:
        super().__init__(stderr=stderr, width=width, file=file, highlight=False, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=printable(segment.text))


def console(*, stderr: bool = False) -> Console:
    """A console as wide as the terminal; in a pipe wide enough for the tables, and wider if COLUMNS says so."""
    output = PlainConsole(stderr=stderr)
    return output if output.is_terminal else PlainConsole(stderr=stderr, width=max(PIPE_WIDTH, output.width))


def say(text: str) -> None:
    """Print a sentence in one line, whatever brackets its paths and names have."""
    console().print(text, soft_wrap=True)


def plain_table(*headings: str, right: Collection[str] = ()) -> Table:
    """A table without lines; the columns named in `right` hold numbers and end at their right edge."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    for heading in headings:
        table.add_column(heading, justify="right" if heading in right else "left")
    return table


@contextmanager
def progress(label: str) -> Iterator[Callable[[float], None]]:
    """A progress bar on stderr; yields the function that takes the share done, 0 to 1. Where that is no terminal, a
    line now and then."""
    output = console(stderr=True)
    if not output.is_terminal:
        yield _lines(label, output)
        return
    bar = Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=40),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=output,
    )
    with bar:
        task = bar.add_task(label, total=1.0)

        def done(share: float) -> None:
            bar.update(task, completed=min(max(share, 0.0), 1.0))

        yield done
        bar.update(task, completed=1.0)


def _lines(label: str, output: Console, period: float = 10.0) -> Callable[[float], None]:
    """Prints the share done and the time since now, a line at most every `period` [s]."""
    begin = printed = time.monotonic()

    def done(share: float) -> None:
        nonlocal printed
        now = time.monotonic()
        if now - printed > period:
            printed = now
            output.print(f"{label}: {100 * share:.0f} % in {now - begin:.0f} s")

    return done


def in_files(done: Callable[[float], None]) -> Callable[[str, int, int], None]:
    """The progress of a number of files on a bar that takes shares."""

    def report(_: str, count: int, total: int) -> None:
        done(count / max(total, 1))

    return report


@contextmanager
def waiting(label: str) -> Iterator[None]:
    """A moving sign on stderr for work whose length is not known beforehand."""
    with console(stderr=True).status(Text(label)):
        yield


def show_drive(drive: Drive, out: Console) -> None:
    """Print what a drive came to: one table, what had no reference, time and losses."""
    out.print()
    out.print(Text(drive.title, style="bold"))
    facts = [*drive.facts(), *([drive.way] if drive.way else [])]
    out.print(Text(" · ".join(facts), style="dim"))
    if drive.scores:
        out.print(_score_table(drive))
    else:
        out.print("This recording has no reference for anything that was estimated.")
    if drive.unreferenced:
        out.print(f"Without a reference: {named(drive.unreferenced)}.")
    if drive.balance is not None:
        out.print(f"{balance_in_words(drive.balance)}.")
    out.print(
        f"Compute time {drive.step_us_median:.0f} µs per step (median), real-time factor {drive.realtime_factor:.3g}, "
        f"messages lost {drive.messages_lost}."
    )
    for note in drive.notes:
        out.print(Text(f"Note: {note}"))
    for status in drive.diagnostics:
        if status.level > 0:
            out.print(Text(f"{status.level.name} {status.name}: {status.message}", style="yellow"))


def show_inspection(inspection: Inspection, out: Console) -> None:
    """Print what a recording holds and every doubt about it."""
    start = datetime.fromtimestamp(inspection.start * 1e-9, UTC)
    out.print(Text(inspection.name or "recording", style="bold"))
    lost = f", {inspection.messages_lost} messages lost" if inspection.messages_lost else ""
    out.print(f"{inspection.duration:.1f} s from {start:%Y-%m-%d %H:%M:%S} UTC{lost}")
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    table.add_column("topic", overflow="fold")
    table.add_column("type", no_wrap=True)
    for heading in ("messages", "rate", "latency", "longest gap"):
        table.add_column(heading, justify="right", no_wrap=True)
    for topic in inspection.topics:
        gap = max((silence.length for silence in topic.gaps), default=0.0)
        table.add_row(
            topic.topic,
            topic.kind.rsplit("/", 1)[-1],
            str(topic.count),
            "–" if isnan(topic.rate_hz) else f"{topic.rate_hz:.4g} Hz",
            "–" if isnan(topic.latency_median) else f"{topic.latency_median * 1e3:.1f} ms",
            f"{gap:.2f} s" if gap else "–",
        )
    out.print(table)
    for topic in inspection.topics:
        if topic.constant:
            out.print(Text(f"{topic.topic}: never changes: {', '.join(topic.constant)}", style="dim"))
    if inspection.missing:
        out.print(Text(f"Not in it: {', '.join(inspection.missing)}", style="dim"))
    for note in inspection.notes:
        out.print(Text(f"Note: {note}"))
    for problem in inspection.problems:
        out.print(Text(f"Look at {problem}", style="yellow"))
    if not inspection.problems:
        out.print("Nothing looks wrong.")


def _score_table(drive: Drive) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 1))
    table.add_column("signal", no_wrap=True)
    for heading in HEADINGS:
        table.add_column(heading, justify="right", no_wrap=True)
    for name, result in drive.scores.items():
        table.add_row(SIGNALS[name].label, *score_cells(name, result, drive.trivial.get(name)))
        for label, scores in drive.baselines.items():
            if name in scores:
                table.add_row(f"  {label}", *score_cells(name, scores[name]), style="dim")
    return table
