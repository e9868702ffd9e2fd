"""Parts of a vehicle file: tyres, suspension tables, the list of parameters."""

from __future__ import annotations

import json
from pathlib import Path

import click

from vsense_ros.cli.common import EXISTING, NEW_FILE, NEW_FOLDER


@click.command()
@click.argument("files", nargs=-1, metavar="[FILE]...", type=EXISTING)
@click.option("--out", type=NEW_FOLDER, default=Path("out/tyres"), show_default=True, help="Folder to write to.")
@click.option("--rig", is_flag=True, help="Also draw a rig test: a plank pulled away below the tyre.")
def tyres(files: tuple[Path, ...], out: Path, rig: bool) -> None:
    """Draw the force curves of tyres.

    \b
    Examples:
      vsense tyres --out docs/tyres
      vsense tyres my_tyre.tir --rig

    The pictures show force curves, friction ellipse, the influence of load and inclination, and lag. FILE is a .tir
    file, or YAML as in a vehicle file; without FILE, all tyres of config/tyres are drawn.
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
@click.option("--output", type=NEW_FILE, metavar="FILE", help="File to write; default: the vehicle file itself.")
@click.option("--bump", default=0.06, show_default=True, help="Bump travel of the wheel centre [m].")
@click.option("--rebound", default=0.06, show_default=True, help="Rebound travel of the wheel centre [m].")
@click.option("--rack", default=0.04, show_default=True, help="Rack travel to either side [m].")
def suspension(vehicle: str, output: Path | None, bump: float, rebound: float, rack: float) -> None:
    """Compute suspension tables from the linkages of VEHICLE.

    \b
    Examples:
      vsense suspension prototype_real
      vsense suspension my_car.yaml --output my_car_with_tables.yaml --bump 0.09

    The tables state wheel centre, camber, toe, caster and spring travel as polynomials of wheel travel and steering.
    They are written to the section `suspension` of the vehicle file. The car with 14 degrees of freedom then moves its
    wheels as the linkages do.
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
@click.option("--json", "as_json", is_flag=True, help="Print a JSON schema instead of a Markdown table.")
def schema(as_json: bool) -> None:
    """Print the keys of a vehicle file: units, ranges, defaults.

    \b
    Examples:
      vsense schema > parameters.md
      vsense schema --json > vehicle.schema.json
    """
    from vsense_ros.files.schema import json_schema, markdown_table

    click.echo(json.dumps(json_schema(), indent=2) if as_json else markdown_table(), nl=as_json)


@click.command()
@click.argument("vehicle", metavar="VEHICLE")
@click.option("--output", type=NEW_FILE, metavar="FILE", help="File to write; default: print.")
@click.option("--prefix", default="", metavar="TEXT", help="Prefix of the name of every link, such as car1/.")
def urdf(vehicle: str, output: Path | None, prefix: str) -> None:
    """Write the links and joints of VEHICLE as a URDF.

    \b
    Examples:
      vsense urdf rav4 --output rav4.urdf
      vsense urdf rav4 --prefix car1/

    The file is for RViz, Foxglove, robot_state_publisher and tf2. base_link is the middle of the rear axle on the
    ground. The observer node publishes the same text on robot_description.
    """
    from vsense_ros.cli.common import load_car
    from vsense_ros.evaluate.terminal import say
    from vsense_ros.files.atomic import atomic_write
    from vsense_ros.files.urdf import urdf as as_urdf

    text = as_urdf(load_car(vehicle), prefix)
    if output is None:
        click.echo(text, nl=False)
        return
    with atomic_write(output) as file:
        file.write(text)
    say(f"Written to {output}.")


@click.command("compile")
@click.argument("vehicles", nargs=-1, required=True, metavar="VEHICLE...")
@click.option(
    "--filter",
    "chosen",
    metavar="NAME",
    help="Filter, as `vsense filters` lists them; default: that of the observer node.",
)
def compile_models(vehicles: tuple[str, ...], chosen: str | None) -> None:
    """Compile the models of VEHICLE in advance.

    \b
    Examples:
      vsense compile rav4
      vsense compile my_car.yaml --filter ukf

    The observer then starts at once. Compiled models are kept in the cache folder of the user, or in the folder that
    VSENSE_CACHE names. They are compiled again if the vehicle file, this package or the processor changes.
    """
    import time

    from vsense_ros import codegen
    from vsense_ros.cache import compiled_folder
    from vsense_ros.cli.common import load_car
    from vsense_ros.errors import InputError
    from vsense_ros.evaluate.terminal import say, waiting
    from vsense_ros.runner import Runner
    from vsense_ros.runner.catalogue import every_filter

    if codegen.compiler() is None:
        raise InputError(
            "no C compiler here (cc, gcc or clang; CC names another): install one, such as apt install gcc"
        )
    for name in vehicles:
        car = load_car(name)
        begin = time.perf_counter()
        with waiting(f"compiling {car.name}"):
            Runner(car, None, every_filter()[chosen].make if chosen else None)
        say(f"{car.name}: compiled in {time.perf_counter() - begin:.1f} s, kept in {compiled_folder()}.")


COMMANDS = (tyres, suspension, schema, urdf, compile_models)
