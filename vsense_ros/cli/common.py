"""What the commands share: how they end where the input is at fault, and the options that several have."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsense_ros.api.stretch import Stretch
from vsense_ros.errors import InputError
from vsense_ros.extras import explained
from vsense_ros.files.names import printable

if TYPE_CHECKING:  # at run time it would load the whole model before the first line of help
    from vsense_ros.estimation.catalogue import Catalogue
    from vsense_ros.model.vehicle import Vehicle

FAULT = 2  # exit code for input that cannot be used, as for a wrong option
STOPPED = 130  # exit code of a command that the user stopped, as of a shell
DIVERGED = 3  # exit code of a run in which the filter diverged
EXISTING = click.Path(exists=True, path_type=Path)
NEW_FILE = click.Path(dir_okay=False, path_type=Path)
NEW_FOLDER = click.Path(file_okay=False, path_type=Path)
VEHICLE_HELP = "Vehicle file, or the name of one in config/vehicles (genesis, rav4, …)."
vehicle_option = click.option("--vehicle", required=True, metavar="FILE", help=VEHICLE_HELP)


class StretchType(click.ParamType):
    """`recording`, or `recording@from:to` in seconds since its first stamp; either may be left out."""

    name = "recording"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Stretch:
        if isinstance(value, Stretch):
            return value
        try:
            stretch = Stretch.parse(value)
        except InputError as error:
            self.fail(str(error), param, ctx)
        EXISTING.convert(str(stretch.path), param, ctx)
        return stretch


STRETCH = StretchType()


class Commands(click.Group):
    """A group whose commands end with one message, not a traceback, where the input is at fault."""

    program = "vsense"  # that the message names

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with explained():
                return super().invoke(ctx)
        except InputError as error:
            click.echo(f"{self.program}: {printable(str(error))}", err=True)
        except OSError as error:
            place = f"{error.filename}: " if error.filename else ""
            click.echo(f"{self.program}: {printable(f'{place}{error.strerror or error}')}", err=True)
        except KeyboardInterrupt:
            click.echo(f"\n{self.program}: stopped; what was finished stays, and no file is half-written", err=True)
            ctx.exit(STOPPED)
        ctx.exit(FAULT)


class GroupedCommands(Commands):
    """A group of commands whose help lists them below headings, with their whole summaries."""

    headings: Mapping[str, Sequence[str]] = {}  # names of commands by heading

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        shown = {name: command for name, command in self.commands.items() if not command.hidden}
        listed = {name for names in self.headings.values() for name in names}
        unlisted = sorted(set(shown) - listed)
        width = max(map(len, shown), default=0)
        for heading, names in [*self.headings.items(), ("Other", unlisted)]:
            rows = [(name.ljust(width), shown[name].get_short_help_str(10_000)) for name in names if name in shown]
            if rows:
                with formatter.section(heading):
                    formatter.write_dl(rows)


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
    values: dict[str, Any] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key.isidentifier():
            raise click.BadParameter(f"expected KEY=VALUE, found {pair!r}")
        try:
            values[key] = json.loads(text)
        except json.JSONDecodeError:
            values[key] = text
    return values


def warn(text: str) -> None:
    """One line on stderr, if there is something to be said."""
    if text:
        click.echo(f"warning: {printable(text)}", err=True)


def load_car(vehicle: str) -> Vehicle:
    """The vehicle of a file, or of a name in config/vehicles."""
    from vsense_ros.api.vehicle import load_vehicle

    return load_vehicle(vehicle)


def every_filter() -> Catalogue:
    """The filters of the multibody car and those of the GNSS/INS family."""
    from vsense_ros.runner import catalogue

    return catalogue.every_filter()
