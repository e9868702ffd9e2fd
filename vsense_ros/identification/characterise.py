"""What kind of car this is: rolling radii, stiffnesses, understeer and roll gradient, steering ratio, its response.

The parameter tests of Leung 2010 (section 3.6.1) and the usual ones of ISO 4138 and ISO 7401, as regressions. A car of
a vehicle file drives them on the full model; recordings are taken as they come. Standard deviations are by the
jackknife over stretches of a drive, so that slow errors count as what they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from vsense_ros.errors import InputError
from vsense_ros.identification.drive_signals import DRIVE_SIGNALS, DriveSignals, of_trajectory, reading_over_angle
from vsense_ros.manoeuvre import MANOEUVRES
from vsense_ros.manoeuvre.driver import SpeedKeeper, understeer_gradient
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import FORCE_X, FORCE_Y, WHEEL_OUTPUTS
from vsense_ros.model.handling.base import slopes, static_loads
from vsense_ros.model.simulation.closed_loop import Driver, rolling_radii, rolling_straight, simulate
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class CharacteriseSettings:
    """Bounds of the driving from which characteristics are read: decisions of this project unless a source is named."""

    block: float = 3.0  # [s] of the stretches that the jackknife leaves out
    straight_yaw_rate: float = np.radians(1.0)  # [rad/s] yaw rate below which a drive is straight
    least_speed: float = 3.0  # [m/s] below which nothing is evaluated
    linear_acceleration: float = 4.0  # [m/s²] lateral acceleration up to which a car is linear, about
    steady_jerk: float = 1.0  # [m/s³] change of the lateral acceleration up to which a turn is a steady one, about
    linear_slip: float = 0.02  # [-] longitudinal slip up to which a tyre is linear
    linear_slip_angle: float = np.radians(2.0)  # [rad] slip angle up to which a tyre is linear
    quasi_static_frequency: float = 0.5  # [Hz] below which a car follows its steering as in a steady turn
    least_explained: float = 0.5  # [-] share of the variance of the roll angle that a reported roll gradient explains
    least_coherence: float = 0.8  # [-] coherence of a frequency whose response is reported
    segment: float = 8.0  # [s] of the frequency response's windows, in which its slowest oscillation goes twice
    # [-] share of its value: a stiffness with a larger standard deviation is not reported
    largest_deviation: float = 0.2
    slow_speed: float = 15 / 3.6  # [m/s] at which Rodríguez 2020 measures radii, the slow one
    fast_speed: float = 50 / 3.6  # [m/s] and the fast one


CHARACTERISE = CharacteriseSettings()

_SLIP, _ANGLE = WHEEL_OUTPUTS.index("slip"), WHEEL_OUTPUTS.index("slip_angle")
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Quantity:
    """A number of the car with its standard deviation; `value` None: `note` says why it is not known."""

    name: str
    unit: str
    value: float | None = None
    deviation: float | None = None
    note: str = ""
    file: float | None = None  # what the vehicle file says


@dataclass(frozen=True)
class Scatter:
    """Points and the line through them, for a picture."""

    x: Array
    y: Array
    slope: float


@dataclass(frozen=True)
class FrequencyResponse:
    """Yaw rate over road-wheel angle, (f,) each."""

    speed: float  # [m/s], the mean
    frequency: Array  # [Hz]
    gain: Array  # [1/s]
    phase: Array  # [rad]
    coherence: Array


@dataclass
class Characteristics:
    """Quantities, scatter plots and frequency responses that the drives of a car determine."""

    title: str
    quantities: list[Quantity] = field(default_factory=list)
    scatters: dict[str, Scatter] = field(default_factory=dict)
    responses: list[FrequencyResponse] = field(default_factory=list)


def characterise(title: str, drives: Sequence[DriveSignals], vehicle: Vehicle | None) -> Characteristics:
    """Characteristics of a car from drives, which may be of different kinds; without a vehicle file there is no
    wheelbase, and fewer characteristics can be determined.

    Raises `InputError` where their steering was not read at the same place.
    """
    if len({drive.at_steering_wheel for drive in drives}) > 1:
        raise InputError(
            "some of the recordings have the angle of the steering wheel, others that of the road wheels; characterise "
            "them one kind at a time"
        )
    characteristics = Characteristics(title)
    _radii(characteristics, drives, vehicle)
    ratio = _steering(characteristics, drives, vehicle)
    _roll(characteristics, drives)
    _wheel_stiffness(characteristics, drives, vehicle)
    _axle_stiffness(characteristics, drives, vehicle, ratio)
    _frequency_response(characteristics, drives, ratio)
    return characteristics


def drive_tests(vehicle: Vehicle, progress: Progress = lambda share: None) -> list[DriveSignals]:
    """The tests of a car, on the full model without sensor errors: straight at 15 and 50 km/h, a slow drive that winds,
    speeds up and brakes, a slow ramp of the steering, and a sweep of it.

    Raises `InputError` where the motion leaves the model's range.
    """
    plans: list[tuple[str, float, float, Driver]] = [
        ("straight at 15 km/h", CHARACTERISE.slow_speed, 16.0, _held(vehicle, CHARACTERISE.slow_speed)),
        ("straight at 50 km/h", CHARACTERISE.fast_speed, 16.0, _held(vehicle, CHARACTERISE.fast_speed)),
        ("winding at 15 km/h", CHARACTERISE.slow_speed, 30.0, _winding(vehicle)),
    ]
    for name in ("slow_ramp_steer", "steering_sweep"):
        manoeuvre = MANOEUVRES[name]
        plans.append((manoeuvre.title.lower(), manoeuvre.speed, manoeuvre.duration, manoeuvre.driver(vehicle)))
    drives = []
    for i, (name, speed, duration, driver) in enumerate(plans):
        q, u = rolling_straight(vehicle, speed)
        try:
            drive = simulate(vehicle, driver, duration, keep_every=round(DRIVE_SIGNALS.step * 1e3), q=q, u=u)
        except FloatingPointError as error:
            raise InputError(f"{error} ({name}); is there a value in the vehicle file that no car has?") from None
        drives.append(of_trajectory(name, drive, vehicle))
        progress((i + 1) / len(plans))
    return drives


def _held(vehicle: Vehicle, speed: float) -> Driver:
    feet = SpeedKeeper(vehicle, lambda t: speed)
    return lambda t, q, u: np.array([0.0, *feet(t, u)])


def _winding(vehicle: Vehicle) -> Driver:
    feet = SpeedKeeper(vehicle, lambda t: CHARACTERISE.slow_speed + 1.0 * float(np.sin(0.7 * t)))
    return lambda t, q, u: np.array([0.06 * np.sin(1.1 * t), *feet(t, u)])


def regression(parts: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Least squares y = X c over parts, each X (n, k) and y (n,): coefficients (k,), and their standard deviations (k,)
    by the jackknife over stretches of `CHARACTERISE.block`; infinite where there are fewer than four, or X leaves
    something open."""
    length = round(CHARACTERISE.block / DRIVE_SIGNALS.step)
    blocks = []
    for x, y in parts:
        for begin in range(0, len(y), length):
            rows = slice(begin, begin + length)
            blocks.append((x[rows].T @ x[rows], x[rows].T @ y[rows]))
    unknowns = parts[0][0].shape[1] if parts else 0
    if not blocks:
        return np.full(unknowns, np.nan), np.full(unknowns, np.inf)
    squares, products = (np.array(matrices) for matrices in zip(*blocks, strict=True))
    normal_matrix, product = squares.sum(axis=0), products.sum(axis=0)
    scale = np.sqrt(np.maximum(np.diag(normal_matrix), 1e-300))
    if np.linalg.cond(normal_matrix / np.outer(scale, scale)) > 1e8:
        return np.full(unknowns, np.nan), np.full(unknowns, np.inf)
    best = np.linalg.solve(normal_matrix, product)
    count = len(blocks)
    if count < 4:
        return best, np.full(unknowns, np.inf)
    without = np.array([np.linalg.lstsq(normal_matrix - a, product - b, rcond=None)[0] for a, b in blocks])
    return best, np.sqrt((count - 1) / count * np.sum((without - without.mean(axis=0)) ** 2, axis=0))


def _slow(value: Array) -> Array:
    """Without what is faster than `CHARACTERISE.quasi_static_frequency`."""
    sections = signal.butter(2, CHARACTERISE.quasi_static_frequency, fs=1 / DRIVE_SIGNALS.step, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, value, axis=0))


def _settled(drive: DriveSignals) -> NDArray[np.bool_]:
    """Where a drive is fast enough and known, away from its ends and gaps."""
    reach = round(1 / DRIVE_SIGNALS.step)
    unknown = np.convolve(~drive.valid, np.ones(2 * reach + 1), mode="same") > 0
    good = ~unknown & (drive.speed > CHARACTERISE.least_speed)
    good[:reach] = good[-reach:] = False
    return good


def _steady(drive: DriveSignals) -> NDArray[np.bool_]:
    """Flags (n,) of the rows in which the lateral acceleration is small and changes slowly."""
    lateral = _slow(drive.speed * drive.yaw_rate)
    return (np.abs(lateral) < CHARACTERISE.linear_acceleration) & (
        np.abs(np.gradient(lateral, DRIVE_SIGNALS.step)) < CHARACTERISE.steady_jerk
    )


def _quantity(
    name: str, unit: str, value: float, deviation: float, why: str, file: float | None = None, note: str = ""
) -> Quantity:
    if not np.isfinite(value):
        return Quantity(name, unit, note=why, file=file)
    if "stiffness" in name and np.isfinite(deviation) and deviation > CHARACTERISE.largest_deviation * abs(value):
        return Quantity(name, unit, note=f"{why}: {value:.3g} ± {deviation:.2g} {unit}", file=file)
    note = note if np.isfinite(deviation) else "too short to say how well this is known"
    return Quantity(name, unit, value, deviation if np.isfinite(deviation) else None, note, file)


def by_file(vehicle: Vehicle, axle: str) -> tuple[float, float]:
    """Slip stiffness [N] and cornering stiffness [N/rad] of a tyre of the "front" or "rear" axle, at zero slip."""
    index = ("front", "rear").index(axle)
    return slopes((vehicle.physics.front, vehicle.physics.rear)[index], static_loads(vehicle)[index])


def _radii(characteristics: Characteristics, drives: Sequence[DriveSignals], vehicle: Vehicle | None) -> None:
    """V / ω on the straight, of each axle; at each speed for tests at several."""
    parts: dict[str, list[tuple[Array, Array]]] = {}
    for drive in drives:
        if drive.spin is None:
            continue
        changing = np.abs(np.gradient(_slow(drive.speed), DRIVE_SIGNALS.step)) > 0.3
        rows = _settled(drive) & (np.abs(drive.yaw_rate) < CHARACTERISE.straight_yaw_rate) & ~changing
        if rows.sum() * DRIVE_SIGNALS.step < 2.0:
            continue
        test_name = f" ({drive.name})" if drive.name.startswith("straight") else ""
        if vehicle is not None and drive.wheels is not None and not test_name:
            continue
        for axle, pair in (("front", slice(0, 2)), ("rear", slice(2, 4))):
            spin = drive.spin[rows][:, pair].mean(axis=1, keepdims=True)
            parts.setdefault(f"rolling radius, {axle}{test_name}", []).append((spin, drive.speed[rows]))
    if not parts:
        why = "no wheel speeds" if all(d.spin is None for d in drives) else "no straight at a constant speed"
        characteristics.quantities.append(Quantity("rolling radius", "m", note=why))
    for name, pieces in parts.items():
        value, deviation = regression(pieces)
        file = None if vehicle is None else float(rolling_radii(vehicle)[0 if "front" in name else 2])
        characteristics.quantities.append(
            _quantity(name, "m", float(value[0]), float(deviation[0]), "no straight", file)
        )


def _steering(
    characteristics: Characteristics, drives: Sequence[DriveSignals], vehicle: Vehicle | None
) -> float | None:
    """δ = offset + i (L r / V + K V r): steering ratio i, understeer gradient K, offset; returns what to divide the
    reading by. Where only one speed was driven, i and K cannot be separated and the file's ratio is taken."""
    if vehicle is None:
        why = "needs a wheelbase: give --vehicle"
        for name, unit in (("steering ratio", "-"), ("understeer gradient", "deg/g"), ("steering offset", "deg")):
            characteristics.quantities.append(Quantity(name, unit, note=why))
        return None
    chassis = vehicle.physics.chassis
    wheelbase = chassis.cog_to_front_axle + chassis.cog_to_rear_axle
    at_wheel = drives[0].at_steering_wheel
    from_file = reading_over_angle(vehicle, at_steering_wheel=at_wheel)
    parts, speeds = [], []
    for drive in drives:
        lateral = drive.speed * drive.yaw_rate
        rows = _settled(drive) & _steady(drive)
        curvature = _slow(drive.yaw_rate / np.maximum(drive.speed, CHARACTERISE.least_speed))
        x = np.column_stack([wheelbase * curvature, _slow(lateral), np.ones(len(drive))])
        parts.append((x[rows], _slow(drive.steering)[rows]))
        turning = rows & (np.abs(lateral) > 0.3)
        speeds.append(drive.speed[turning])
    driven = np.concatenate(speeds)
    place_of_steering = "at the steering wheel" if at_wheel else "of the reading"
    if len(driven) * DRIVE_SIGNALS.step < 3.0:
        for name, unit in (("steering ratio", "-"), ("understeer gradient", "deg/g")):
            characteristics.quantities.append(Quantity(name, unit, note="no bends"))
        return from_file
    one_speed = np.std(driven) < 0.1 * np.mean(driven)
    if one_speed:
        ratio, ratio_deviation = from_file, np.inf
        pieces = [(x[:, 1:], y - ratio * x[:, 0]) for x, y in parts]
        coefficients, deviations = regression(pieces)
        characteristics.quantities.append(
            Quantity("steering ratio", "-", note="one speed only: the file's is taken", file=ratio)
        )
    else:
        all_coefficients, all_deviations = regression(parts)
        ratio, ratio_deviation = float(all_coefficients[0]), float(all_deviations[0])
        coefficients, deviations = all_coefficients[1:], all_deviations[1:]
        characteristics.quantities.append(
            _quantity("steering ratio", "-", ratio, ratio_deviation, "not separable", from_file)
        )
        if not ratio > 0:
            ratio = from_file
    in_degrees = np.degrees(GRAVITY) / ratio
    quantity = _quantity(
        "understeer gradient", "deg/g", float(coefficients[0]) * in_degrees, float(deviations[0]) * in_degrees,
        "not separable from the ratio", np.degrees(GRAVITY) * understeer_gradient(vehicle),
        "file: of linear tyres under static loads",
    )  # fmt: skip
    characteristics.quantities.append(quantity)
    offset, deviation = (float(np.degrees(value[1])) for value in (coefficients, deviations))
    characteristics.quantities.append(
        _quantity(f"steering offset, {place_of_steering}", "deg", offset, deviation, "not separable")
    )
    x, y = (np.concatenate([part[i] for part in parts]) for i in range(2))
    excess_angle = (y - coefficients[1]) / ratio - x[:, 0]
    characteristics.scatters["understeer"] = Scatter(
        x[:, 1], np.degrees(excess_angle), float(np.degrees(coefficients[0]) / ratio)
    )
    return ratio


def _roll(characteristics: Characteristics, drives: Sequence[DriveSignals]) -> None:
    """Roll over lateral acceleration, of the body; without a roll angle by what the accelerometer feels beyond V r."""
    parts, by_accelerometer = [], False
    for drive in drives:
        lateral = _slow(drive.speed * drive.yaw_rate)
        rows = _settled(drive) & _steady(drive)
        if drive.roll is not None:
            roll = _slow(drive.roll)
        elif drive.lateral_force is not None:
            # The accelerometer measures a_y + g φ; with side slip known its derivative is taken off too.
            sliding = np.zeros(len(drive))
            if drive.side_slip is not None:
                sliding = np.gradient(_slow(drive.speed * np.tan(drive.side_slip)), DRIVE_SIGNALS.step)
            roll, by_accelerometer = (_slow(drive.lateral_force) - lateral - sliding) / GRAVITY, True
        else:
            continue
        parts.append((np.column_stack([lateral, np.ones(len(lateral))])[rows], roll[rows]))
    if not parts or sum(np.sum(np.abs(x[:, 0]) > 0.3) for x, _ in parts) * DRIVE_SIGNALS.step < 3.0:
        characteristics.quantities.append(
            Quantity("roll gradient", "deg/g", note="no bends, or neither roll nor accelerometer")
        )
        return
    value, deviation = regression(parts)
    x, y = (np.concatenate([part[i] for part in parts]) for i in range(2))
    characteristics.scatters["roll"] = Scatter(x[:, 0], np.degrees(y - value[1]), float(np.degrees(value[0])))
    explained = 1 - np.var(y - x @ value) / np.var(y)
    if explained < CHARACTERISE.least_explained:
        why = (
            f"lateral acceleration explains {100 * explained:.0f} % of it only: the road is banked, or a sensor drifts"
        )
        characteristics.quantities.append(Quantity("roll gradient", "deg/g", note=why))
        return
    scale = np.degrees(GRAVITY)
    quantity = _quantity("roll gradient", "deg/g", float(value[0]) * scale, float(deviation[0]) * scale, "no bends")
    if by_accelerometer:
        note = "by the accelerometer: its scale and the bank of the road count as roll"
        quantity = Quantity(quantity.name, quantity.unit, quantity.value, quantity.deviation, note)
    characteristics.quantities.append(quantity)


def _wheel_stiffness(characteristics: Characteristics, drives: Sequence[DriveSignals], vehicle: Vehicle | None) -> None:
    """Slopes of tyre force over slip, mean of an axle's tyres, where forces are known (Leung 2010, eqs. 3.28, 3.29)."""
    winding_drives = [drive for drive in drives if drive.wheels is not None and drive.name.startswith("winding")]
    if not winding_drives:
        return
    for axle, pair in (("front", slice(0, 2)), ("rear", slice(2, 4))):
        for stiffness_name, slip, force, limit, sign, unit in (
            ("slip stiffness", _SLIP, FORCE_X, CHARACTERISE.linear_slip, 1.0, "N"),
            ("cornering stiffness", _ANGLE, FORCE_Y, CHARACTERISE.linear_slip_angle, -1.0, "N/rad"),
        ):
            parts = []
            for drive in winding_drives:
                rows = _settled(drive)
                x, y = (drive.wheels[rows, k][:, pair].mean(axis=1) for k in (slip, force))  # type: ignore[index]
                small = np.abs(x) < limit
                parts.append((np.column_stack([sign * x, np.ones(len(x))])[small], y[small]))
            value, deviation = regression(parts)
            name = f"{stiffness_name} of a tyre, {axle}"
            file = by_file(vehicle, axle)[0 if unit == "N" else 1] if vehicle is not None else None
            characteristics.quantities.append(
                _quantity(name, unit, float(value[0]), float(deviation[0]), "too little slip", file)
            )
            x, y = parts[0]
            characteristics.scatters[f"{stiffness_name} {axle}"] = Scatter(x[:, 0], y - value[1], float(value[0]))


def _axle_stiffness(
    characteristics: Characteristics, drives: Sequence[DriveSignals], vehicle: Vehicle | None, ratio: float | None
) -> None:
    """Slopes of axle force over slip angle, of both tyres together, from motion: needs mass and side slip."""
    slip_drives = [d for d in drives if d.side_slip is not None and not d.name.startswith("winding")]
    if vehicle is None or not slip_drives or ratio is None:
        why = "needs a side slip" if vehicle is not None else "needs mass and geometry: give --vehicle"
        for axle in ("front", "rear"):
            characteristics.quantities.append(Quantity(f"cornering stiffness of the axle, {axle}", "N/rad", note=why))
        return
    chassis = vehicle.physics.chassis
    a, b = chassis.cog_to_front_axle, chassis.cog_to_rear_axle
    parts: dict[str, list[tuple[Array, Array]]] = {"front": [], "rear": []}
    for drive in slip_drives:
        speed, rate, slip = (_slow(v) for v in (drive.speed, drive.yaw_rate, drive.side_slip))  # type: ignore[arg-type]
        lateral = speed * rate + np.gradient(speed * slip, DRIVE_SIGNALS.step)
        turning = chassis.yaw_inertia * np.gradient(rate, DRIVE_SIGNALS.step)
        front = (chassis.mass * b * lateral + turning) / (a + b)
        forces = {"front": front, "rear": chassis.mass * lateral - front}
        at_least = np.maximum(speed, CHARACTERISE.least_speed)
        angles = {
            "front": slip + a * rate / at_least - _slow(drive.steering) / ratio,
            "rear": slip - b * rate / at_least,
        }
        rows = _settled(drive) & (np.abs(lateral) < CHARACTERISE.linear_acceleration)
        for axle, angle in angles.items():
            small = rows & (np.abs(angle) < CHARACTERISE.linear_slip_angle)
            x = np.column_stack([-angle, np.ones(len(angle))])
            parts[axle].append((x[small], forces[axle][small]))
    for axle, pieces in parts.items():
        value, deviation = regression(pieces)
        name, file = f"cornering stiffness of the axle, {axle}", 2 * by_file(vehicle, axle)[1]
        characteristics.quantities.append(
            _quantity(name, "N/rad", float(value[0]), float(deviation[0]), "too little slip", file)
        )
        x, y = (np.concatenate([piece[i] for piece in pieces]) for i in range(2))
        characteristics.scatters[f"axle {axle}"] = Scatter(np.degrees(x[:, 0]), (y - value[1]) / 1e3, float(value[0]))


def _frequency_response(characteristics: Characteristics, drives: Sequence[DriveSignals], ratio: float | None) -> None:
    """Yaw rate over road-wheel angle by cross spectra (Welch), each drive by itself, where they are coherent."""
    for drive in drives:
        rows = np.flatnonzero(_settled(drive))
        if (
            len(rows) < 2 * CHARACTERISE.segment / DRIVE_SIGNALS.step
            or (np.diff(rows) > 1).sum() > 50
            or _is_narrow(drive)
        ):
            continue
        first, last = _longest_run(rows)
        angle, rate = drive.steering[first:last] / (ratio or 1.0), drive.yaw_rate[first:last]
        if last - first < 2 * CHARACTERISE.segment / DRIVE_SIGNALS.step or np.ptp(angle) < 1e-3:
            continue
        options = {
            "fs": 1 / DRIVE_SIGNALS.step,
            "nperseg": round(CHARACTERISE.segment / DRIVE_SIGNALS.step),
            "detrend": "linear",
        }
        frequency, cross = signal.csd(angle, rate, **options)
        _, power = signal.welch(angle, **options)
        _, coherence = signal.coherence(angle, rate, **options)
        good = (frequency >= 2 / CHARACTERISE.segment) & (frequency < 5.0) & (coherence > CHARACTERISE.least_coherence)
        if good.sum() < 4:
            continue
        response = cross[good] / power[good]
        characteristics.responses.append(
            FrequencyResponse(
                float(drive.speed[first:last].mean()), frequency[good], np.abs(response),
                np.unwrap(np.angle(response)), coherence[good],
            )
        )  # fmt: skip
    if not characteristics.responses:
        characteristics.quantities.append(
            Quantity("yaw-rate gain", "1/s", note="steering and yaw rate are not coherent anywhere")
        )
        return
    richest = max(characteristics.responses, key=lambda measured: (min(len(measured.frequency), 8), measured.speed))
    speed = f"at {3.6 * richest.speed:.0f} km/h"
    characteristics.quantities.append(
        Quantity(f"yaw-rate gain at {richest.frequency[0]:.2g} Hz {speed}", "1/s", float(richest.gain[0]))
    )
    slow = richest.frequency < max(1.0, float(richest.frequency[3]))
    lag = -float(np.polyfit(2 * np.pi * richest.frequency[slow], richest.phase[slow], 1)[0])
    characteristics.quantities.append(Quantity(f"lag of the yaw rate behind the steering {speed}", "s", lag))


def _is_narrow(drive: DriveSignals) -> bool:
    """True if a drive is a test whose steering has one frequency or none."""
    return drive.wheels is not None and drive.name.startswith(("straight", "winding"))


def _longest_run(rows: NDArray[np.int64]) -> tuple[int, int]:
    """First row, and the one after the last, of the longest stretch of rows that follow each other."""
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    longest = max(runs, key=len)
    return int(longest[0]), int(longest[-1]) + 1
