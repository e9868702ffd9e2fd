"""Run an observer over a recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from vsense_ros.cli.common import DIVERGED, EXISTING, NEW_FOLDER, every_filter, load_car, vehicle_option, warn
from vsense_ros.files.names import printable

if TYPE_CHECKING:
    from vsense_ros.api.estimation import Task
    from vsense_ros.model.vehicle import Vehicle


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
@click.option("--against", metavar="TOPICS", help="Compare with these topics: reference (default) or smoothed.")
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
    against: str | None,
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

    If BAG contains a reference, the estimates are compared with it, or with what `vsense smooth` computed. BAG may also
    be a recording that `vsense import` reads. The command writes a bag with the estimates and summary.json; --report
    adds a picture (PNG, SVG) and a report that opens without a network. If the filter diverges, the exit code is 3, and
    the estimates until then are written.
    """
    from vsense_ros.api.estimation import check_filter, estimate_task
    from vsense_ros.bag import write_bag
    from vsense_ros.evaluate.terminal import console, progress, say, show_drive, waiting

    car = load_car(vehicle)
    check_filter(chosen or "", smooth=smooth, lag=lag)
    task = _prepared(bag, car, mend)
    with progress(f"estimating {task.recording.name}") as done:
        result = estimate_task(
            task, chosen or "", smooth=smooth, lag=lag, against=against or "reference", progress=done
        )
    drive = result.drive
    name = drive.name
    folder = out if out is not None else Path("out") / "run" / name
    folder.mkdir(parents=True, exist_ok=True)
    write_bag(folder / "output", result.output, overwrite=True)
    (folder / "summary.json").write_text(json.dumps({name: drive.summary()}, indent=2) + "\n", encoding="utf-8")
    if report:
        from vsense_ros.evaluate.picture import draw
        from vsense_ros.evaluate.provenance import provenance
        from vsense_ros.evaluate.report import write_report
        from vsense_ros.files.installed import vehicle_path

        with waiting("drawing"):
            picture = draw(drive, folder / "picture")[0]
            origin = provenance(vehicle=vehicle_path(vehicle), recording=bag, filter=chosen or "")
            write_report(
                [drive], folder / "report.html", title=drive.title, pictures={name: picture}, provenance=origin
            )
    show_drive(drive, console())
    say(f"Results in {folder}.")
    if result.failure:
        click.echo(f"vsense: {printable(result.failure)}", err=True)
        context.exit(DIVERGED)


def _prepared(bag: Path, car: Vehicle, mend: bool) -> Task:
    """A recording that has been read and examined for a car, with what is wrong or was mended said to the user."""
    from vsense_ros.api.estimation import prepare
    from vsense_ros.evaluate.terminal import say, waiting

    with waiting(f"reading {bag.name}"):
        task = prepare(bag, car, mend=mend)
    for sentence in task.warnings:
        warn(sentence)
    for note in task.notes:
        say(note)
    return task


@click.command()
@click.argument("bag", type=EXISTING)
@vehicle_option
@click.option("--out", type=NEW_FOLDER, help="Bag to write; default: out/smooth/<name>.")
@click.option("--mend", is_flag=True, help="Correct signs, axes and units that cannot be right.")
def smooth(bag: Path, vehicle: str, out: Path | None, mend: bool) -> None:
    """Compute a reference from all that was measured, where no reference was driven.

    \b
    Examples:
      vsense smooth lap --vehicle my_car.yaml --out lap_smoothed
      vsense run lap_smoothed --vehicle my_car.yaml --against smoothed

    The motion of the car is fitted to the whole recording at once: GNSS, inertial sensors, rear wheels and the heading
    of two antennas, with biases, lever arm and delay of the antenna, and how its rear axle slides. The command writes a
    bag of the recording with the topics smoothed/odometry and smoothed/sideslip, which state standard deviations.
    """
    from vsense_ros.api.estimation import UNSETTLED, smooth_task
    from vsense_ros.bag import write_bag
    from vsense_ros.evaluate.signals import SIGNALS
    from vsense_ros.evaluate.terminal import console, plain_table, progress, say
    from vsense_ros.navigation.offline import UNITS

    task = _prepared(bag, load_car(vehicle), mend)
    with progress(f"smoothing {task.recording.name}") as done:
        smoothed = smooth_task(task, done)
    titles = ("RMSE against the reference", "in 2σ", "NEES") if smoothed.scores else ()
    table = plain_table("signal", "standard deviation (median)", *titles)
    for name, deviation in smoothed.deviations.items():
        signal, score = SIGNALS[name], smoothed.scores.get(name)
        cells = [f"{deviation * signal.shown_per_unit:.3g} {signal.shown_unit}"]
        if score is not None and score.within_2s is not None and score.nees is not None:
            rmse = f"{score.rmse * signal.shown_per_unit:.3g} {signal.shown_unit}"
            cells += [rmse, f"{100 * score.within_2s:.0f} %", f"{score.nees:.2f}"]
        table.add_row(signal.label, *cells)
    console().print(table)
    table = plain_table("parameter of sensors or car", "value", "±", "unit", right=("value", "±"))
    for name, (value, deviation) in smoothed.parameters.items():
        table.add_row(name.replace("_", " "), f"{value:.4g}", f"{deviation:.2g}", UNITS[name])
    console().print(table)
    folder = out if out is not None else Path("out") / "smooth" / task.recording.name
    folder.parent.mkdir(parents=True, exist_ok=True)
    write_bag(folder, smoothed.recording, overwrite=out is None)
    if smoothed.change > UNSETTLED:
        warn(f"the last iteration still moved a state by {smoothed.change:.1f} of its standard deviation")
    say(f"Written to {folder}. Compare with it: vsense run {folder} --vehicle {vehicle} --against smoothed")


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

    catalogue = every_filter()
    console().print(described(catalogue if every else catalogue.recommended))


COMMANDS = (run, smooth, filters)
