"""Noise covariances of the observer, found by maximising the likelihood of recordings.

The likelihood is that of the innovations of the errorEKF: the density of every message given all before it. It needs no
reference. Unknowns are the logarithms of standard deviations, so none can become negative. The method is Fisher scoring
(Gupta & Mehra 1974): the derivatives of the innovations and of their deviations, by differences, give the gradient and
the information matrix together, and the inverse of the latter says how well each number is determined.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

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
        used = of_wheels.get(field, not field.endswith("time_constant"))
        if used and getattr(errors, field) > 0:
            paths.append(f"observer.force_errors.{field}")
    for slope in ("grade", "bank"):
        if getattr(around, slope) > 0:
            paths += [f"observer.surroundings.{slope}", f"observer.surroundings.{slope}_change"]
    return paths


@dataclass(frozen=True)
class Found:
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
    """A tuned vehicle, what was found, and its figures before and after; None: nothing was held out."""

    vehicle: Vehicle
    found: tuple[Found, ...]
    before: Figures
    after: Figures
    held_out: tuple[Figures, Figures] | None

    def changed(self, start: Vehicle) -> list[str]:
        """Dotted paths of what differs from the vehicle that tuning started from."""
        paths = [found.path for found in self.found if found.before != found.after]
        for name, sensor in start.sensors.items():
            if getattr(sensor, _FROM_MESSAGE, None) != getattr(self.vehicle.sensors[name], _FROM_MESSAGE, None):
                paths.append(f"sensors.{name}.{_FROM_MESSAGE}")
        return paths

    def write(self, path: Path) -> None:
        """Everything but the vehicle as JSON."""
        content = {
            "numbers": {f.path: asdict(f) | {"determined": f.determined, "at_bound": f.at_bound} for f in self.found},
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
    known = vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update={"parameters": {}})})
    start = with_own_noise(known) if own_noise else known
    nominal, free_parameters = of_vehicle(start), [_free(name) for name in noise_numbers(vehicle)]
    every, count = [*recordings, *held_out], len(recordings)
    jobs = count * (len(free_parameters) + 1)
    with ProcessPoolExecutor(min(os.cpu_count() or 1, jobs), initializer=_keep, initargs=(every,)) as pool:

        def cars(points: Sequence[Array], digits: int = EXACT) -> list[Vehicle]:
            return [with_values(start, with_offsets(nominal, free_parameters, point), digits) for point in points]

        def evaluate(points: Sequence[Array], done: Progress | None) -> list[list[Innovations]]:
            return _innovations_of(pool, cars(points), count, done)

        offsets, deviations = maximise(evaluate, free_parameters, part(progress, 0, 1))
        (tuned,) = cars([offsets], NOISE.digits)
        judged = [[pool.submit(_judged, i, car) for i in range(len(every))] for car in (known, tuned)]
        first, last = ([job.result() for job in of_car] for of_car in judged)
    before, after = (_figures(one[:count], first[:count]) for one in (first, last))
    unseen = [_figures(one[count:], first[count:]) for one in (first, last) if held_out]
    values = of_vehicle(tuned).values
    found = tuple(
        Found(free.name, free.value(nominal.values), free.value(values), float(deviation))
        for free, deviation in zip(free_parameters, deviations, strict=True)
    )
    observer = tuned.observer.model_copy(update={"parameters": vehicle.observer.parameters})
    result = tuned.model_copy(update={"observer": observer})
    return Tuning(result, found, before, after, (unseen[0], unseen[1]) if held_out else None)


def _innovations_of(
    pool: Executor, cars: Sequence[Vehicle], recordings: int, progress: Progress | None
) -> list[list[Innovations]]:
    """Innovations of each car, on the first so many recordings, by sensor and recording."""
    asked = [[pool.submit(_innovations, i, car) for i in range(recordings)] for car in cars]
    found: list[list[Innovations]] = []
    for i, of_car in enumerate(asked):
        found.append([one for job in of_car for one in job.result().values()])
        if progress is not None:
            progress((i + 1) / len(asked))
    return found


def _free(name: str) -> FreeParameter:
    """The logarithm of a standard deviation of the vehicle file."""
    return FreeParameter(name, "-", NOISE.prior, -NOISE.bound, NOISE.bound, multiplied({name: 1.0}))


# Innovations at each of some points, (k,) offsets, in the same order of sensors.
Evaluate = Callable[[Sequence[Array], Progress | None], list[list[Innovations]]]


def maximise(
    evaluate: Evaluate,
    free_parameters: Sequence[FreeParameter],
    progress: Progress | None = None,
    iterations: int = NOISE.most_iterations,
) -> tuple[Array, Array]:
    """Offsets (k,) at which innovations are likeliest, with the prior of the free parameters, and their standard
    deviations (k,).

    Each iteration is a scoring step, shortened until it is an improvement. Which messages are outliers is decided once,
    at zero: if that could change, a filter that refuses whatever is unlikely would win. Two points are compared by the
    messages that both have an innovation of.
    """
    count = len(free_parameters)
    deviations = np.array([free.deviation for free in free_parameters])
    low, high = np.array([free.low for free in free_parameters]), np.array([free.high for free in free_parameters])
    here = np.zeros(count)
    now = evaluate([here], None)[0]
    if not now:
        raise InputError("the recordings have no message of a sensor that measures; there is no innovation to judge by")
    stamps, credible = [one.stamp for one in now], [one.credible() for one in now]

    def at(points: Sequence[Array], done: Progress | None = None) -> list[list[Innovations]]:
        """`evaluate`, of the messages that there were at zero."""
        return [[one.at(stamp) for one, stamp in zip(of, stamps, strict=True)] for of in evaluate(points, done)]

    def rise(there: Array, found: Sequence[Innovations]) -> float:
        """Twice the rise of log-likelihood and prior together, from the present values."""
        both = [of & one.there & other.there for of, one, other in zip(credible, now, found, strict=True)]
        before, after = (_minus_twice_log_likelihood(of, both) for of in (now, found))
        return before - after + float(np.sum((here / deviations) ** 2) - np.sum((there / deviations) ** 2))

    for iteration in range(iterations):
        nearby = at([here + NOISE.difference * unit for unit in np.eye(count)], part(progress, iteration, iterations))
        equations = _equations(free_parameters, here, now, nearby, credible)
        change = _scoring_step(equations, here)
        if -0.5 * equations.gradient @ change < NOISE.least_gain * count:
            break
        step = change * deviations
        step *= min(1.0, NOISE.largest_step / float(np.abs(step).max()))
        for shorter in NOISE.shares_of_step:
            there = np.clip(here + shorter * step, low, high)
            found = at([there])[0]
            if rise(there, found) > 0:
                break
        else:
            break
        here, now = there, found
    if progress is not None:
        progress(1.0)
    return here, equations.spread() * deviations


def _scoring_step(equations: NormalEquations, offsets: Array) -> Array:
    """The change (k,) of the free parameters [deviations], of which those stay that are at a bound and would go
    beyond."""
    free_parameters, uphill = equations.free_parameters, equations.gradient
    moving = [
        i for i, (free, at) in enumerate(zip(free_parameters, offsets, strict=True))
        if not (at <= free.low and uphill[i] >= 0) and not (at >= free.high and uphill[i] <= 0)
    ]  # fmt: skip
    change = np.zeros(len(free_parameters))
    change[moving] = equations.only(moving).change()
    return change


_Mask = NDArray[np.bool_]


def _minus_twice_log_likelihood(found: Sequence[Innovations], credible: Sequence[_Mask]) -> float:
    """Minus twice the log-likelihood of innovations, which is minimised as squared residuals are in least squares."""
    return -2.0 * sum(float(i.log_density()[of].sum()) for i, of in zip(found, credible, strict=True))


def _equations(
    free_parameters: Sequence[FreeParameter],
    offsets: Array,
    now: Sequence[Innovations],
    nearby: Sequence[Sequence[Innovations]],
    credible: Sequence[_Mask],
) -> NormalEquations:
    """The equations of a scoring step: the Fisher information stands where least squares has the products of slopes,
    and the gradient of the log-likelihood, with a minus, where it has those of slopes and residuals."""
    deviations = np.array([free.deviation for free in free_parameters])
    gradient, information = _score(now, nearby, credible)
    return NormalEquations(
        tuple(free_parameters), offsets / deviations, 1.0, (information * np.outer(deviations, deviations))[None],
        (-gradient * deviations)[None], np.array([_minus_twice_log_likelihood(now, credible)]),
        np.array([sum(int(of.sum()) for of in credible)]),
    )  # fmt: skip


def _score(
    now: Sequence[Innovations], nearby: Sequence[Sequence[Innovations]], credible: Sequence[_Mask]
) -> tuple[Array, Array]:
    """Gradient (k,) and Fisher information (k, k) of the log-likelihood.

    Of an innovation e with deviation d the log density is -½ (e/d)² - log d: its slope is -(e/d)(∂e/d) + ((e/d)² - 1)
    ∂log d, and its information (∂e/d)² + 2 (∂log d)². The factor (e/d)² - 1, which vanishes in the mean at the optimum,
    keeps the error of one-sided differences out of the result.
    """
    count = len(nearby)
    slope, information = np.zeros(count), np.zeros((count, count))
    for i, (here, of) in enumerate(zip(now, credible, strict=True)):
        by_innovation, by_scale = (np.zeros((here.whitened[of].size, count)) for _ in range(2))
        for k, all_there in enumerate(nearby):
            stretch = all_there[i].deviation[of] / here.deviation[of]
            change = (all_there[i].whitened[of] * stretch - here.whitened[of]) / NOISE.difference
            by_innovation[:, k] = np.nan_to_num(change).clip(-NOISE.steepest, NOISE.steepest).ravel()
            by_scale[:, k] = np.nan_to_num(np.log(stretch) / NOISE.difference).ravel()
        w = np.nan_to_num(here.whitened[of]).ravel()
        slope += (w**2 - 1) @ by_scale - w @ by_innovation
        information += by_innovation.T @ by_innovation + 2 * by_scale.T @ by_scale
    return slope, information


_RECORDINGS: list[Recording] = []  # of a worker process


def _keep(recordings: Sequence[Recording]) -> None:
    _RECORDINGS[:] = recordings


def _innovations(index: int, vehicle: Vehicle) -> dict[str, Innovations]:
    return innovations(_RECORDINGS[index], vehicle)


_Judged = tuple[dict[str, Innovations], dict[str, Error]]


def _judged(index: int, vehicle: Vehicle) -> _Judged:
    """Innovations, and errors against the reference where there is one."""
    recording = _RECORDINGS[index]
    errors: dict[str, Error] = {}
    if any("reference/" in topic for topic in recording.channels):
        errors = errors_of(at_reference(run(recording, vehicle).output, vehicle), recording)
    return innovations(recording, vehicle), errors


def _figures(results: Sequence[_Judged], first: Sequence[_Judged]) -> Figures:
    """Over all recordings; which messages are credible is decided by the `first` results, those before tuning."""
    names = list(dict.fromkeys(name for found, _ in results for name in found))
    pairs = [
        (name, found[name], before[name].credible())
        for (found, _), (before, _) in zip(results, first, strict=True)
        for name in found
    ]
    sensors = {}
    for name in [*names, ALL]:
        chosen = [pair for pair in pairs if name in (pair[0], ALL)]
        sensors[name] = consistency([one for _, one, _ in chosen], [of for *_, of in chosen])
    signals = list(dict.fromkeys(name for _, errors in results for name in errors))
    by_signal = {name: [errors[name] for _, errors in results if name in errors] for name in signals}
    means = {
        name: Error(
            float(np.sqrt(np.mean([e.rmse**2 for e in of]))),
            float(np.mean([e.nees for e in of])),
            float(np.mean([e.inside for e in of])),
        )
        for name, of in by_signal.items()
    }
    return Figures(sensors, means)
