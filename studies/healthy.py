"""Sensors that are left out on drives on which every sensor is right: none may be, for longer than a moment.

Cars of the repository are known too well to show that. The drives are those of a car whose file was written from a
catalogue, to the limit of its tyres, with sensors as they are: what contradicts the filter there is the model.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click
from rich.table import Table

from studies.fault_outcomes import LONGEST_OUT
from vsense_ros.cli.common import load_car
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import Runner, playing
from vsense_ros.runner.run import topics_in

_BETWEEN = 50_000_000  # [ns] from one look at what is left out to the next


class TimeOut(NamedTuple):
    """How long a sensor, or an axis of one, was left out: in all, and at a time [s]."""

    total: float = 0.0
    longest: float = 0.0


def times_out(recording: Recording, vehicle: Vehicle) -> dict[str, TimeOut]:
    """What the observer of a car leaves out of the sensors of a recording, by names of sensors and axes."""
    runner, last = Runner(vehicle, recording.map_origin), 0
    times: dict[str, TimeOut] = {}
    begun: dict[str, int] = {}  # since when what is out now has been [ns]
    for _ in playing.play(runner, recording, topics_in(recording, runner.topics)):
        now = runner.stamp
        if now < last + _BETWEEN:
            continue
        passed, last = (now - last) * 1e-9, now
        out = set(_left_out(runner))
        begun = {name: begun.get(name, now) for name in out}
        for name, since in begun.items():
            before = times.get(name, TimeOut())
            times[name] = TimeOut(before.total + passed, max(before.longest, (now - since) * 1e-9))
    return times


def _left_out(runner: Runner) -> Iterator[str]:
    """Names of the sensors that are left out now, and of axes with those of their sensors."""
    yield from (axes.name(axis) for axes, axis, _ in runner.vote.out)
    yield from (runner.names[index] for judge in runner.judges for index in judge.out)


@click.command()
@click.argument("car", metavar="CAR")
@click.argument(
    "recordings", metavar="RECORDING", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path)
)
def healthy(car: str, recordings: tuple[Path, ...]) -> None:
    """List the sensors that the observer leaves out on drives on which all of them are right.

    CAR is a vehicle file, or its name. Ends with 1 where one is out for longer than 2 s at a time.

    \b
    Examples:
      python -m studies healthy prototype_model bags/double_lane_change bags/brake_in_turn
      python -m studies healthy niki.yaml niki/Low_Speed niki/High_Speed
    """
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, plain_table

    vehicle, longest = load_car(car), 0.0
    table: Table = plain_table("recording", "out", "seconds", "of", "at a time", right=("seconds", "of", "at a time"))
    for path in recordings:
        recording = import_recording(path)
        times = times_out(recording, vehicle) or {"–": TimeOut()}
        for name, time in sorted(times.items()):
            table.add_row(path.name, name, f"{time.total:.1f}", f"{recording.duration:.0f}", f"{time.longest:.1f}")
            longest = max(longest, time.longest)
    console().print(table)
    if longest > LONGEST_OUT:
        raise SystemExit(1)
