"""Parts of a vehicle file: tyres, suspension tables, the list of parameters."""

from __future__ import annotations

import json
from pathlib import Path

import click

from vsense_ros.cli.common import EXISTING


@click.command()
@click.argument("files", nargs=-1, metavar="[FILE]...", type=EXISTING)
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/tyres"), show_default=True, help="Folder.")
@click.option("--rig", is_flag=True, help="Draw besides what a rig measures: a plank pulled away below the tyre.")
def tyres(files: tuple[Path, ...], out: Path, rig: bool) -> None:
    """Draw tyres: force curves, friction ellipse, influence of load and inclination, lag.

    FILE is a .tir file or YAML as in a vehicle file; without, all of config/tyres.

    \b
    Examples:
      vsense tyres --out docs/tyres
      vsense tyres my_tyre.tir --rig
    """
    from vsense_ros.evaluate.tyre_picture import draw
    from vsense_ros.evaluate.tyre_rig import draw_rig
    from vsense_ros.files.installed import shared_folder
    from vsense_ros.files.tyre import load_tyre

    out.mkdir(parents=True, exist_ok=True)
    for file in files or sorted((shared_folder("config") / "tyres").iterdir()):
        tyre = load_tyre(file)
        title = f"{file.stem} ({tyre.model.replace('_', ' ')})"
        click.echo(draw(tyre, title, out / f"{file.stem}.png"))
        if rig:
            click.echo(draw_rig(tyre, title, out / f"{file.stem}_rig.png"))


@click.command()
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
    from vsense_ros.evaluate.suspension_table import show
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
    show(tables, errors, console())
    say(f"Written to {target}.")


@click.command()
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


COMMANDS = (tyres, suspension, schema)
