"""The table of all filters of the literature."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rich.table import Table

from studies.literature import bevly_bias, decentralised, gao_aiding, he_four_wheel_steering, liu_odometry, ryu_bank
from studies.literature.finding import Finding

EXAMINED: tuple[Callable[[], list[Finding]], ...] = (
    liu_odometry.examine,
    ryu_bank.examine,
    bevly_bias.examine,
    decentralised.examine,
    gao_aiding.examine,
    he_four_wheel_steering.examine,
)


def findings(progress: Callable[[float], None] = lambda share: None) -> list[Finding]:
    """What all of them find."""
    found: list[Finding] = []
    for i, examine in enumerate(EXAMINED):
        found += examine()
        progress((i + 1) / len(EXAMINED))
    return found


def table(found: Sequence[Finding]) -> Table:
    """For the terminal."""
    made = Table(title="Filters that Leung 2010 describes, in small simulations")
    for heading in ("filter", "source", "quantity"):
        made.add_column(heading)
    made.add_column("found", justify="right")
    made.add_column("beside it")
    made.add_column("", justify="right")
    for one in found:
        numbers = f"{one.found:.3g} {one.unit}", one.beside, f"{one.reference:.3g} {one.unit}"
        made.add_row(one.filter, one.source, one.quantity, *numbers)
    return made
