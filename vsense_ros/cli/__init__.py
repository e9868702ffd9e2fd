"""The `vsense` command: every job of the project that needs no ROS, and the demo of those that do.

One file for each group of commands. Modules of the project are imported inside the commands, so that `vsense --help`
answers at once; what a command prints as a table is made where the figures come from.
"""

from __future__ import annotations

import click

from vsense_ros.cli import (
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
    trust,
    vehicle,
    view,
)
from vsense_ros.cli.common import Commands


def _print_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if not wanted or context.resilient_parsing:
        return
    from importlib.metadata import PackageNotFoundError, version

    try:
        click.echo(f"vsense {version('vsense_ros')}")
    except PackageNotFoundError:
        click.echo("vsense, run from its sources without having been installed")
    context.exit()


@click.group(cls=Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_print_version, help="Show it.")
def main() -> None:
    """On-vehicle virtual sensing: what the car did that no sensor measured.

    \b
    vsense demo                                   see it work on real drives
    vsense import LAP.mat lap                     turn a recording into a bag
    vsense info lap                               look for what is wrong with it
    vsense run lap --vehicle genesis --report     estimate, compare, report
    """


for _command in (
    *recordings.COMMANDS,
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
):
    main.add_command(_command)
