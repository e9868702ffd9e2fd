"""Which figures of the repeated tables are as near to those of Leung 2010 as they should be, and why others are not.

A heading should be within 30 % of the printed one, a lateral velocity and a side slip within a factor of 1.3. These two
are judged in m/s and degrees, a share of the range being that of our drive: errors that differ by less than half the
noise of a fix, or a third of what a good reference of the side slip resolves, are alike, however many percent of a
small range that is. A printed figure is any that is rounded to it: 0.04 may be 0.035, which is an eighth less.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.text import Text

Figure = Mapping[str, float | None]
Rows = Mapping[str, Mapping[str, Figure]]


@dataclass(frozen=True)
class Demand:
    """How near figures should be: the goals of this repetition."""

    heading: float = 0.3  # [-] of the printed figure
    factor: float = 1.3  # [-] on the printed lateral velocity or side slip
    velocity: float = 0.0125  # [m/s] of difference that is none: half the noise of a fix (table B.2)
    angle: float = np.radians(0.05)  # [rad] of difference in side slip that is none: a third of the 0.15° of an RT3000


DEMAND = Demand()


class Judged(NamedTuple):
    """A figure beside the printed one, both in `unit`."""

    row: str
    column: str
    ours: float
    printed: float
    unit: str
    within: bool

    def __str__(self) -> str:
        return f"{self.row}, {self.column}: {self.ours:.3g} instead of {self.printed:.3g} {self.unit}"


class Cause(NamedTuple):
    """Why figures of a table are elsewhere: of columns with this in their titles, in rows with these first letters."""

    table: str
    column: str
    rows: tuple[str, ...]
    words: str


class Shape(NamedTuple):
    """What a column is: its quantity, and of which kind its figures are (`leung.Column`)."""

    quantity: str
    kind: str


def judged(rows: Rows, shape: Callable[[str, str], Shape | None]) -> Iterator[Judged]:
    """Figures of headings, lateral velocities and side slips of a table that the thesis prints, too. `shape` says of a
    row and a title what its figures are."""
    for row, columns in rows.items():
        for title, figure in columns.items():
            ours, printed, of = figure["ours"], figure.get("printed"), shape(row, title)
            if ours is None or printed is None or of is None:
                continue
            quantity, kind = of
            angle = quantity in ("yaw", "side_slip", "raw_side_slip")
            if not angle and quantity != "lateral_velocity":
                continue
            rounding = _rounding(printed)
            nearest = min(max(ours, printed - rounding), printed + rounding)
            if kind == "V":  # 100 times the mean square
                errors = np.sqrt(np.array([ours, printed, nearest]) / 100)
            else:
                errors = np.array([ours, printed, nearest]) / 100 * (figure.get("range") or 0.0)
            difference = abs(errors[0] - errors[2])
            if quantity == "yaw":
                near = difference <= DEMAND.heading * errors[2]
            else:
                near = errors[2] / DEMAND.factor <= errors[0] <= DEMAND.factor * errors[2]
                near |= difference < (DEMAND.angle if angle else DEMAND.velocity)
            shown = np.degrees(errors) if angle else errors
            yield Judged(row, title, float(shown[0]), float(shown[1]), "°" if angle else "m/s", bool(near))


def _rounding(printed: float) -> float:
    """Half a unit of the last digit of a figure of the thesis, which has two decimals or four."""
    return 0.5 * 10.0 ** -(2 if round(printed, 2) == printed else 4)


def show(name: str, every: list[Judged], causes: list[Cause], out: Console) -> None:
    """Print for a table how many of its figures are near enough, and the others by their cause."""
    if not every:
        return
    outside = [one for one in every if not one.within]
    better = sum(one.ours < one.printed for one in outside)
    out.print(
        Text(
            f"Table {name}: {len(every) - len(outside)} of {len(every)} headings, lateral velocities and side slips "
            f"within 30 % or a factor of 1.3; {better} better, {len(outside) - better} worse."
        ),
        soft_wrap=True,
    )
    by_cause: dict[str, list[Judged]] = {}
    for one in outside:
        by_cause.setdefault(_cause(name, one, causes), []).append(one)
    for words, ones in by_cause.items():
        columns = Counter(one.column for one in ones)
        where = "; ".join(
            f"{column} in " + ", ".join(
                f"{one.row} {one.ours:.2g} ({one.printed:.2g}) {one.unit}" for one in ones if one.column == column
            )
            for column in columns
        )  # fmt: skip
        out.print(Text(f"  {where}\n    {words}"), soft_wrap=True)


def _cause(name: str, one: Judged, causes: list[Cause]) -> str:
    for cause in causes:
        if cause.table == name and cause.column in one.column and one.row.startswith(cause.rows):
            return cause.words
    return "cause not known"
