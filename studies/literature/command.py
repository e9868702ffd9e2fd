"""The command `python -m studies literature`."""

from __future__ import annotations

import click


@click.command()
def literature() -> None:
    """Examine filters that Leung 2010 describes in chapter 2 and does not use, in small simulations.

    \b
    Examples:
      python -m studies literature
    """
    from studies.literature.table import findings, table
    from vsense_ros.evaluate.terminal import console, progress

    with progress("simulating") as done:
        found = findings(done)
    console().print(table(found))
