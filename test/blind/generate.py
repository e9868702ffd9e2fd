"""Cases to disk: many lanes per simulation, one folder per case with recordings and a vehicle file and nothing else."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np

from blind import cars, courses, knobs, vehicle_file
from blind.cases import BLIND_TO_VELOCITY, Case
from blind.courses import Course
from blind.sensors import Bench
from blind.tyres import mixed
from vsense_ros.bag import write_bag

LANES_AT_ONCE = 800
LARGEST_SIDE_SLIP = 0.21  # [rad] 12°
FINISHED = "case.json"


@dataclass(frozen=True)
class Lane:
    case: Case
    course: Course
    index: int  # of the recording in its case
    role: str  # train, held_out


def lanes_of(case: Case) -> list[Lane]:
    manoeuvres = "rich" if case.manoeuvres == BLIND_TO_VELOCITY else case.manoeuvres
    train, held_out = courses.drawn(manoeuvres, case.rng("courses"))
    roles = [("train", course) for course in train] + [("held_out", course) for course in held_out]
    return [Lane(case, course, i, role) for i, (role, course) in enumerate(roles)]


def batches(cases: list[Case]) -> Iterator[list[Case]]:
    """Cases that are simulated together: one plant, as many lanes as fit, like durations where there are many."""
    for plant in sorted({case.plant for case in cases}):
        lanes = {case.number: len(lanes_of(case)) for case in cases if case.plant == plant}
        many = sum(lanes.values()) > LANES_AT_ONCE / 2
        ordered = sorted(
            (case for case in cases if case.plant == plant),
            key=lambda c: (many and "rich" not in c.manoeuvres, c.tyre, c.number),
        )
        batch: list[Case] = []
        for case in ordered:
            other = batch and many and ("rich" in case.manoeuvres) != ("rich" in batch[0].manoeuvres)
            if batch and (other or sum(lanes[c.number] for c in [*batch, case]) > LANES_AT_ONCE):
                yield batch
                batch = []
            batch.append(case)
        if batch:
            yield batch


def seconds(batch: list[Case]) -> float:
    """Simulated time until the longest lane of a batch ends [s]."""
    return max(lane.course.duration for case in batch for lane in lanes_of(case))


def generate(batch: list[Case], folder: Path, tick: Callable[[float], None] = lambda seconds: None) -> list[str]:
    """Simulate a batch and write each case to `folder/<number>`; returns the numbers of those that lost control."""
    lanes = [lane for case in batch for lane in lanes_of(case)]
    simulate = import_module(f"blind.plants.{batch[0].plant}").simulate
    log = simulate(
        cars.side_by_side([lane.case.car for lane in lanes]),
        knobs.side_by_side([lane.case.knobs() for lane in lanes]),
        [lane.course for lane in lanes],
        mixed([lane.case.tyre for lane in lanes]),
        tick,
    )
    lost, at = [], 0
    for case in batch:
        own = lanes[at : at + len(lanes_of(case))]
        motions = [log.lane(at + i, lane.course.duration) for i, lane in enumerate(own)]
        if not all(under_control(motion) for motion in motions):
            lost.append(case.number)
        write_case(case, own, motions, folder)
        at += len(own)
    return lost


def under_control(motion: dict[str, np.ndarray]) -> bool:
    """True if the car never spun, stopped or locked a wheel: else no model says anything."""
    forward, sideways = motion["velocity"][:, 0], motion["velocity"][:, 1]
    return bool(
        np.all(np.isfinite(forward))
        and np.all(forward > 2)
        and np.all(np.abs(sideways) < np.tan(LARGEST_SIDE_SLIP) * forward)
        and np.all(motion["spin"] > 0)
    )


def write_case(case: Case, lanes: list[Lane], motions: list[dict], folder: Path) -> None:
    """Bags `train/<recording>` and `held_out/<recording>`, `vehicle.yaml`, and `case.json` when all is there."""
    target = folder / case.number
    shutil.rmtree(target, ignore_errors=True)
    mounting, biases = case.sensors()
    bench = Bench(case.grade, mounting, biases, case.knobs(), case.recorder)
    written: dict[str, list[str]] = {"train": [], "held_out": []}
    for lane, motion in zip(lanes, motions, strict=True):
        gnss = case.manoeuvres != BLIND_TO_VELOCITY
        recording = bench.record(motion, lane.course.name, lane.index, case.rng(f"noise {lane.index}"), gnss=gnss)
        name = f"{lane.role}/{lane.index:02d}_{lane.course.name.replace(' ', '_')}"
        write_bag(target / name, recording, overwrite=True)
        written[lane.role].append(name)
    wrong = vehicle_file.drawn_errors(case.rng("vehicle file"))
    vehicle_file.write(target / "vehicle.yaml", case.car, case.tyre, case.model, mounting, case.grade, wrong)
    (target / FINISHED).write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")
