"""Noise covariances of the observer, found by maximising the likelihood of recordings.

The likelihood is that of the innovations of the errorEKF: the density of every message given all before it. It needs no
reference. Sensors are as noisy as the file states, even where their readings show more: the observer, which believes
the readings, would hide that the file states too little. Unknowns are the logarithms of standard deviations, so none
can become negative. The method is Fisher scoring (Gupta & Mehra 1974): the derivatives of the innovations and of their
deviations, by differences, give the gradient and the information matrix together, and the inverse of the latter says
how well each number is determined.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.innovations import Innovations
from vsense_ros.evaluate.consistency import Consistency, Error, consistency, errors_of
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.identification.free_parameter import FreeParameter, multiplied, with_offsets
from vsense_ros.identification.normal_equations import NormalEquations
from vsense_ros.identification.parameter_set import EXACT, of_vehicle, with_values
from vsense_ros.identification.progress import Progress, part
from vsense_ros.messages.recording import Recording
from vsense_ros.model.schema.observer_settings import ForceErrors
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner import run
from vsense_ros.runner.innovations import innovations

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NoiseSettings:
    """Settings of the fit of noise levels: decisions of this project."""

    prior: float = float(np.log(3))  # [-] standard deviation of the logarithm of a number around what the file says
    # [-] largest change of a logarithm: a drive on which an error did not show is no proof of none
    bound: float = float(np.log(10))
    largest_step: float = float(np.log(5))  # [-] change of a logarithm in one iteration
    difference: float = 0.05  # [-] of a logarithm, for derivatives
    # [-] change of a whitened innovation by a logarithm: beyond that, a gate decided otherwise some time before
    steepest: float = 3.0
    most_iterations: int = 8  # [-]
    # [-] shares of a step that are tried until one is an improvement
    shares_of_step: tuple[float, float, float, float] = (1.0, 0.5, 0.25, 0.125)
    # [nat] log-likelihood, of each number, that an iteration must promise; noise alone gives 0.5
    least_gain: float = 0.05
    # [-] a number is determined whose standard deviation is at most this share of the prior's
    determined_share: float = 0.5
    digits: int = 3  # significant digits that are kept of a number


NOISE = NoiseSettings()


_FROM_MESSAGE = "noise_from_message"
ALL = "all"  # sensors together, in tables


def noise_numbers(vehicle: Vehicle) -> list[str]:
    """Dotted paths of what is tuned: noise of the sensors, force errors and slopes of the road.

    What is zero stays zero. Initial uncertainties stay: a recording has only one beginning. So do correlation times:
    with them free, the likelihood, most of which is fast sensors, takes slow errors for ever slower ones, and on
    recordings that are held out the side slip gets worse.
    """
    kinds = {sensor.kind for sensor in vehicle.sensors.values()}
    torques_unknown = "wheel_speeds" in kinds and "wheel_torques" not in kinds
    paths = []
    for name, sensor in vehicle.sensors.items():
        for field in sensor.noise_fields:
            value = getattr(sensor, field, None)
            if isinstance(value, tuple):
                paths += [f"sensors.{name}.{field}.{i}" for i in range(len(value))]
            elif value is not None:
                paths.append(f"sensors.{name}.{field}")
    errors, around = vehicle.observer.force_errors, vehicle.observer.surroundings
    of_wheels = {"wheel_spin": torques_unknown, "unmeasured_drive": not kinds & {"wheel_speeds", "wheel_torques"}}
    for field in ForceErrors.model_fields:
        applies = of_wheels.get(field, not field.endswith("time_constant"))
        if applies and getattr(errors, field) > 0:
            paths.append(f"observer.force_errors.{field}")
    for slope in ("grade", "bank"):
        if getattr(around, slope) > 0:
            paths += [f"observer.surroundings.{slope}", f"observer.surroundings.{slope}_change"]
    return paths


@dataclass(frozen=True)
class TunedNumber:
    """One number: dotted path, before, after, and the standard deviation of the logarithm of the latter, as far as the
    innovations are white."""

    path: str
    before: float
    after: float
    deviation: float

    @property
    def determined(self) -> bool:
        """True if the recordings determine it."""
        return self.deviation < NOISE.determined_share * NOISE.prior

    @property
    def at_bound(self) -> bool:
        """True if it has reached its bound."""
        return bool(abs(np.log(self.after / self.before)) > 0.99 * NOISE.bound)


@dataclass(frozen=True)
class Figures:
    """How consistent the filter is on some recordings: by sensor and for `ALL`, and by signal where there are
    references."""

    sensors: Mapping[str, Consistency]
    errors: Mapping[str, Error]


@dataclass(frozen=True)
class Tuning:
    """A tuned vehicle, the numbers that were tuned, and the figures before and after; `held_out` is None where no
    recordings were held out."""

    vehicle: Vehicle
    numbers: tuple[TunedNumber, ...]
    before: Figures
    after: Figures
    held_out: tuple[Figures, Figures] | None

    def changed(self, start: Vehicle) -> list[str]:
        """Dotted paths of what differs from the vehicle that tuning started from."""
        paths = [number.path for number in self.numbers if number.before != number.after]
        for name, sensor in start.sensors.items():
            if getattr(sensor, _FROM_MESSAGE, None) != getattr(self.vehicle.sensors[name], _FROM_MESSAGE, None):
                paths.append(f"sensors.{name}.{_FROM_MESSAGE}")
        return paths

    def write(self, path: Path) -> None:
        """Everything but the vehicle as JSON."""
        content = {
            "numbers": {f.path: asdict(f) | {"determined": f.determined, "at_bound": f.at_bound} for f in self.numbers},
            "before": asdict(self.before),
            "after": asdict(self.after),
        }
        if self.held_out is not None:
            content["held_out"] = dict(zip(("before", "after"), map(asdict, self.held_out), strict=True))
        path.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def with_own_noise(vehicle: Vehicle) -> Vehicle:
    """The vehicle, whose sensors have the noise of the file even where messages state another."""
    sensors = {
        name: sensor.model_copy(update={_FROM_MESSAGE: False}) if _FROM_MESSAGE in type(sensor).model_fields else sensor
        for name, sensor in vehicle.sensors.items()
    }
    return vehicle.model_copy(update={"sensors": sensors})


def tune(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    *,
    own_noise: bool = False,
    progress: Progress | None = None,
) -> Tuning:
    """The vehicle with the noise numbers under which the recordings are likeliest.

    A number of which they say nothing stays where it is, by a prior of a factor of three. With `own_noise`, sensors
    whose messages state covariances are tuned as well, and no longer read them. Parameters that the observer would
    estimate keep the file's values. Runs are shared out to all processors. `progress` takes the share done.
    """
    fixed = vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update={"parameters": {}})})
    start = with_own_noise(fixed) if own_noise else fixed
    nominal, free_parameters = of_vehicle(start), [_free(name) for name in noise_numbers(vehicle)]
    all_recordings, count = [*recordings, *held_out], len(recordings)
    jobs = count * (len(free_parameters) + 1)
    with ProcessPoolExecutor(min(os.cpu_count() or 1, jobs), initializer=_keep, initargs=(all_recordings,)) as pool:

        def cars(points: Sequence[Array], digits: int = EXACT) -> list[Vehicle]:
            return [with_values(start, with_offsets(nominal, free_parameters, point), digits) for point in points]

        def evaluate(points: Sequence[Array], done: Progress | None) -> list[list[Innovations]]:
            return _innovations_of(pool, cars(points), count, done)

        offsets, deviations, _ = maximise(evaluate, free_parameters, part(progress, 0, 1))
        (tuned,) = cars([offsets], NOISE.digits)
        judged = [[pool.submit(_judged, i, car) for i in range(len(all_recordings))] for car in (fixed, tuned)]
        first, last = ([job.result() for job in of_car] for of_car in judged)
    before, after = (_figures(judged_runs[:count], first[:count]) for judged_runs in (first, last))
    unseen = [_figures(judged_runs[count:], first[count:]) for judged_runs in (first, last) if held_out]
    values = of_vehicle(tuned).values
    numbers = tuple(
        TunedNumber(free.name, free.value(nominal.values), free.value(values), float(deviation))
        for free, deviation in zip(free_parameters, deviations, strict=True)
    )
    observer = tuned.observer.model_copy(update={"parameters": vehicle.observer.parameters})
    result = tuned.model_copy(update={"observer": observer})
    return Tuning(result, numbers, before, after, (unseen[0], unseen[1]) if held_out else None)


def _innovations_of(
    pool: Executor, cars: Sequence[Vehicle], recordings: int, progress: Progress | None
) -> list[list[Innovations]]:
    """Innovations of each car, on the first so many recordings, by sensor and recording."""
    jobs_by_car = [[pool.submit(_innovations, i, car) for i in range(recordings)] for car in cars]
    innovations_by_car: list[list[Innovations]] = []
    for i, of_car in enumerate(jobs_by_car):
        innovations_by_car.append(
            [sensor_innovations for job in of_car for sensor_innovations in job.result().values()]
        )
        if progress is not None:
            progress((i + 1) / len(jobs_by_car))
    return innovations_by_car


def _free(name: str) -> FreeParameter:
    """The logarithm of a standard deviation of the vehicle file."""
    return FreeParameter(name, "-", NOISE.prior, -NOISE.bound, NOISE.bound, multiplied({name: 1.0}))


# Innovations at each of some points, (k,) offsets, in the same order of sensors.
Evaluate = Callable[[Sequence[Array], Progress | None], list[list[Innovations]]]
_Mask = NDArray[np.bool_]


class Slopes(NamedTuple):
    """How the innovations of one sensor on one recording change with k free parameters."""

    stamp: NDArray[np.int64]  # (n,) [ns] of the messages that are judged
    credible: _Mask  # (n,) messages that are no outliers
    by_innovation: Array  # (c m, k) slopes of the innovations of the credible messages, over their deviations
    by_scale: Array  # (c m, k) slopes of the logarithms of these deviations


class Maximum(NamedTuple):
    """Offsets (k,) at which innovations are likeliest, with the prior of the free parameters, their standard deviations
    (k,), and the slopes that led there, by recording and sensor."""

    offsets: Array
    deviations: Array
    slopes: list[Slopes]


def maximise(
    evaluate: Evaluate,
    free_parameters: Sequence[FreeParameter],
    progress: Progress | None = None,
    iterations: int = NOISE.most_iterations,
    *,
    renew: bool = True,
    earlier: Maximum | None = None,
) -> Maximum:
    """The offsets at which innovations are likeliest.

    Each iteration is a scoring step, shortened until it is an improvement. Which messages are outliers is decided once,
    at zero: if that could change, a filter that refuses whatever is unlikely would win. Two points are compared by the
    messages that both have an innovation of. Without `renew` the slopes are those of the first point throughout, so
    that a further iteration costs one evaluation in place of k + 1. The search goes on where an `earlier` one, of a car
    that is much alike, ended, with its slopes and its messages.
    """
    count = len(free_parameters)
    deviations = np.array([free.deviation for free in free_parameters])
    low, high = np.array([free.low for free in free_parameters]), np.array([free.high for free in free_parameters])
    offsets, slopes = (np.zeros(count), None) if earlier is None else (earlier.offsets, earlier.slopes)
    innovations_here = evaluate([offsets], None)[0]
    if not innovations_here:
        raise InputError("the recordings have no message of a sensor that measures; there is no innovation to judge by")
    stamps, credible = _judged_by(slopes or innovations_here)

    def at_stamps(by_sensor: Sequence[Innovations]) -> list[Innovations]:
        """Innovations of the messages that are judged."""
        return [innovations.at(stamp) for innovations, stamp in zip(by_sensor, stamps, strict=True)]

    def rise(new_offsets: Array, new_innovations: Sequence[Innovations]) -> float:
        """Twice the rise of log-likelihood and prior together, from the present values."""
        prior = float(np.sum((offsets / deviations) ** 2) - np.sum((new_offsets / deviations) ** 2))
        return prior + _twice_gained(innovations_here, new_innovations, credible)

    innovations_here = at_stamps(innovations_here)
    for iteration in range(iterations):
        if slopes is None or (renew and earlier is None):
            points = list(offsets + NOISE.difference * np.eye(count))
            nearby = [at_stamps(one) for one in evaluate(points, part(progress, iteration, iterations))]
            slopes = _slopes(innovations_here, nearby, credible)
        equations = _equations(free_parameters, offsets, innovations_here, slopes)
        change = _scoring_step(equations, offsets)
        if -0.5 * equations.gradient @ change < NOISE.least_gain * count:
            break
        step = change * deviations
        step *= min(1.0, NOISE.largest_step / float(np.abs(step).max()))
        shorter_steps = (np.clip(offsets + share * step, low, high) for share in NOISE.shares_of_step)
        trials = ((trial, at_stamps(evaluate([trial], None)[0])) for trial in shorter_steps)
        better = next((trial for trial in trials if rise(*trial) > 0), None)
        if better is None:
            break
        offsets, innovations_here = better
    if progress is not None:
        progress(1.0)
    assert slopes is not None
    return Maximum(offsets, equations.spread() * deviations, slopes)


def _judged_by(messages: Sequence[Slopes | Innovations]) -> tuple[list[NDArray[np.int64]], list[NDArray[np.bool_]]]:
    """Stamps [ns] of the messages of each sensor, and which of them are no outliers."""
    credible = [one.credible if isinstance(one, Slopes) else one.credible() for one in messages]
    return [one.stamp for one in messages], credible


def _twice_gained(
    before: Sequence[Innovations], after: Sequence[Innovations], credible: Sequence[NDArray[np.bool_]]
) -> float:
    """Twice the rise of the log-likelihood of the credible messages that have an innovation before and after."""
    compared = [mask & one.there & other.there for mask, one, other in zip(credible, before, after, strict=True)]
    return _minus_twice_log_likelihood(before, compared) - _minus_twice_log_likelihood(after, compared)


def _scoring_step(equations: NormalEquations, offsets: Array) -> Array:
    """The change (k,) of the free parameters [deviations], of which those stay that are at a bound and would go
    beyond."""
    free_parameters, uphill = equations.free_parameters, equations.gradient
    moving = [
        i for i, (free, offset) in enumerate(zip(free_parameters, offsets, strict=True))
        if not (offset <= free.low and uphill[i] >= 0) and not (offset >= free.high and uphill[i] <= 0)
    ]  # fmt: skip
    change = np.zeros(len(free_parameters))
    change[moving] = equations.only(moving).change()
    return change


def _minus_twice_log_likelihood(all_innovations: Sequence[Innovations], credible: Sequence[_Mask]) -> float:
    """Minus twice the log-likelihood of innovations, which is minimised as squared residuals are in least squares."""
    return -2.0 * sum(float(i.log_density()[mask].sum()) for i, mask in zip(all_innovations, credible, strict=True))


def _equations(
    free_parameters: Sequence[FreeParameter],
    offsets: Array,
    present: Sequence[Innovations],
    slopes: Sequence[Slopes],
) -> NormalEquations:
    """The equations of a scoring step: the Fisher information stands where least squares has the products of slopes,
    and the gradient of the log-likelihood, with a minus, where it has those of slopes and residuals."""
    deviations = np.array([free.deviation for free in free_parameters])
    gradient, information = _score(present, slopes)
    credible = [by_sensor.credible for by_sensor in slopes]
    return NormalEquations(
        tuple(free_parameters), offsets / deviations, 1.0, (information * np.outer(deviations, deviations))[None],
        (-gradient * deviations)[None], np.array([_minus_twice_log_likelihood(present, credible)]),
        np.array([sum(int(mask.sum()) for mask in credible)]),
    )  # fmt: skip


def _slopes(
    present: Sequence[Innovations], nearby: Sequence[Sequence[Innovations]], credible: Sequence[_Mask]
) -> list[Slopes]:
    """Slopes from innovations at present and where each of the free parameters is `NOISE.difference` further."""
    found = []
    for i, (at_present, mask) in enumerate(zip(present, credible, strict=True)):
        by_innovation, by_scale = (np.zeros((at_present.whitened[mask].size, len(nearby))) for _ in range(2))
        for k, all_there in enumerate(nearby):
            stretch = all_there[i].deviation[mask] / at_present.deviation[mask]
            change = (all_there[i].whitened[mask] * stretch - at_present.whitened[mask]) / NOISE.difference
            by_innovation[:, k] = np.nan_to_num(change).clip(-NOISE.steepest, NOISE.steepest).ravel()
            by_scale[:, k] = np.nan_to_num(np.log(stretch) / NOISE.difference).ravel()
        found.append(Slopes(at_present.stamp, mask, by_innovation, by_scale))
    return found


def _score(present: Sequence[Innovations], slopes: Sequence[Slopes]) -> tuple[Array, Array]:
    """Gradient (k,) and Fisher information (k, k) of the log-likelihood.

    Of an innovation e with deviation d the log density is -½ (e/d)² - log d: its slope is -(e/d)(∂e/d) + ((e/d)² - 1)
    ∂log d, and its information (∂e/d)² + 2 (∂log d)². The factor (e/d)² - 1, which vanishes in the mean at the optimum,
    keeps the error of one-sided differences out of the result.
    """
    count = slopes[0].by_scale.shape[1]
    slope, information = np.zeros(count), np.zeros((count, count))
    for at_present, (_, mask, by_innovation, by_scale) in zip(present, slopes, strict=True):
        whitened = at_present.whitened[mask].ravel()
        w = np.nan_to_num(whitened)
        slope += np.where(np.isnan(whitened), 0.0, w**2 - 1) @ by_scale - w @ by_innovation
        information += by_innovation.T @ by_innovation + 2 * by_scale.T @ by_scale
    return slope, information


_RECORDINGS: list[Recording] = []  # of a worker process


def _keep(recordings: Sequence[Recording]) -> None:
    _RECORDINGS[:] = recordings


def _innovations(index: int, vehicle: Vehicle) -> dict[str, Innovations]:
    return innovations(_RECORDINGS[index], vehicle, noise_as_stated=True)


_Judged = tuple[dict[str, Innovations], dict[str, Error]]


def _judged(index: int, vehicle: Vehicle) -> _Judged:
    """Innovations, and errors against the reference where there is one."""
    recording = _RECORDINGS[index]
    errors: dict[str, Error] = {}
    if any("reference/" in topic for topic in recording.channels):
        errors = errors_of(at_reference(run(recording, vehicle).output, vehicle), recording)
    return innovations(recording, vehicle, noise_as_stated=True), errors


def _figures(results: Sequence[_Judged], first: Sequence[_Judged]) -> Figures:
    """Over all recordings; which messages are credible is decided by the `first` results, those before tuning."""
    names = list(dict.fromkeys(name for by_sensor, _ in results for name in by_sensor))
    pairs = [
        (name, by_sensor[name], before[name].credible())
        for (by_sensor, _), (before, _) in zip(results, first, strict=True)
        for name in by_sensor
    ]
    sensors = {}
    for name in [*names, ALL]:
        chosen = [pair for pair in pairs if name in (pair[0], ALL)]
        sensors[name] = consistency(
            [sensor_innovations for _, sensor_innovations, _ in chosen], [mask for *_, mask in chosen]
        )
    signals = list(dict.fromkeys(name for _, errors in results for name in errors))
    by_signal = {name: [errors[name] for _, errors in results if name in errors] for name in signals}
    means = {
        name: Error(
            float(np.sqrt(np.mean([e.rmse**2 for e in drive_errors]))),
            float(np.mean([e.nees for e in drive_errors])),
            float(np.mean([e.inside for e in drive_errors])),
        )
        for name, drive_errors in by_signal.items()
    }
    return Figures(sensors, means)
