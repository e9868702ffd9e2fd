"""Numbers of a vehicle file, fitted to recordings whose reference knows the side slip.

The measure is the one an observer is examined by: the error of the side slip that it estimates, at the place of the
reference. It is smooth in everything a vehicle file says, noise levels included, so that nonlinear least squares needs
a handful of Jacobians by differences where a search one number at a time needs hundreds of runs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from vsense_ros.errors import InputError
from vsense_ros.evaluate.metrics import align
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import read_signals
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer import run

Array = NDArray[np.float64]
Progress = Callable[[float], None]

RATE = 10.0  # at which the errors are taken [Hz]: side slip changes slower than that
DIFFERENCE = 0.1  # of a free parameter, for the Jacobian [steps]
LEAST_GAIN = 0.002  # of an iteration, as a share of the sum of squares: a thousandth of the error
LEAST_STEP = 1e-3  # of an iteration, as a share of the way from the start
ITERATIONS = 20  # at most
PRIOR = 0.001  # share of the mean square error at the start that a free parameter one step from its start value costs
DIGITS = 4  # that are kept of a fitted number


@dataclass(frozen=True)
class FreeParameter:
    """Numbers of a vehicle file that change together by one unknown.

    `powers` names them by dotted path (lists by index, or whole). A step multiplies each by exp(`step` · power), or
    adds `step` · power where the free parameter `adds`. A step is how far the truth may well be from a typical value.
    """

    name: str
    powers: Mapping[str, float]
    step: float
    adds: bool = False

    def turn(self, data: dict[str, Any], steps: float, digits: int) -> None:
        """Change the content of a vehicle file in place; its numbers keep so many digits."""
        for path, power in self.powers.items():
            node, key = _place(data, path)
            node[key] = self._changed(node[key], power * self.step * steps, digits)

    def _changed(self, value: Any, change: float, digits: int) -> Any:
        if isinstance(value, list):
            return [self._changed(one, change, digits) for one in value]
        return _rounded(value + change if self.adds else value * np.exp(change), digits)

    def value(self, vehicle: Vehicle) -> float:
        """The first of its numbers."""
        node, key = _place(vehicle.model_dump(mode="json"), next(iter(self.powers)))
        value = node[key]
        return float(value[0] if isinstance(value, list) else value)


@dataclass(frozen=True)
class Fit:
    """A vehicle whose free parameters were turned, and the RMSE of its side slip on each recording, before and after
    [rad]."""

    vehicle: Vehicle
    before: tuple[float, ...]
    after: tuple[float, ...]


def turned(
    vehicle: Vehicle, free_parameters: Sequence[FreeParameter], steps: Sequence[float] | Array, digits: int = 17
) -> Vehicle:
    """The vehicle with its free parameters turned; raises `ValueError` if that is no valid vehicle."""
    data = vehicle.model_dump(mode="json")
    for parameter, turns in zip(free_parameters, steps, strict=True):
        parameter.turn(data, float(turns), digits)
    return Vehicle.model_validate(data)


def fit(
    vehicle: Vehicle,
    free_parameters: Sequence[FreeParameter],
    recordings: Sequence[Recording],
    iterations: int = ITERATIONS,
    prior: float = PRIOR,
    progress: Progress | None = None,
) -> Fit:
    """Turn the free parameters so that the mean square error of the side slip is least, each recording with equal
    weight.

    Gauss-Newton within a region of trust, at first of one step, ended when an iteration that went as foreseen gains
    less than `LEAST_GAIN`. The mean error is the mounting angle of the reference, so it is taken out and
    `reference.yaw` changed by it. A free parameter that the recordings do not tell anything about stays where it is: a
    departure by n steps costs n² `prior`. Runs are shared out to all processors; the result does not depend on how many
    there are. `progress` takes the share done, of `iterations`.
    """
    weight = prior**0.5
    with ProcessPoolExecutor(min(os.cpu_count() or 1, len(recordings) * len(free_parameters))) as pool:
        before = _errors(pool, [vehicle], recordings)[0]
        scale = float(np.sqrt(np.mean(np.square(rmse(before)))))
        rounds = count()

        def residuals(steps: Array, errors: Sequence[Array] | None = None) -> Array:
            if errors is None:
                errors = _errors(pool, [turned(vehicle, free_parameters, steps)], recordings)[0]
            return np.concatenate([_stacked(errors) / scale, weight * steps])

        def jacobian(steps: Array) -> Array:
            nearby = [steps, *(steps + DIFFERENCE * unit for unit in np.eye(len(free_parameters)))]
            share = part(progress, next(rounds), iterations)
            errors = _errors(pool, [turned(vehicle, free_parameters, at) for at in nearby], recordings, share)
            here, *ahead = (residuals(at, error) for at, error in zip(nearby, errors, strict=True))
            return np.column_stack([(there - here) / DIFFERENCE for there in ahead])

        search = least_squares(
            residuals, np.zeros(len(free_parameters)), jacobian, ftol=LEAST_GAIN, xtol=LEAST_STEP, max_nfev=iterations
        )
        fitted = turned(vehicle, free_parameters, search.x, DIGITS)
        found = _errors(pool, [fitted], recordings)[0]
    yaw = _rounded(vehicle.reference.yaw + _mean(found), DIGITS)
    fitted = fitted.model_copy(update={"reference": fitted.reference.model_copy(update={"yaw": yaw})})
    if progress is not None:
        progress(1.0)
    return Fit(fitted, rmse(before), rmse(found))


def _errors(
    pool: Executor, vehicles: Sequence[Vehicle], recordings: Sequence[Recording], progress: Progress | None = None
) -> list[list[Array]]:
    """Of each vehicle on each recording."""
    jobs = [[pool.submit(side_slip_error, vehicle, recording) for recording in recordings] for vehicle in vehicles]
    found = []
    for i, of_vehicle in enumerate(jobs):
        found.append([job.result() for job in of_vehicle])
        if progress is not None:
            progress((i + 1) / len(jobs))
    return found


def part(progress: Progress | None, index: int, count: int) -> Progress | None:
    """What one of `count` equal parts of a job reports its own share to."""
    return None if progress is None else lambda share: progress((index + share) / count)


def side_slip_error(vehicle: Vehicle, recording: Recording) -> Array:
    """Estimate - reference at the stamps of the reference, thinned to `RATE`, (n,) [rad].

    Where the observer does not tell a side slip, it counts as having said zero: silence must not pay.
    """
    output = read_signals(at_reference(run(recording, vehicle, rate=RATE).output, vehicle), "vsense")
    truth = read_signals(recording, "reference").get("side_slip")
    if truth is None or len(truth) < 2:
        raise InputError(f"{recording.name}: a fit needs a side slip in reference/odometry, there is none")
    error = -truth.value[:, 0]
    if "side_slip" in output:
        aligned = align(output["side_slip"], truth)
        error[np.searchsorted(truth.stamp, aligned.stamp)] = aligned.error[:, 0]
    stride = max(1, round(1e9 / RATE / float(np.median(np.diff(truth.stamp)))))
    return error[::stride]


def rmse(errors: Sequence[Array]) -> tuple[float, ...]:
    """Of each recording, without the mean error of all [rad]."""
    mean = _mean(errors)
    return tuple(float(np.sqrt(np.mean((error - mean) ** 2))) for error in errors)


def _mean(errors: Sequence[Array]) -> float:
    return float(np.mean([error.mean() for error in errors]))


def _stacked(errors: Sequence[Array]) -> Array:
    """Errors without their mean, scaled: the sum of their squares is the mean of the recordings' mean squares."""
    mean = _mean(errors)
    return np.concatenate([(error - mean) / np.sqrt(len(error) * len(errors)) for error in errors])


def _place(data: dict[str, Any], path: str) -> tuple[Any, int | str]:
    """What holds the number at a dotted path, and its key there."""
    *parents, last = path.split(".")
    node: Any = data
    for key in parents:
        node = node[key]
    return node, int(last) if isinstance(node, list) else last


def _rounded(value: float, digits: int) -> float:
    return float(f"{value:.{digits}g}")
