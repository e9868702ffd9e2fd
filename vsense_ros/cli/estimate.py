"""Run an observer over a recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsense_ros.cli.common import DIVERGED, EXISTING, NEW_FOLDER, every_filter, load_car, vehicle_option, warn
from vsense_ros.errors import InputError
from vsense_ros.files.names import printable

if TYPE_CHECKING:
    from vsense_ros.messages.recording import Recording
    from vsense_ros.model.vehicle import Vehicle

    Progress = Callable[[float], None]


@click.command()
@click.argument("bag", type=EXISTING)
@vehicle_option
@click.option("--out", type=NEW_FOLDER, help="Folder for the results; default: out/run/<name>.")
@click.option("--filter", "chosen", metavar="NAME", help="Filter, as `vsense filters` lists them.")
@click.option("--smooth", is_flag=True, help="Smooth over the whole recording (GNSS/INS filters).")
@click.option(
    "--lag",
    type=click.FloatRange(0, min_open=True),
    metavar="SECONDS",
    help="Smooth with this many seconds of later data.",
)
@click.option("--mend", is_flag=True, help="Correct signs, axes and units that cannot be right.")
@click.option("--report", is_flag=True, help="Also write a picture and an HTML report.")
@click.pass_context
def run(
    context: click.Context,
    bag: Path,
    vehicle: str,
    out: Path | None,
    chosen: str | None,
    smooth: bool,
    lag: float | None,
    mend: bool,
    report: bool,
) -> None:
    """Estimate the motion and the tyre forces of a car from BAG.

    \b
    Examples:
      vsense run bags/double_lane_change --vehicle prototype_model --report
      vsense run med_lap --vehicle genesis --out out/med_lap
      vsense run bags/step_steer --vehicle prototype_model --filter dekf
      vsense run med_lap --vehicle genesis --filter inertial --smooth

    If BAG contains a reference, the estimates are compared with it. BAG may also be a recording that `vsense import`
    reads. The command writes a bag with the estimates and summary.json; --report adds a picture (PNG, SVG) and a report
    that opens without a network. If the filter diverges, the exit code is 3, and the estimates until then are written.
    """
    from dataclasses import replace

    import numpy as np

    from vsense_ros.bag import write_bag
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.checks.examination import findings
    from vsense_ros.checks.mending import mended, mends
    from vsense_ros.checks.roles import topics_of
    from vsense_ros.checks.sentences import mend_in_words, sentences
    from vsense_ros.estimation.reading import noise_at_start
    from vsense_ros.evaluate.drive import Drive
    from vsense_ros.evaluate.reference import at_reference, mounting_in_words
    from vsense_ros.evaluate.terminal import console, progress, say, show_drive, waiting
    from vsense_ros.model.sensors import unheard
    from vsense_ros.model.simulation.closed_loop import rolling_radii

    car = load_car(vehicle)
    estimate = _way(chosen, smooth, lag)
    with waiting(f"reading {bag.name}"):
        recording = import_recording(bag)
    name = recording.name or bag.stem
    for sentence in unheard(recording.channels, car.sensors.values(), car.name):
        warn(sentence)
    topics, radius = topics_of(car.sensors.values()), float(np.mean(rolling_radii(car)))
    if mend:
        todo = mends(recording, topics, radius)
        recording = mended(recording, todo)
        for one in todo:
            say(f"Mended: {mend_in_words(one)}.")
    for sentence in sentences(findings(recording, topics, radius)):
        warn(sentence)
    heading = [sensor.topic for sensor in car.sensors.values() if sensor.on_map]
    if heading and not any(topic in recording for topic in heading):
        warn(f"none of {', '.join(heading)} is in the recording: the car's heading on the map stays unknown")
    for sensor, noise in noise_at_start(recording, car.sensing()).items():
        say(f"{sensor}: standard deviation {noise}")
    with progress(f"estimating {name}") as done:
        result = estimate(recording, car, done)
    compared = replace(result, output=at_reference(result.output, car))
    notes = tuple(filter(None, [mounting_in_words(car)]))
    drive = Drive.of(name, f"{name}, {car.name}", recording, compared, vehicle=car, way="without ROS", notes=notes)
    folder = out if out is not None else Path("out") / "run" / name
    folder.mkdir(parents=True, exist_ok=True)
    write_bag(folder / "output", result.output, overwrite=True)
    (folder / "summary.json").write_text(json.dumps({name: drive.summary()}, indent=2) + "\n", encoding="utf-8")
    if report:
        from vsense_ros.evaluate.picture import draw
        from vsense_ros.evaluate.report import write_report

        with waiting("drawing"):
            picture = draw(drive, folder / "picture")[0]
            write_report([drive], folder / "report.html", title=drive.title, pictures={name: picture})
    show_drive(drive, console())
    say(f"Results in {folder}.")
    if result.failure:
        click.echo(f"vsense: {printable(result.failure)}", err=True)
        context.exit(DIVERGED)


def _way(chosen: str | None, smooth: bool, lag: float | None) -> Callable[[Recording, Vehicle, Progress], Any]:
    """Function that estimates a recording of a vehicle: message by message, or smoothed."""
    from vsense_ros.navigation.catalogue import FILTERS as NAVIGATION
    from vsense_ros.runner import run
    from vsense_ros.runner.smoothing import run_smoothed

    if chosen is not None:
        every_filter()[chosen]  # which says what there is
    if not (smooth or lag):
        return lambda recording, car, done: run(recording, car, chosen or "", progress=done)
    if chosen not in NAVIGATION.names:
        raise InputError(
            "--smooth and --lag are for a GNSS/INS filter of one state space, which --filter names; `vsense filters` "
            "lists them"
        )
    return lambda recording, car, done: run_smoothed(recording, car, chosen, lag=lag, progress=done)


@click.command()
@click.option("--all", "every", is_flag=True, help="Include filters that repeat a paper or serve as a comparison.")
def filters(every: bool) -> None:
    """List the filters, and when to use which.

    \b
    Examples:
      vsense filters
      vsense filters --all

    `vsense run --filter NAME` and the parameter `filter` of the observer node take one of them. `vsense export c`
    writes errorEKF, SPI and all GNSS/INS filters except the particle filter.
    """
    from vsense_ros.estimation.catalogue import described
    from vsense_ros.evaluate.terminal import console

    known = every_filter()
    console().print(described(known if every else known.recommended))


COMMANDS = (run, filters)
