"""The `vsense` command: every job of the project that needs no ROS, and the demo of those that do.

Modules of the project are imported inside the commands, so that `vsense --help` answers at once.
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from vsense_ros.errors import InputError

FAULT = 2  # exit code for input that cannot be used, as for a wrong option


class _Commands(click.Group):
    """A group whose commands end with one message, not a traceback, where the input is at fault."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except InputError as error:
            click.echo(f"vsense: {error}", err=True)
        except OSError as error:
            place = f"{error.filename}: " if error.filename else ""
            click.echo(f"vsense: {place}{error.strerror or error}", err=True)
        ctx.exit(FAULT)


class _HoldsOut(click.Command):
    """A command whose --hold-out takes everything up to the next option, as a shell writes out `--hold-out lap_*`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        spread: list[str] = []
        held_out = False
        for arg in args:
            name, is_joined, first = arg.partition("=")
            if is_joined and name == "--hold-out":
                spread += [name, first]
                held_out = True
                continue
            if arg.startswith("-"):
                held_out = arg == "--hold-out"
            elif held_out and spread[-1] != "--hold-out":
                spread.append("--hold-out")
            spread.append(arg)
        return super().parse_args(ctx, spread)


def _print_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if not wanted or context.resilient_parsing:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        click.echo(f"vsense {version('vsense_ros')}")
    except PackageNotFoundError:
        click.echo("vsense, run from its sources without having been installed")
    context.exit()


def _options(_: click.Context, __: click.Parameter, pairs: tuple[str, ...]) -> dict[str, Any]:
    """`key=value` pairs; values that read as JSON (numbers, true, false) become what they read as."""
    found: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.isidentifier():
            raise click.BadParameter(f"expected KEY=VALUE, found {pair!r}")
        try:
            found[key] = json.loads(text)
        except json.JSONDecodeError:
            found[key] = text
    return found


def _warn(text: str) -> None:
    """One line on stderr, if there is something to be said."""
    if text:
        click.echo(f"warning: {text}", err=True)


_EXISTING = click.Path(exists=True, path_type=Path)
_vehicle_option = click.option(
    "--vehicle",
    required=True,
    metavar="FILE",
    help="Vehicle file, or the name of one in config/vehicles (genesis, rav4, …).",
)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="Show it.")
def main() -> None:
    """On-vehicle virtual sensing: what the car did that no sensor measured.

    \b
    vsense demo                                   see it work on real drives
    vsense import LAP.mat lap                     turn a recording into a bag
    vsense info lap                               look for what is wrong with it
    vsense run lap --vehicle genesis --report     estimate, compare, report
    """


@main.command("import")
@click.argument("source", type=_EXISTING)
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--mapping", type=_EXISTING, help="Names, units and signs of the columns (CSV, MDF4).")
@click.option(
    "--option", "options", multiple=True, metavar="KEY=VALUE", callback=_options, help="Passed to the importer."
)
@click.option("--overwrite", is_flag=True, help="Replace a bag that stands at OUT.")
def import_(source: Path, out: Path, mapping: Path | None, options: dict[str, Any], overwrite: bool) -> None:
    """Turn a recording from elsewhere into a bag that rosbag2 plays.

    The format is found by looking at SOURCE.

    \b
    Examples:
      vsense import laps/med_lap_center_8_21.mat med_lap
      vsense import log.csv log --mapping log.yaml
      vsense import segment/ rav4 --option rolling_radius=0.35
    """
    from vsense_ros.bag import write_bag
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.bag.inspect import inspect
    from vsense_ros.evaluate.terminal import console, say, show_inspection, waiting

    if mapping is not None:
        options["mapping"] = mapping
    with waiting(f"importing {source.name}"):
        recording = import_recording(source, **options)
        write_bag(out, recording, overwrite=overwrite)
    show_inspection(inspect(recording), console())
    say(f"Written to {out}.")


@main.command()
@click.argument("bag", type=_EXISTING)
def info(bag: Path) -> None:
    """Say what BAG holds and what looks wrong in it.

    Signals, rates, gaps, clocks, latencies; frozen signals, units, signs and frames that cannot be right. BAG may also
    be a recording that `vsense import` understands.

    \b
    Examples:
      vsense info bags/double_lane_change
      vsense info laps/med_lap_center_8_21.mat
    """
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.bag.inspect import inspect
    from vsense_ros.evaluate.terminal import console, show_inspection, waiting

    with waiting(f"reading {bag.name}"):
        inspection = inspect(import_recording(bag))
    show_inspection(inspection, console())


@main.command()
@click.argument("bag", type=_EXISTING)
@_vehicle_option
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the results; default: out/run/<name>.")
@click.option("--report", is_flag=True, help="Also a picture and an HTML report.")
def run(bag: Path, vehicle: str, out: Path | None, report: bool) -> None:
    """Estimate what BAG does not tell, and compare with its reference where it has one.

    BAG may also be a recording that `vsense import` understands. Writes an output bag and summary.json, with --report
    also a picture (PNG, SVG) and a report that opens without a network.

    \b
    Examples:
      vsense run bags/double_lane_change --vehicle prototype_model --report
      vsense run med_lap --vehicle genesis --out out/med_lap
    """
    from dataclasses import replace

    from vsense_ros import observer
    from vsense_ros.bag import write_bag
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.drive import Drive
    from vsense_ros.evaluate.reference import at_reference, mounting_in_words
    from vsense_ros.evaluate.terminal import console, progress, say, show_drive, waiting
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle

    car = load_vehicle(vehicle_path(vehicle))
    with waiting(f"reading {bag.name}"):
        recording = import_recording(bag)
    name = recording.name or bag.stem
    with progress(f"estimating {name}") as done:
        result = observer.run(recording, car, progress=done)
    compared = replace(result, output=at_reference(result.output, car))
    notes = tuple(filter(None, [mounting_in_words(car)]))
    drive = Drive.of(name, f"{name}, {car.name}", recording, compared, way="without ROS", notes=notes)
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


@main.command(cls=_HoldsOut)
@click.argument("recordings", nargs=-1, type=_EXISTING)
@click.option(
    "--vehicle", metavar="FILE", help="Vehicle file, or the name of one in config/vehicles (genesis, rav4, …)."
)
@click.option("--hold-out", "held_out", metavar="RECORDING…", multiple=True, type=_EXISTING, help="To prove it on.")
@click.option("--assume", multiple=True, metavar="EFFECT", help="Fit this effect instead of searching; repeatable.")
@click.option(
    "--ablation",
    metavar="PART",
    help="For comparison, the method without a part: no_refit, no_projection, chi2_thresholds.",
)
@click.option("--fleet", type=_EXISTING, metavar="DIR", help="Explain every vehicle that has a folder in DIR.")
@click.option("--scheduler", metavar="ADDRESS", help="Of a Dask cluster that sees the same files: tcp://host:8786.")
@click.option("--workers", type=click.IntRange(min=1), help="Processes on this machine; default: one per core.")
@click.option("--next", "design", is_flag=True, help="Say which test would tell the answer in --report apart.")
@click.option("--report", type=click.Path(path_type=Path), default=Path("out/explain"), show_default=True)
def explain(
    recordings: tuple[Path, ...],
    vehicle: str | None,
    held_out: tuple[Path, ...],
    assume: tuple[str, ...],
    ablation: str | None,
    fleet: Path | None,
    scheduler: str | None,
    workers: int | None,
    design: bool,
    report: Path,
) -> None:
    """Say what physics the model of a car leaves out on RECORDINGS.

    The parameters that a vehicle file is never sure of are fitted first; what is then left over is held against the
    effects of the library. Writes explain.json, report.html, and where something is named vehicle.extended.yaml,
    which every other command takes as --vehicle.

    With --fleet, DIR has one folder for each vehicle: its recordings, vehicle.yaml (or one in DIR for all that have
    none), and in held_out/ those to prove it on. All recordings of a vehicle are explained together, as what is named
    must hold on those left out of the fit. Vehicles run beside each other on Dask; what was done before, of the same
    files, is not done again; what cannot be used is listed with its reason. Writes into --report, outside of DIR, a
    folder for each vehicle, fleet.parquet (a row per recording and effect), fleet.csv and fleet.html.

    After an ambiguous answer generated manoeuvres are driven with each effect of the answer set at its fitted size, and
    ranked by what they would tell: next.json. With --next and no RECORDINGS that is done for the answer in the folder
    of --report.

    \b
    Examples:
      vsense explain lap_1 lap_2 --hold-out lap_3 --vehicle genesis --report out/explain
      vsense explain --next --vehicle genesis --report out/explain
      vsense explain --fleet recordings --report out/fleet
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
    verdict = _explain(recordings, vehicle, held_out, assume, ablation or "", report) if recordings else "ambiguous"
    if verdict == "ambiguous":
        try:
            _design(vehicle, report)
        except Exception as error:  # the answer is there without the next test
            if not recordings:
                raise
            _warn(f"no next test could be designed: {type(error).__name__}: {error}")
    elif design:
        click.echo(f"No next test: it would tell apart what an ambiguous answer leaves open; this one is {verdict}.")


def _explain(
    recordings: tuple[Path, ...],
    vehicle: str,
    held_out: tuple[Path, ...],
    assume: tuple[str, ...],
    ablation: str,
    report: Path,
) -> str:
    """The verdict."""
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle
    from vsense_ros.mismatch.explain import STAGES, explain_recordings
    from vsense_ros.mismatch.terminal import printed

    car = load_vehicle(vehicle_path(vehicle))
    report.mkdir(parents=True, exist_ok=True)  # what cannot be written is said before it is searched for
    names = _told_apart([*recordings, *held_out])
    train, proof = (
        [replace(recording, name=names.get(path, recording.name)) for path, recording in read]
        for read in ([(path, import_recording(path)) for path in paths] for paths in (recordings, held_out))
    )
    with progress("searching") as done:
        steps = iter(range(STAGES))
        found = explain_recordings(
            train, car, proof, assume, ablation, lambda: done(min(1.0, (next(steps, STAGES) + 1) / STAGES))
        )
    found.write(report)
    printed(found.answer, console())
    say(f"Results in {report}.")
    return found.answer.verdict


def _told_apart(paths: Sequence[Path]) -> dict[Path, str]:
    """Names with the folder, of recordings that are called alike without it."""
    alike = Counter(path.stem for path in {path.resolve() for path in paths})
    return {path: f"{path.resolve().parent.name}/{path.name}" for path in paths if alike[path.resolve().stem] > 1}


def _design(vehicle: str, report: Path) -> None:
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle
    from vsense_ros.mismatch import design
    from vsense_ros.mismatch.answer_schema import read_answer

    car = load_vehicle(vehicle_path(vehicle))
    design.left_open(read_answer(report), car)  # says what is wrong before a bar begins
    with progress("driving manoeuvres that may tell it apart") as done:
        found = design.designed(report, car, done)
    design.printed(found, console())
    say(f"Results in {report / design.NEXT}.")


def _explain_fleet(folder: Path, report: Path, scheduler: str | None, count: int | None) -> None:
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.mismatch import fleet, fleet_report

    fleet.make_room(report, folder)
    members = fleet.members(folder)
    with progress(f"explaining {len(members)} vehicles") as done, fleet.workers(scheduler, count) as client:
        results = fleet.explain_fleet(members, report, client, progress=done)
    fleet_report.write(results, report)
    fleet_report.printed(results, console())
    say(f"Results in {report}.")


@main.command(cls=_HoldsOut)
@click.argument("recordings", nargs=-1, required=True, type=_EXISTING)
@_vehicle_option
@click.option("--output", required=True, type=click.Path(dir_okay=False, path_type=Path), metavar="FILE", help="YAML.")
@click.option("--hold-out", "held_out", metavar="RECORDING…", multiple=True, type=_EXISTING, help="To judge by.")
@click.option("--own-noise", is_flag=True, help="Tune what messages state about their noise, too, and ignore that.")
def tune(recordings: tuple[Path, ...], vehicle: str, output: Path, held_out: tuple[Path, ...], own_noise: bool) -> None:
    """Find the noise covariances of the observer under which RECORDINGS are likeliest.

    Writes the vehicle file with them, comments kept, beside it a picture and all figures as JSON: how consistent the
    filter is with its innovations before and after, and with the truth where there is one.

    \b
    Examples:
      vsense tune drive_1 drive_2 --hold-out drive_3 --vehicle my_car.yaml --output my_car_tuned.yaml
    """
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle, save_changes
    from vsense_ros.identify import noise as job
    from vsense_ros.identify import noise_report
    from vsense_ros.model.vehicle import left_out_of_observer

    path = vehicle_path(vehicle)
    car = load_vehicle(path)
    _warn(left_out_of_observer(car))
    drives, proof = ([import_recording(recording) for recording in paths] for paths in (recordings, held_out))
    with progress("tuning") as done:
        result = job.tune(car, drives, proof, own_noise=own_noise, progress=done)
    output.parent.mkdir(parents=True, exist_ok=True)
    save_changes(path, output, result.vehicle, result.changed(car))
    result.write(output.with_suffix(".json"))
    picture = noise_report.draw(result, output.with_suffix(".png"))
    noise_report.show(result, console())
    say(f"Written to {output}, {output.with_suffix('.json').name}, {picture.name}.")


@main.command()
@click.argument("recordings", nargs=-1, required=True, type=_EXISTING)
@_vehicle_option
@click.option("--calibrate", type=click.Path(path_type=Path), metavar="LIMITS", help="File to write the limits to.")
@click.option("--limits", "limits_file", type=_EXISTING, metavar="LIMITS", help="Limits to judge RECORDINGS by.")
def monitor(recordings: tuple[Path, ...], vehicle: str, calibrate: Path | None, limits_file: Path | None) -> None:
    """Watch whether the observer's model still fits: find out what is normal, or judge RECORDINGS.

    Innovations of each sensor, generalized forces that the model lacks, and estimated errors are looked at over ten
    seconds. With --calibrate, RECORDINGS are at least two drives with nothing wrong, as different as they come; what
    they have, with a margin that each of them left out would have needed, becomes the limits. What one of them lacks
    has none, and is told. The observer node takes them as its parameter `monitor` and says in its diagnostics what has
    left them, and since when.

    \b
    Examples:
      vsense monitor monday tuesday --vehicle my_car.yaml --calibrate my_car.monitor.yaml
      vsense monitor friday --vehicle my_car.yaml --limits my_car.monitor.yaml
      ros2 run vsense_ros observer --ros-args -p vehicle:=my_car.yaml -p monitor:=my_car.monitor.yaml
    """
    if (calibrate is None) == (limits_file is None):
        raise click.UsageError("expected either --calibrate or --limits")
    from rich.table import Table

    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle
    from vsense_ros.model.vehicle import left_out_of_observer
    from vsense_ros.observer import calibration
    from vsense_ros.observer.monitor import load_limits, save_limits

    car = load_vehicle(vehicle_path(vehicle))
    _warn(left_out_of_observer(car))
    limits = load_limits(limits_file) if limits_file is not None else None
    names = _told_apart(recordings)
    watched = []
    with progress("watching") as done:
        for i, path in enumerate(recordings):
            share = i / len(recordings)
            recording = import_recording(path)
            recording = replace(recording, name=names.get(path, recording.name))
            watched.append(
                calibration.watch(recording, car, limits, lambda p, s=share: done(s + p / len(recordings)))  # type: ignore[misc]
            )
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    if calibrate is not None:
        found = calibration.calibrate(watched, car)
        save_limits(calibrate, found.limits)
        for heading in ("quantity", "mean from", "to", "rms to", "unit", "margin", "needed"):
            table.add_column(heading, justify="left" if heading in ("quantity", "unit") else "right")
        for name, one in found.limits.quantities.items():
            rms = "–" if one.rms is None else f"{one.rms:.3g}"
            margins = (f"{one.margin:.2f}", f"{found.needed[name]:.2f}")
            table.add_row(name, f"{one.low:.3g}", f"{one.high:.3g}", rms, one.unit, *margins)
        console().print(table)
        console().print("Needed: for each of the recordings, left out, to stay within the limits of the others.")
        cautions = [f"The same drive, which counts once: {', '.join(alike)}." for alike in found.repeated]
        for reason in dict.fromkeys(found.without.values()):
            quantities = ", ".join(name for name, why in found.without.items() if why == reason)
            cautions.append(f"No limits for {quantities}: {reason}.")
        if found.unsure:
            unsure = ", ".join(found.unsure)
            cautions.append(f"They differ too much for sure limits, more recordings are needed: {unsure}.")
        for text in cautions:
            console().print(text, soft_wrap=True, style="yellow", markup=False)
        say(f"Written to {calibrate}.")
        return
    for heading in ("recording", "no longer fits", "since"):
        table.add_column(heading, justify="right" if heading == "since" else "left")
    for drive in watched:
        for name, since in drive.beyond.items():
            table.add_row(drive.name, name, f"{since:.1f} s")
        if not drive.beyond:
            table.add_row(drive.name, "nothing", "–")
    console().print(table)


@main.command()
@click.argument("manoeuvre")
@_vehicle_option
@click.option("--out", required=True, type=click.Path(path_type=Path), metavar="BAG", help="Bag to write.")
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True, help="Of the sensors' noise.")
@click.option("--overwrite", is_flag=True, help="Replace a bag that stands at BAG.")
def simulate(manoeuvre: str, vehicle: str, out: Path, seed: int, overwrite: bool) -> None:
    """Drive a MANOEUVRE with the 14-DOF car: what its sensors record, with the truth as reference.

    An unknown name lists those there are.

    \b
    Examples:
      vsense simulate step_steer --vehicle prototype_real --out out/step_steer
      vsense run out/step_steer --vehicle prototype_model
    """
    from vsense_ros.bag import write_bag
    from vsense_ros.bag.inspect import inspect
    from vsense_ros.evaluate.terminal import console, say, show_inspection, waiting
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle
    from vsense_ros.manoeuvre import generate
    from vsense_ros.model.vehicle import left_out_of_simulation

    car = load_vehicle(vehicle_path(vehicle))
    _warn(left_out_of_simulation(car))
    with waiting(f"driving {manoeuvre}"):
        recording = generate(manoeuvre, car, seed)
        write_bag(out, recording, overwrite=overwrite)
    show_inspection(inspect(recording), console())
    say(f"Written to {out}.")


@main.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("bags"), show_default=True, help="Folder.")
def bags(out: Path) -> None:
    """Generate the manoeuvre bags of the repository again, bit by bit.

    \b
    Examples:
      vsense bags
      vsense bags --out /tmp/bags && diff -r bags /tmp/bags
    """
    from vsense_ros.evaluate.terminal import progress
    from vsense_ros.manoeuvre import STANDARD
    from vsense_ros.manoeuvre.bags import plant, write_bags

    written: list[Path] = []
    with progress("generating") as done:
        for path in write_bags(out, plant()):
            written.append(path)
            done(len(written) / len(STANDARD))
    for path in written:
        size = sum(file.stat().st_size for file in path.iterdir()) / 1e6
        click.echo(f"{path} {size:.2f} MB")


@main.command()
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/demo"), show_default=True, help="Folder.")
@click.option("--without-ros", is_flag=True, help="Run everything in this process.")
def demo(out: Path, without_ros: bool) -> None:
    """Three drives through the ROS processes: tables, pictures, a report.

    A Toyota RAV4 from its raw CAN, IMU and GNSS bytes, a lap of a Hyundai Genesis, a generated double lane change.
    Says what it leaves out where recordings, network or ROS are missing.

    \b
    Examples:
      vsense demo
      vsense demo --without-ros --out /tmp/demo
    """
    from vsense_ros.evaluate.terminal import console
    from vsense_ros.experiments.demo import run_demo

    run_demo(out, console(), through_ros=not without_ros)


@main.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/genesis.json"), show_default=True, help="File."
)
@click.option("--vehicle", metavar="FILE", default="genesis", show_default=True, help="Vehicle file, or its name.")
@click.option(
    "--identify", metavar="FILE", type=click.Path(path_type=Path), help="Identify the car instead, and write FILE."
)
@click.option("--start", metavar="FILE", default="genesis_start", show_default=True, help="Where that search begins.")
@click.option(
    "--reference", metavar="FILE", help="Vehicle file that tells place and mounting of the reference instead."
)
def genesis(out: Path, vehicle: str, identify: Path | None, start: str, reference: str | None) -> None:
    """Examine the observer on the third Genesis lap, or identify the car from the two others.

    Identification takes a quarter of an hour and gives the same values every time. It does not look at the third lap,
    so that nothing is chosen by what comes out there.

    \b
    Examples:
      vsense genesis
      vsense genesis --identify out/genesis.yaml
      vsense genesis --vehicle out/genesis.yaml
      vsense genesis --vehicle genesis_start --reference genesis_identified
    """
    from math import degrees

    from rich.table import Table

    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.experiments import genesis as job
    from vsense_ros.experiments.demo import dataset
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle, save_vehicle
    from vsense_ros.model.vehicle import left_out_of_observer

    def show(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
        table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
        for i, heading in enumerate(head):
            table.add_column(heading, justify="right" if i else "left")
        for row in rows:
            table.add_row(*row)
        console().print(table)

    folder = dataset("genesis_oxts_can")
    folder = folder if folder.is_dir() else folder.parent
    if identify is None:
        car = load_vehicle(vehicle_path(vehicle))
        _warn(left_out_of_observer(car))
        if reference is not None:
            car = car.model_copy(update={"reference": load_vehicle(vehicle_path(reference)).reference})
        with progress("estimating the third lap") as done:
            results = job.examine(folder, car, done)
        job.write_results(results, out)
        show(
            ("case", "side slip RMSE [°]", "lateral velocity NRMSD [%]"),
            [(name, *(f"{figure:.3f}" for figure in figures.values())) for name, figures in results.items()],
        )
        return
    if reference is not None:
        raise click.UsageError("--identify finds place and mounting of the reference itself")
    before = load_vehicle(vehicle_path(start))
    _warn(left_out_of_observer(before))
    with progress("identifying from the slow and the fast lap") as done:
        found = job.identify(before, job.identification_laps(folder), done)
    identify.parent.mkdir(parents=True, exist_ok=True)
    save_vehicle(identify, found.vehicle)
    numbers = [(knob.name, *(f"{knob.value(car):.4g}" for car in (before, found.vehicle))) for knob in job.KNOBS]
    yaw = ("mounting angle of the reference", *(f"{car.reference.yaw:.4g}" for car in (before, found.vehicle)))
    errors = [
        (f"side slip RMSE on {name} [°]", *(f"{degrees(error):.3f}" for error in pair))
        for name, *pair in zip(job.IDENTIFIED_FROM, found.before, found.after, strict=True)
    ]
    show(("identified", "start", "found"), [*numbers, yaw, *errors])
    say(f"Written to {identify}.")


@main.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/thesis.json"), show_default=True, help="File."
)
def thesis(out: Path) -> None:
    """Repeat the tables of Rodríguez 2020: a full car of 600 kg, observers that believe in 700 kg and more grip.

    \b
    Examples:
      vsense thesis
    """
    from vsense_ros.evaluate.terminal import console, progress
    from vsense_ros.experiments import thesis as job
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle

    plant, model = (load_vehicle(vehicle_path(name)) for name in ("prototype_real", "prototype_model"))
    with progress("driving and estimating") as done:
        results = job.repeat(plant, model, progress=done)
    job.write(results, out)
    job.show(results, console())


@main.group(invoke_without_command=True, cls=_Commands)
@click.pass_context
def datasets(context: click.Context) -> None:
    """List the public recordings that the project knows; fetch them.

    They are kept in the folder that VSENSE_DATA names, else in this user's cache.

    \b
    Examples:
      vsense datasets
      vsense datasets fetch genesis_oxts_can
    """
    if context.invoked_subcommand is not None:
        return
    from rich.table import Table

    from vsense_ros.bag import datasets as known
    from vsense_ros.evaluate.terminal import console, say

    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    for heading in ("name", "here", "licence", "what"):
        table.add_column(heading, no_wrap=heading != "what")
    for one in known.DATASETS.values():
        table.add_row(one.name, "no" if known.find(one.name) is None else "yes", one.licence, one.title)
    console().print(table)
    say(f"Folder: {known.data_dir()}")


@datasets.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
def fetch(names: tuple[str, ...]) -> None:
    """Download what is missing and check it; without NAME all of them."""
    from vsense_ros.bag import datasets as known
    from vsense_ros.evaluate.terminal import in_files, progress

    for name in names or tuple(known.DATASETS):
        with progress(name) as done:
            path = known.fetch(name, in_files(done))
        click.echo(path)


@main.group(cls=_Commands)
def export() -> None:
    """Write an observer for machines that have no Python.

    \b
    Examples:
      vsense export c prototype_model --output out/c --check bags/double_lane_change
    """


@export.command("c")
@click.argument("vehicle")
@click.option(
    "--output", required=True, type=click.Path(file_okay=False, path_type=Path), metavar="DIR", help="Folder."
)
@click.option(
    "--sensor", "sensors", multiple=True, metavar="NAME", help="Only these of the vehicle file; default: all."
)
@click.option("--check", metavar="BAG", type=_EXISTING, help="Compile, and compare with the Python observer on BAG.")
def export_c(vehicle: str, output: Path, sensors: tuple[str, ...], check: Path | None) -> None:
    """Write the observer of VEHICLE and its sensors as C99: no allocation, no library but libm, one struct.

    The errorEKF, or the SPI where VEHICLE lists parameters that are to be estimated.

    With --check both observers get the same calls on a recording; the largest difference is printed, and size and time
    of a step go into the README of the sources.

    \b
    Examples:
      vsense export c prototype_model --output out/c
      vsense export c rav4 --output out/rav4 --check segment/
      vsense export c rav4 --output out/small --sensor imu --sensor wheel_speeds --sensor steering
    """
    from vsense_ros.evaluate.terminal import console, progress, say, waiting
    from vsense_ros.export import c
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle
    from vsense_ros.model.vehicle import left_out_of_observer

    car = load_vehicle(vehicle_path(vehicle))
    if sensors:
        car = c.with_sensors(car, sensors)
    _warn(left_out_of_observer(car))
    with waiting("writing C"):
        files = c.write(car, output)
    say(f"Written to {output}: {', '.join(file.name for file in files)}.")
    if check is None:
        return
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.export import check as checking

    recording = import_recording(check)
    with waiting("compiling C"):
        library = checking.build(output)
    with progress("comparing") as done:
        difference = checking.compare(car, library, recording, done)
    for line in difference.in_words():
        console().print(line, soft_wrap=True)
    with waiting("measuring"):
        c.write(car, output, checking.measure(output))
    say(f"Size and time of a step: {output / 'README.md'}.")


@main.command()
@click.argument("files", nargs=-1, metavar="[FILE]...", type=_EXISTING)
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/tyres"), show_default=True, help="Folder.")
def tyres(files: tuple[Path, ...], out: Path) -> None:
    """Draw tyres: force curves, friction ellipse, influence of load and inclination, lag.

    FILE is a .tir file or YAML as in a vehicle file; without, all of config/tyres.

    \b
    Examples:
      vsense tyres --out docs/tyres
      vsense tyres my_tyre.tir
    """
    from vsense_ros.evaluate.tyre_picture import draw
    from vsense_ros.files.installed import shared_folder
    from vsense_ros.files.tyre import load_tyre

    out.mkdir(parents=True, exist_ok=True)
    for file in files or sorted((shared_folder("config") / "tyres").iterdir()):
        tyre = load_tyre(file)
        click.echo(draw(tyre, f"{file.stem} ({tyre.model.replace('_', ' ')})", out / f"{file.stem}.png"))


@main.command()
@click.argument("vehicle", metavar="VEHICLE")
@click.option("--output", type=click.Path(path_type=Path), metavar="FILE", help="Default: the vehicle file itself.")
@click.option("--bump", default=0.06, show_default=True, help="Highest wheel centre [m] over its design position.")
@click.option("--rebound", default=0.06, show_default=True, help="Lowest one below [m].")
@click.option("--rack", default=0.04, show_default=True, help="Travel of the rack to either side [m].")
def suspension(vehicle: str, output: Path | None, bump: float, rebound: float, rack: float) -> None:
    """Make kinematic tables of the suspension from the linkages of VEHICLE.

    Wheel centre, camber, toe, caster and spring travel against wheel travel and steering, as polynomials in the section
    `suspension` of the vehicle file. The car with 14 degrees of freedom then moves its wheels as the linkages do.

    \b
    Examples:
      vsense suspension prototype_real
      vsense suspension my_car.yaml --output my_car_with_tables.yaml --bump 0.09
    """
    from rich.table import Table

    from vsense_ros.evaluate.terminal import console, say, waiting
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle, save_tables
    from vsense_ros.model.car.kinematic_tables import kinematic_tables, largest_errors

    path = vehicle_path(vehicle)
    car = load_vehicle(path)
    with waiting(f"solving the linkages of {car.name}"):
        tables = kinematic_tables(car, bump, rebound, rack)
        errors = largest_errors(car, tables, rack)
    target = path if output is None else output
    save_tables(path, target, tables)
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    for heading in ("axle", "quantity", "coefficients", "largest error"):
        table.add_column(heading, justify="right" if heading in ("coefficients", "largest error") else "left")
    for axle, columns in errors.items():
        for name, error in columns.items():
            count = sum(c != 0 for row in getattr(getattr(tables, axle), name) for c in row)
            unit = f"{1e6 * error:.1f} µrad" if name in ("camber", "toe", "caster") else f"{1e6 * error:.1f} µm"
            table.add_row(axle, name, str(count), unit)
    console().print(table)
    say(f"Written to {target}.")


@main.command()
@click.option(
    "--vehicle", default="prototype_real", show_default=True, metavar="FILE", help="With linkages and tables."
)
@click.option("--out", type=click.Path(path_type=Path), default=Path("docs"), show_default=True, help="Folder.")
def simplification(vehicle: str, out: Path) -> None:
    """Compare the simplified car with the one that has all its bodies, on each generated manoeuvre.

    Writes simplification.md with tables and pictures: on suspension tables, and on straight guides.

    \b
    Examples:
      vsense simplification
      vsense simplification --vehicle my_car_with_tables.yaml --out out
    """
    from vsense_ros.evaluate.terminal import progress
    from vsense_ros.experiments import simplification as job
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle

    car = load_vehicle(vehicle_path(vehicle))
    if ids := [effect.id for effect in car.physics.effects.present()]:
        _warn(f"the comparison leaves out {', '.join(ids)} (physics.effects), which the full car cannot have")
    with progress("driving") as done:
        document = job.write(car, out, done)
    click.echo(document)


@main.command()
@click.option("--json", "as_json", is_flag=True, help="JSON schema instead of a Markdown table.")
def schema(as_json: bool) -> None:
    """Print the parameters of a vehicle file: keys, units, ranges, defaults.

    \b
    Examples:
      vsense schema > parameters.md
      vsense schema --json > vehicle.schema.json
    """
    from vsense_ros.files.schema import json_schema, markdown_table

    click.echo(json.dumps(json_schema(), indent=2) if as_json else markdown_table(), nl=as_json)


if __name__ == "__main__":
    sys.exit(main())
