"""The command `python -m studies leung`."""

from __future__ import annotations

from pathlib import Path

import click

from vsense_ros.cli.common import NEW_FILE, warn


@click.command()
@click.option("--table", "tables", multiple=True, metavar="N.M", help="Only this table; may be given again.")
@click.option("--figure", "one_by_one", multiple=True, metavar="N.M", help="A figure in numbers; may be given again.")
@click.option("--causes", is_flag=True, help="Instead: plant and sensors with one thing changed at a time.")
@click.option("--quick", is_flag=True, help="One seed, and four of the ten manoeuvres.")
@click.option("--figures", is_flag=True, help="Draw his figures as well, some 35 pages (ten minutes).")
@click.option("--processes", type=click.IntRange(1), metavar="N", help="Default: as many as there are cores.")
@click.option("--out", type=NEW_FILE, default=Path("out/leung.json"), show_default=True, help="File.")
def leung(
    tables: tuple[str, ...],
    one_by_one: tuple[str, ...],
    causes: bool,
    quick: bool,
    figures: bool,
    processes: int | None,
    out: Path,
) -> None:
    """Repeat the tables of Leung 2010: GNSS/INS filters and vehicle models on a simulated saloon, beside his figures.

    Each drive by each filter is kept in the folder `leung` beside FILE, so that what was stopped goes on where it was.
    Table 4.11 is that of the Genesis, where its laps are there. Without --table, --figure makes only figures: it prints
    what they show and what the thesis says of them, and draws them. --causes shows what figures of the tables depend
    on: each experiment changes one property of the plant or of its sensors.

    \b
    Examples:
      python -m studies leung --quick
      python -m studies leung --table 4.2 --table 5.5
      python -m studies leung --figure 4.20
      python -m studies leung --causes
      python -m studies leung --quick --figures
    """
    from studies import leung as job
    from vsense_ros.demo import dataset
    from vsense_ros.evaluate.terminal import console, progress, say

    if causes:
        from studies import leung_experiments

        with progress("driving and estimating") as done:
            outcomes = leung_experiments.outcomes(out.parent / "leung", done)
        console().print(leung_experiments.table(outcomes))
        return
    if one_by_one:
        from studies import leung_figures

        leung_figures.repeat(one_by_one, processes, out)
        if not tables:
            return
    names = tables or job.NAMES
    job.check(names)
    laps = None
    if job.GENESIS in names or figures:
        try:
            folder = dataset("genesis_oxts_can")
            laps = folder if folder.is_dir() else folder.parent
        except (OSError, ValueError) as error:
            warn(f"table {job.GENESIS} and its figures are left out: {error}")
    with progress("driving and estimating") as done:
        figures_by_table, results = job.repeat(
            names, out.parent / "leung", laps, done, quick=quick, processes=processes
        )
    job.write(figures_by_table, results, out)
    job.show(figures_by_table, console())
    job.show_verdicts(figures_by_table, console())
    say(f"Written to {out}.")
    if figures:
        from studies import leung_figures, leung_models_picture, leung_pictures

        folder = out.with_suffix("")
        with progress("drawing filters") as done:
            pictures = leung_pictures.draw_all(folder / "figures", folder, laps, done)
        with progress("drawing what is also in numbers") as done:
            pictures += leung_figures.draw_all(folder / "figures", folder, done)
        with progress("drawing models") as done:
            pictures += leung_models_picture.draw_all(folder / "figures", folder, done)
        say(f"{len(pictures)} pictures in {folder / 'figures'}.")
