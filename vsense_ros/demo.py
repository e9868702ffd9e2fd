"""The demonstration: three drives, each through the processes that a car would run, and what they came to.

Nothing is prepared: the RAV4's raw CAN frames go onto a bus and its IMU and GNSS bytes over serial lines to the
drivers, the others are replayed as topics. What is missing on this machine (recordings, network, ROS) is said, and the
rest is shown.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rich.text import Text

from vsense_ros.bag import datasets, write_bag
from vsense_ros.bag.gnss_bytes import gnss_byte_stream
from vsense_ros.bag.importers import comma2k19, import_recording
from vsense_ros.driver.imu import encode_mtdata2
from vsense_ros.errors import InputError
from vsense_ros.evaluate import baselines
from vsense_ros.evaluate.drive import Drive
from vsense_ros.evaluate.metrics import SignalScore
from vsense_ros.evaluate.picture import draw
from vsense_ros.evaluate.reference import at_reference, mounting_in_words
from vsense_ros.evaluate.report import write_report
from vsense_ros.evaluate.terminal import in_files, progress, show_drive, waiting
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.node.processes import RosRun, run_through_ros
from vsense_ros.runner import run

if TYPE_CHECKING:
    from rich.console import Console

Baselines = Mapping[str, Mapping[str, SignalScore]]


def _as_topics(_: Path, recording: Recording, scratch: Path) -> dict[str, Any]:
    """A recording is replayed as topics."""
    write_bag(scratch / "input", recording)
    return {"recording_bag": scratch / "input"}


def _as_bytes(source: Path, recording: Recording, scratch: Path) -> dict[str, Any]:
    """The raw CAN frames on a bus, IMU and GNSS as the bytes that such sensors send.

    Their drivers get the noise levels of these sensors in this car, where a phone on the windscreen shakes.
    """
    sensors = load_vehicle(vehicle_path("rav4")).sensors
    imu_noise, speed_noise = sensors["imu"].model_dump(), sensors["velocity"].model_dump()["noise"]
    comma2k19.write_can_log(source, scratch / "can.log")
    imu = [
        (sample.received or sample.stamp, encode_mtdata2(sample, count & 0xFFFF))
        for count, sample in enumerate(recording.samples(("imu/data",)))
    ]
    return {
        "recording_bag": None,
        "can_log": scratch / "can.log",
        "can_log_channel": "can0",
        "can_database": next(iter(source.parent.glob("*.dbc"))),
        "can_mapping": shared_folder("config") / "can" / "toyota_rav4_2017.yaml",
        "gnss_bytes": gnss_byte_stream(recording, "nmea"),
        "imu_bytes": imu,
        "driver_parameters": {
            "imu_driver": {
                "rate_deviation": float(imu_noise["rate_noise"][2]),
                "acceleration_deviation": float(max(imu_noise["force_noise"])),
            },
            "gps_driver": {"speed_deviation": float(speed_noise)},
        },
    }


@dataclass(frozen=True)
class Job:
    """One drive of the demonstration.

    `vehicle` names a file in config/vehicles; `source` gives the path of the recording or raises `InputError` saying
    why it is not here; `baselines` scores simpler ways to the same signals; `feed` makes of path, recording and a
    scratch folder what `run_through_ros` sends to the processes, and `road` says which these are.
    """

    name: str
    title: str
    vehicle: str
    source: Callable[[], Path]
    baselines: Callable[[Path, Recording], Baselines] | None = None
    feed: Callable[[Path, Recording, Path], dict[str, Any]] = _as_topics
    road: str = "replay → observer → recorder"


def dataset(name: str) -> Path:
    """The recording of a dataset, downloaded if it is not here."""
    path = datasets.find(name)
    if path is not None:
        return path
    with progress(f"downloading {name}") as done:
        return datasets.fetch(name, in_files(done))


def manoeuvre(name: str) -> Path:
    """A generated bag."""
    path = shared_folder("bags") / name
    if not path.exists():
        raise InputError(f"{path} is not there; `make bags` generates it")
    return path


def raw_signals(source: Path, recording: Recording) -> Baselines:
    """Scores of the RAV4's wheel speeds and of the gyro alone."""
    radius = float(recording.metadata.get("wheel_rolling_radius_m", comma2k19.ROLLING_RADIUS))
    uncalibrated = comma2k19.read(source, calibrated_gyro=False)
    return baselines.by_label(
        ("raw CAN wheel speeds", baselines.score_all(baselines.wheel_speed(recording, radius), recording)),
        ("raw gyro", baselines.score_all(baselines.gyro(uncalibrated), recording)),
        ("gyro, bias removed by the phone", baselines.score_all(baselines.gyro(recording), recording)),
    )


def handling_formulas(source: Path, recording: Recording) -> Baselines:
    """Scores of formulas of yaw rate and speed on a lap: one fitted to the other laps, one of geometry alone."""
    others = [import_recording(source.with_name(name)) for name in ("cpg_slow_lap.mat", "cpg_fast_lap.mat")]
    fitted = baselines.regression(recording, baselines.fit_regression(others))
    car = load_vehicle(vehicle_path("genesis"))
    rolling = baselines.kinematic(recording, car.physics.chassis.cog_to_rear_axle)
    return baselines.by_label(
        ("regression on two other laps", baselines.score_all(fitted, recording)),
        ("kinematic, rear axle without slip", baselines.score_all(rolling, recording)),
    )


# What the nodes publish and the reader of a bag has no numbers for: nothing to report.
_WITHOUT_NUMBERS = ("diagnostics", "tf", "tf_static", "robot_description")

JOBS = (
    Job(
        "rav4",
        "Toyota RAV4 on a highway",
        "rav4",
        lambda: dataset("comma2k19_rav4"),
        raw_signals,
        _as_bytes,
        "CAN bus and serial lines → drivers → observer → recorder",
    ),
    Job(
        "genesis",
        "Hyundai Genesis on a proving-ground lap",
        "genesis",
        lambda: dataset("genesis_oxts_can"),
        handling_formulas,
    ),
    Job(
        "double_lane_change",
        "Double lane change, ISO 3888",
        "prototype_model",
        lambda: manoeuvre("double_lane_change"),
    ),
)


def run_demo(out: Path, console: Console, *, through_ros: bool = True, jobs: tuple[Job, ...] = JOBS) -> list[Drive]:
    """Run all drives that can be run here; writes bags, pictures, a report and `summary.json` into `out`.

    Raises `InputError` if not a single drive could be run, and at its end, with all results written, if there is ROS
    but its processes failed on a drive, which was then computed without them.
    """
    out.mkdir(parents=True, exist_ok=True)
    left_out: list[str] = []
    if through_ros and find_spec("rclpy") is None:
        through_ros = False
        left_out.append("There is no ROS 2 on this machine (rclpy cannot be imported): everything runs without it.")
    failures: list[str] = []
    drives: list[Drive] = []
    for job in jobs:
        try:
            drives.append(_run(job, out, through_ros, failures))
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
    console.print(f"\nReport {report}, pictures and output bags beside it.", soft_wrap=True, markup=False)
    if failures:
        raise InputError("\n".join(failures))
    return drives


def _run(job: Job, out: Path, through_ros: bool, failures: list[str]) -> Drive:
    source = job.source()
    with waiting(f"{job.name}: reading the recording"):
        recording = import_recording(source)
    simpler = job.baselines(source, recording) if job.baselines else {}
    vehicle_file = vehicle_path(job.vehicle)
    vehicle = load_vehicle(vehicle_file)
    notes = tuple(filter(None, [mounting_in_words(vehicle)]))
    if through_ros:
        try:
            result = _through_ros(job, source, recording, vehicle_file, out / job.name)
        except InputError as error:
            failures.append(f"{job.name}: its ROS processes failed, what is shown was computed without them: {error}")
        else:
            latency = f", latency {result.latency_ms['p99']:.1f} ms (99 %)" if "p99" in result.latency_ms else ""
            way = f"through ROS processes: {job.road}{latency}"
            seen = _as_seen(recording, result.recording)
            compared = replace(result, output=at_reference(result.output, vehicle))
            return Drive.of(
                job.name, job.title, seen, compared, vehicle=vehicle, baselines=simpler, way=way, notes=notes
            )
    with progress(f"{job.name}: estimating without ROS") as done:
        alone = run(recording, vehicle, progress=done)
    write_bag(out / job.name, alone.output, overwrite=True)
    moved = replace(alone, output=at_reference(alone.output, vehicle))
    return Drive.of(
        job.name, job.title, recording, moved, vehicle=vehicle, baselines=simpler, way="without ROS", notes=notes
    )


def _through_ros(job: Job, source: Path, recording: Recording, vehicle_file: Path, out: Path) -> RosRun:
    with TemporaryDirectory(prefix="vsense_demo_") as scratch, progress(f"{job.name}: {job.road}") as done:
        feed = job.feed(source, recording, Path(scratch))
        return run_through_ros(
            vehicle_file=vehicle_file, map_origin=recording.map_origin, out_bag=out, progress=done, **feed
        )


def _as_seen(recording: Recording, recorded: Recording) -> Recording:
    """What the drivers published, with the reference of the recording that they were fed from."""
    channels = {topic: channel for topic, channel in recorded.channels.items() if not topic.startswith("vsense/")}
    channels |= {topic: channel for topic, channel in recording.channels.items() if topic.startswith("reference/")}
    notes = tuple(note for note in recorded.notes if note.partition(":")[0] not in _WITHOUT_NUMBERS)
    return replace(recording, channels=channels, notes=recording.notes + notes)
