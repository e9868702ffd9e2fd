"""Everything that can be hidden shows where the mismatch study says it does, and leaves the drive a drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is one of the plants: make venv installs it")

from blind import cars, courses, knobs
from blind.cars import CARS
from blind.effects import EFFECTS
from blind.outside import OUTSIDE
from blind.plants import mujoco_tree
from blind.sensors import GRADES, Bench, Biases, Mounting
from blind.tyres import FORMULAS

pytestmark = pytest.mark.timeout(1200)  # all drives are simulated for the first test

CAR = CARS[1]
MOUNTING = Mounting((0.2, 0.0, -0.1), (-0.3, 0.0, 0.9))
LIMIT = 16.0  # [s] of each course
# Where what the library does not have shows.
COURSES_OUTSIDE = ("limit ramp", "accelerate and brake", "slalom")


def _hidden(name: str):
    rng = np.random.default_rng(5)
    return (EFFECTS[name].hide(1.0, rng, CAR) if name in EFFECTS else OUTSIDE[name](rng, CAR)).knobs


@pytest.fixture(scope="module")
def drives():
    """Logs by name of what is hidden (None: nothing) and of the course."""
    known = {c.name: replace(c, duration=min(c.duration, LIMIT)) for c in courses.rich(np.random.default_rng(4))[0]}
    lanes = [(None, course) for course in known.values()]
    lanes += [(name, known[effect.best]) for name, effect in EFFECTS.items()]
    lanes += [(name, known[course]) for name in OUTSIDE for course in COURSES_OUTSIDE]
    log = mujoco_tree.simulate(
        cars.side_by_side([CAR] * len(lanes)),
        knobs.side_by_side([_hidden(name) if name else {} for name, _ in lanes]),
        [course for _, course in lanes],
        FORMULAS["magic_formula_1989"],
    )
    return {(name, course.name): log.lane(i, course.duration) for i, (name, course) in enumerate(lanes)}


def _change(drives, name: str, course: str) -> float:
    """Largest root mean square change of a signal that the sensors give, over its noise; a driver may steer it away."""
    grade, noise = GRADES["automotive"], np.random.default_rng
    found = []
    for hidden in (None, name):
        bench = Bench("automotive", MOUNTING, Biases.drawn(grade, noise(1)), _hidden(hidden) if hidden else {})
        recording = bench.record(drives[hidden, course], course, 0, noise(2))
        imu = recording["imu/data"].columns
        found.append(
            [
                imu["angular_velocity"] / grade.gyro,
                imu["linear_acceleration"] / grade.accelerometer,
                recording["vehicle/wheel_speeds"].columns["velocity"] / grade.wheel,
                recording["gps/velocity"].columns["linear"][:, :2] / grade.velocity,
                recording["vehicle/steering"].columns["position"] / grade.handwheel,
            ]
        )
    return max(float(np.sqrt(np.mean((a - b) ** 2, axis=0)).max()) for a, b in zip(*found, strict=True))


@pytest.mark.exam
@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_typical_size_shows_in_its_best_manoeuvre(drives, name):
    assert _change(drives, name, EFFECTS[name].best) > 1.0


@pytest.mark.exam
@pytest.mark.parametrize("name", OUTSIDE)
def test_what_the_library_lacks_shows_too(drives, name):
    assert max(_change(drives, name, course) for course in COURSES_OUTSIDE) > 2.0


@pytest.mark.exam
def test_nothing_hidden_makes_a_car_spin_or_fall(drives):
    for (name, course), lane in drives.items():
        forward, sideways = lane["velocity"][:, 0], lane["velocity"][:, 1]
        assert np.all(np.isfinite(forward)), (name, course)
        assert np.all(np.abs(np.arctan2(sideways, forward)) < np.radians(9)), (name, course)
        assert np.all(forward > 3), (name, course)


def test_an_effect_turns_knobs_in_proportion_to_its_size():
    for name, effect in EFFECTS.items():
        one, other = (effect.hide(size, np.random.default_rng(3), CAR) for size in (0.35, 1.0))
        assert one.where == other.where, name
        assert one.value == pytest.approx(0.35 * other.value), name
        assert one.knobs.keys() == other.knobs.keys() <= knobs.KNOBS.keys(), name
