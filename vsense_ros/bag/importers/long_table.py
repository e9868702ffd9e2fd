"""Tables with one value a row, each with the name of its signal, as Car Scanner writes them."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from vsense_ros.bag.importers import text_table
from vsense_ros.bag.importers.build import Array
from vsense_ros.bag.importers.mapping import Column, ColumnMapping, Ref
from vsense_ros.errors import InputError


class LongTable:
    """The signals of such a table by name. Times are seconds after `base` [ns]."""

    def __init__(self, path: Path, wanted: ColumnMapping) -> None:
        self.path, rows = path, wanted.rows
        assert rows is not None
        table = text_table.read_texts(path, wanted, tuple(filter(None, (rows.name, rows.value, rows.unit))))
        self.notes, self.base = table.notes, table.base
        names = np.array(table.texts[0])
        values = np.array([self._number(text, wanted) for text in table.texts[1]])
        stated = table.texts[2] if rows.unit else [""] * len(names)
        self.signals: dict[str, Column] = {}
        for name in dict.fromkeys(names.tolist()):
            own = np.flatnonzero((names == name) & np.isfinite(values))
            if len(own):
                self.signals[name] = Column(table.time[own], values[own], stated[int(own[0])])

    @staticmethod
    def _number(text: str, wanted: ColumnMapping) -> float:
        try:
            return float(text.replace(wanted.decimal, "."))
        except ValueError:
            return math.nan

    def column(self, ref: Ref) -> Column:
        """A signal by its name."""
        if ref.name not in self.signals:
            raise InputError(f"{self.path}: no row is named {ref}; found: {', '.join(self.signals)[:600]}")
        return self.signals[str(ref.name)]

    def values(self, name: str) -> Array:
        """The values of a signal."""
        return self.signals[name].values
