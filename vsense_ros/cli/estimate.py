"""Run an observer over a recording."""

from __future__ import annotations

import json
from pathlib import Path

import click

from vsense_ros.cli.common import DIVERGED, EXISTING, NEW_FOLDER, every_filter, load_car, vehicle_option, warn
from vsense_ros.files.names import printable


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
    from vsense_ros.api.estimation import check_filter, estimate_task, prepare
    from vsense_ros.bag import write_bag
    from vsense_ros.evaluate.terminal import console, progress, say, show_drive, waiting

    car = load_car(vehicle)
    check_filter(chosen or "", smooth=smooth, lag=lag)
    with waiting(f"reading {bag.name}"):
        task = prepare(bag, car, mend=mend)
    for sentence in task.warnings:
        warn(sentence)
    for note in task.notes:
        say(note)
    with progress(f"estimating {task.recording.name}") as done:
        result = estimate_task(task, chosen or "", smooth=smooth, lag=lag, progress=done)
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
