"""The demonstration: three drives, each through the processes that a car would run, and what they came to.

Nothing is prepared: the RAV4's raw CAN frames go onto a bus and its IMU and GNSS bytes over serial lines to the
drivers, the others are replayed as topics. What is missing on this machine (recordings, network, ROS) is said, and the
rest is shown.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from rich.text import Text

from vsense_ros import observer
from vsense_ros.bag import datasets, write_bag
from vsense_ros.bag.importers import comma2k19, import_recording
from vsense_ros.errors import InputError
from vsense_ros.evaluate import baselines
from vsense_ros.evaluate.drive import Drive, RunFigures
from vsense_ros.evaluate.metrics import SignalScore
from vsense_ros.evaluate.picture import draw
from vsense_ros.evaluate.report import write_report
from vsense_ros.evaluate.terminal import in_files, progress, show_drive, waiting
from vsense_ros.recording import Recording
from vsense_ros.shared_files import shared_folder
from vsense_ros.vehicle_file import load_vehicle

if TYPE_CHECKING:
    from rich.console import Console

Baselines = Mapping[str, Mapping[str, SignalScore]]


@dataclass(frozen=True)
class Job:
    """One drive of the demonstration.

    `vehicle` names a file in config/vehicles; `source` gives the path of the recording or raises `InputError` saying
    why it is not here; `baselines` scores simpler ways to the same signals.
    """

    name: str
    title: str
    vehicle: str
    source: Callable[[], Path]
    baselines: Callable[[Path, Recording], Baselines] | None = None


def dataset(name: str) -> Path:
    """The recording of a dataset, downloaded if it is not here."""
    found = datasets.find(name)
    if found is not None:
        return found
    with progress(f"downloading {name}") as done:
        return datasets.fetch(name, in_files(done))


def manoeuvre(name: str) -> Path:
    """A generated bag."""
    path = shared_folder("bags") / name
    if not path.exists():
        raise InputError(f"{path} is not there; `vsense bags` generates it")
    return path


def raw_signals(source: Path, recording: Recording) -> Baselines:
    """What the RAV4's wheel speeds and the gyro alone tell."""
    radius = float(recording.metadata.get("wheel_rolling_radius_m", comma2k19.ROLLING_RADIUS))
    uncalibrated = comma2k19.read(source, calibrated_gyro=False)
    return baselines.by_label(
        ("raw CAN wheel speeds", baselines.score_all(baselines.wheel_speed(recording, radius), recording)),
        ("raw gyro", baselines.score_all(baselines.gyro(uncalibrated), recording)),
        ("gyro, bias removed by the phone", baselines.score_all(baselines.gyro(recording), recording)),
    )


def handling_formulas(source: Path, recording: Recording) -> Baselines:
    """What formulas of yaw rate and speed tell of a lap: one fitted to the other laps, one of geometry alone."""
    others = [import_recording(source.with_name(name)) for name in ("cpg_slow_lap.mat", "cpg_fast_lap.mat")]
    fitted = baselines.regression(recording, baselines.fit_regression(others))
    car = load_vehicle(shared_folder("config") / "vehicles" / "genesis.yaml")
    rolling = baselines.kinematic(recording, car.physics.chassis.cog_to_rear_axle)
    return baselines.by_label(
        ("regression on two other laps", baselines.score_all(fitted, recording)),
        ("kinematic, rear axle without slip", baselines.score_all(rolling, recording)),
    )


JOBS = (
    Job("rav4", "Toyota RAV4 on a highway", "rav4", lambda: dataset("comma2k19_rav4"), raw_signals),
    Job(
        "genesis",
        "Hyundai Genesis on a proving-ground lap",
        "genesis",
        lambda: dataset("genesis_oxts_can"),
        handling_formulas,
    ),
    Job("double_lane_change", "Double lane change, ISO 3888", "sedan", lambda: manoeuvre("double_lane_change")),
)


def run_demo(out: Path, console: Console, *, through_ros: bool = True, jobs: tuple[Job, ...] = JOBS) -> list[Drive]:
    """Run all drives that can be run here; writes bags, pictures, a report and `summary.json` into `out`.

    Raises `InputError` if not a single drive could be run.
    """
    out.mkdir(parents=True, exist_ok=True)
    left_out: list[str] = []
    if through_ros and find_spec("rclpy") is None:
        through_ros = False
        left_out.append("There is no ROS 2 on this machine (rclpy cannot be imported): everything runs without it.")
    drives: list[Drive] = []
    for job in jobs:
        try:
            drives.append(_run(job, out, through_ros))
        except InputError as error:
            left_out.append(f"{job.title} is left out: {error}")
    for words in left_out:
        console.print(Text(words, style="yellow"))
    if not drives:
        raise InputError("no drive of the demonstration could be run; the reasons stand above")
    with waiting("drawing"):
        pictures = {drive.name: draw(drive, out / drive.name)[0] for drive in drives}
        report = write_report(drives, out / "report.html", title="vsense: demonstration", pictures=pictures)
    summary = json.dumps({drive.name: drive.summary() for drive in drives}, indent=2, allow_nan=False)
    (out / "summary.json").write_text(summary + "\n", encoding="utf-8")
    for drive in drives:
        show_drive(drive, console)
    console.print(f"\nReport {report}, pictures and output bags beside it.", soft_wrap=True)
    return drives


def _run(job: Job, out: Path, through_ros: bool) -> Drive:
    source = job.source()
    with waiting(f"{job.name}: reading the recording"):
        recording = import_recording(source)
    vehicle_file = shared_folder("config") / "vehicles" / f"{job.vehicle}.yaml"
    result, way = _estimate(job, source, recording, vehicle_file, through_ros)
    write_bag(out / job.name, result.output, overwrite=True)
    simpler = job.baselines(source, recording) if job.baselines else {}
    return Drive.of(job.name, job.title, recording, result, baselines=simpler, way=way)


def _estimate(
    job: Job, source: Path, recording: Recording, vehicle_file: Path, through_ros: bool
) -> tuple[RunFigures, str]:
    vehicle = load_vehicle(vehicle_file)
    with progress(f"{job.name}: estimating without ROS") as done:
        return observer.run(recording, vehicle, progress=done), "without ROS"
