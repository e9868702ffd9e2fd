"""How cost grows with sensors, states and the length of a recording: `python tools/scaling.py docs/scaling.md`.

Steps of observers are timed as `tools/bench_parts.py` times them. What a command needs for a recording is measured in a
process of its own for each length: a generated double lane change, over and over, whose positions go on with the car.
The page and its picture are written anew, with the growth of `explain` by `tools/explain_growth.py`, the parts of a run
by `tools/run_parts.py` and the plan of `tools/fleet_plan.py` at its end. `--longest` says up to how many seconds of a
recording are estimated and explained.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import explain_growth
import fleet_plan
import numpy as np
import run_parts

import vsense_ros as vs
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.sensors import sensors_of

ROOT = Path(__file__).resolve().parents[1]
BAG, VEHICLE = ROOT / "bags/double_lane_change", "prototype_model"
SPEED, STEP = 15.0, 0.004  # [m/s], [s]
SLOTS, SLOT = 200, 2e-3  # measurements of a step, of so many seconds each
LENGTHS = {  # [s] of recordings, by what is done with them
    "run": (24, 60, 120, 240, 900),
    "prepare explain": (900, 3600, 10800),
    "explain": (24, 60, 120, 240, 900),
}
PARAMETERS = ("chassis.mass", "road.friction", "chassis.yaw_inertia", "front.cornering_scale", "rear.cornering_scale")


@dataclass(frozen=True)
class Cost:
    """Processor time [s] and memory [MB] that a recording of this length [s] takes, and the memory before."""

    length: float
    seconds: float
    memory: float
    before: float


def repeated(recording: Recording, seconds: float) -> Recording:
    """A recording over and over, for about so many seconds, without its reference."""
    recording = replace(
        recording, channels={t: c for t, c in recording.channels.items() if not t.startswith("reference/")}
    )
    every = [channel for channel in recording.channels.values() if len(channel)]
    period = max(int(c.stamp[-1]) for c in every) - min(int(c.stamp[0]) for c in every) + 10_000_000
    count = max(1, round(seconds * 1e9 / period))
    channels = {}
    for topic, channel in recording.channels.items():
        later = np.repeat(np.arange(count) * period, len(channel))
        columns = {
            name: np.tile(values, (count, 1))
            if values.strides[0]
            else np.broadcast_to(values[0], (len(later), values.shape[1]))
            for name, values in channel.columns.items()
        }
        for name in columns.keys() & {"latitude", "longitude"}:
            way = (channel.columns[name][-1] - channel.columns[name][0]) * len(channel) / (len(channel) - 1)
            columns[name] = columns[name] + np.repeat(np.arange(count), len(channel))[:, None] * way
        stamp, received = (np.tile(times, count) + later for times in (channel.stamp, channel.received))
        channels[topic] = replace(channel, stamp=stamp, received=received, columns=columns)
    return Recording(channels, f"{seconds:g} s", metadata=dict(recording.metadata))


def step_time(vehicle: Vehicle, name: str, sensors: tuple[str, ...]) -> tuple[int, float]:
    """States of an observer, and the time [µs] of a step with corrections by these sensors of a car that rolls on."""
    every = sensors_of(vehicle)
    observer = FILTERS[name].make(vehicle, every)
    observer.start_rolling(SPEED)
    wheel = vehicle.physics.front.unloaded_radius
    at = {
        "imu": [0, 0, 0, 0, 0, 9.80665],
        "wheel_speeds": [SPEED / wheel] * 4,
        "velocity": [SPEED, 0],
        "position": [0, 0],
    }
    known = [(key, np.array(at[key], float), every[key].deviations() ** 2, 1e9) for key in sensors]

    def step() -> None:
        observer.predict(STEP)
        for what in known:
            observer.correct(*what)

    found = []
    for _ in range(SLOTS):
        before, calls = time.perf_counter(), 0
        while time.perf_counter() - before < SLOT:
            step()
            calls += 1
        found.append((time.perf_counter() - before) / calls)
    return len(observer.names), 1e6 * min(found)


def steps() -> list[tuple[str, int, int, float]]:
    """Observer, number of its states, sensors and the time of a step [µs]."""
    car = vs.load_vehicle(VEHICLE)
    rows = []
    for sensors in ((), ("imu",), ("imu", "wheel_speeds"), ("imu", "wheel_speeds", "velocity", "position")):
        rows.append(("errorEKF", *step_time(car, "error_ekf", sensors), len(sensors)))
    for count in (1, 2, 5):
        raw = car.model_dump()
        estimated = {name: {"deviation": 0.1 * abs(car.values()[name])} for name in PARAMETERS[:count]}
        raw["observer"] |= {"parameters": estimated, "parameter_filter": "ekf"}
        sensors = ("imu", "wheel_speeds")
        rows.append((f"SPI, parameters: {count}", *step_time(type(car).model_validate(raw), "spi", sensors), 2))
    return [(name, states, sensors, micros) for name, states, micros, sensors in rows]


def prepared(recording: Recording) -> None:
    """All that `explain` does before it fits: the share of its work that grows with the recording."""
    from vsense_ros.mismatch.comparable import comparable
    from vsense_ros.mismatch.explain import LONGEST_FITTED
    from vsense_ros.mismatch.selection import most_telling

    most_telling(comparable([recording], (), vs.load_vehicle(VEHICLE)).fitted, LONGEST_FITTED)


JOBS: dict[str, Callable[[Recording], object]] = {
    "run": lambda recording: vs.estimate(recording, VEHICLE),
    "prepare explain": prepared,
    "explain": lambda recording: vs.explain(recording, VEHICLE, observe=False),
}


def measured(job: str, length: float) -> Cost:
    """The cost of a job, in this process."""
    recording = repeated(vs.read(BAG), length)
    before, begun = _memory(), time.process_time()
    JOBS[job](recording)
    return Cost(recording.duration, time.process_time() - begun, _memory(), before)


def _memory() -> float:
    """The most memory that this process has had so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def in_process_of_its_own(job: str, length: float) -> Cost:
    line = [sys.executable, __file__, "--job", job, "--length", str(length)]
    done = subprocess.run(line, check=True, stdout=subprocess.PIPE, text=True)
    return Cost(*json.loads(done.stdout.splitlines()[-1]))


def picture(costs: dict[str, list[Cost]], path: Path) -> None:
    """Processor time and memory over the length of a recording."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for job, rows in costs.items():
        length = [row.length for row in rows]
        axes[0].loglog(length, [row.seconds for row in rows], "o-", label=job)
        axes[1].semilogx(length, [row.memory for row in rows], "o-", label=job)
    for axis, label in zip(axes, ("processor time [s]", "memory at most [MB]"), strict=True):
        axis.set(xlabel="recording [s]", ylabel=label)
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.savefig(path, metadata={"Date": None})


def page(rows: list[tuple[str, int, int, float]], costs: dict[str, list[Cost]], image: str, longest: float) -> str:
    """The page, of recordings of up to `longest` [s] where they are estimated and explained."""
    lines = [
        "# How cost grows", "",
        f"Made by `python tools/scaling.py docs/scaling.md --longest {longest:g}`. Times are those of the machine on",
        "which it ran, which may have been busy with something else; how they grow is what this page is about.", "",
        "## A step, by states and sensors", "",
        "Smallest time of a step of 4 ms with one correction by each sensor.", "",
        "| observer | states | sensors | step |", "|---|---|---|---|",
        *(f"| {name} | {states} | {sensors} | {micros:.1f} µs |" for name, states, sensors, micros in rows), "",
        "## A command, by the length of a recording", "",
        f"![Processor time and memory over the length of a recording]({image})", "",
        "The recording is the generated double lane change over and over, with an inertial sensor at 250 Hz. Memory is",
        "the most that the process had, of which it had a part before the command began.", "",
        "| command | recording | processor time | for a second of it | memory | before |", "|---|---|---|---|---|---|",
        *(
            f"| {job} | {row.length:.0f} s | {row.seconds:.1f} s | {1e3 * row.seconds / row.length:.1f} ms | "
            f"{row.memory:.0f} MB | {row.before:.0f} MB |"
            for job, found in costs.items() for row in found
        ), "",
        "`explain` fits 900 s of driving at most, chosen from all of it, and proves on as much: beyond that only its",
        "preparation (*prepare explain*) grows.", "",
    ]  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(prog="scaling", description=__doc__)
    parser.add_argument("page", type=Path, nargs="?")
    parser.add_argument(
        "--longest", type=float, default=900.0, help="[s] of recordings that are estimated and explained"
    )
    parser.add_argument("--job", choices=JOBS)
    parser.add_argument("--length", type=float)
    arguments = parser.parse_args()
    if arguments.job:
        cost = measured(arguments.job, arguments.length)
        print(json.dumps([cost.length, cost.seconds, cost.memory, cost.before]))
        return
    costs: dict[str, list[Cost]] = {}
    for job, lengths in LENGTHS.items():
        for length in lengths:
            if job == "prepare explain" or length <= arguments.longest:
                costs.setdefault(job, []).append(in_process_of_its_own(job, length))
                print(job, costs[job][-1], flush=True)
    image = arguments.page.with_suffix(".svg")
    picture(costs, image)
    text = page(steps(), costs, image.name, arguments.longest)
    text = fleet_plan.with_section(text, fleet_plan.section(text, fleet_plan.Night()))
    text = run_parts.into(text, explain_growth.section(explain_growth.measured()), explain_growth.TITLE)
    source = f"{BAG.relative_to(ROOT)} {VEHICLE}"
    text = run_parts.into(text, run_parts.section(source, vs.read(BAG), vs.load_vehicle(VEHICLE)))
    arguments.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
