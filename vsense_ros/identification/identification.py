"""A car's parameters from recordings: what `vsense identify` does.

Passes of an identifying filter find the place (rinsing.py); then prior and drives are weighed (information.py), so that
a parameter that the drives do not determine keeps the value of the vehicle file, and is refused by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any, Literal

import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.integrated import Rates
from vsense_ros.identification import best, handling_values, recorded
from vsense_ros.identification.identified import Identification, Product, advice
from vsense_ros.identification.information import Information, Refusal, information, refusals, weigh
from vsense_ros.identification.likelihood import Likelihood
from vsense_ros.identification.open_loop import OpenLoop
from vsense_ros.identification.prediction import judged
from vsense_ros.identification.progress import Progress, part
from vsense_ros.identification.recorded import Signals
from vsense_ros.identification.rinsing import Drive, Identifier, Noise, Rinsed, Schedule, rinse
from vsense_ros.identification.sensor_errors import STEERING, WithSensorErrors
from vsense_ros.messages.recording import Recording
from vsense_ros.model.handling import best_4dof
from vsense_ros.model.handling.best_4dof import Best4Dof
from vsense_ros.model.handling.single_track import SingleTrack
from vsense_ros.model.vehicle import Vehicle

ModelName = Literal["best", "single_track"]
Weigh = Callable[[Sequence[Drive]], Information]  # what some drives say alone
AXLES = ("front", "rear")


@dataclass(frozen=True)
class IdentificationSettings:
    """Decisions of the identification of handling models."""

    two_cars_deviations: float = 3.0  # [-] standard deviations between two drives, beyond which they are not of one car
    # [-] and the share of the value: a town and a country road of one simulated car came out 21 % apart, as forces at
    # small radii are not those of a single track, and temperature and load change a tyre beside that
    two_cars_share: float = 0.25
    most_passes: int = 10  # over the drives
    # [-] correlation of two signals that should go together, from which on one has the wrong sign
    reversed_correlation: float = -0.4
    # standard deviations of the gain [-], the offset [rad] and the delay [s] of the steering angle
    steering_prior: tuple[float, float, float] = (0.1, 0.01, 0.05)


IDENTIFICATION = IdentificationSettings()


@dataclass(frozen=True)
class Handling:
    """How one handling model is identified: `make` it; noise; what is free; which are judged by their curve."""

    make: Callable[[], Rates]
    noise: Noise
    free: tuple[str, ...]
    offsets: Mapping[str, tuple[float, float]]  # of the outputs: deviation, and by how much it drifts in a second
    by_likelihood: bool = False  # whether the likeliest values are looked for, in place of passes of a filter of them


_LATERAL = tuple(f"{axle}_{name}" for axle in AXLES for name in ("stiffness", "peak", "shape", "curvature"))
MODELS: Mapping[str, Handling] = {
    "best": Handling(
        lambda: Best4Dof(on_body=True, yaw_rate=True),
        Noise((*best.SETTINGS.output_deviations, 0.005), best.SETTINGS.start_deviations, best.DISTURBANCES),
        tuple(best_4dof.SYMBOLS),
        {
            "longitudinal_acceleration": (0.3, 1e-3),
            "lateral_acceleration": (0.3, 1e-3),
            "roll_rate": (0.01, 1e-3),
            "yaw_rate": (0.005, 1e-4),
        },
    ),
    "single_track": Handling(
        SingleTrack,
        Noise((0.003, 2e-4), (0.3, 0.05, 3000.0, 3000.0), {"lateral_velocity": 0.02, "yaw_rate": 0.001}),
        ("yaw_inertia", "relaxation_length", "roll_gradient", *_LATERAL),
        {"lateral_acceleration": (0.5, 1e-3), "yaw_rate": (0.005, 1e-4)},
        by_likelihood=True,
    ),
}
WANDERING = {"steering_wander": (1e-3, 1e-3), "bank": (0.2, 0.07), "grade": (0.2, 0.05)}  # as offsets


def identify(
    recordings: Sequence[Recording],
    vehicle: Vehicle,
    model: ModelName = "best",
    *,
    free: Sequence[str] = (),
    held_out: Sequence[Recording] = (),
    progress: Progress | None = None,
) -> Identification:
    """Identify the parameters of a handling model.

    The observer predicts the course in silences of the receiver with the vehicle before and after, on the recordings
    held out if there are any. These courses were not fitted. If it predicts worse, the vehicle stays as it was.

    Raises `InputError` where the recordings cannot determine anything, or the free parameters are none of the model.
    """
    signals = [recorded.signals(one, vehicle) for one in recordings]
    for one_recording in signals:
        check_signs(one_recording)
    recorded_drives = recorded.drives(signals, model)
    one, prior = handling_identifier(vehicle, model, free, recorded_drives)
    whole = one.model
    assert isinstance(whole, WithSensorErrors)
    start, wanted = one.values, tuple(name for name in one.free if name not in STEERING)
    drives = [whole.drive(drive) for drive in recorded_drives]
    weighed, rinsed, own = _estimated(one, drives, prior, model, part(progress, 0, 2))
    refused = tuple(r for r in refusals(weighed, best_4dof.JUDGED_BY_CURVE) if r.name in wanted)
    check_one_car(one, drives, own)
    products = tuple(_products(one, drives, weighed, own))
    if len(refused) == len(wanted) and not any(product.is_determined for product in products):
        raise _undetermined(refused)
    made = Identification(
        model, vehicle, vehicle, start, wanted, weighed, rinsed, refused, products, tuple(drives), {}, {},
        tuple(r.name for r in held_out),
    )  # fmt: skip
    changed = _written(made)
    others = recorded.drives([recorded.signals(r, vehicle) for r in held_out], model)
    every = [*drives, *map(whole.drive, others)]
    verdict = judged(held_out or recordings, vehicle, changed, part(progress, 1, 2))
    kept = vehicle if verdict is not None and verdict.is_worse else changed
    made = replace(made, vehicle=kept, verdict=verdict, fits=fits(made, whole, every))
    made = _with_side_slip(made, whole, [*recordings, *held_out], every)
    if progress is not None:
        progress(1.0)
    return made


def _estimated(
    one: Identifier, drives: Sequence[Drive], prior: Array, model: ModelName, progress: Progress | None
) -> tuple[Information, Rinsed, Weigh]:
    """What the drives say of the parameters, by the method of the model; results as of `_by_likelihood`.

    Raises `InputError` where the model cannot follow the drives.
    """
    method = _by_likelihood if MODELS[model].by_likelihood else _by_rinsing
    try:
        return method(one, drives, prior, progress)
    except FloatingPointError as error:
        raise InputError(
            f"the model {model} cannot follow {', '.join(d.name for d in drives)}: {error}. Are units and signs of the "
            "signals, wheel radii and mass of the vehicle file right?"
        ) from None


def _by_likelihood(
    one: Identifier, drives: Sequence[Drive], prior: Array, progress: Progress | None
) -> tuple[Information, Rinsed, Weigh]:
    """What the drives say of the parameters by the likelihood of their outputs, how they were estimated, and what
    weighs some of the drives with noise of their own: what distinguishes two cars would else pass for noise of both."""
    exact = Likelihood(one)
    weighed, rinsed = exact.weigh(drives, one.begin(), one.begin(), prior, progress=progress)
    together = exact.factors

    def own(some: Sequence[Drive]) -> Information:
        exact.factors = together
        return exact.weigh(some, weighed.values, one.begin(), prior)[0]

    return weighed, rinsed, own


def _by_rinsing(
    one: Identifier, drives: Sequence[Drive], prior: Array, progress: Progress | None
) -> tuple[Information, Rinsed, Weigh]:
    """What the drives say of the parameters after passes of an identifying filter over them, how they were estimated,
    and what weighs some of the drives. What is not determined does not wander from pass to pass."""
    left = information(one, drives, one.begin(), prior).left
    one.scales = prior / best.SETTINGS.prior_share * np.clip(1 - left**2, 1e-3, 1.0)
    rinsed = rinse(one, drives, Schedule(passes=IDENTIFICATION.most_passes), progress=progress)
    weighed = weigh(one, drives, rinsed.values, one.begin(), prior)

    def own(some: Sequence[Drive]) -> Information:
        return weigh(one, some, weighed.values, one.begin(), prior)

    return weighed, rinsed, own


def _undetermined(refused: Sequence[Refusal]) -> InputError:
    reasons = "; ".join(f"{refusal}; to determine it, {advice(refusal.name)}" for refusal in refused)
    return InputError(f"the drives determine none of the free parameters: {reasons}")


def _written(made: Identification) -> Vehicle:
    """The vehicle with what was determined, and how well. Raises `InputError` where that makes no car."""
    names = {*made.determined, "steering_gain", "steering_delay"}
    try:
        changed = handling_values.changes(made.vehicle, made.values, names)
    except ValueError as error:
        raise InputError(f"the parameters that were found make no car: {error}") from None
    source = "identified by " + ", ".join(drive.name for drive in made.drives)
    return handling_values.with_uncertainty(changed, made.file_deviations, source)


def _noise(vehicle: Vehicle, model: Rates, least: Sequence[float]) -> list[float]:
    """Deviations of the outputs (m,): those of the vehicle's inertial sensor, if they are larger than the least."""
    imu = next((s for s in vehicle.sensors.values() if "rates and forces" in s.measures), None)
    if imu is None:
        return list(least)
    rates, forces = imu.deviations()[:3], imu.deviations()[3:6]
    own = {
        "longitudinal_acceleration": forces[0], "lateral_acceleration": forces[1], "roll_rate": rates[0],
        "yaw_rate": rates[2],
    }  # fmt: skip
    return [max(float(own[name]), one) for name, one in zip(model.outputs, least, strict=True)]


def handling_identifier(
    vehicle: Vehicle, model: ModelName, free: Sequence[str] = (), drives: Sequence[Drive] = ()
) -> tuple[Identifier, Array]:
    """An identifier of a handling model with the parameters of a vehicle file, of which some are free, then the errors
    of its sensors; and the prior deviations of all these. The noise of the outputs is estimated from `drives` if there
    are any, else taken from the vehicle file. Raises `InputError` for a free parameter that the model does not have."""
    how = MODELS[model]
    base = how.make()
    wanted = tuple(free) or how.free
    check_free(wanted, base.parameters, model)
    whole = WithSensorErrors(base)
    start = {name: value for name, value in handling_values.of_vehicle(vehicle).items() if name in base.parameters}
    start |= {"steering_gain": 1.0, "steering_offset": 0.0, "steering_delay": 0.0}
    prior = np.array([*_prior(vehicle, start, wanted, [drive.name for drive in drives]), *_steering_prior(vehicle)])
    if how.by_likelihood and drives:
        outputs = np.maximum(np.sqrt(np.mean([np.square(drive.noise) for drive in drives], axis=0)), how.noise.outputs)
    else:
        outputs = np.array(_noise(vehicle, base, how.noise.outputs))
    errors = [*how.offsets.values(), *(WANDERING[name] for name in whole.wandering)]
    off, drift = zip(*errors, strict=True)
    disturbances = {**how.noise.disturbances, **dict(zip(whole.errors, drift, strict=True))}
    noise = Noise(outputs.tolist(), (*how.noise.start, *off), disturbances)
    one = Identifier(
        whole, start, (*wanted, *STEERING), noise, curves=_curves(start, model),
        scales=prior / best.SETTINGS.prior_share, bounds=best_4dof.BOUNDS,
    )  # fmt: skip
    return one, prior


def _prior(vehicle: Vehicle, start: Mapping[str, float], wanted: Sequence[str], drives: Sequence[str]) -> Array:
    """Prior standard deviations (p,) of the free parameters: those of the vehicle file, else those of `best.prior`.

    A deviation that comes from one of the same drives is left out, so that no drive counts twice.
    """
    independent = {
        path: known
        for path, known in vehicle.uncertainty.items()
        if not any(name in known.source for name in drives if name)
    }
    stated = handling_values.deviations(vehicle.model_copy(update={"uncertainty": independent}))
    usual = best.prior(start, wanted)
    return np.array([stated.get(name, default) for name, default in zip(wanted, usual.tolist(), strict=True)])


def _steering_prior(vehicle: Vehicle) -> tuple[float, float, float]:
    """Prior standard deviations of the gain [-], the offset [rad] and the delay [s] of the steering angle.

    A vehicle file that knows its steering ratio better than usual knows the gain as well. That holds for a ratio that
    was calibrated on the same drives, too: calibration compares geometry on the gentle part of a drive, and a gain that
    is free beside the tyres takes up what a single track lacks in tight bends, at the expense of the front stiffness.
    """
    gain, offset, delay = IDENTIFICATION.steering_prior
    known = vehicle.uncertainty.get("physics.steering.ratio")
    if known is not None:
        gain = min(gain, known.deviation / abs(vehicle.physics.steering.ratio))
    return gain, offset, delay


def check_free(wanted: Sequence[str], known: Sequence[str], model: str) -> None:
    """Raises `InputError` for a name that is no parameter of the model."""
    for name in wanted:
        if name not in known:
            near = get_close_matches(name, known, 3, 0.5) or known
            raise InputError(f"--free: the model {model} has no parameter {name!r}; nearest are {', '.join(near)}")


def check_signs(one: Signals) -> None:
    """Raises `InputError` for a signal that goes against another that it should go with."""
    moving = one.known
    turned = one.rates[:, 2] * one.speed
    slowly = np.convolve(np.gradient(one.speed, recorded.RECORDED.step), np.ones(100) / 100, "same")
    pairs = (
        ("the lateral acceleration", one.forces[:, 1], "yaw rate times speed", turned, 0.3),
        ("the steering angle", one.steering * one.speed**2, "yaw rate times speed", turned, 0.3),
        ("the steering angle", one.steering * one.speed**2, "the lateral acceleration", one.forces[:, 1], 0.3),
        ("the longitudinal acceleration", one.forces[:, 0], "the change of speed", slowly, 0.3),
    )
    for name, signal, other, with_it, least in pairs:
        good = moving & np.isfinite(signal) & np.isfinite(with_it)
        if good.sum() < 500 or np.std(with_it[good]) < least or np.std(signal[good]) == 0:
            continue
        correlation = float(np.corrcoef(signal[good], with_it[good])[0, 1])
        if correlation < IDENTIFICATION.reversed_correlation:
            raise InputError(
                f"{one.name}: {name} goes against {other} (correlation {correlation:+.2f}): one of the two has the "
                "wrong sign. Axes are ISO 8855: x forward, y left, positive steering to the left; set attitude or gain "
                "of the sensor in the vehicle file, or the sign in the mapping of the importer"
            )


def check_one_car(one: Identifier, drives: Sequence[Drive], own: Weigh) -> None:
    """Raises `InputError` for drives whose cornering stiffnesses are those of two cars."""
    if len(drives) < 2:
        return
    alone = [own([drive]) for drive in drives]
    for axle in AXLES:
        stiffness = [cornering_stiffness(found, axle, one.values) for found in alone]
        for i, (a, s) in enumerate(stiffness):
            for j, (b, t) in enumerate(stiffness[:i]):
                if abs(a - b) > max(
                    IDENTIFICATION.two_cars_deviations * float(np.hypot(s, t)),
                    IDENTIFICATION.two_cars_share * max(a, b),
                ):
                    raise InputError(
                        f"{drives[j].name} and {drives[i].name} are not of one car, or not with the same tyres: the "
                        f"cornering stiffness of a {axle} tyre is {b:.3g} ± {t:.1g} N/rad in one and {a:.3g} ± {s:.1g} "
                        "in the other; identify them one by one"
                    )


def cornering_stiffness(found: Information, axle: str, start: Mapping[str, float]) -> tuple[float, float]:
    """D C_α of an axle's tyres and its standard deviation [N/rad]."""
    known = dict(start) | dict(zip(found.names, found.values.tolist(), strict=True))
    names = (f"{axle}_stiffness", f"{axle}_peak")
    gradient = np.zeros(len(found.names))
    for name, other in (names, names[::-1]):
        if name in found.names:
            gradient[found.names.index(name)] = known[other]
    return known[names[0]] * known[names[1]], found.deviation_of(gradient)


def _products(one: Identifier, drives: Sequence[Drive], weighed: Information, own: Weigh) -> list[Product]:
    axles = [axle for axle in AXLES if {f"{axle}_stiffness", f"{axle}_peak"} & set(one.free)]
    if not axles:
        return []
    halves: list[list[Drive]] = [[], []]
    for drive in drives:
        middle = len(drive.inputs) // 2
        halves[0].append(drive.part(0, middle, drive.start))
        begun = drive.start.copy()
        if isinstance(getattr(one.model, "model", None), Best4Dof):
            begun[0] = float(np.mean(drive.inputs[middle, 1:5])) * one.values["wheel_radius"]
        halves[1].append(drive.part(middle, len(drive.inputs), begun))
    said = [own(half) for half in halves]
    made = []
    for axle in axles:
        value, deviation = cornering_stiffness(weighed, axle, one.values)
        first, second = (cornering_stiffness(half, axle, one.values) for half in said)
        before = best.SETTINGS.prior_share * 2**0.5 * value
        made.append(Product(axle, value, deviation, (first, second), deviation < 0.6 * before))
    return made


def _curves(start: Mapping[str, float], model: str) -> Any:
    """Force curves over their peaks, of the tyres that the model has."""
    full = {name: start.get(name, best_4dof.PAPER[name]) for name in Best4Dof.parameters}
    peak = best_4dof.curves(full).max(axis=1)[:, None]

    def curves(values: Mapping[str, float]) -> Array:
        found = best_4dof.curves({name: values.get(name, full[name]) for name in full}) / peak
        return found if model == "best" else found[[0, 2]]

    return curves


def fits(
    made: Identification, model: WithSensorErrors, drives: Sequence[Drive]
) -> dict[str, dict[str, tuple[float, float]]]:
    """Fit of the model alone, before and after: 1 - standard deviation of the error / that of the output, NaN where it
    cannot follow. A mean error is an offset of the sensor."""
    found: dict[str, dict[str, tuple[float, float]]] = {}
    errors = {name: value for name, value in made.values.items() if name in STEERING}
    for drive in drives:
        pair = []
        for values in (made.start | errors, made.values):
            one = OpenLoop(model, values, (STEERING[0],))
            try:
                outputs = one.outputs(drive, np.array([values[STEERING[0]]]))
                rms = (outputs - drive.outputs).std(axis=0)
                pair.append(1 - rms / np.maximum(drive.outputs.std(axis=0), 1e-9))
            except FloatingPointError:
                pair.append(np.full(len(model.outputs), np.nan))
        found[drive.name] = {
            name: (float(pair[0][i]), float(pair[1][i])) for i, name in enumerate(model.outputs)
        }  # fmt: skip
    return found


def _with_side_slip(
    made: Identification, model: WithSensorErrors, recordings: Sequence[Recording], drives: Sequence[Drive]
) -> Identification:
    """With the RMSE of the side slip of the model alone [rad], of recordings with a reference, and where that sits.

    Its place along the car and how it is turned are found by least squares on those that were fitted to: its side slip
    is that of the centre of gravity, plus the place times yaw rate over speed, less the turn.
    """
    parts = {}
    for recording, drive in zip(recordings, drives, strict=True):
        if "reference/odometry" in recording:
            parts[drive.name] = _slip_error(made, model, recording, drive)
    fitted = [parts[drive.name] for drive in made.drives if drive.name in parts]
    if not fitted:
        return made
    columns = np.concatenate([np.column_stack([turning, np.ones(len(turning))]) for _, turning in fitted])
    mounting = np.linalg.lstsq(columns, np.concatenate([error for error, _ in fitted]), rcond=None)[0]
    found = {
        name: float(np.sqrt(np.mean((error - turning * mounting[0] - mounting[1]) ** 2)))
        for name, (error, turning) in parts.items()
    }
    known = made.vehicle.reference
    place = (float(mounting[0]), *known.position[1:])
    reference = known.model_copy(update={"position": place, "yaw": -float(mounting[1])})
    return replace(made, side_slip=found, vehicle=made.vehicle.model_copy(update={"reference": reference}))


def _slip_error(
    made: Identification, model: WithSensorErrors, recording: Recording, drive: Drive
) -> tuple[Array, Array]:
    """Side slip of the reference less that of the model at the centre of gravity [rad], and yaw rate over speed [1/m],
    (N,) each, where the car drives."""
    truth, values, names = recording["reference/odometry"], made.values, model.states
    states = OpenLoop(model, values, STEERING[:1]).states(drive, np.array([values[STEERING[0]]]))
    lateral, yaw = (states[:, names.index(name)] for name in ("lateral_velocity", "yaw_rate"))
    speed = states[:, 0] if names[0] == "speed" else drive.inputs[:, 1]
    at = (truth.stamp - recording.first_stamp) * 1e-9
    true = np.interp(
        drive.begin + drive.seconds, at, np.arctan2(truth.columns["linear"][:, 1], truth.columns["linear"][:, 0])
    )
    return (true - np.arctan2(lateral, speed)), yaw / speed
