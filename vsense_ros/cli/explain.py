"""Name the physics that a model leaves out, and the test that would decide between explanations."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.api.stretch import Stretch
from vsense_ros.cli.common import EXISTING, NEW_FOLDER, STRETCH, VEHICLE_HELP, HoldsOut, load_car, warn


@click.command(cls=HoldsOut)
@click.argument("recordings", nargs=-1, type=STRETCH)
@click.option("--vehicle", metavar="FILE", help=VEHICLE_HELP)
@click.option(
    "--hold-out",
    "held_out",
    metavar="RECORDING…",
    multiple=True,
    type=STRETCH,
    help="Recordings for validation; not used for fitting.",
)
@click.option("--assume", multiple=True, metavar="EFFECT", help="Fit this effect instead of searching; repeatable.")
@click.option(
    "--ablation",
    metavar="PART",
    help="Leave out a part of the method, for comparison: no_refit, no_projection, chi2_thresholds.",
)
@click.option("--laps", "by_lap", is_flag=True, help="Cut each recording into its laps, by position.")
@click.option(
    "--mend",
    is_flag=True,
    help="Correct signs, axes and units that cannot be right; without it, the correction is reported.",
)
@click.option(
    "--observer/--no-observer",
    "observe",
    default=True,
    help="Run the observer with the explained model, and fit its noise levels; on by default.",
)
@click.option("--fleet", type=EXISTING, metavar="DIR", help="Explain every vehicle that has a folder in DIR.")
@click.option(
    "--scheduler", metavar="ADDRESS", help="Address of a Dask cluster that sees the same files: tcp://host:8786."
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine; default: one per core.")
@click.option(
    "--next", "design", is_flag=True, help="Suggest the test that decides between the explanations in --report."
)
@click.option(
    "--report", type=NEW_FOLDER, default=Path("out/explain"), show_default=True, help="Folder for the results."
)
def explain(
    recordings: tuple[Stretch, ...],
    vehicle: str | None,
    held_out: tuple[Stretch, ...],
    assume: tuple[str, ...],
    ablation: str | None,
    by_lap: bool,
    mend: bool,
    observe: bool,
    fleet: Path | None,
    scheduler: str | None,
    workers: int | None,
    design: bool,
    report: Path,
) -> None:
    """Find the physics that the model of a car lacks.

    \b
    Examples:
      vsense explain lap_1 lap_2 --hold-out lap_3 --vehicle genesis --report out/explain
      vsense explain --next --vehicle genesis --report out/explain
      vsense explain --fleet recordings --report out/fleet

    The uncertain parameters of the vehicle file are fitted first. The residual is then compared with the effects of the
    library. Writes explain.json, report.html and, if an effect is named, vehicle.extended.yaml, which every other
    command takes as --vehicle.

    A recording may be a part of a file, such as `lap.mcap@207:310` [s since its first stamp]. Recordings whose signs,
    axes or units cannot be right are refused with the correction, which --mend applies.

    --next simulates manoeuvres with each remaining explanation of an ambiguous answer, ranks them by how clearly they
    separate the explanations, and writes next.json. Without RECORDINGS it uses the answer in the folder of --report.

    --fleet explains every vehicle that has a folder in DIR. The folder contains recordings, vehicle.yaml (or one in DIR
    for all vehicles that have none) and, in held_out/, the recordings for validation. The vehicles are processed in
    parallel by Dask. Results of unchanged files are reused, and vehicles that cannot be used are listed with the
    reason. The folder of --report, which must be outside of DIR, gets a folder for each vehicle, fleet.parquet (a row
    for each recording and effect), fleet.csv and fleet.html.
    """
    if fleet is not None:
        if recordings or vehicle or held_out or assume or ablation or design:
            raise click.UsageError("--fleet takes recordings and vehicle files from its folder, and no others")
        _explain_fleet(fleet, report, scheduler, workers)
        return
    if scheduler or workers:
        raise click.UsageError("--scheduler and --workers belong to --fleet")
    if not vehicle or not (recordings or design):
        raise click.UsageError("expected --vehicle and RECORDINGS, or --vehicle and --next, or --fleet")
    if not recordings and (held_out or assume):
        raise click.UsageError("--hold-out and --assume need RECORDINGS")
    if recordings:
        verdict = _explain(recordings, vehicle, held_out, assume, ablation or "", by_lap, mend, observe, report)
        _next_test(verdict, vehicle, report, design)
    else:
        _design(vehicle, report)


def _next_test(verdict: str, vehicle: str, report: Path, design: bool) -> None:
    """Design the test that would decide an ambiguous answer, or say how; without it the answer still holds."""
    if verdict != "ambiguous":
        if design:
            click.echo(f"No next test: it would decide what an ambiguous answer leaves open; this one is {verdict}.")
        return
    if not design:
        click.echo(f"vsense explain --next --vehicle {vehicle} --report {report} suggests the test that would decide.")
        return
    try:
        _design(vehicle, report)
    except Exception as error:
        warn(f"no next test could be designed: {type(error).__name__}: {error}")


def _explain(
    recordings: tuple[Stretch, ...],
    vehicle: str,
    held_out: tuple[Stretch, ...],
    assume: tuple[str, ...],
    ablation: str,
    by_lap: bool,
    mend: bool,
    observe: bool,
    report: Path,
) -> str:
    """Explain recordings, write and print the answer, and return its verdict."""
    from vsense_ros.api.explanation import explain as explained
    from vsense_ros.evaluate.terminal import console, progress, say

    car = load_car(vehicle)
    report.mkdir(parents=True, exist_ok=True)  # what cannot be written is said before it is searched for
    with progress("searching") as done:
        explanation = explained(
            recordings,
            car,
            hold_out=held_out,
            assume=assume,
            ablation=ablation,
            by_lap=by_lap,
            mend=mend,
            observe=observe,
            progress=done,
        )
    explanation.write(report)
    explanation.show(console())
    say(f"Results in {report}.")
    return explanation.answer.verdict


def _design(vehicle: str, report: Path) -> None:
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.mismatch import design
    from vsense_ros.mismatch.answer_schema import read_answer

    car = load_car(vehicle)
    design.left_open(read_answer(report), car)  # says what is wrong before a bar begins
    with progress("driving manoeuvres that may decide") as done:
        tests = design.designed(report, car, done)
    design.printed(tests, console())
    say(f"Results in {report / design.NEXT}.")


def _explain_fleet(folder: Path, report: Path, scheduler: str | None, count: int | None) -> None:
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.fleet import fleet
    from vsense_ros.fleet import report as pages

    fleet.make_room(report, folder)
    members = fleet.members(folder)
    with progress(f"explaining {len(members)} vehicles") as done, fleet.workers(scheduler, count) as client:
        results = fleet.explain_fleet(members, report, client, progress=done)
    pages.write(results, report)
    pages.printed(results, console())
    say(f"Results in {report}.")


COMMANDS = (explain,)
