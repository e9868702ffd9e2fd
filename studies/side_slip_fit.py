"""Numbers of a vehicle file, fitted to recordings whose reference knows the side slip.

The measure is the one an observer is examined by: the error of the side slip that it estimates, at the place of the
reference. It is smooth in everything a vehicle file says, noise levels included, so that nonlinear least squares needs
a handful of Jacobians by differences where a search one number at a time needs hundreds of runs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass
from itertools import count

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.identification.free_parameter import FreeParameter
from vsense_ros.identification.least_squares import DivergedError, Settings, fit
from vsense_ros.identification.parameter_set import ParameterSet, of_vehicle, rounded, with_values
from vsense_ros.identification.progress import Progress
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SideSlipSettings:
    """Settings of the fit to measured side slip: decisions of this project."""

    rate: float = 10.0  # at which the errors are taken [Hz]: side slip changes slower than that
    difference: float = 0.1  # [deviations] of a free parameter, for the Jacobian
    longest_step: float = 1.0  # [deviations] of an iteration: the observer is not linear in noise levels beyond
    most_iterations: int = 20  # [-]
    # [-] share of the mean square error at the start that a free parameter one deviation off costs
    prior_share: float = 0.001
    digits: int = 4  # significant digits that are kept of a fitted number
    at_once: int = 64  # vehicles whose runs wait for a processor together


SIDE_SLIP = SideSlipSettings()


@dataclass(frozen=True)
class SideSlipFit:
    """A vehicle whose free parameters were fitted, and the RMSE of its side slip on each recording, before and after
    [rad]."""

    vehicle: Vehicle
    before: tuple[float, ...]
    after: tuple[float, ...]


class SideSlipResiduals:
    """Errors of the side slip that the observer of a vehicle estimates, without the mean of all recordings, which is
    the mounting angle of the reference; each recording is a block of equal weight.

    They are in units of the root mean square error with the vehicle as it is, so that its cost is 1. A parameter set
    with which there can be no such vehicle diverges. Runs are shared out to the processes of `pool`; results do not
    depend on how many there are.
    """

    at_once = SIDE_SLIP.at_once

    def __init__(self, vehicle: Vehicle, recordings: Sequence[Recording], pool: Executor) -> None:
        self._vehicle, self._recordings, self._pool = vehicle, recordings, pool
        self._runs: dict[str, list[Future[Array]]] = {}  # by content of the vehicle
        self.before = self.errors(vehicle)
        self._scale = float(np.sqrt(np.mean(np.square(rmse(self.before)))))

    def errors(self, vehicle: Vehicle) -> list[Array]:
        """Estimate - reference on each recording, (n,) [rad]."""
        return [job.result() for job in self._jobs(vehicle)]

    def prepare(self, parameter_sets: Sequence[ParameterSet], near: ParameterSet | None = None) -> None:
        """Begin the runs of parameter sets whose residuals are asked for next."""
        for vehicle in map(self._with, parameter_sets):
            if vehicle is not None:
                self._jobs(vehicle)

    def diverged(self, parameter_set: ParameterSet) -> list[bool]:
        """True for each recording if there can be no such vehicle."""
        return [self._with(parameter_set) is None] * len(self._recordings)

    def __call__(self, parameter_set: ParameterSet, instead: Sequence[Array] | None = None) -> list[Array]:
        """(n,) of each recording: the sum of their squares is the mean of the recordings' mean squares, over that of
        the vehicle as it is. Raises `DivergedError` where there can be no such vehicle and nothing is given instead."""
        vehicle = self._with(parameter_set)
        if vehicle is not None:
            return self._weighted(self.errors(vehicle))
        if instead is None:
            raise DivergedError
        return list(instead)

    def _weighted(self, errors: Sequence[Array]) -> list[Array]:
        mean = _mean(errors)
        return [(error - mean) / (self._scale * np.sqrt(len(error) * len(errors))) for error in errors]

    def _with(self, parameter_set: ParameterSet) -> Vehicle | None:
        """The vehicle with the numbers of a parameter set, if there can be one."""
        try:
            return with_values(self._vehicle, parameter_set)
        except ValueError:
            return None

    def _jobs(self, vehicle: Vehicle) -> list[Future[Array]]:
        """The runs of a vehicle, one for each recording."""
        key = vehicle.model_dump_json()
        if key not in self._runs:
            if len(self._runs) > SIDE_SLIP.at_once:
                self._runs.pop(next(iter(self._runs)))
            self._runs[key] = [self._pool.submit(side_slip_error, vehicle, one) for one in self._recordings]
        return self._runs[key]


def fit_side_slip(
    vehicle: Vehicle,
    free_parameters: Sequence[FreeParameter],
    recordings: Sequence[Recording],
    iterations: int = SIDE_SLIP.most_iterations,
    prior: float = SIDE_SLIP.prior_share,
    progress: Progress | None = None,
) -> SideSlipFit:
    """Change the free parameters so that the mean square error of the side slip is least, each recording with equal
    weight.

    The mean error is the mounting angle of the reference, so it is taken out and `reference.yaw` changed by it. A free
    parameter that the recordings say nothing about stays where it is: a departure by n deviations costs
    n² `prior`. Runs are shared out to all processors. `progress` takes the share done, of `iterations`.
    """
    settings = Settings(iterations, SIDE_SLIP.difference, range(iterations), SIDE_SLIP.longest_step, prior)
    with ProcessPoolExecutor(min(os.cpu_count() or 1, len(recordings) * len(free_parameters))) as pool:
        residuals = SideSlipResiduals(vehicle, recordings, pool)
        found = fit(
            residuals, of_vehicle(vehicle), free_parameters, begin=np.zeros(len(free_parameters)), settings=settings,
            progress=_counted(progress, iterations * (len(free_parameters) + 1)),
        )  # fmt: skip
        fitted = with_values(vehicle, found.parameter_set, SIDE_SLIP.digits)
        after = residuals.errors(fitted)
    yaw = rounded(vehicle.reference.yaw + _mean(after), SIDE_SLIP.digits)
    fitted = fitted.model_copy(update={"reference": fitted.reference.model_copy(update={"yaw": yaw})})
    if progress is not None:
        progress(1.0)
    return SideSlipFit(fitted, rmse(residuals.before), rmse(after))


def _counted(progress: Progress | None, steps: int) -> Callable[[], None]:
    """What a job calls after each of at most so many steps."""
    if progress is None:
        return lambda: None
    done = count(1)
    return lambda: progress(min(1.0, next(done) / steps))


def side_slip_error(vehicle: Vehicle, recording: Recording) -> Array:
    """Estimate - reference at the stamps of the reference, thinned to `SIDE_SLIP.rate`, (n,) [rad].

    Where the observer does not estimate a side slip, it counts as having said zero: silence must not pay.
    """
    output = read_signals(at_reference(run(recording, vehicle, rate=SIDE_SLIP.rate).output, vehicle), "vsense")
    truth = read_signals(recording, "reference").get("side_slip")
    if truth is None or len(truth) < 2:
        raise InputError(f"{recording.name}: a fit needs a side slip in reference/odometry, there is none")
    error = -truth.value[:, 0]
    if "side_slip" in output:
        aligned = align(output["side_slip"], truth)
        error[np.searchsorted(truth.stamp, aligned.stamp)] = aligned.error[:, 0]
    stride = max(1, round(1e9 / SIDE_SLIP.rate / float(np.median(np.diff(truth.stamp)))))
    return error[::stride]


def rmse(errors: Sequence[Array]) -> tuple[float, ...]:
    """Root mean square error of each recording, without the mean error of all [rad]."""
    mean = _mean(errors)
    return tuple(float(np.sqrt(np.mean((error - mean) ** 2))) for error in errors)


def _mean(errors: Sequence[Array]) -> float:
    return float(np.mean([error.mean() for error in errors]))
