"""Tune how much the observer trusts its sensors and its model; watch whether the model still fits."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from vsense_ros.cli.common import EXISTING, NEW_FILE, HoldsOut, load_car, vehicle_option, warn


@click.command(cls=HoldsOut)
@click.argument("recordings", nargs=-1, required=True, type=EXISTING)
@vehicle_option
@click.option("--output", required=True, type=NEW_FILE, metavar="FILE", help="Vehicle file to write.")
@click.option(
    "--hold-out", "held_out", metavar="RECORDING…", multiple=True, type=EXISTING, help="Recordings for validation."
)
@click.option("--own-noise", is_flag=True, help="Ignore the noise that messages state, and tune it, too.")
def tune(recordings: tuple[Path, ...], vehicle: str, output: Path, held_out: tuple[Path, ...], own_noise: bool) -> None:
    """Estimate the noise levels of sensors and model.

    \b
    Examples:
      vsense tune drive_1 drive_2 --hold-out drive_3 --vehicle my_car.yaml --output my_car_tuned.yaml

    Maximises the likelihood of the recordings over the noise covariances of the observer. Writes the vehicle file with
    the new values (comments are kept), a picture, and all figures as JSON: how consistent the filter is with its
    innovations and, if there is a reference, with the truth, before and after.
    """
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import save_changes
    from vsense_ros.identification import noise as job
    from vsense_ros.identification import noise_report
    from vsense_ros.model.vehicle import left_out_of_observer

    path = vehicle_path(vehicle)
    car = load_car(vehicle)
    warn(left_out_of_observer(car))
    drives, proof = ([import_recording(recording) for recording in paths] for paths in (recordings, held_out))
    with progress("tuning") as done:
        result = job.tune(car, drives, proof, own_noise=own_noise, progress=done)
    output.parent.mkdir(parents=True, exist_ok=True)
    save_changes(path, output, result.vehicle, result.changed(car))
    result.write(output.with_suffix(".json"))
    picture = noise_report.draw(result, output.with_suffix(".png"))
    noise_report.show(result, console())
    say(f"Written to {output}, {output.with_suffix('.json').name}, {picture.name}.")


@click.command()
@click.argument("recordings", nargs=-1, required=True, type=EXISTING)
@vehicle_option
@click.option("--calibrate", type=NEW_FILE, metavar="LIMITS", help="File to write the limits to.")
@click.option("--limits", "limits_file", type=EXISTING, metavar="LIMITS", help="Limits to check RECORDINGS against.")
def monitor(recordings: tuple[Path, ...], vehicle: str, calibrate: Path | None, limits_file: Path | None) -> None:
    """Check whether the observer's model still fits the car.

    \b
    Examples:
      vsense monitor monday tuesday --vehicle my_car.yaml --calibrate my_car.monitor.yaml
      vsense monitor friday --vehicle my_car.yaml --limits my_car.monitor.yaml
      ros2 run vsense_ros observer --ros-args -p vehicle:=my_car.yaml -p monitor:=my_car.monitor.yaml

    The command averages the innovations of each sensor, the generalized forces that the model lacks, and the estimated
    errors over ten seconds. With --calibrate, RECORDINGS are at least two drives without faults, as different as
    possible. Their values become the limits, with the margin that each of them would have needed if it had been left
    out. A quantity that one of them lacks gets no limit, and is reported. The observer node reads the limits through
    its parameter `monitor`, and reports in its diagnostics what has left them, and since when.
    """
    if (calibrate is None) == (limits_file is None):
        raise click.UsageError("expected either --calibrate or --limits")
    from vsense_ros.api.recording import read_each
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.identification import monitor_report
    from vsense_ros.model.vehicle import left_out_of_observer
    from vsense_ros.observer.monitor import load_limits, save_limits
    from vsense_ros.runner import calibration

    car = load_car(vehicle)
    warn(left_out_of_observer(car))
    limits = load_limits(limits_file) if limits_file is not None else None
    watched = []
    with progress("watching") as done:
        for i, recording in enumerate(read_each(recordings)):
            before = i / len(recordings)
            report = partial(lambda before, share: done(before + share / len(recordings)), before)
            watched.append(calibration.watch(recording, car, limits, report))
    if calibrate is None:
        monitor_report.show_watched(watched, console())
        return
    calibrated = calibration.calibrate(watched, car)
    save_limits(calibrate, calibrated.limits)
    monitor_report.show_limits(calibrated, console())
    say(f"Written to {calibrate}.")


@click.command()
@click.option("--out", type=NEW_FILE, default=Path("out/faults.json"), show_default=True, help="File to write.")
@click.option("--only", metavar="WORDS", default="", help="Only faults whose name contains these words.")
@click.option("--filter", "chosen", metavar="NAME", default="", help="Filter, as `vsense filters` lists them.")
def faults(out: Path, only: str, chosen: str) -> None:
    """Simulate sensor faults and show their effect.

    \b
    Examples:
      vsense faults
      vsense faults --only gyro
      vsense faults --filter strapdown

    Axes of inertial sensors jump, drift, freeze or disappear, and GNSS jumps, is wrong or is absent, on the generated
    bags and on the drive of the RAV4. This takes about a minute.
    """
    from vsense_ros.assess import faults as job
    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import console, progress, say

    cases = [case for case in job.CASES if only in case.title and job.concerns(case, chosen)]
    if not cases:
        raise InputError(
            f"no fault that concerns the filter has {only!r} in its name; `vsense faults` without --only lists them all"
        )
    outcomes, left_out = [], {}
    with progress("faults") as done:
        for i, case in enumerate(cases):
            try:
                outcomes.append(job.examine(case, chosen))
            except InputError as error:
                left_out[case.drive] = str(error)
            done((i + 1) / len(cases))
    job.write(outcomes, out)
    console().print(job.table(outcomes))
    for name, why in left_out.items():
        say(f"Without {name}: {why}")
    say(f"{sum(outcome.holds for outcome in outcomes)} of {len(outcomes)} hold. Written to {out}.")


COMMANDS = (faults, tune, monitor)
