"""What the commands share: how they end where the input is at fault, and the options that several have."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsense_ros.errors import InputError

if TYPE_CHECKING:  # at run time it would load the whole model before the first line of help
    from vsense_ros.estimation.catalogue import Catalogue
    from vsense_ros.messages.recording import Recording
    from vsense_ros.model.vehicle import Vehicle

FAULT = 2  # exit code for input that cannot be used, as for a wrong option
EXISTING = click.Path(exists=True, path_type=Path)
VEHICLE_HELP = "Vehicle file, or the name of one in config/vehicles (genesis, rav4, …)."
vehicle_option = click.option("--vehicle", required=True, metavar="FILE", help=VEHICLE_HELP)


class Commands(click.Group):
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


class HoldsOut(click.Command):
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


def key_value_pairs(_: click.Context, __: click.Parameter, pairs: tuple[str, ...]) -> dict[str, Any]:
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


def warn(text: str) -> None:
    """One line on stderr, if there is something to be said."""
    if text:
        click.echo(f"warning: {text}", err=True)


def distinct_names(paths: Sequence[Path]) -> dict[Path, str]:
    """Names that begin with the folder, for recordings whose names are the same without it."""
    alike = Counter(path.stem for path in {path.resolve() for path in paths})
    return {path: f"{path.resolve().parent.name}/{path.name}" for path in paths if alike[path.resolve().stem] > 1}


def import_named(paths: Sequence[Path], names: Mapping[Path, str]) -> list[Recording]:
    """The recordings of any known format, with the names that are given for their paths."""
    from vsense_ros.bag.importers import import_recording

    found = [import_recording(path) for path in paths]
    return [replace(one, name=names.get(path, one.name)) for path, one in zip(paths, found, strict=True)]


def load_car(vehicle: str) -> Vehicle:
    """The vehicle of a file, or of a name in config/vehicles."""
    from vsense_ros.files.installed import vehicle_path
    from vsense_ros.files.vehicle import load_vehicle

    return load_vehicle(vehicle_path(vehicle))


def every_filter() -> Catalogue:
    """The filters of the multibody car and those of the GNSS/INS family."""
    from vsense_ros.estimation.catalogue import Catalogue
    from vsense_ros.navigation.catalogue import FILTERS as of_navigation
    from vsense_ros.observer.catalogue import FILTERS as of_car

    return Catalogue([*of_car, *of_navigation])
