"""Recordings: import them, look into them, fetch the public ones."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from vsense_ros.cli.common import EXISTING, Commands, key_value_pairs
from vsense_ros.errors import InputError
from vsense_ros.files.names import printable

if TYPE_CHECKING:
    from vsense_ros.bag.importers import Importer
    from vsense_ros.messages.recording import Recording


@click.command("import")
@click.argument("sources", nargs=-1, type=EXISTING, metavar="SOURCE...")
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--mapping",
    "mappings",
    multiple=True,
    type=EXISTING,
    help="Mapping of columns or signals to topics (text tables, measurement files, CAN). With several sources, one "
    "for each that needs it, in their order; default: the YAML file beside the source.",
)
@click.option(
    "--dbc",
    "databases",
    multiple=True,
    metavar="[BUS=]FILE",
    help="Database of a CAN log. Of a log of several buses one for each (can0=car.dbc), with a mapping for each.",
)
@click.option(
    "--option", "options", multiple=True, metavar="KEY=VALUE", callback=key_value_pairs, help="Passed to the importer."
)
@click.option("--keep-times", is_flag=True, help="Of several sources: their loggers have one clock, so shift none.")
@click.option("--overwrite", is_flag=True, help="Replace an existing bag at OUT.")
@click.option("--guess", "proposed", is_flag=True, help="Propose a mapping for a table, measurement or bag; no OUT.")
def import_(
    sources: tuple[Path, ...],
    out: Path,
    mappings: tuple[Path, ...],
    databases: tuple[str, ...],
    options: dict[str, Any],
    keep_times: bool,
    overwrite: bool,
    proposed: bool,
) -> None:
    """Convert a recording to a bag that rosbag2 plays.

    \b
    Examples:
      vsense import laps/med_lap_center_8_21.mat med_lap
      vsense import log.csv --guess > log.yaml
      vsense import log.csv log --mapping log.yaml
      vsense import foreign_bag --guess > topics.yaml
      vsense import drive.blf drive --dbc car.dbc --mapping config/can/toyota_rav4_2017.yaml
      vsense import drive.blf gnss.csv drive --dbc car.dbc --mapping can.yaml --mapping gnss.yaml
      vsense import segment/ rav4 --option rolling_radius=0.35

    The format is recognised from the content of SOURCE. Several recordings of one drive, from loggers with clocks of
    their own, become one recording in the time of the first. The offsets between the clocks are estimated from the
    motion that all of them measure.
    """
    from vsense_ros.bag.importers import find_importer, import_pieces, import_recording, is_large
    from vsense_ros.bag.join import joined
    from vsense_ros.bag.writing import write_pieces
    from vsense_ros.checks.inspect import inspect
    from vsense_ros.evaluate.terminal import console, say, show_inspection, waiting
    from vsense_ros.model.sensors import known_topics

    if proposed:
        if len(databases) > 1:
            raise InputError("--guess proposes a mapping for one bus; expected one --dbc")
        _propose((*sources, out), Path(databases[0].rpartition("=")[2]) if databases else None)
        return
    if not sources:
        raise InputError(f"{out}: expected a recording and the bag to write, found one of the two")
    unused_mappings = list(mappings)
    recordings = []
    following: Iterator[Recording] = iter(())  # pieces of a large file behind the first one
    for source in sources:
        with_dbc: dict[str, Any] = {"dbc": databases} if databases else {}
        importer = find_importer(source, {**options, **with_dbc})
        source_options = {**options, **_own_files(importer, with_dbc, unused_mappings, len(sources) == 1)}
        with waiting(f"importing {source.name}"):
            if len(sources) > 1:
                recordings.append(import_recording(source, **source_options))
            else:
                following = import_pieces(source, **source_options)
                recordings.append(next(following))
    if unused_mappings:
        raise InputError(f"{unused_mappings[0]}: a mapping more than there are sources that take one")
    with waiting(f"writing {out.name}"):
        recording = joined(recordings, keep_times=keep_times) if len(recordings) > 1 else recordings[0]
        write_pieces(out, chain([recording], following), overwrite=overwrite)
    show_inspection(inspect(recording, known_topics()), console())
    if len(sources) == 1 and importer.pieces is not None and is_large(sources[0]):
        say(f"Of this large file the first {recording.duration:.0f} s are inspected: all of it by 'vsense info {out}'.")
    say(f"Written to {out}.")


def _own_files(
    importer: Importer, with_dbc: dict[str, Any], unused_mappings: list[Path], alone: bool
) -> dict[str, Any]:
    """Databases and mappings for one source, which are taken out of the `unused_mappings`; one that is `alone` gets
    them in any case, so that its importer says what it cannot use."""
    source_options = with_dbc if "dbc" in importer.options or alone else {}
    if not unused_mappings or not ("mapping" in importer.options or alone):
        return dict(source_options)
    databases = source_options.get("dbc", ())
    count = len(databases) if len(unused_mappings) >= len(databases) > 1 else 1
    chosen = tuple(unused_mappings[:count]) if count > 1 else unused_mappings[0]
    del unused_mappings[:count]
    return {**source_options, "mapping": chosen}


def _propose(sources: tuple[Path, ...], dbc: Path | None) -> None:
    """Print a mapping, with what was assumed as comments."""
    from vsense_ros.bag.importers.guess import guess

    for source in sources:
        if not source.exists():
            raise InputError(
                f"{source}: no such file; --guess proposes a mapping for a table, a measurement file or a bag"
            )
        proposal = guess(source, dbc)
        remarks = [f"A proposal for {source.name}: look at every line, then import with --mapping.", *proposal.remarks]
        for remark in remarks:
            click.echo(f"# {' '.join(printable(remark).split())}")  # on its line, whatever a column is called
        click.echo(printable(proposal.text), nl=False)


@click.command()
@click.argument("bag", type=EXISTING)
@click.option(
    "--mapping",
    "mappings",
    multiple=True,
    type=EXISTING,
    help="Mapping of columns or signals; default: the YAML file beside BAG.",
)
@click.option("--dbc", "databases", multiple=True, metavar="[BUS=]FILE", help="Database of a CAN log, of each bus.")
def info(bag: Path, mappings: tuple[Path, ...], databases: tuple[str, ...]) -> None:
    """List the signals of BAG and what looks wrong in them.

    \b
    Examples:
      vsense info bags/double_lane_change
      vsense info laps/med_lap_center_8_21.mat
      vsense info drive.blf --dbc car.dbc --mapping config/can/toyota_rav4_2017.yaml

    Shows signals, rates, gaps, clocks and latencies, and reports frozen signals, and units, signs and frames that
    cannot be right. BAG may also be a recording that `vsense import` reads.
    """
    from vsense_ros.api.recording import info as examined
    from vsense_ros.evaluate.terminal import console, waiting

    options: dict[str, Any] = {"dbc": databases} if databases else {}
    if mappings:
        options["mapping"] = mappings if len(mappings) > 1 else mappings[0]
    with waiting(f"reading {bag.name}"):
        content = examined(bag, **options)
    content.show(console())


@click.group(invoke_without_command=True, cls=Commands)
@click.pass_context
def datasets(context: click.Context) -> None:
    """List and download public recordings.

    \b
    Examples:
      vsense datasets
      vsense datasets fetch genesis_oxts_can

    They are stored in the folder that VSENSE_DATA names, by default in the cache of the user.
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
    """Download missing recordings and verify their checksums.

    \b
    Examples:
      vsense datasets fetch genesis_oxts_can

    Without NAME, all recordings are downloaded.
    """
    from vsense_ros.bag import datasets as known
    from vsense_ros.evaluate.terminal import in_files, progress

    for name in names or tuple(known.DATASETS):
        with progress(name) as done:
            path = known.fetch(name, in_files(done))
        click.echo(path)


COMMANDS = (import_, info, datasets)
