"""A study of filters on the drives of `leung_drives`: one run for each manoeuvre, seed, receiver and filter, kept by
its content. Filters get the readings directly, in order, so that a study measures the filter and no transport.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from studies import leung_observers
from studies.leung_scores import score, score_side_slip
from studies.tasks import DoTasks, Task, in_turn
from vsense_ros.assess.drives import (
    SETTLED,
    Case,
    Errors,
    Readings,
    Truth,
    digest,
    drive_plant,
    readings,
    sources,
    trajectory,
)
from vsense_ros.assess.filter_run import follow
from vsense_ros.errors import InputError
from vsense_ros.evaluate.signals import wrap
from vsense_ros.files.atomic import in_place_of
from vsense_ros.manoeuvre import MANOEUVRES
from vsense_ros.navigation.catalogue import FILTERS
from vsense_ros.navigation.motion import Motions
from vsense_ros.navigation.space import MOTION, Definition

Array = NDArray[np.float64]

# Per second that is driven, roughly: of the plant, and of a filter.
PLANT_SECONDS, FILTER_SECONDS = 0.05, 0.01


def estimate(name: str, truth: Truth, case: Case, definition: Definition | None = None) -> dict[str, Any]:
    """What a filter makes of a case, and how far that is from the truth: by quantity RMSE and range of the truth, over
    the whole run and when settled; normalized errors squared of side slip and yaw; final parameters. Without a
    `definition` the filter is that of the catalogue by this name."""
    if name == leung_observers.BOUND:
        case = replace(case, noise=0.0, errors=replace(case.errors, bus=None))
    read = readings(truth, case)
    if name in leung_observers.OBSERVERS:
        return leung_observers.estimate(name, truth, case, read)
    motions, at = follow(name, truth, case, read, definition=definition)
    return _scores(motions, truth, at, read, case.errors)


def _scores(motions: Motions, truth: Truth, at: NDArray[np.int64], read: Readings, errors: Errors) -> dict[str, Any]:
    settled = truth.t[at] > SETTLED
    straight = np.abs(truth.yaw_rate) < 1e-3
    radius = float(np.mean(2 * truth.forward_velocity[straight] / truth.spins[straight, 2:].sum(axis=1)))
    true = {name: getattr(truth, name)[at] for name in ("yaw", "forward_velocity", "lateral_velocity", "yaw_rate")}
    true["side_slip"] = truth.side_slip[at]
    scores: dict[str, Any] = {}
    for name in true:
        if name == "side_slip" and motions.has_side_slip:
            error = motions.side_slip[:, 0] - true[name]
        elif name in motions.estimated:
            error = motions.value[:, MOTION.index(name)] - true[name]
        else:
            continue
        scores[name] = score(wrap(error) if name in ("yaw", "side_slip") else error, true[name], settled)
    biases = {
        "gyro_bias": errors.gyro.bias, "acceleration_bias_x": errors.force.bias,
        "acceleration_bias_y": errors.force.bias, "steering_bias": errors.steering.bias, "rolling_radius": radius,
    }  # fmt: skip
    for j, full in enumerate(motions.parameter_names):
        name = full.rpartition(".")[2]
        if name in biases and name not in scores:
            error = motions.parameters[:, j] - biases[name]
            scores[name] = score(error, np.zeros(len(at)), settled)
    scores["nees"] = {}
    if "side_slip" in scores:
        error = wrap(motions.side_slip[:, 0] - true["side_slip"])
        scores |= score_side_slip(error, motions.side_slip[:, 1], settled)
    if "yaw" in motions.estimated:
        rows = np.flatnonzero(np.isfinite(read.fixes[at, 0]))
        course = np.arctan2(read.fixes[at[rows], 1], read.fixes[at[rows], 0])
        raw = wrap(course - motions.value[rows, MOTION.index("yaw")])
        scores["raw_side_slip"] = score(wrap(raw - true["side_slip"][rows]), true["side_slip"], settled[rows])
    return scores


Results = Mapping[tuple[Case, str], Mapping[str, Any]]


def study(
    cases: Iterable[tuple[Case, Sequence[str]]],
    store: Path,
    progress: Callable[[float], None] = lambda share: None,
    *,
    do_tasks: DoTasks = in_turn,
) -> Results:
    """Scores of each case and filter, made by `do_tasks`. What is in `store` from a run that was stopped is not done
    again; a change of the filters, the plant or the sensors makes anew what depends on it. Raises `InputError` for
    unknown names."""
    wanted = [(case, tuple(dict.fromkeys(names))) for case, names in cases]
    for case, names in wanted:
        if case.manoeuvre not in MANOEUVRES:
            raise InputError(f"no manoeuvre {case.manoeuvre!r}; known are {', '.join(MANOEUVRES)}")
        for name in names:
            if name not in leung_observers.OBSERVERS:
                FILTERS[name]
    store.mkdir(parents=True, exist_ok=True)
    results: dict[tuple[Case, str], Mapping[str, Any]] = {}
    missing = []
    for case, names in wanted:
        left = []
        for name in names:
            file = _file(store, case, name)
            if file.exists():
                results[case, name] = json.loads(file.read_text(encoding="utf-8"))
            else:
                left.append(name)
        if left:
            missing.append((case, tuple(left)))
    if not missing:
        progress(1.0)
        return results
    # Plants first: many cases share one.
    drives = dict.fromkeys((case.manoeuvre, case.plant) for case, _ in missing)
    plants = [Task(PLANT_SECONDS * MANOEUVRES[name].duration, _drive, (name, plant, store)) for name, plant in drives]
    tasks = [
        Task(FILTER_SECONDS * MANOEUVRES[case.manoeuvre].duration * len(names), _work, (case, names, store))
        for case, names in missing
    ]
    driving = sum(one.seconds for one in plants) / sum(one.seconds for one in (*plants, *tasks))
    do_tasks(plants, lambda share: progress(driving * share))
    every = do_tasks(tasks, lambda share: progress(driving + (1 - driving) * share))
    for (case, _), scores in zip(missing, every, strict=True):
        results |= {(case, name): one for name, one in scores.items()}
    return results


def _drive(manoeuvre: str, plant: str, store: Path) -> None:
    trajectory(manoeuvre, plant, store)


def _work(case: Case, names: Sequence[str], store: Path) -> dict[str, Mapping[str, Any]]:
    """One drive by some filters, kept."""
    truth = drive_plant(case.manoeuvre, case.plant, store)
    results: dict[str, Mapping[str, Any]] = {}
    for name in names:
        results[name] = estimate(name, truth, case)
        with in_place_of(_file(store, case, name)) as temporary:
            temporary.write_text(json.dumps(results[name]), encoding="utf-8")
    return results


def _file(store: Path, case: Case, name: str) -> Path:
    own = ("observer",) if name in leung_observers.OBSERVERS else ("navigation",)
    files = sources("vsense_ros", "estimation", "manoeuvre", "model", "assess", *own) + sources("studies", "leung_*")
    return store / f"{case.manoeuvre}_{case.seed}_{name}_{digest(json.dumps(asdict(case)), name, *files)}.json"
