"""The public recordings as a table: which there are, and which are on this machine."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from vsense_ros.bag.datasets import DATASETS, find


def show(console: Console) -> None:
    """Print the table."""
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    for heading in ("name", "here", "licence", "what"):
        table.add_column(heading, no_wrap=heading != "what")
    for one in DATASETS.values():
        table.add_row(one.name, "no" if find(one.name) is None else "yes", one.licence, one.title)
    console.print(table)
