"""Comparison of the observer with and without the effects of an answer, on recordings that no fit has seen.

An observer lives with a model that is a little wrong: it doubts it, by its noise levels. So each vehicle is judged with
noise levels that fit it, found on the recordings that were fitted. How likely the measurements of the held-out
recordings are to it, each given all before it, needs no reference (Schweppe 1965); where a recording has a reference,
errors against it are reported besides, with the reference where the vehicle file puts it, and where the recording does:
how a reference is mounted is nothing that an observer can know.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from vsense_ros.estimation.innovations import Innovations
from vsense_ros.evaluate.metrics import SignalScore, align, compare
from vsense_ros.evaluate.reference import at_reference
from vsense_ros.evaluate.signals import SLOWEST_SIDE_SLIP, read_signals
from vsense_ros.identification.free_parameter import FreeParameter, multiplied, with_offsets
from vsense_ros.identification.noise import NOISE, Maximum, maximise, noise_numbers
from vsense_ros.identification.parameter_set import EXACT, of_vehicle, with_values
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.answer_schema import (
    ObserverComparison,
    ObserverError,
    ObserverFigures,
    ReferencePlace,
    SensorFigures,
)
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.innovations import innovations, innovations_and_output

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ObserverComparisonSettings:
    """How the observer is compared with and without the effects of an answer: decisions of this project."""

    # [s] of what was fitted, from which noise levels are found: more says hardly more of a dozen numbers
    tuned_on: float = 150.0
    judged_on: float = 900.0  # [s] of what was held out
    iterations: int = 3  # of that search: beyond them levels change by less than they matter
    further_iterations: int = 1  # of the search for the extended vehicle's, which begins where that one ended
    noteworthy: float = 0.003  # [nat] per message by which likelihoods differ for more than rounding
    noteworthy_slip: float = 1.75e-5  # [rad] the same of side slips: a thousandth of a degree, as they are said
    worse: float = 1.05  # of an error against the reference, from where on it has grown
    # steps of Newton's method to the mounting of a reference, which is linear but for a small angle
    mounting_steps: int = 3
    # [m, m, rad] ahead, to the left, and turned: a reference is on its car, and its axes are nearly those of the car,
    # where a drive without bends would put it anywhere
    furthest_mounting: tuple[float, float, float] = (4.0, 1.0, 0.2)


COMPARISON = ObserverComparisonSettings()

BODY = ("vertical", "roll", "pitch", "suspension")  # force errors that change together
ALONG = ("longitudinal", "wheel_spin", "grade", "grade_change")  # what acts along the car
REPORTED = (
    "side_slip",
    "lateral_velocity",
    "yaw_rate",
    "roll",
    "pitch",
    "speed",
)  # signals of which errors are reported
PROVING = ("side_slip", "lateral_velocity")  # those for which observers are run
CONSTANT = ("roll", "pitch")  # whose constant the mounting of a reference shifts


def comparison(
    recordings: Sequence[Recording],
    held_out: Sequence[Recording],
    dataset: Dataset,
    vehicle: Vehicle,
    extended: Vehicle,
    progress: Callable[[], None] = lambda: None,
) -> tuple[ObserverComparison, Vehicle]:
    """How the observer fares with the vehicle and with the extended one, on what was held out, or where nothing was on
    the recordings themselves; and the extended vehicle with the noise levels that fit it, unless such levels make the
    errors against a reference larger: then with those of the file.

    `dataset` says which stretches of the recordings were fitted. Raises `InputError` where the observer does not start.
    """
    pieces = _pieces(recordings, dataset)
    judged = [one.between(None, COMPARISON.judged_on / len(held_out)) for one in held_out] or pieces
    retuned, maximum = with_fitting_noise(vehicle, pieces, progress)
    cars = {"as_it_was": vehicle, "retuned": retuned}
    runs = {name: [innovations_and_output(one, car) for one in judged] for name, car in cars.items()}
    outputs = {name: _against_reference([run for _, run in runs[name]], judged, car) for name, car in cars.items()}
    progress()
    # What is likely of fast sensors may be wrong of slow errors, which a reference shows.
    if not _grown(outputs["retuned"].errors, outputs["as_it_was"].errors):
        extended, _ = with_fitting_noise(extended, pieces, progress, maximum)
    runs["extended"] = [innovations_and_output(one, extended) for one in judged]
    outputs["extended"] = _against_reference([run for _, run in runs["extended"]], judged, extended)
    progress()
    innovations_of = {name: [innovations for innovations, _ in of_car] for name, of_car in runs.items()}
    credible = _judged_by(innovations_of)
    figures = {}
    for name, of in innovations_of.items():
        sensors = _by_sensor(of, innovations_of["as_it_was"], credible)
        whole = sum(one.messages * one.log_likelihood for one in sensors.values())
        figures[name] = ObserverFigures(
            log_likelihood=whole / max(_messages(credible), 1), sensors=sensors,
            errors=outputs[name].errors, reference=outputs[name].place,
        )  # fmt: skip
    result = ObserverComparison(
        recordings=tuple(one.name for one in judged), held_out=bool(held_out), messages=_messages(credible),
        improved=False, sentence="", **figures,
    )  # fmt: skip
    verdict, sentence = _judged(result)
    return result.with_(improved=verdict, sentence=sentence), extended


def _judged_by(innovations_of: dict[str, list[dict[str, Innovations]]]) -> list[dict[str, NDArray[np.bool_]]]:
    """Which messages all cars are judged by, by recording and sensor: what an outlier is, is the same for all, and what
    one of them has no innovation of, none is judged by. The innovations are brought to the stamps of the first car."""
    credible = [{s: one.credible() for s, one in of.items()} for of in innovations_of["as_it_was"]]
    stamps = [{s: one.stamp for s, one in of.items()} for of in innovations_of["as_it_was"]]
    for name, of_car in innovations_of.items():
        innovations_of[name] = [
            {s: of[s].at(at[s]) for s in at if s in of} for of, at in zip(of_car, stamps, strict=True)
        ]
        for rows, of in zip(credible, innovations_of[name], strict=True):
            for s in rows.keys() - of.keys():
                del rows[s]
            for s in rows:
                rows[s] = rows[s] & of[s].there
    return credible


def with_fitting_noise(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    progress: Callable[[], None] = lambda: None,
    earlier: Maximum | None = None,
) -> tuple[Vehicle, Maximum]:
    """The vehicle with the noise levels of its model under which the recordings are likeliest: as `vsense tune` finds
    them, with fewer numbers, and slopes that are simulated once; and how they were found, with which the search for
    those of a car that is much alike begins."""
    estimating = vehicle.observer.parameters
    known = vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update={"parameters": {}})})
    free_parameters = [_free(name, group) for name, group in noise_levels(vehicle).items()]
    nominal = of_vehicle(known)

    def evaluate(points: Sequence[Array], _: object) -> list[list[Innovations]]:
        of_recordings = []
        for point in points:
            car = with_values(known, with_offsets(nominal, free_parameters, point), EXACT)
            of_recordings.append([one for recording in recordings for one in innovations(recording, car).values()])
            progress()
        return of_recordings

    iterations = COMPARISON.iterations if earlier is None else COMPARISON.further_iterations
    maximum = maximise(evaluate, free_parameters, iterations=iterations, renew=False, earlier=earlier)
    tuned = with_values(known, with_offsets(nominal, free_parameters, maximum.offsets), NOISE.digits)
    observer = tuned.observer.model_copy(update={"parameters": estimating})
    return tuned.model_copy(update={"observer": observer}), maximum


def noise_levels(vehicle: Vehicle) -> dict[str, tuple[str, ...]]:
    """Groups of noise numbers, each of which is fitted as one factor: how far the model's forces may be wrong, and what
    is known of the road's slopes.

    The noise of sensors stays as the file has it: a better model changes nothing of it. Fitted, it would fall to what
    is white of it, where sensors that filter and send faster than they measure have most of their error in what lasts.
    Nor does what acts along the car, where wheel torques are not measured: that is the driver, and no model.
    """
    driven = any(sensor.kind == "wheel_torques" for sensor in vehicle.sensors.values())
    groups: dict[str, list[str]] = {}
    for path in noise_numbers(vehicle):
        where, _, last = path.rpartition(".")
        if path.startswith("sensors.") or (last in ALONG and not driven):
            continue
        groups.setdefault(f"{where}.body" if last in BODY else path, []).append(path)
    return {name: tuple(paths) for name, paths in groups.items()}


def _free(name: str, paths: Sequence[str]) -> FreeParameter:
    return FreeParameter(name, "-", NOISE.prior, -NOISE.bound, NOISE.bound, multiplied(dict.fromkeys(paths, 1.0)))


def _pieces(recordings: Sequence[Recording], dataset: Dataset) -> list[Recording]:
    """A stretch of each recording that was fitted, from the beginning of its first window on."""
    fitted = [windows[0] for windows in dataset.by_recording()]
    return [
        recordings[window.recording].between(
            begin := max(0.0, window.begin - 5.0), begin + COMPARISON.tuned_on / len(fitted)
        )
        for window in fitted
    ]


_ByRecording = Sequence[Mapping[str, Innovations]]  # by recording and sensor
_Credible = Sequence[Mapping[str, NDArray[np.bool_]]]


def _messages(credible: _Credible) -> int:
    return sum(int(of.sum()) for one in credible for of in one.values())


def _by_sensor(after: _ByRecording, before: _ByRecording, credible: _Credible) -> dict[str, SensorFigures]:
    names = dict.fromkeys(sensor for one in credible for sensor in one)
    result = {}
    for name in names:
        parts = [
            (one[name], was[name], rows[name])
            for one, was, rows in zip(after, before, credible, strict=True)
            if name in rows
        ]
        count = sum(int(of.sum()) for *_, of in parts)
        density = sum(float(one.log_density()[of].sum()) for one, _, of in parts)
        whitened = np.concatenate([one.whitened[of] for one, _, of in parts])
        squares = np.nansum(np.concatenate([_sizes(one, of) ** 2 for one, _, of in parts]), axis=0)
        squares_before = np.nansum(np.concatenate([_sizes(was, of) ** 2 for _, was, of in parts]), axis=0)
        known = (squares > 0) & (squares_before > 0)
        ratio = np.sqrt(squares[known] / squares_before[known])
        result[name] = SensorFigures(
            messages=count,
            log_likelihood=density / max(count, 1),
            innovation=float(np.exp(np.mean(np.log(ratio)))) if known.any() else 1.0,
            nis=float(np.nanmean(whitened**2)),
        )
    return result


def _sizes(one: Innovations, of: NDArray[np.bool_]) -> Array:
    """Innovations in the units of the sensor (n, m)."""
    return np.asarray(one.whitened[of] * one.deviation[of])


@dataclass(frozen=True)
class _Against:
    """Errors against references by signal, and where the recordings say that the reference is."""

    errors: dict[str, ObserverError]
    place: ReferencePlace | None


def _against_reference(every: Sequence[Recording], recordings: Sequence[Recording], vehicle: Vehicle) -> _Against:
    """Errors of `every` output of the recordings of which there is a reference."""
    pairs = [
        (output, one)
        for output, one in zip(every, recordings, strict=True)
        if any(topic.startswith("reference/") for topic in one.channels)
    ]
    if not pairs:
        return _Against({}, None)
    outputs, referenced = zip(*pairs, strict=True)
    place = fitted_place(outputs, referenced, vehicle)
    stated = [compare(at_reference(o, vehicle), r) for o, r in zip(outputs, referenced, strict=True)]
    moved = vehicle
    if place is not None:
        mounting = vehicle.reference.model_copy(
            update={"position": (place.x, place.y, vehicle.reference.position[2]), "yaw": place.yaw}
        )
        moved = vehicle.model_copy(update={"reference": mounting})
    fitted = [compare(at_reference(o, moved), r) for o, r in zip(outputs, referenced, strict=True)]
    errors = {}
    for name in REPORTED:
        both = [(one[name], two[name]) for one, two in zip(stated, fitted, strict=True) if name in one and name in two]
        if both:
            errors[name] = ObserverError(
                unit=both[0][0].unit,
                rmse=_joined([one for one, _ in both], constant=False),
                without_constant=_joined([two for _, two in both], constant=name in CONSTANT),
            )
    return _Against(errors, place)


def _joined(scores: Sequence[SignalScore], *, constant: bool) -> float:
    """Root mean square of the errors of several recordings, without the constant that they share if asked."""
    count = np.array([score.n for score in scores])
    square = float(np.average([score.rmse**2 for score in scores], weights=count))
    mean = float(np.average([score.bias for score in scores], weights=count)) if constant else 0.0
    return float(np.sqrt(max(square - mean**2, 0.0)))


def fitted_place(
    outputs: Sequence[Recording], recordings: Sequence[Recording], vehicle: Vehicle
) -> ReferencePlace | None:
    """Where on the car the reference is, and how far its axes are turned, by what it says of the car's velocity: by
    linear least squares. None where it determines none."""
    parts = []
    for output, recording in zip(outputs, recordings, strict=True):
        estimates, truths = read_signals(output, "vsense"), read_signals(recording, "reference")
        names = ("longitudinal_velocity", "lateral_velocity")
        if not all(name in estimates and name in truths for name in (*names, "yaw_rate")):
            continue
        ahead, aside, turning = (align(estimates[name], truths[name]) for name in (*names, "yaw_rate"))
        stamps = np.intersect1d(np.intersect1d(ahead.stamp, aside.stamp), turning.stamp)
        x, y, r = (one.estimate[np.isin(one.stamp, stamps), 0] for one in (ahead, aside, turning))
        true_x, true_y = (one.truth[np.isin(one.stamp, stamps), 0] for one in (ahead, aside))
        moving = x > SLOWEST_SIDE_SLIP
        parts.append(np.array([x, y, r, true_x, true_y])[:, moving])
    if not sum(part.shape[1] for part in parts):
        return None
    x, y, r, true_x, true_y = np.concatenate(parts, axis=1)
    place, zero = np.zeros(3), np.zeros_like(r)
    furthest = np.array(COMPARISON.furthest_mounting)
    for _ in range(COMPARISON.mounting_steps):
        # The velocity v + ω × position, in axes that are turned by what is known of the yaw.
        cos, sin = np.cos(place[2]), np.sin(place[2])
        there_x, there_y = cos * true_x - sin * true_y, sin * true_x + cos * true_y
        own_x, own_y = x - r * place[1], y + r * place[0]
        rows = np.block([[zero[:, None], -r[:, None], own_y[:, None]], [r[:, None], zero[:, None], -own_x[:, None]]])
        off = np.concatenate([there_x - own_x, there_y - own_y])
        place += lsq_linear(rows, off, bounds=(-furthest - place, furthest - place)).x
    return ReferencePlace(x=float(place[0]), y=float(place[1]), yaw=float(place[2]))


def _judged(compared: ObserverComparison) -> tuple[bool, str]:
    """True if the observer is better with the extended file, and a sentence that says so."""
    was, retuned, extended = compared.as_it_was, compared.retuned, compared.extended
    on = "held-out recordings" if compared.held_out else "the fitted recordings, as none was held out"
    kept = bool(_grown(retuned.errors, was.errors))  # the noise levels of the file
    rival = was if kept else retuned
    gained, by_noise = (one.log_likelihood - was.log_likelihood for one in (extended, rival))
    rises = gained > COMPARISON.noteworthy
    off, by_others = _slip(extended), _slip(rival)
    likelier = gained - by_noise > COMPARISON.noteworthy
    by_model = off < by_others / COMPARISON.worse or (likelier and off - by_others < COMPARISON.noteworthy_slip)
    grown = _grown(extended.errors, was.errors)
    figures = (
        f"on {on} the log-likelihood per message changes by {_signed(gained)}; other noise levels alone change it by "
        f"{_signed(retuned.log_likelihood - was.log_likelihood)}"
    )
    if "side_slip" in extended.errors and "side_slip" in was.errors:
        before, after = (np.degrees(one.errors["side_slip"].without_constant) for one in (was, extended))
        alone = np.degrees(retuned.errors["side_slip"].without_constant)
        figures += (
            f"; the side slip is wrong by {after:.3f}° instead of {before:.3f}° (with other noise levels alone by "
            f"{alone:.3f}°{', and so the file keeps its own' if kept else ''}), the mounting of the reference fitted"
        )
    if rises and by_model and not grown:
        return True, f"The observer is better with the extended file: {figures}."
    if grown:
        worse = f"its {' and '.join(grown)} {'is' if len(grown) == 1 else 'are'} worse"
    else:
        worse = "other noise levels alone do as much for it" if rises else "measurements are no likelier to it"
    return False, f"The observer is not better with the extended file, as {worse}: {figures}."


def _grown(errors: Mapping[str, ObserverError], before: Mapping[str, ObserverError]) -> list[str]:
    """Which of the proving errors, in words, are larger than before by more than a little."""
    return [
        name.replace("_", " ")
        for name in PROVING
        if name in errors
        and name in before
        and errors[name].without_constant > COMPARISON.worse * before[name].without_constant
    ]


def _slip(figures: ObserverFigures) -> float:
    """The side slip's error [rad] with the mounting of the reference fitted, as its constant says nothing of the
    observer; 0 without a reference."""
    error = figures.errors.get(PROVING[0])
    return 0.0 if error is None else error.without_constant


def _signed(value: float) -> str:
    return f"{value:+.3f}".replace("-", "−")
