"""What was estimated: signals with their standard deviations, units, and the reference where there is one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vsense_ros.api.saving import save
from vsense_ros.errors import InputError
from vsense_ros.evaluate.drive import Drive
from vsense_ros.evaluate.metrics import SignalScore, align
from vsense_ros.evaluate.printable import Printable
from vsense_ros.evaluate.signals import Series, read_signals
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Recording
from vsense_ros.messages.table import Column, Table, merged
from vsense_ros.model.vehicle import Vehicle

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from rich.console import Console

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimatedSignal:
    """One estimated signal of a drive.

    `stamp` (n,) [ns] and `time` (n,) [s since the first estimate] are the times; `value` (n,) in `unit` (SI), of the
    centre of gravity; `position` has (n, 2), east and north. `sigma` (n,) is one standard deviation, infinite where the
    value means nothing (side slip of a car at rest), None where the filter states none. `reference` (as `value`) is
    what the reference system measured, NaN between its measurements where they are too far apart, None where there is
    no reference. `error` (as `value`) is the estimate minus the reference, at the place of the reference system.
    `score` has RMSE, coverage and the like, at the times of the reference.
    """

    name: str
    unit: str
    stamp: NDArray[np.int64]
    time: Array
    value: Array
    sigma: Array | None = None
    reference: Array | None = None
    error: Array | None = None
    score: SignalScore | None = None

    @property
    def rmse(self) -> float | None:
        """Root mean square of the error [unit]; None without a reference."""
        return None if self.score is None else self.score.rmse

    @property
    def coverage(self) -> float | None:
        """Share of the errors within two standard deviations, 0.954 if these are right; None where it is not known."""
        return None if self.score is None else self.score.within_2s

    def columns(self) -> list[Column]:
        """The signal, its σ, its reference and its error as columns of a table."""
        parts = [("", self.value), ("_sigma", self.sigma), ("_reference", self.reference), ("_error", self.error)]
        columns = []
        for suffix, array in parts:
            if array is None:
                continue
            if array.ndim == 1:
                columns.append(Column(f"{self.name}{suffix}", self.unit, array))
                continue
            for axis, values in zip("xy", array.T, strict=True):
                columns.append(Column(f"{self.name}_{axis}{suffix}", self.unit, values))
        return columns


def read_estimates(
    output: Recording,
    reference: Recording | None = None,
    moved: Recording | None = None,
    scores: Mapping[str, SignalScore] | None = None,
) -> dict[str, EstimatedSignal]:
    """The estimated signals of the output of a run, such as the bag that `vsense run` writes.

    `reference` is the recording that was estimated; `moved` is the output at the place of its reference system, by
    default the output itself; `scores` are those of the comparison.
    """
    estimates = read_signals(output, "vsense")
    truths = read_signals(reference, "reference") if reference is not None else {}
    compared = read_signals(moved, "vsense") if moved is not None else estimates
    start = min((int(series.stamp[0]) for series in estimates.values()), default=0)
    signals = {}
    for name, series in estimates.items():
        truth = error = None
        if name in truths:
            truth, error = _compared(series, compared.get(name, series), truths[name])
        signals[name] = EstimatedSignal(
            name,
            series.signal.unit,
            series.stamp,
            np.asarray((series.stamp - start) * 1e-9),
            _flat(series.value),
            series.deviation,
            None if truth is None else _flat(truth),
            None if error is None else _flat(error),
            None if scores is None else scores.get(name),
        )
    return signals


def _compared(estimate: Series, moved: Series, truth: Series) -> tuple[Array, Array]:
    """The truth at the stamps of the estimate, and the error of the moved one, (n, k) each, NaN where the truth is not
    known."""
    aligned = align(truth, moved)
    rows, of_moved = np.searchsorted(estimate.stamp, aligned.stamp), np.searchsorted(moved.stamp, aligned.stamp)
    reference, error = np.full(estimate.value.shape, np.nan), np.full(estimate.value.shape, np.nan)
    error[rows] = aligned.truth - aligned.estimate
    reference[rows] = moved.value[of_moved] - error[rows]
    return reference, error


def _flat(values: Array) -> Array:
    return values[:, 0] if values.shape[1] == 1 else values


def table_of(signals: Mapping[str, EstimatedSignal], name: str) -> Table:
    """Estimated signals as one table over all their times."""
    return merged([Table(signal.name, signal.stamp, tuple(signal.columns())) for signal in signals.values()], name)


class Result(Printable, Mapping[str, EstimatedSignal]):
    """Estimates of one drive: a mapping from names of signals (`side_slip`, `yaw_rate`, `wheel_force_fl_z`, …) to
    `EstimatedSignal`.

    `drive` has scores, facts and notes as tables and reports show them; `output` is the recording of all output topics
    (`vsense/…`), `parameters` are the quantities estimated along with the state, by name: value and standard deviation
    at the end [SI]; `failure` says when and why the filter diverged, and is empty if it did not. `print(result)` shows
    the table of `vsense run`.
    """

    def __init__(
        self,
        drive: Drive,
        output: Recording,
        vehicle: Vehicle,
        parameters: Mapping[str, tuple[float, float]],
        failure: str = "",
    ) -> None:
        self.drive, self.output, self.vehicle = drive, output, vehicle
        self.parameters, self.failure = dict(parameters), failure

    @cached_property
    def signals(self) -> dict[str, EstimatedSignal]:
        """All estimated signals by name."""
        return read_estimates(self.output, self.drive.input, self.drive.output, self.drive.scores)

    def __getitem__(self, name: str) -> EstimatedSignal:
        """Raises `KeyError` for a signal that was not estimated, with those that were."""
        if name not in self.signals:
            raise KeyError(f"{name!r} was not estimated; there are {', '.join(self.signals)}")
        return self.signals[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.signals)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What the observer reports at the end: a line for itself and one for each sensor."""
        return self.drive.diagnostics

    def summary(self) -> dict[str, Any]:
        """Scores and figures as in `summary.json` of `vsense run`."""
        return self.drive.summary()

    def table(self) -> Table:
        """All signals with σ, reference and error over one time."""
        return table_of(self.signals, self.drive.name)

    def to_dataframe(self) -> pandas.DataFrame:
        """`table` as a pandas frame over the time [s]; columns are named with their units: `side_slip [rad]`,
        `side_slip_sigma [rad]`, `side_slip_reference [rad]`, `side_slip_error [rad]`. Raises `MissingExtra` if pandas
        is not installed."""
        return self.table().to_pandas()

    def plot(self, path: str | Path | None = None) -> Figure:
        """The picture of the drive: path, speed, yaw rate, side slip with ±2σ and reference, tyre forces.

        Returns the matplotlib figure, and writes it where a path is given (its ending says as what). Raises
        `MissingExtra` if matplotlib is not installed.
        """
        from vsense_ros.extras import explained

        with explained():
            from vsense_ros.evaluate.picture import figure_of
        figure = figure_of(self.drive)
        if path is not None:
            figure.savefig(path)
        return figure

    def save(self, path: str | Path) -> None:
        """Write the estimates as .csv, .parquet, .mat, .mf4, or .mcap, which is a bag of the output topics.

        Raises `InputError` for another ending, `MissingExtra` if the library of a format is not installed.
        """
        save(path, self.output, [self.table()])

    @property
    def title(self) -> str:
        """Recording, vehicle, and how many signals were estimated."""
        return f"{self.drive.title}, {len(self)} signals"

    def show(self, out: Console) -> None:
        """Print errors and coverage of the estimates."""
        from vsense_ros.evaluate.terminal import show_drive

        show_drive(self.drive, out)


def export_results(source: Recording, path: str | Path) -> None:
    """Write estimates, or a recording, for other programs: .csv, .parquet, .mat, .mf4, .mcap.

    A `source` with topics of estimates (`vsense/…`), such as the output of a run, gives signals with their standard
    deviations; any other recording gives the signals of all its topics. Raises as `Result.save`, and `InputError` for
    a recording without messages.
    """
    signals = read_estimates(source, source)
    tables = [table_of(signals, source.name)] if signals else list(source.tables())
    if not tables:
        raise InputError(f"{source.name or 'recording'}: there is no message in it to be written")
    save(path, source, tables)
