"""Signals with names, units and a common time, and what other libraries make of them: pandas, polars, xarray."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vsense_ros.extras import explained

if TYPE_CHECKING:  # each is optional, and imported by the method that makes it
    import pandas
    import polars
    import xarray

Array = NDArray[np.float64]

TIME, STAMP = "time [s]", "stamp [ns]"  # headings of the two columns of time


@dataclass(frozen=True)
class Column:
    """One signal: its name, its unit ("1" for a ratio, "" where it is not known), and its values (n,), NaN where
    absent."""

    name: str
    unit: str
    value: Array

    @property
    def heading(self) -> str:
        """Name and unit, as `side_slip [rad]`; the name alone where no unit is known."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def is_absent(self) -> bool:
        """True if there is no value at all."""
        return bool(np.isnan(self.value).all())


@dataclass(frozen=True)
class Table:
    """Signals over one time: `stamp` (n,) [ns since the Unix epoch, or as the recording counts], `columns` of (n,)
    each. `name` is that of a topic, or of what the table is about."""

    name: str
    stamp: NDArray[np.int64]
    columns: tuple[Column, ...]

    def __len__(self) -> int:
        return len(self.stamp)

    def seconds(self, start: int | None = None) -> Array:
        """Time (n,) [s] since `start` [ns], by default since the first row."""
        if not len(self):
            return np.zeros(0)
        return np.asarray((self.stamp - (self.stamp[0] if start is None else start)) * 1e-9)

    def in_order(self) -> Table:
        """The rows by time; of several with one stamp the last value of each column counts that is not absent."""
        if (self.stamp[1:] > self.stamp[:-1]).all():
            return self
        order = np.argsort(self.stamp, kind="stable")
        ascending = self.stamp[order]
        first = np.flatnonzero(np.append(True, ascending[1:] != ascending[:-1]))
        last = np.append(first[1:], len(order)) - 1
        columns = []
        for column in self.columns:
            value = column.value[order]
            present = np.maximum.reduceat(np.where(np.isnan(value), -1, np.arange(len(value))), first)
            columns.append(Column(column.name, column.unit, value[np.where(present < first, last, present)]))
        return Table(self.name, ascending[first], tuple(columns))

    def to_pandas(self) -> pandas.DataFrame:
        """A frame with a column for each signal, named with its unit, over the time [s] since the first row.

        `frame.attrs` has `start_ns`, the stamp of the first row. Raises `MissingExtra` if pandas is not installed.
        """
        with explained():
            import pandas
        index = pandas.Index(self.seconds(), name=TIME)
        frame = pandas.DataFrame({column.heading: column.value for column in self.columns}, index=index)
        frame.attrs["start_ns"] = int(self.stamp[0]) if len(self) else 0
        return frame

    def to_polars(self) -> polars.DataFrame:
        """A frame with the columns `time [s]`, `stamp [ns]`, and one for each signal; what is absent is null.

        Raises `MissingExtra` if polars is not installed.
        """
        with explained():
            import polars
        columns = {TIME: self.seconds(), STAMP: self.stamp, **{c.heading: c.value for c in self.columns}}
        return polars.DataFrame(columns, nan_to_null=True)

    def to_xarray(self) -> xarray.Dataset:
        """A data set over the coordinate `time` [s] since the first row; each variable has its unit in `attrs`.

        Raises `MissingExtra` if xarray is not installed.
        """
        with explained():
            import xarray
        variables = {c.name: ("time", c.value, {"units": c.unit}) for c in self.columns}
        time = ("time", self.seconds(), {"units": "s"})
        start = int(self.stamp[0]) if len(self) else 0
        return xarray.Dataset(variables, {"time": time}, {"name": self.name, "start_ns": start})


def merged(tables: Sequence[Table], name: str = "") -> Table:
    """One table over all times of several, NaN where a signal was not measured. Nothing is interpolated."""
    if len(tables) == 1:
        return tables[0]
    stamp = np.unique(np.concatenate([table.stamp for table in tables])) if tables else np.zeros(0, dtype=np.int64)
    columns = []
    for table in tables:
        rows = np.searchsorted(stamp, table.stamp)
        for column in table.columns:
            value = np.full(len(stamp), np.nan)
            value[rows] = column.value
            columns.append(Column(column.name, column.unit, value))
    return Table(name, stamp, tuple(columns))
