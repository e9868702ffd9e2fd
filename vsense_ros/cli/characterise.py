"""Say what kind of car it is."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import VEHICLE_HELP, load_car, warn


@click.command()
@click.argument("car_or_recordings", nargs=-1, required=True, metavar="VEHICLE|RECORDING...")
@click.option(
    "--vehicle", metavar="FILE", help=f"States mass, wheelbase and sensor mounting for RECORDINGS. {VEHICLE_HELP}"
)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/characterise"), show_default=True,
    help="Path without extension, for a picture and JSON.",
)  # fmt: skip
def characterise(car_or_recordings: tuple[str, ...], vehicle: str | None, out: Path) -> None:
    """Measure understeer, roll gradient, radii and stiffnesses.

    \b
    Examples:
      vsense characterise jaguar_saloon
      vsense characterise lap_1 lap_2 --vehicle genesis --out out/genesis_laps

    Determines rolling radii, stiffnesses, understeer and roll gradient, steering ratio and frequency response. A
    VEHICLE file is driven through the tests on the full model: straights at 15 and 50 km/h, a winding drive, a slow
    ramp of the steering, and a sweep. RECORDINGS are used as they are; quantities that they cannot determine are listed
    with the reason. The standard deviations include slow errors, but not systematic ones: the bank of a road looks like
    roll to an accelerometer.
    """
    from vsense_ros.api.recording import read_each
    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import console, progress, say
    from vsense_ros.files.installed import shared_folder
    from vsense_ros.identification import characterise as job
    from vsense_ros.identification import characterise_report as report
    from vsense_ros.identification.drive_signals import of_recording
    from vsense_ros.model.vehicle import left_out_of_simulation

    folder = shared_folder("config") / "vehicles"
    files = [a for a in car_or_recordings if Path(a).suffix in (".yaml", ".yml") or (folder / f"{a}.yaml").is_file()]
    if files and (len(car_or_recordings) > 1 or vehicle is not None):
        raise click.UsageError(
            f"expected one VEHICLE alone, or RECORDINGS and --vehicle; found the vehicle {files[0]} among others"
        )
    car = load_car(files[0]) if files else load_car(vehicle) if vehicle is not None else None
    if files and car is not None:
        warn(left_out_of_simulation(car))
        with progress("driving the tests") as done:
            drives = job.drive_tests(car, done)
        title = car.name
    else:
        paths = [Path(argument) for argument in car_or_recordings]
        for path in paths:
            if not path.exists():
                raise InputError(f"{path}: neither a recording nor a vehicle file, nor the name of one in {folder}")
        with progress("reading") as done:
            drives = []
            for i, recording in enumerate(read_each(paths)):
                drives.append(of_recording(recording, car))
                done((i + 1) / len(paths))
        title = ", ".join(drive.name for drive in drives)
    result = job.characterise(title, drives, car)
    report.show(result, console())
    out.parent.mkdir(parents=True, exist_ok=True)
    report.write(result, out.with_suffix(".json"))
    picture = report.draw(result, car, out.with_suffix(".png"))
    say(f"Written to {picture} and {out.with_suffix('.json').name}.")


COMMANDS = (characterise,)
