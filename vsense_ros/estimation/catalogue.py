"""Filters that can be chosen by name: `vsense filters` lists them, `--filter NAME` takes one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

from rich.console import Group
from rich.table import Table
from rich.text import Text

from vsense_ros.errors import InputError
from vsense_ros.estimation.state_space import Measurement, StateSpace

_WIDEST = 68  # columns of text, as wide as is read with ease


@dataclass(frozen=True)
class FilterFamily:
    """Description of a filter for a user who has to choose one, and `make`, which builds it."""

    name: str  # as in `--filter NAME`
    title: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    sensors: tuple[str, ...]
    when: str  # to take which: one sentence
    make: Callable[..., Any] = field(compare=False)
    recommended: bool = True  # False: to repeat a paper or to compare with, listed by `vsense filters --all` alone

    @classmethod
    def of(
        cls,
        name: str,
        title: str,
        when: str,
        system: StateSpace,
        measurements: Iterable[Measurement],
        make: Callable[..., Any],
    ) -> FilterFamily:
        """Describe a filter of one state space, whose states, inputs and sensors are read from it."""
        return cls(name, title, system.names, system.inputs, tuple(one.name for one in measurements), when, make)


class Catalogue:
    """Families by name. Packages that have filters add theirs; this one names none."""

    def __init__(self, families: Iterable[FilterFamily] = ()) -> None:
        self._families: dict[str, FilterFamily] = {}
        for family in families:
            self.add(family)

    def add(self, family: FilterFamily) -> FilterFamily:
        """Raises `ValueError` for a second family of one name."""
        if family.name in self._families:
            raise ValueError(f"there are two filters called {family.name!r}")
        self._families[family.name] = family
        return family

    def __iter__(self) -> Any:
        return iter(self._families.values())

    def __len__(self) -> int:
        return len(self._families)

    @property
    def names(self) -> tuple[str, ...]:
        """In the order in which they were added."""
        return tuple(self._families)

    @property
    def recommended(self) -> tuple[FilterFamily, ...]:
        """Families for use on a car, without those that repeat a paper or are references to compare with."""
        return tuple(one for one in self._families.values() if one.recommended)

    def __getitem__(self, name: str) -> FilterFamily:
        """Raises `InputError` for a name that is not there, with those that are."""
        family = self._families.get(name)
        if family is None:
            near = get_close_matches(name, self._families, 1)
            hint = f", did you mean {near[0]!r}?" if near else "."
            listed = [one.name for one in self.recommended]
            others = len(self) - len(listed)
            more = f"; `vsense filters --all` lists {others} more, to compare with" if others else ""
            raise InputError(f"there is no filter {name!r}{hint} There are: {', '.join(listed) or 'none'}{more}")
        return family


def described(families: Iterable[FilterFamily]) -> Group:
    """The filters for a terminal of any width: for each its name and title, when to use it, and what it works with."""
    return Group(*(part for one in families for part in _described(one)))


def _described(one: FilterFamily) -> tuple[Text, Table]:
    when = one.when if one.recommended else f"of the literature, for comparison only: {one.when}"
    lines = Table(box=None, show_header=False, pad_edge=False, padding=(0, 1))
    lines.add_column(style="dim", width=10)
    lines.add_column(overflow="fold", max_width=_WIDEST)
    for heading, content in (
        ("  what", one.title),
        ("  use it", when),
        ("  sensors", ", ".join(one.sensors)),
        ("  inputs", ", ".join(one.inputs)),
        ("  states", ", ".join(one.states)),
    ):
        lines.add_row(heading, content)
    return Text(f"\n{one.name}", style="bold"), lines
