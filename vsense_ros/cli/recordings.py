"""Recordings: import them, look into them, fetch the public ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from vsense_ros.cli.common import EXISTING, Commands, key_value_pairs


@click.command("import")
@click.argument("source", type=EXISTING)
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--mapping", type=EXISTING, help="Which column or signal is what: names, units, signs (tables, measurements, CAN)."
)
@click.option("--dbc", type=EXISTING, help="Database of a CAN log.")
@click.option(
    "--option", "options", multiple=True, metavar="KEY=VALUE", callback=key_value_pairs, help="Passed to the importer."
)
@click.option("--overwrite", is_flag=True, help="Replace a bag that stands at OUT.")
def import_(
    source: Path, out: Path, mapping: Path | None, dbc: Path | None, options: dict[str, Any], overwrite: bool
) -> None:
    """Turn a recording from elsewhere into a bag that rosbag2 plays.

    The format is found by looking at SOURCE.

    \b
    Examples:
      vsense import laps/med_lap_center_8_21.mat med_lap
      vsense import log.csv log --mapping log.yaml
      vsense import drive.blf drive --dbc car.dbc --mapping config/can/toyota_rav4_2017.yaml
      vsense import segment/ rav4 --option rolling_radius=0.35
    """
    from vsense_ros.bag import write_bag
    from vsense_ros.bag.importers import import_recording
    from vsense_ros.evaluate.terminal import console, say, show_inspection, waiting
    from vsense_ros.messages.inspect import inspect
    from vsense_ros.model.sensors import known_topics

    options |= {name: value for name, value in (("mapping", mapping), ("dbc", dbc)) if value is not None}
    with waiting(f"importing {source.name}"):
        recording = import_recording(source, **options)
        write_bag(out, recording, overwrite=overwrite)
    show_inspection(inspect(recording, known_topics()), console())
    say(f"Written to {out}.")


@click.command()
@click.argument("bag", type=EXISTING)
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
    from vsense_ros.evaluate.terminal import console, show_inspection, waiting
    from vsense_ros.messages.inspect import inspect
    from vsense_ros.model.sensors import known_topics

    with waiting(f"reading {bag.name}"):
        inspection = inspect(import_recording(bag), known_topics())
    show_inspection(inspection, console())


@click.group(invoke_without_command=True, cls=Commands)
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
    from vsense_ros.bag import datasets as known
    from vsense_ros.bag.dataset_table import show
    from vsense_ros.evaluate.terminal import console, say

    show(console())
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


COMMANDS = (import_, info, datasets)
