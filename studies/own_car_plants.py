"""Simulated cars of the study of an own car: plants of test/blind, which share no equation with the package.

What a car hides is drawn by its seed. Simulating it takes minutes, so the motion on all drives is kept in the user's
cache under a name made from the code of the plants and everything that was simulated.
"""

from __future__ import annotations

import pickle
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.cache import digest_of, user_folder
from vsense_ros.files.atomic import in_place_of

Array = NDArray[np.float64]
Lane = Mapping[str, Array]

TESTS = Path(__file__).parents[1] / "test"
TYRE = "magic_formula_1989"
# Name, duration [s], fastest, slowest [m/s], tightest bend [m], lateral acceleration [m/s²].
DRIVES = (("town", 60.0, 14.0, 5.0, 14.0, 2.8), ("rural road", 60.0, 22.0, 10.0, 40.0, 3.4))
HELD_OUT = ("way home", 40.0, 19.0, 9.0, 28.0, 3.2)


@dataclass(frozen=True)
class Plant:
    """A car of the blind examination: the kind of its plant, which of the three types it is, the seed of what it hides,
    and how it logs."""

    name: str
    kind: str
    which: int
    seed: int
    log: str


PLANTS = (
    Plant("hatchback", "newton_euler", 0, 7, "German CAN"),
    Plant("saloon", "mujoco_tree", 1, 11, "American CAN"),
    Plant("sport utility", "newton_euler", 2, 13, "Asian CAN"),
    Plant("estate", "newton_euler", 1, 17, "foreign bag"),
    Plant("city car", "mujoco_tree", 0, 19, "table"),
)


@dataclass(frozen=True)
class Hidden:
    """What a simulated car hides: its numbers, its drives, and the generator of what its sensors and catalogue err."""

    car: Any
    courses: tuple[Any, ...]
    rng: np.random.Generator


def blind(part: str) -> Any:
    """A module of the blind examination."""
    if str(TESTS) not in sys.path:
        sys.path.append(str(TESTS))
    return import_module(f"blind.{part}")


def hidden(one: Plant) -> Hidden:
    """Masses, springs, tyres and dimensions a few per cent off the car's type, and its drives, drawn by its seed."""
    rng = np.random.default_rng(one.seed)
    cars, courses = blind("cars"), blind("courses")
    kind = cars.CARS[one.which]
    factor = rng.uniform(0.97, 1.03, 3)
    car = replace(kind, mass=kind.mass * factor[0], cog_height=kind.cog_height * factor[1],
                  yaw_inertia=kind.yaw_inertia * factor[2])  # fmt: skip
    roads = tuple(
        replace(courses.road(rng, duration, *limits, drive), roughness=0.002, seed=int(rng.integers(2**31)))
        for drive, duration, *limits in (*DRIVES, HELD_OUT)
    )
    return Hidden(car, roads, rng)


def simulated(one: Plant, group: Sequence[Plant]) -> tuple[Hidden, Sequence[Lane]]:
    """What a simulated car hides, and what happened on its drives: columns by name (rows, columns) at 200 Hz.

    The motion is read from the cache. What is not there yet is simulated, side by side with the others of `group` that
    are of the same kind and not there either.
    """
    car = hidden(one)
    stored = _stored(one, car)
    if not stored.exists():
        missing = {other: found for other in {one, *group} if other.kind == one.kind
                   if not _stored(other, found := hidden(other)).exists()}  # fmt: skip
        lanes = iter(_simulate(one.kind, list(missing.values())))
        for other, found in missing.items():
            _store(_stored(other, found), [next(lanes) for _ in found.courses])
    columns: list[dict[str, Array]] = [{} for _ in car.courses]
    with np.load(stored) as content:
        for key, values in content.items():
            lane, _, name = key.partition(" ")
            columns[int(lane)][name] = values.astype(float)
    return car, columns


def _simulate(kind: str, cars: Sequence[Hidden]) -> list[Lane]:
    courses = [course for one in cars for course in one.courses]
    motion = blind(f"plants.{kind}").simulate(
        blind("cars").side_by_side([one.car for one in cars for _ in one.courses]),
        blind("knobs").side_by_side([{}] * len(courses)), courses, blind("tyres").mixed([TYRE] * len(courses)),
    )  # fmt: skip
    return [motion.lane(i, course.duration) for i, course in enumerate(courses)]


def _store(path: Path, lanes: Sequence[Lane]) -> None:
    """Keep the motion as the plants log it: in single precision."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content: dict[str, Any] = {
        f"{i} {name}": column.astype(np.float32) for i, lane in enumerate(lanes) for name, column in lane.items()
    }
    with in_place_of(path) as fresh, fresh.open("wb") as file:
        np.savez_compressed(file, **content)


def _stored(one: Plant, car: Hidden) -> Path:
    """Place of a car's motion in the user's cache, by what decides it: the code of the blind examination, NumPy, and
    the car with its drives."""
    code = f"{digest_of(TESTS / 'blind')} {np.__version__} {one.kind} {TYRE}"
    key = sha256(code.encode() + pickle.dumps((car.car, car.courses))).hexdigest()[:20]
    return user_folder() / "own_car" / f"{one.kind}-{key}.npz"
