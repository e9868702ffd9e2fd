"""From catalogue values and an ordinary drive to a vehicle file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from vsense_ros.cli.common import EXISTING, NEW_FILE, vehicle_option

DOUBTFUL = 1  # exit code of a check that found something

# Options that a new vehicle cannot do without, with what is asked in a terminal and an example.
_NEEDED = {
    "mass": ("Mass of the car as it is driven, in kg", "1395"),
    "wheelbase": ("Wheelbase in m", "2.63"),
    "track": ("Track of the front wheels in m", "1.54"),
    "tyre": ("Size of the tyres, as on their sides", "205/55R16 91V"),
}
_WELCOME = {
    "axle_load_front": ("Mass on the front axle in kg", "820"),
    "steering_ratio": ("Steering ratio", "15.5"),
    "height": ("Height of the car in m", "1.45"),
}


@click.command("new-vehicle")
@click.argument("output", type=NEW_FILE, metavar="FILE")
@click.option("--name", help="Name of the car; default: that of the file.")
@click.option("--mass", type=float, metavar="KG", help="Mass as it is driven, with occupants and fuel.")
@click.option("--wheelbase", type=float, metavar="M", help="Distance between the axles.")
@click.option("--track", type=float, metavar="M", help="Distance between the front wheels.")
@click.option("--track-rear", type=float, metavar="M", help="Distance between the rear wheels; default: as in front.")
@click.option("--axle-load-front", type=float, metavar="KG", help="Part of the mass on the front wheels.")
@click.option("--tyre", metavar="SIZE", help="Tyre size, such as 205/55R16 or, with its load index, 205/55R16 91V.")
@click.option("--tyre-rear", metavar="SIZE", help="Tyre size of the rear wheels; default: as in front.")
@click.option(
    "--driven", type=click.Choice(["front", "rear", "all"]), default="front", show_default=True, help="Driven wheels."
)
@click.option("--steering-ratio", type=float, metavar="NUMBER", help="Steering-wheel angle over road-wheel angle.")
@click.option("--height", type=float, metavar="M", help="Height of the car.")
@click.option(
    "--like", type=click.Choice(["compact", "saloon", "suv", "van", "formula-student"]),
    help="Kind of car; default: what mass, wheelbase and height make likely.",
)  # fmt: skip
@click.option(
    "--for", "recordings", type=EXISTING, multiple=True, metavar="RECORDING",
    help="Recording of the car: one with a velocity in the axes of the car adds the sensor for it; may be repeated.",
)  # fmt: skip
@click.option("--force", is_flag=True, help="Replace an existing FILE.")
def new_vehicle(output: Path, force: bool, recordings: tuple[Path, ...], **values: Any) -> None:
    """Write the vehicle file of a car from catalogue values.

    \b
    Examples:
      vsense new-vehicle my_car.yaml --mass 1395 --wheelbase 2.63 --track 1.54 --axle-load-front 820 --tyre 205/55R16
      vsense new-vehicle racer.yaml --like formula-student

    All other numbers follow from rules that were derived from measurements of public cars: inertias, centre of gravity,
    springs, dampers, anti-roll bars and tyres. Each number has a standard deviation and a source, which `identify`,
    `explain` and the observer use as a prior. In a terminal the command asks for missing values.
    """
    from vsense_ros.api.preparation import new_vehicle as make
    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import say

    if output.exists() and not force:
        raise InputError(f"{output} exists; give another name, or --force to replace it")
    values["name"] = values["name"] or output.stem.replace("_", " ")
    if sys.stdin.isatty():
        _ask(values)
    new = make(**values, recordings=recordings)
    new.write(output)
    say(
        f"Written to {output}: {len(new.from_catalogue)} numbers from the catalogue, "
        f"{len(new.numbers) - len(new.from_catalogue)} by the rules for {new.kind} cars. Next: vsense check {output} "
        "RECORDING"
    )


def _ask(values: dict[str, Any]) -> None:
    """Ask for the needed values that are missing; if there was one, also for those that rules can fill."""
    missing = [name for name in _NEEDED if values[name] is None]
    for name in missing:
        words, example = _NEEDED[name]
        values[name] = click.prompt(f"{words} (such as {example})", type=str if name == "tyre" else float)
    for name, (words, example) in _WELCOME.items() if missing else ():
        if values[name] is None:
            answer = click.prompt(f"{words} (such as {example}; empty: by a rule)", default="", show_default=False)
            values[name] = _number(answer)


def _number(text: str) -> float | None:
    try:
        return float(text) if text.strip() else None
    except ValueError:
        raise click.BadParameter(f"expected a number, found {text!r}") from None


@click.command()
@click.argument("vehicle", metavar="VEHICLE")
@click.argument("recordings", nargs=-1, type=EXISTING, metavar="[RECORDING]...")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.pass_context
def check(context: click.Context, vehicle: str, recordings: tuple[Path, ...], as_json: bool) -> None:
    """Check whether VEHICLE describes a plausible car, and fits recordings.

    \b
    Examples:
      vsense check my_car.yaml
      vsense check my_car.yaml drive_1 drive_2

    Compares weight distribution, inertias, natural frequencies, tyres at their loads, understeer and roll gradient, and
    positions and noise of the sensors with the ranges of real cars. If a figure is outside, the command names the
    mistake that explains it: wrong units, exchanged distances, or a diameter instead of a radius. With RECORDINGS of
    the car, it also reports what their sensors contradict: units, signs and axes of signals, radii, steering ratio,
    mounting, latencies. The exit code is 0 if nothing looks wrong, and 1 otherwise.
    """
    from vsense_ros.api.preparation import check as checked
    from vsense_ros.evaluate.terminal import console

    result = checked(vehicle, recordings)
    if as_json:
        click.echo(json.dumps(result.as_dict(), indent=2))
    else:
        result.show(console())
    context.exit(0 if result.is_good else DOUBTFUL)


@click.command()
@click.argument("recordings", nargs=-1, required=True, type=EXISTING, metavar="RECORDING...")
@vehicle_option
@click.option("--output", type=NEW_FILE, metavar="FILE", help="Default: VEHICLE with .calibrated before its ending.")
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def calibrate(recordings: tuple[Path, ...], vehicle: str, output: Path | None, as_json: bool) -> None:
    """Calibrate the sensors of a car by ordinary drives: RECORDINGS with GNSS.

    Rolling radii, steering ratio and offset, mounting of the inertial sensor, place of the antenna, latencies, noise,
    and the cornering stiffness of the axles. Writes a new vehicle file, with what changed, by how much and how sure
    that is. What the drives do not determine stays as it is, and it says what to drive next. At the end the observer
    predicts the course in stretches whose GNSS it does not hear, with the file before and after: what makes that worse
    is refused. References are not looked at.

    \b
    Examples:
      vsense calibrate drive --vehicle my_car.yaml --output my_car.calibrated.yaml
      vsense calibrate lap_1 lap_2 --vehicle my_car.yaml
    """
    from vsense_ros.api.preparation import calibrate as calibrated
    from vsense_ros.api.preparation import write_calibration
    from vsense_ros.api.vehicle import load_vehicle
    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import console, say, waiting
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.prepare import calibration_report as report

    source = vehicle_path(vehicle)
    target = output or Path(f"{source.stem}.calibrated.yaml")
    car = load_vehicle(source)
    if target.exists() and target.resolve() == source.resolve():
        raise InputError(f"{target} is the vehicle file itself; give another name with --output")
    with waiting("calibrating"):
        calibration = calibrated(recordings, car)
    write_calibration(calibration, target, source)
    if as_json:
        click.echo(json.dumps(report.as_dict(calibration), indent=2))
        return
    calibration.show(console())
    say(f"Written to {target}. Next: vsense identify RECORDING... --vehicle {target}, or vsense run.")


COMMANDS = (new_vehicle, check, calibrate)
