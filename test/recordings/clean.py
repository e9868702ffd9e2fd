"""Recordings with nothing wrong: whatever a check finds in them, or mends, it should have left alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from recordings.conventions import SIZES
from vsense_ros.checks.inspect import inspect
from vsense_ros.checks.mending import mends
from vsense_ros.checks.sentences import sentence
from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.manoeuvre import MANOEUVRES, recorded, upright_drive
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle

VEHICLES = ("prototype_real", "rav4", "genesis", "prototype_model")


LONGEST = 25.0  # [s] of a manoeuvre: long ones, and full cars on rough roads, take minutes to simulate


def _motions() -> list[tuple[str, Vehicle]]:
    """Every short manoeuvre on level ground with every vehicle."""
    cars = [load_vehicle(vehicle_path(name)) for name in VEHICLES]
    short = [name for name, m in MANOEUVRES.items() if m.surface is None and m.duration <= LONGEST]
    return [(name, car) for name in short for car in cars]


def clean(count: int) -> Iterator[tuple[str, Recording]]:
    """Recordings of cars that do not overturn, of three sizes (`conventions.SIZES`), with other noise each time.

    The motion takes most of the time: each is simulated once, and recorded as often as `count` needs.
    """
    motions = _motions()
    made = 0
    for index, (name, car) in enumerate(motions):
        try:
            trajectory = upright_drive(name, car)
        except InputError:
            continue
        times = -(-(count - made) // (len(motions) - index))
        for seed in range(1, times + 1):
            size = SIZES[made % len(SIZES)]
            made += 1
            yield f"{car.name}, {size.name}, {name}, noise {seed}", size.of(recorded(name, trajectory, car, seed))


@dataclass
class Examined:
    """What was found in clean recordings, and what would have been changed in them."""

    recordings: int = 0
    doubted: list[str] = field(default_factory=list)  # names of recordings with problems
    problems: list[str] = field(default_factory=list)
    mended: list[str] = field(default_factory=list)  # names of recordings, each with what would be done to it


def examined(count: int, done: Callable[[float], None] = lambda share: None) -> Examined:
    """The checks and the mends of `count` clean recordings; `done` gets the share that is done."""
    found = Examined()
    for name, recording in clean(count):
        found.recordings += 1
        problems = [f"{name}: {problem}" for problem in inspect(recording).problems]
        found.problems += problems
        found.doubted += [name] if problems else []
        wrong = [sentence(finding) for finding in mends(recording)]
        found.mended += [f"{name}: {'; '.join(wrong)}"] if wrong else []
        done(found.recordings / count)
    return found
