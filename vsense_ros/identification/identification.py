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
    signals = [recorded.signals(recording, vehicle) for recording in recordings]
    for measured in signals:
        check_signs(measured)
    recorded_drives = recorded.drives(signals, model)
    identifier, prior = handling_identifier(vehicle, model, free, recorded_drives)
    with_errors = identifier.model
    assert isinstance(with_errors, WithSensorErrors)
    start, free_of_car = identifier.values, tuple(name for name in identifier.free if name not in STEERING)
    drives = [with_errors.drive(drive) for drive in recorded_drives]
    weighed, rinsed, weigh_some = _estimated(identifier, drives, prior, model, part(progress, 0, 2))
    refused = tuple(r for r in refusals(weighed, best_4dof.JUDGED_BY_CURVE) if r.name in free_of_car)
    check_one_car(identifier, drives, weigh_some)
    products = tuple(_products(identifier, drives, weighed, weigh_some))
    if len(refused) == len(free_of_car) and not any(product.is_determined for product in products):
        raise _undetermined(refused)
    identification = Identification(
        model, vehicle, vehicle, start, free_of_car, weighed, rinsed, refused, products, tuple(drives), {}, {},
        tuple(r.name for r in held_out),
    )  # fmt: skip
    changed = _written(identification)
    other_drives = recorded.drives([recorded.signals(r, vehicle) for r in held_out], model)
    all_drives = [*drives, *map(with_errors.drive, other_drives)]
    verdict = judged(held_out or recordings, vehicle, changed, part(progress, 1, 2))
    final_vehicle = vehicle if verdict is not None and verdict.is_worse else changed
    identification = replace(
        identification, vehicle=final_vehicle, verdict=verdict, fits=fits(identification, with_errors, all_drives)
    )
    identification = _with_side_slip(identification, with_errors, [*recordings, *held_out], all_drives)
    if progress is not None:
        progress(1.0)
    return identification


def _estimated(
    identifier: Identifier, drives: Sequence[Drive], prior: Array, model: ModelName, progress: Progress | None
) -> tuple[Information, Rinsed, Weigh]:
    """What the drives say of the parameters, by the method of the model; results as of `_by_likelihood`.

    Raises `InputError` where the model cannot follow the drives.
    """
    method = _by_likelihood if MODELS[model].by_likelihood else _by_rinsing
    try:
        return method(identifier, drives, prior, progress)
    except FloatingPointError as error:
        raise InputError(
            f"the model {model} cannot follow {', '.join(d.name for d in drives)}: {error}. Are units and signs of the "
            "signals, wheel radii and mass of the vehicle file right?"
        ) from None


def _by_likelihood(
    identifier: Identifier, drives: Sequence[Drive], prior: Array, progress: Progress | None
) -> tuple[Information, Rinsed, Weigh]:
    """What the drives say of the parameters by the likelihood of their outputs, how they were estimated, and what
    weighs some of the drives with noise of their own: what distinguishes two cars would else pass for noise of both."""
    likelihood = Likelihood(identifier)
    weighed, rinsed = likelihood.weigh(drives, identifier.begin(), identifier.begin(), prior, progress=progress)
    joint_factors = likelihood.factors

    def weigh_some(selected: Sequence[Drive]) -> Information:
        likelihood.factors = joint_factors
        return likelihood.weigh(selected, weighed.values, identifier.begin(), prior)[0]

    return weighed, rinsed, weigh_some


def _by_rinsing(
    identifier: Identifier, drives: Sequence[Drive], prior: Array, progress: Progress | None
) -> tuple[Information, Rinsed, Weigh]:
    """What the drives say of the parameters after passes of an identifying filter over them, how they were estimated,
    and what weighs some of the drives. What is not determined does not wander from pass to pass."""
    remaining = information(identifier, drives, identifier.begin(), prior).remaining_share
    identifier.scales = prior / best.SETTINGS.prior_share * np.clip(1 - remaining**2, 1e-3, 1.0)
    rinsed = rinse(identifier, drives, Schedule(passes=IDENTIFICATION.most_passes), progress=progress)
    weighed = weigh(identifier, drives, rinsed.values, identifier.begin(), prior)

    def weigh_some(selected: Sequence[Drive]) -> Information:
        return weigh(identifier, selected, weighed.values, identifier.begin(), prior)

    return weighed, rinsed, weigh_some


def _undetermined(refused: Sequence[Refusal]) -> InputError:
    reasons = "; ".join(f"{refusal}; to determine it, {advice(refusal.name)}" for refusal in refused)
    return InputError(f"the drives determine none of the free parameters: {reasons}")


def _written(identification: Identification) -> Vehicle:
    """The vehicle with what was determined, and how well. Raises `InputError` where that makes no car."""
    names = {*identification.determined, "steering_gain", "steering_delay"}
    try:
        changed = handling_values.changes(identification.vehicle, identification.values, names)
    except ValueError as error:
        raise InputError(f"the parameters that were found make no car: {error}") from None
    source = "identified by " + ", ".join(drive.name for drive in identification.drives)
    return handling_values.with_uncertainty(changed, identification.file_deviations, source)


def _noise(vehicle: Vehicle, model: Rates, least: Sequence[float]) -> list[float]:
    """Deviations of the outputs (m,): those of the vehicle's inertial sensor, if they are larger than the least."""
    imu = next((s for s in vehicle.sensors.values() if "rates and forces" in s.measures), None)
    if imu is None:
        return list(least)
    rates, forces = imu.deviations()[:3], imu.deviations()[3:6]
    sensor_noise = {
        "longitudinal_acceleration": forces[0], "lateral_acceleration": forces[1], "roll_rate": rates[0],
        "yaw_rate": rates[2],
    }  # fmt: skip
    return [max(float(sensor_noise[name]), least_noise) for name, least_noise in zip(model.outputs, least, strict=True)]


def handling_identifier(
    vehicle: Vehicle, model: ModelName, free: Sequence[str] = (), drives: Sequence[Drive] = ()
) -> tuple[Identifier, Array]:
    """An identifier of a handling model with the parameters of a vehicle file, of which some are free, then the errors
    of its sensors; and the prior deviations of all these. The noise of the outputs is estimated from `drives` if there
    are any, else taken from the vehicle file. Raises `InputError` for a free parameter that the model does not have."""
    settings = MODELS[model]
    base = settings.make()
    free_names = tuple(free) or settings.free
    check_free(free_names, base.parameters, model)
    with_errors = WithSensorErrors(base)
    start = {name: value for name, value in handling_values.of_vehicle(vehicle).items() if name in base.parameters}
    start |= {"steering_gain": 1.0, "steering_offset": 0.0, "steering_delay": 0.0}
    prior = np.array([*_prior(vehicle, start, free_names, [drive.name for drive in drives]), *_steering_prior(vehicle)])
    if settings.by_likelihood and drives:
        outputs = np.maximum(
            np.sqrt(np.mean([np.square(drive.noise) for drive in drives], axis=0)), settings.noise.outputs
        )
    else:
        outputs = np.array(_noise(vehicle, base, settings.noise.outputs))
    errors = [*settings.offsets.values(), *(WANDERING[name] for name in with_errors.wandering)]
    offsets, drift = zip(*errors, strict=True)
    disturbances = {**settings.noise.disturbances, **dict(zip(with_errors.errors, drift, strict=True))}
    noise = Noise(outputs.tolist(), (*settings.noise.start, *offsets), disturbances)
    identifier = Identifier(
        with_errors, start, (*free_names, *STEERING), noise, curves=_curves(start, model),
        scales=prior / best.SETTINGS.prior_share, bounds=best_4dof.BOUNDS,
    )  # fmt: skip
    return identifier, prior


def _prior(vehicle: Vehicle, start: Mapping[str, float], free_names: Sequence[str], drives: Sequence[str]) -> Array:
    """Prior standard deviations (p,) of the free parameters: those of the vehicle file, else those of `best.prior`.

    A deviation that comes from one of the same drives is left out, so that no drive counts twice.
    """
    independent = {
        path: deviation
        for path, deviation in vehicle.uncertainty.items()
        if not any(name in deviation.source for name in drives if name)
    }
    stated = handling_values.deviations(vehicle.model_copy(update={"uncertainty": independent}))
    usual = best.prior(start, free_names)
    return np.array([stated.get(name, default) for name, default in zip(free_names, usual.tolist(), strict=True)])


def _steering_prior(vehicle: Vehicle) -> tuple[float, float, float]:
    """Prior standard deviations of the gain [-], the offset [rad] and the delay [s] of the steering angle.

    A vehicle file that knows its steering ratio better than usual knows the gain as well. That holds for a ratio that
    was calibrated on the same drives, too: calibration compares geometry on the gentle part of a drive, and a gain that
    is free beside the tyres takes up what a single track lacks in tight bends, at the expense of the front stiffness.
    """
    gain, offset, delay = IDENTIFICATION.steering_prior
    stated = vehicle.uncertainty.get("physics.steering.ratio")
    if stated is not None:
        gain = min(gain, stated.deviation / abs(vehicle.physics.steering.ratio))
    return gain, offset, delay


def check_free(names: Sequence[str], parameters: Sequence[str], model: str) -> None:
    """Raises `InputError` for a name that is no parameter of the model."""
    for name in names:
        if name not in parameters:
            nearest_names = get_close_matches(name, parameters, 3, 0.5) or parameters
            raise InputError(
                f"--free: the model {model} has no parameter {name!r}; nearest are {', '.join(nearest_names)}"
            )


def check_signs(signals: Signals) -> None:
    """Raises `InputError` for a signal that goes against another that it should go with."""
    driving = signals.known
    centripetal = signals.rates[:, 2] * signals.speed
    speed_change = np.convolve(np.gradient(signals.speed, recorded.RECORDED.step), np.ones(100) / 100, "same")
    pairs = (
        ("the lateral acceleration", signals.forces[:, 1], "yaw rate times speed", centripetal, 0.3),
        ("the steering angle", signals.steering * signals.speed**2, "yaw rate times speed", centripetal, 0.3),
        (
            "the steering angle",
            signals.steering * signals.speed**2,
            "the lateral acceleration",
            signals.forces[:, 1],
            0.3,
        ),
        ("the longitudinal acceleration", signals.forces[:, 0], "the change of speed", speed_change, 0.3),
    )
    for name, signal, reference_name, reference, least in pairs:
        good = driving & np.isfinite(signal) & np.isfinite(reference)
        if good.sum() < 500 or np.std(reference[good]) < least or np.std(signal[good]) == 0:
            continue
        correlation = float(np.corrcoef(signal[good], reference[good])[0, 1])
        if correlation < IDENTIFICATION.reversed_correlation:
            raise InputError(
                f"{signals.name}: {name} goes against {reference_name} (correlation {correlation:+.2f}): one of the "
                "two has the wrong sign. Axes are ISO 8855: x forward, y left, positive steering to the left; set "
                "attitude or gain "
                "of the sensor in the vehicle file, or the sign in the mapping of the importer"
            )


def check_one_car(identifier: Identifier, drives: Sequence[Drive], weigh_some: Weigh) -> None:
    """Raises `InputError` for drives whose cornering stiffnesses are those of two cars."""
    if len(drives) < 2:
        return
    by_drive = [weigh_some([drive]) for drive in drives]
    for axle in AXLES:
        stiffness = [cornering_stiffness(weighed, axle, identifier.values) for weighed in by_drive]
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


def cornering_stiffness(weighed: Information, axle: str, start: Mapping[str, float]) -> tuple[float, float]:
    """D C_α of an axle's tyres and its standard deviation [N/rad]."""
    values = dict(start) | dict(zip(weighed.names, weighed.values.tolist(), strict=True))
    names = (f"{axle}_stiffness", f"{axle}_peak")
    gradient = np.zeros(len(weighed.names))
    for name, factor in (names, names[::-1]):
        if name in weighed.names:
            gradient[weighed.names.index(name)] = values[factor]
    return values[names[0]] * values[names[1]], weighed.deviation_of(gradient)


def _products(
    identifier: Identifier, drives: Sequence[Drive], weighed: Information, weigh_some: Weigh
) -> list[Product]:
    axles = [axle for axle in AXLES if {f"{axle}_stiffness", f"{axle}_peak"} & set(identifier.free)]
    if not axles:
        return []
    halves: list[list[Drive]] = [[], []]
    for drive in drives:
        middle = len(drive.inputs) // 2
        halves[0].append(drive.part(0, middle, drive.start))
        start = drive.start.copy()
        if isinstance(getattr(identifier.model, "model", None), Best4Dof):
            start[0] = float(np.mean(drive.inputs[middle, 1:5])) * identifier.values["wheel_radius"]
        halves[1].append(drive.part(middle, len(drive.inputs), start))
    of_halves = [weigh_some(half) for half in halves]
    products = []
    for axle in axles:
        value, deviation = cornering_stiffness(weighed, axle, identifier.values)
        first, second = (cornering_stiffness(half, axle, identifier.values) for half in of_halves)
        before = best.SETTINGS.prior_share * 2**0.5 * value
        products.append(Product(axle, value, deviation, (first, second), deviation < 0.6 * before))
    return products


def _curves(start: Mapping[str, float], model: str) -> Any:
    """Force curves over their peaks, of the tyres that the model has."""
    full = {name: start.get(name, best_4dof.PAPER[name]) for name in Best4Dof.parameters}
    peak = best_4dof.curves(full).max(axis=1)[:, None]

    def curves(values: Mapping[str, float]) -> Array:
        scaled_curves = best_4dof.curves({name: values.get(name, full[name]) for name in full}) / peak
        return scaled_curves if model == "best" else scaled_curves[[0, 2]]

    return curves


def fits(
    identification: Identification, model: WithSensorErrors, drives: Sequence[Drive]
) -> dict[str, dict[str, tuple[float, float]]]:
    """Fit of the model alone, before and after: 1 - standard deviation of the error / that of the output, NaN where it
    cannot follow. A mean error is an offset of the sensor."""
    fits_by_drive: dict[str, dict[str, tuple[float, float]]] = {}
    errors = {name: value for name, value in identification.values.items() if name in STEERING}
    for drive in drives:
        pair = []
        for values in (identification.start | errors, identification.values):
            open_loop = OpenLoop(model, values, (STEERING[0],))
            try:
                outputs = open_loop.outputs(drive, np.array([values[STEERING[0]]]))
                rms = (outputs - drive.outputs).std(axis=0)
                pair.append(1 - rms / np.maximum(drive.outputs.std(axis=0), 1e-9))
            except FloatingPointError:
                pair.append(np.full(len(model.outputs), np.nan))
        fits_by_drive[drive.name] = {
            name: (float(pair[0][i]), float(pair[1][i])) for i, name in enumerate(model.outputs)
        }  # fmt: skip
    return fits_by_drive


def _with_side_slip(
    identification: Identification, model: WithSensorErrors, recordings: Sequence[Recording], drives: Sequence[Drive]
) -> Identification:
    """With the RMSE of the side slip of the model alone [rad], of recordings with a reference, and where that sits.

    Its place along the car and how it is turned are found by least squares on those that were fitted to: its side slip
    is that of the centre of gravity, plus the place times yaw rate over speed, less the turn.
    """
    parts = {}
    for recording, drive in zip(recordings, drives, strict=True):
        if "reference/odometry" in recording:
            parts[drive.name] = _slip_error(identification, model, recording, drive)
    fitted = [parts[drive.name] for drive in identification.drives if drive.name in parts]
    if not fitted:
        return identification
    columns = np.concatenate([np.column_stack([turning, np.ones(len(turning))]) for _, turning in fitted])
    mounting = np.linalg.lstsq(columns, np.concatenate([error for error, _ in fitted]), rcond=None)[0]
    errors_by_drive = {
        name: float(np.sqrt(np.mean((error - turning * mounting[0] - mounting[1]) ** 2)))
        for name, (error, turning) in parts.items()
    }
    reference_mounting = identification.vehicle.reference
    place = (float(mounting[0]), *reference_mounting.position[1:])
    reference = reference_mounting.model_copy(update={"position": place, "yaw": -float(mounting[1])})
    return replace(
        identification,
        side_slip=errors_by_drive,
        vehicle=identification.vehicle.model_copy(update={"reference": reference}),
    )


def _slip_error(
    identification: Identification, model: WithSensorErrors, recording: Recording, drive: Drive
) -> tuple[Array, Array]:
    """Side slip of the reference less that of the model at the centre of gravity [rad], and yaw rate over speed [1/m],
    (N,) each, where the car drives."""
    truth, values, names = recording["reference/odometry"], identification.values, model.states
    states = OpenLoop(model, values, STEERING[:1]).states(drive, np.array([values[STEERING[0]]]))
    lateral, yaw = (states[:, names.index(name)] for name in ("lateral_velocity", "yaw_rate"))
    speed = states[:, 0] if names[0] == "speed" else drive.inputs[:, 1]
    reference_times = (truth.stamp - recording.first_stamp) * 1e-9
    true = np.interp(
        drive.begin + drive.seconds,
        reference_times,
        np.arctan2(truth.columns["linear"][:, 1], truth.columns["linear"][:, 0]),
    )
    return (true - np.arctan2(lateral, speed)), yaw / speed
