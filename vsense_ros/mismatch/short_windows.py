"""Short windows for driving at the limit of grip, where no simulation stays beside a car for long.

What was steered to hold the real car does not hold another one, which differs from it a little: it spins, and what it
would have measured from then on says nothing. A simulation of a second that begins where the car is stays near it
(multiple shooting, Bock & Plitt 1984). Where the car is, the observer says, which corrects itself all the time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.evaluate.signals import Series, read_signals
from vsense_ros.identification.free_parameter import FreeParameter
from vsense_ros.identification.least_squares import Fit, fit
from vsense_ros.identification.parameter_set import ParameterSet
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.comparable import NotAssessableError
from vsense_ros.mismatch.extension import extended
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.signals import SIGNALS
from vsense_ros.mismatch.simulation import LOST, Predictor
from vsense_ros.mismatch.windows import Dataset, Window
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.innovations import innovations_and_output

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ShortWindowSettings:
    """How windows in which a simulated car gets lost are divided: decisions of this project."""

    compared: float = 1.0  # [s] of each short window
    run_in: float = 0.5  # [s] before that, in which body and tyres find their state
    settling: float = 10.0  # [s] that the observer gets before the first of them
    rate: float = 50.0  # [Hz] of its estimates


SHORT = ShortWindowSettings()
NOTHING_TO_COMPARE = (
    "where the car drives and its inputs are known, nothing is measured that the model predicts; expected readings of "
    "an inertial sensor, wheel speeds or GNSS velocities throughout"
)


@dataclass(frozen=True)
class Restarts:
    """Restarts the simulation where the observer says the car is, in windows of these recordings."""

    recordings: Sequence[Recording]
    vehicle: Vehicle  # as the file has it

    def refitted(
        self, dataset: Dataset, free_parameters: Sequence[FreeParameter], progress: Callable[[], None]
    ) -> tuple[Dataset, Residuals, Fit]:
        """The base parameters fitted to all windows. If the simulated car gets lost in some they are fitted to the
        others, and then to short windows in place of these: a car that spins shows no way out of that. Where it then
        stays on the road whole windows are fitted, else the short ones. Returned with the windows that were fitted."""

        def fitted_to(windows: Dataset, begin: Fit | None) -> tuple[Residuals, Fit]:
            residuals = Residuals(Predictor(self.vehicle, windows))
            if not any(residuals.layout):
                raise NotAssessableError(NOTHING_TO_COMPARE)
            start, offsets = residuals.predictor.start, None if begin is None else begin.offsets
            return residuals, fit(residuals, start, free_parameters, begin=offsets, progress=progress)

        def whole_again(begin: Fit) -> Fit | None:
            """The fit to whole windows from where another one ended, if the car stays on the road in both."""
            if any(whole.predictor.lost(begin.parameter_set)):
                return None
            _, again = fitted_to(dataset, begin)
            return None if any(whole.predictor.lost(again.parameter_set)) else again

        whole, base = fitted_to(dataset, None)
        lost = whole.predictor.lost(base.parameter_set)
        if not any(lost):
            return dataset, whole, base
        at = base if 2 * sum(lost) > len(lost) else fitted_to(dataset.without(lost, LOST), base)[1]
        if (again := whole_again(at)) is not None:
            return dataset, whole, again
        short = self._divided(dataset, lost, extended(self.vehicle, dataset, at.parameter_set))
        residuals, at = fitted_to(short, None)
        if (again := whole_again(at)) is not None:
            return dataset, whole, again
        rest = short.without(residuals.predictor.lost(at.parameter_set), LOST)
        if not rest.windows:
            return dataset, whole, base
        return (short, residuals, at) if len(rest.windows) == len(short.windows) else (rest, *fitted_to(rest, at))

    def near_the_car(self, dataset: Dataset, parameter_set: ParameterSet) -> Dataset:
        """The data set with short windows in place of those in which the car with these parameters gets lost; without
        those of them in which it still does."""
        lost = Predictor(self.vehicle, dataset).lost(parameter_set)
        if not any(lost):
            return dataset
        short = self._divided(dataset, lost, extended(self.vehicle, dataset, parameter_set))
        return short.without(Predictor(self.vehicle, short).lost(parameter_set), LOST)

    def _divided(self, dataset: Dataset, lost: Sequence[bool], vehicle: Vehicle) -> Dataset:
        windows: list[Window] = []
        remarks: list[str] = []
        for window, gone in zip(dataset.windows, lost, strict=True):
            parts = list(self._parts(window, vehicle)) if gone else []
            windows += parts or [window]
            if parts:
                remarks.append(
                    f"{window.name}: from {window.begin:.0f} to {window.end:.0f} s compared {SHORT.compared:g} s at a "
                    f"time, each from where the observer estimates the car, as {LOST}"
                )
        return replace(dataset, windows=tuple(windows), remarks=(*dataset.remarks, *remarks))

    def _parts(self, window: Window, vehicle: Vehicle) -> Iterator[Window]:
        """A window in short ones, which together compare what it does but for a remainder at its end. None where the
        observer does not start."""
        recording = self.recordings[window.recording]
        try:
            _, output = innovations_and_output(
                recording.between(max(0.0, window.begin - SHORT.settling), window.end), vehicle, SHORT.rate
            )
        except (InputError, FloatingPointError):
            return
        estimates = read_signals(output, "vsense")
        yaw_rate, lateral = (
            _by_time(estimates.get(name), recording.first_stamp) for name in ("yaw_rate", "lateral_velocity")
        )
        if yaw_rate is None or lateral is None:
            return
        length = SHORT.run_in + SHORT.compared + SIGNALS.edge
        first = max(window.begin + window.run_in - SHORT.run_in, yaw_rate[0][0], lateral[0][0])
        for begin in np.arange(first, window.end - length + 1e-9, SHORT.compared).tolist():
            yield window.part(
                begin,
                begin + length,
                run_in=SHORT.run_in,
                yaw_rate=float(np.interp(begin, *yaw_rate)),
                lateral_velocity=float(np.interp(begin, *lateral)),
            )


def _by_time(series: Series | None, first_stamp: int) -> tuple[Array, Array] | None:
    """Times since the first stamp [s] and values of an estimate; None without it."""
    if series is None or not len(series):
        return None
    return np.asarray((series.stamp - first_stamp) * 1e-9, float), series.value[:, 0]
