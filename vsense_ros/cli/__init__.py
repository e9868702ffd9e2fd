"""The `vsense` command: every job of the project that needs no ROS, and the demo of those that do.

One file for each group of commands. Modules of the project are imported inside the commands, so that `vsense --help`
answers at once; what a command prints as a table is made where the figures come from.
"""

from __future__ import annotations

import click

from vsense_ros.cli import (
    can,
    characterise,
    demo,
    design,
    estimate,
    explain,
    export,
    identify,
    observability,
    partition,
    prepare,
    recordings,
    simulate,
    studio,
    trust,
    vehicle,
    view,
)
from vsense_ros.cli.common import GroupedCommands

HEADINGS = {
    "Use": ("studio", "demo", "run", "smooth", "filters", "view", "monitor"),
    "Prepare": (
        "new-vehicle", "can", "import", "info", "check", "calibrate", "datasets", "schema", "suspension", "compile"
    ),
    "Identify": ("characterise", "identify", "tune", "observability"),
    "Explain": ("explain",),
    "Export": ("export", "export-results", "urdf"),
    "Studies": ("simulate", "tyres", "faults", "design", "partition"),
}  # fmt: skip


def _print_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if not wanted or context.resilient_parsing:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        click.echo(f"vsense {version('vsense_ros')}")
    except PackageNotFoundError:
        click.echo("vsense, run from its sources without having been installed")
    context.exit()


@click.group(cls=GroupedCommands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="Show the version."
)
def main() -> None:
    """Estimate what no sensor of a car measures: side slip, attitude, tyre forces.

    \b
    Examples:
      vsense demo                                   see it work on real drives
      vsense import LAP.mat lap                     convert a recording to a bag
      vsense info lap                               look for faults in it
      vsense run lap --vehicle genesis --report     estimate, compare, report
    """


for _command in (
    *recordings.COMMANDS,
    *can.COMMANDS,
    *estimate.COMMANDS,
    *explain.COMMANDS,
    *identify.COMMANDS,
    *trust.COMMANDS,
    *simulate.COMMANDS,
    *export.COMMANDS,
    *prepare.COMMANDS,
    *vehicle.COMMANDS,
    *characterise.COMMANDS,
    *observability.COMMANDS,
    *design.COMMANDS,
    *demo.COMMANDS,
    *partition.COMMANDS,
    *view.COMMANDS,
    *studio.COMMANDS,
):
    main.add_command(_command)
main.headings = HEADINGS
