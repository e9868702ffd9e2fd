"""Write an observer for machines that have no Python."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import click

from vsense_ros.cli.common import EXISTING, NEW_FILE, NEW_FOLDER, Commands, load_car, warn

if TYPE_CHECKING:
    from vsense_ros.model.vehicle import Vehicle


@click.group(cls=Commands)
def export() -> None:
    """Export an observer as C99 or as an FMU.

    \b
    Examples:
      vsense export c prototype_model --output out/c --check bags/double_lane_change
      vsense export fmu prototype_model --fmi 3 --output out/prototype.fmu --check bags/double_lane_change
      vsense export compare bags/double_lane_change --vehicle prototype_model
    """


@export.command("c")
@click.argument("vehicle")
@click.option("--output", required=True, type=NEW_FOLDER, metavar="DIR", help="Folder to write to.")
@click.option(
    "--sensor",
    "sensors",
    multiple=True,
    metavar="NAME",
    help="Use only these sensors of the vehicle file; default: all.",
)
@click.option(
    "--filter",
    "chosen",
    metavar="NAME",
    help="error_ekf, spi, or a GNSS/INS filter, as `vsense filters` lists them; default: as VEHICLE says.",
)
@click.option("--float32", "single", is_flag=True, help="Use single precision.")
@click.option(
    "--prefix",
    default="vsense",
    show_default=True,
    metavar="NAME",
    help="First part of all names of files, types and functions; give each export in a program its own.",
)
@click.option("--check", metavar="BAG", type=EXISTING, help="Compile, and compare with the Python observer on BAG.")
def export_c(
    vehicle: str,
    output: Path,
    sensors: tuple[str, ...],
    chosen: str | None,
    single: bool,
    prefix: str,
    check: Path | None,
) -> None:
    """Write the observer of VEHICLE as C99.

    \b
    Examples:
      vsense export c prototype_model --output out/c
      vsense export c rav4 --output out/rav4 --check segment/
      vsense export c rav4 --output out/small --sensor imu --sensor wheel_speeds --sensor steering
      vsense export c rav4 --output out/dual --filter dual_kkf --check segment/

    The code allocates no memory, uses no library except libm, and keeps its state in one struct. It is the errorEKF, or
    the SPI if VEHICLE lists parameters to be estimated, or the filter that --filter names.

    --check makes the same calls to both observers on a recording and prints the largest difference. Size and time of a
    step of errorEKF or SPI are written to the README of the sources. With --float32, the result is also compared with
    double precision. --check always compiles the names that begin with vsense; another prefix changes nothing else.
    """
    from vsense_ros.evaluate.terminal import console, progress, say, waiting
    from vsense_ros.export import c
    from vsense_ros.model.vehicle import left_out_of_observer
    from vsense_ros.navigation.catalogue import FILTERS as OF_NAVIGATION

    car = load_car(vehicle)
    if sensors:
        car = c.with_sensors(car, sensors)
    if chosen in OF_NAVIGATION.names:
        _export_filter(car, str(chosen), output, prefix, check, single)
        return
    if chosen is not None:
        car = c.with_filter(car, chosen)
    warn(left_out_of_observer(car))
    with waiting("writing C"):
        files = c.write(car, output, single=single, prefix=prefix)
    say(f"Written to {output}: {', '.join(file.name for file in files)}.")
    if check is None:
        return
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.export import check as checking
    from vsense_ros.export.measuring import measure

    recording = import_recording(check)
    if single:
        from vsense_ros.export.single import compare_single

        with waiting("comparing with double precision"):
            differences = compare_single(car, recording)
        for name, unit, largest, size in differences:
            say(f"{name}: at most {largest:.2g} {unit} from double precision, of up to {size:.2g}.")
        return
    with TemporaryDirectory() as place:
        with waiting("compiling C"):
            c.write(car, Path(place))
            library = checking.build(Path(place))
        with progress("comparing") as done:
            difference = checking.compare(car, library, recording, done)
        for line in difference.in_words():
            console().print(line, soft_wrap=True)
        with waiting("measuring"):
            measured = measure(Path(place))
    c.write(car, output, measured, prefix=prefix)
    say(f"Size and time of a step: {output / 'README.md'}.")


def _export_filter(car: Vehicle, name: str, output: Path, prefix: str, check: Path | None, single: bool) -> None:
    """Write a filter of the GNSS/INS family as C, and compare it on a recording where there is one."""
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, progress, say, waiting
    from vsense_ros.export import filters, filters_check

    with waiting("writing C"):
        files = filters.write(car, name, output, prefix, single=single)
    say(f"Written to {output}: {', '.join(file.name for file in files)}.")
    if check is None:
        return
    with TemporaryDirectory() as place, progress("comparing") as done:
        filters.write(car, name, Path(place), single=single)
        difference = filters_check.compare(car, name, Path(place), import_recording(check), done, single=single)
    for line in difference.in_words():
        console().print(line, soft_wrap=True)


@export.command("fmu")
@click.argument("vehicle")
@click.option("--fmi", "version", type=click.Choice(["2", "3"]), default="3", show_default=True, help="Version of FMI.")
@click.option("--plant", is_flag=True, help="Export the car itself instead of its observer.")
@click.option("--output", required=True, type=NEW_FILE, metavar="FILE", help="FMU to write.")
@click.option("--no-binary", is_flag=True, help="Write only sources, to be compiled by the importing tool.")
@click.option("--scalars", is_flag=True, help="FMI 3 without arrays, for tools that read none.")
@click.option(
    "--target",
    "targets",
    multiple=True,
    metavar="MACHINE",
    help="Machine of a binary: x86_64-linux, aarch64-linux, x86_64-windows; may be repeated. Default: this one.",
)
@click.option("--filter", "chosen", metavar="NAME", help="error_ekf or spi; default: that of VEHICLE.")
@click.option(
    "--check",
    metavar="BAG",
    type=EXISTING,
    help="Validate, and compare with the C export and the Python observer on BAG.",
)
def export_fmu(
    vehicle: str,
    version: str,
    plant: bool,
    output: Path,
    no_binary: bool,
    scalars: bool,
    targets: tuple[str, ...],
    chosen: str | None,
    check: Path | None,
) -> None:
    """Write the observer of VEHICLE, or the car itself, as an FMU.

    \b
    Examples:
      vsense export fmu prototype_model --fmi 2 --output out/observer.fmu
      vsense export fmu prototype_model --plant --output out/car.fmu
      vsense export fmu rav4 --output out/rav4.fmu --check segment/
      vsense export fmu rav4 --output out/rav4.fmu --target x86_64-linux --target x86_64-windows

    The functional mock-up unit is for co-simulation, contains its sources, and needs no Python. The inputs of an
    observer are the steering angle and the sensor measurements, with a counter for each sensor that increases with
    every new measurement; its outputs are states and tyre forces. The inputs of a plant are steering, wheel torques and
    slopes of the road.
    """
    from vsense_ros.evaluate.terminal import console, progress, say, waiting
    from vsense_ros.export import c, fmu
    from vsense_ros.model.vehicle import left_out_of_observer

    if check is not None and (plant or no_binary):
        raise click.UsageError("--check compares an observer with a binary: leave --plant and --no-binary")
    if no_binary and targets:
        raise click.UsageError("--no-binary writes no binary, --target names one: leave one of them")
    if scalars and version == "2":
        raise click.UsageError("--scalars is for FMI 3: FMI 2 has nothing but scalars")
    car = load_car(vehicle)
    if chosen is not None:
        car = c.with_filter(car, chosen)
    warn(left_out_of_observer(car))
    with waiting("writing and compiling the unit"):
        machines = () if no_binary else targets or ("",)
        fmu.write(car, output, int(version), plant=plant, scalars=scalars, targets=machines)
    say(f"Written to {output} ({output.stat().st_size / 1024:.0f} kB).")
    if check is None:
        return
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.export import fmu_check

    recording = import_recording(check)
    with progress("comparing") as done:
        agreement = fmu_check.compare(car, output, int(version), recording, done, scalars=scalars)
    for line in agreement.in_words():
        console().print(line, soft_wrap=True)


@export.command("compare")
@click.argument("bag", type=EXISTING)
@click.option("--vehicle", required=True, metavar="NAME", help="Vehicle file, or the name of an installed one.")
@click.option("--filter", "chosen", metavar="NAME", help="error_ekf or spi; default: that of the vehicle.")
@click.option(
    "--seconds", type=click.FloatRange(min=0.0, min_open=True), metavar="S", help="Only the first S seconds of BAG."
)
def export_compare(bag: Path, vehicle: str, chosen: str | None, seconds: float | None) -> None:
    """Run the exported C, the FMU and the observer in Python on BAG.

    \b
    Examples:
      vsense export compare bags/double_lane_change --vehicle prototype_model
      vsense export compare bags/double_lane_change --vehicle prototype_model --filter spi --seconds 2

    All are compiled here and get the same measurements in order of time, as if none came late. A table has the RMS and
    the largest difference of each pair for each output, another the time of a step with its corrections. The FMU is run
    by FMPy, whose calls count in its time, and is left out where FMPy is not installed.
    """
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, plain_table, progress, say, waiting
    from vsense_ros.export import c, side_by_side
    from vsense_ros.model.vehicle import left_out_of_observer

    car = load_car(vehicle)
    if chosen is not None:
        car = c.with_filter(car, chosen)
    warn(left_out_of_observer(car))
    recording = import_recording(bag)
    if seconds is not None:
        recording = side_by_side.beginning(recording, seconds)
    with TemporaryDirectory() as place:
        with waiting("writing and compiling C and the unit"):
            built = side_by_side.build(car, Path(place))
        with progress("comparing") as done:
            comparison = side_by_side.compare(car, built, recording, done)
    headings = [f"{a} - {b}, {measure}" for a, b in comparison.pairs for measure in ("RMS", "largest")]
    table = plain_table("output", "unit", *headings, right=headings)
    table.columns[0].no_wrap = True
    columns = [column for pair in comparison.pairs for column in comparison.apart(pair)]
    for i, (name, unit) in enumerate(comparison.outputs):
        table.add_row(name, unit, *(f"{column[i]:.1e}" for column in columns))
    console().print(table)
    times = plain_table("computed by", "step", right=["step"])
    for name, seconds_of_step in comparison.seconds.items():
        times.add_row(name, f"{seconds_of_step * 1e6:.0f} µs")
    console().print(times)
    say(f"{comparison.steps} steps of {recording.name or bag.name}.")
    if side_by_side.UNIT not in comparison.values:
        say("The FMU was left out: FMPy is not installed (pip install 'vsense_ros[fmu]').")


@click.command("export-results")
@click.argument("source", type=EXISTING)
@click.option(
    "--to",
    "target",
    required=True,
    type=NEW_FILE,
    metavar="FILE",
    help="Its ending: .csv, .parquet, .mat, .mf4, .mcap.",
)
def export_results(source: Path, target: Path) -> None:
    """Convert estimates or a recording for other programs.

    \b
    Examples:
      vsense export-results out/run/double_lane_change --to lane_change.csv
      vsense export-results bags/step_steer --to step_steer.mf4

    SOURCE is the folder of a run, its output bag, or any recording that `vsense import` understands. Estimates are
    written as signals with their standard deviations, named with their units: `side_slip [rad]`,
    `side_slip_sigma [rad]`. `time [s]` counts from the first row, `stamp [ns]` since the Unix epoch. Of a recording
    without estimates all signals are written, with empty places at times at which they were not measured.
    """
    from vsense_ros.api.recording import read
    from vsense_ros.api.result import export_results as written
    from vsense_ros.api.saving import check_target
    from vsense_ros.evaluate.terminal import say, waiting

    check_target(target)
    output = source / "output"
    with waiting(f"reading {source.name}"):
        recording = read(output if output.is_dir() else source)
    with waiting(f"writing {target.name}"):
        written(recording, target)
    say(f"Written to {target}.")


COMMANDS = (export, export_results)
