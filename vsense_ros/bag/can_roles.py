"""Which signals of a bus measure the motion of the car: by names and units, and by what must hold among them.

- The four wheels agree with each other and with the speed.
- Right and left wheels differ by the yaw rate times the track.
- The lateral acceleration is about the speed times the yaw rate, the longitudinal one the change of speed.
- The steering angle is about the wheelbase times the yaw rate over the speed, times the steering ratio.

Signs follow from the same relations, in the axes of ISO 8855: forward, left, and turning left positive.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.bag.can_gnss import GnssOutput, gnss_outputs
from vsense_ros.bag.can_names import CONCEPTS, WHEEL_SIDES, likeness, side_keys
from vsense_ros.bag.can_survey import CanSurvey, HeardSignal
from vsense_ros.messages import units

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RoleSettings:
    """Decisions of the recognition: typical numbers of cars, and what counts as agreement."""

    rate: float = 20.0  # [Hz] of the common time
    most_samples: int = 40_000  # of the common time, which is coarser for longer logs
    smoothing: float = 0.4  # [s] over which signals are averaged before they are compared
    track: float = 1.55  # [m]
    wheelbase: float = 2.75  # [m]
    steering_ratio: float = 15.0  # [-]
    radius: float = 0.32  # [m] rolling radius
    slowest: float = 3.0  # [m/s] below which nothing is compared
    alike: float = 0.7  # [-] correlation from which two signals say the same
    unlike: float = 0.3  # [-] and up to which they do not
    wheels_alike: float = 0.8  # [-] correlation of each wheel with the mean of the four
    steady_spread: float = 0.1  # [-] standard deviation over mean, up to which a speed is steady
    unit_factor: float = 2.5  # [-] by which a gain may be off before a unit is not believed
    enough: float = 0.9  # [-] points from which a signal is proposed


ROLES = RoleSettings()
# Units that a signal of a quantity without a stated unit may have, the usual first.
_UNITS: Mapping[str, tuple[str, ...]] = {
    "velocity": ("km/h", "m/s", "mph", "rad/s", "rpm"),
    "angular velocity": ("deg/s", "rad/s"),
    "angle": ("deg", "rad"),
    "acceleration": ("m/s²", "g"),
}
_LARGEST: Mapping[str, float] = {"velocity": 120.0, "angular velocity": 4.0, "angle": 15.0, "acceleration": 60.0}  # SI


@dataclass(frozen=True)
class Recognized:
    """A signal that measures something: the value in `unit` is `factor` × the physical value of the database.

    `sign` is the signal of the direction where the value is a magnitude, negative where it is `negative`. `correlation`
    is that with what the other signals say, NaN where they say nothing. `reasons` are for people.
    """

    signal: HeardSignal
    unit: str
    factor: float = 1.0
    sign: HeardSignal | None = None
    negative: int = 1
    correlation: float = math.nan
    reasons: tuple[str, ...] = ()

    @property
    def contradicts_stated_unit(self) -> bool:
        """True if the database states another unit."""
        stated = units.canonical(self.signal.unit) if self.signal.unit else None
        return stated is not None and stated != self.unit


@dataclass(frozen=True)
class Roles:
    """What was recognized. `wheels` has all four or none; `others` are further signals that seem to measure a role;
    `gnss` is what sounds like a satellite receiver, `gnss_outputs` what of it is a position and a velocity."""

    wheels: Mapping[str, Recognized] = field(default_factory=dict)
    steering_wheel: Recognized | None = None
    yaw_rate: Recognized | None = None
    lateral_acceleration: Recognized | None = None
    longitudinal_acceleration: Recognized | None = None
    speed: Recognized | None = None
    gnss: tuple[HeardSignal, ...] = ()
    gnss_outputs: tuple[GnssOutput, ...] = ()
    others: Mapping[str, tuple[HeardSignal, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Candidate:
    points: float
    recognized: Recognized


class _Motion:
    """What a log says of the car's motion, on a common time; quantities are added as they are recognized."""

    def __init__(self, survey: CanSurvey) -> None:
        signals = [signal for signal in survey.signals if len(signal.time) > 1]
        start = min((float(signal.time[0]) for signal in signals), default=0.0)
        end = max((float(signal.time[-1]) for signal in signals), default=0.0)
        count = int(np.clip((end - start) * ROLES.rate, 2, ROLES.most_samples))
        self.time = np.linspace(start, end, count)
        self.step = max((end - start) / (count - 1), 1e-3)
        self.speed: Array | None = None  # [m/s]
        self.yaw_rate: Array | None = None  # [rad/s]

    def of(self, signal: HeardSignal) -> Array:
        """Values of a signal at the common time."""
        return np.interp(self.time, signal.time, signal.value)

    def smooth(self, values: Array) -> Array:
        """Mean over `ROLES.smoothing`."""
        width = max(1, round(ROLES.smoothing / self.step))
        if width == 1 or len(values) < 2 * width:
            return values
        padded = np.pad(values, width, mode="edge")
        return np.convolve(padded, np.ones(width) / width, "same")[width:-width]

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Where the car drives so fast that the relations hold."""
        if self.speed is None:
            return np.ones(len(self.time), dtype=bool)
        return self.speed > ROLES.slowest

    def expected(self, role: str) -> Array | None:
        """What the recognized signals say of a role [SI]; None where they say nothing."""
        speed, yaw_rate = self.speed, self.yaw_rate
        if role == "longitudinal_acceleration":
            return None if speed is None else np.gradient(self.smooth(speed), self.step)
        if yaw_rate is None:
            return None
        if role == "yaw_rate":
            return yaw_rate
        if speed is None:
            return None
        if role == "lateral_acceleration":
            return speed * yaw_rate
        return ROLES.steering_ratio * ROLES.wheelbase * yaw_rate / np.maximum(speed, ROLES.slowest)

    def relation(self, values: Array, expected: Array) -> tuple[float, float]:
        """Correlation of values with what is expected of them, and the expectation per unit of the value."""
        rows = self.moving
        if rows.sum() < 20:
            return math.nan, math.nan
        one, other = self.smooth(values)[rows], self.smooth(expected)[rows]
        one, other = one - one.mean(), other - other.mean()
        power = float(one @ one), float(other @ other)
        if min(power) <= 0:
            return math.nan, math.nan
        correlation = float(one @ other) / math.sqrt(power[0] * power[1])
        return correlation, math.copysign(math.sqrt(power[1] / power[0]), correlation)


def recognize(survey: CanSurvey) -> Roles:
    """Find the signals that measure the car's motion among all that were heard."""
    motion = _Motion(survey)
    signals = [signal for signal in survey.signals if _varies(signal) or signal.bits > 1]
    speed = _speed(motion, signals)
    if speed is not None:
        motion.speed = motion.of(speed.signal) * speed.factor * units.to_si(speed.unit)
    wheels = _wheels(motion, signals, None if speed is None else motion.speed)
    if wheels:
        rim = {side: _rim_speed(motion, one) for side, one in wheels.items()}
        motion.speed = np.mean(list(rim.values()), axis=0)
        difference = (rim["fr"] - rim["fl"] + rim["rr"] - rim["rl"]) / 2
        if _varies_more(difference, max(one.signal.step * _per_unit(one) for one in wheels.values())):
            motion.yaw_rate = motion.smooth(difference / ROLES.track)
    others: dict[str, tuple[HeardSignal, ...]] = {}

    def best(role: str) -> Recognized | None:
        taken = {one.signal.label for one in wheels.values()}
        ranked = _ranked(motion, role, [one for one in signals if one.label not in taken])
        others[role] = tuple(one.recognized.signal for one in ranked[1:5])
        return ranked[0].recognized if ranked else None

    yaw_rate = best("yaw_rate")
    if yaw_rate is not None and (motion.yaw_rate is None or abs(yaw_rate.correlation) > ROLES.alike):
        motion.yaw_rate = _signed(motion, yaw_rate) * yaw_rate.factor * units.to_si(yaw_rate.unit)
    return Roles(
        wheels,
        best("steering_wheel"),
        yaw_rate,
        best("lateral_acceleration"),
        best("longitudinal_acceleration"),
        speed,
        tuple(signal for signal in signals if likeness("gnss", signal.name, signal.message) > 0.5),
        gnss_outputs(signals),
        {role: rest for role, rest in others.items() if rest},
    )


def _varies(signal: HeardSignal) -> bool:
    return signal.high > signal.low


def _varies_more(values: Array, step: float) -> bool:
    """True if a difference of wheels is more than the steps of their values can make of nothing."""
    return float(np.std(values)) > 0.3 * step


def _per_unit(recognized: Recognized) -> float:
    """Metres per second at the rim of a wheel in one unit of its signal."""
    is_angular = units.quantity_of(recognized.unit) == "angular velocity"
    return abs(recognized.factor) * units.to_si(recognized.unit) * (ROLES.radius if is_angular else 1.0)


def _rim_speed(motion: _Motion, recognized: Recognized) -> Array:
    return motion.of(recognized.signal) * _per_unit(recognized)


def _signed(motion: _Motion, recognized: Recognized) -> Array:
    """Values at the common time, with the sign of their own bit."""
    values = motion.of(recognized.signal)
    if recognized.sign is None:
        return values
    return values * np.where(np.round(motion.of(recognized.sign)) == recognized.negative, -1.0, 1.0)


# Speed and wheels


def _speed(motion: _Motion, signals: Sequence[HeardSignal]) -> Recognized | None:
    """The speed of the car by its name, of several that with a unit and the finest steps."""
    candidates = []
    for signal in signals:
        points = likeness("speed", signal.name, signal.message)
        quantity = units.quantity_of(signal.unit) if signal.unit else None
        if points == 0 or signal.bits < 7 or quantity not in (None, "number", "velocity") or signal.low < -30:
            continue
        stated = units.canonical(signal.unit) if quantity == "velocity" else None
        unit = stated or ("km/h" if signal.high > 60 else "m/s")
        points += 0.5 * (stated is not None) + 0.3 * min(signal.bits / 16, 1.0) + 0.2 * _varies(signal)
        if signal.high * units.to_si(unit) < _LARGEST["velocity"]:
            candidates.append(_Candidate(points, Recognized(signal, unit)))
    return max(candidates, key=lambda one: one.points).recognized if candidates else None


def _wheels(motion: _Motion, signals: Sequence[HeardSignal], speed: Array | None) -> dict[str, Recognized]:
    """The four wheels: signals whose names differ in the wheel alone, and whose values go together."""
    families: dict[tuple[int, str], dict[str, list[HeardSignal]]] = {}
    for signal in signals:
        if signal.bits < 6 or likeness("wheel_speed", signal.name, signal.message) == 0:
            continue
        for row, side, key in side_keys(signal.name):
            families.setdefault((row, key), {}).setdefault(side, []).append(signal)
    best: tuple[float, dict[str, HeardSignal]] | None = None
    for (row, _), sides in families.items():
        if set(sides) != set(WHEEL_SIDES):
            continue
        chosen = _one_each(sides)
        points = _wheel_points(motion, list(chosen.values()), speed) - 0.001 * row
        if points > ROLES.enough and (best is None or points > best[0]):
            best = points, chosen
    if best is None:
        return {}
    unit, reason = _unit_of_wheels(motion, list(best[1].values()), speed)
    return {side: Recognized(signal, unit, reasons=(reason,) if reason else ()) for side, signal in best[1].items()}


def _one_each(sides: Mapping[str, Sequence[HeardSignal]]) -> dict[str, HeardSignal]:
    """One signal for each wheel, from as few messages as can be, and those that come most often."""
    messages: dict[str, tuple[int, float]] = {}
    for signals in sides.values():
        for signal in signals:
            count, rate = messages.get(signal.message, (0, signal.rate))
            messages[signal.message] = count + 1, rate
    return {side: max(signals, key=lambda one: messages[one.message]) for side, signals in sides.items()}


def _wheel_points(motion: _Motion, wheels: Sequence[HeardSignal], speed: Array | None) -> float:
    """How much four signals are like the speeds of wheels; less than nothing for what cannot be."""
    points = sum(likeness("wheel_speed", one.name, one.message) for one in wheels) / 4
    quantities = {units.quantity_of(one.unit) if one.unit else None for one in wheels}
    if not quantities <= {None, "number", "velocity", "angular velocity"}:
        return -1.0
    points += 0.4 * bool(quantities & {"velocity", "angular velocity"}) + 0.2 * min(wheels[0].bits / 16, 1.0)
    values = np.array([motion.of(one) for one in wheels])
    mean = values.mean(axis=0)
    spread = float(np.std(mean))
    if spread == 0:
        return points - 0.3
    apart = float(np.abs(values - mean).mean())
    steady = spread < ROLES.steady_spread * abs(float(mean.mean()))  # then wheels differ more than the speed changes
    together = steady or all(
        float(np.corrcoef(one, mean)[0, 1]) > ROLES.wheels_alike for one in values if np.std(one) > 0
    )
    if not together or apart > 0.3 * (abs(float(mean.mean())) + spread):
        return -1.0
    points += 0.5
    if speed is not None and np.std(speed) > 0:
        points += 0.5 if float(np.corrcoef(mean, speed)[0, 1]) > ROLES.wheels_alike else -0.3
    return points


def _unit_of_wheels(motion: _Motion, wheels: Sequence[HeardSignal], speed: Array | None) -> tuple[str, str]:
    """Unit of the wheels' speeds, and why where it is not stated."""
    stated = units.canonical(wheels[0].unit) if wheels[0].unit else None
    if stated is not None and units.quantity_of(stated) in ("velocity", "angular velocity"):
        return stated, ""
    mean = np.mean([motion.of(one) for one in wheels], axis=0)
    if speed is not None and float(np.median(mean[motion.moving])) > 0:
        gain = float(np.median(speed[motion.moving]) / np.median(mean[motion.moving]))
        sizes = {unit: _per_unit(Recognized(wheels[0], unit)) for unit in _UNITS["velocity"]}
        unit = min(sizes, key=lambda one: abs(math.log(sizes[one] / gain)))
        return unit, f"no unit is stated; {unit} by the speed of the car"
    unit = "km/h" if float(mean.max()) > 60 else "m/s"
    return unit, f"no unit is stated; {unit} by its size (up to {float(mean.max()):.4g})"


# Roles of single signals


def _ranked(motion: _Motion, role: str, signals: Sequence[HeardSignal]) -> list[_Candidate]:
    """Signals that may play a role, the likeliest first."""
    candidates = [one for signal in signals if (one := _candidate(motion, role, signal, signals)) is not None]
    return sorted(candidates, key=lambda one: -one.points)


def _candidate(motion: _Motion, role: str, signal: HeardSignal, signals: Sequence[HeardSignal]) -> _Candidate | None:
    """A signal in a role, with its points; None if it cannot be."""
    concept = CONCEPTS[role]
    name = likeness(role, signal.name, signal.message)
    quantity = units.quantity_of(signal.unit) if signal.unit else None
    if name == 0 or signal.bits < 6 or quantity not in (None, "number", concept.quantity):
        return None
    points = name + 0.4 * (quantity == concept.quantity) + 0.1 * min(signal.bits / 16, 1.0) + 0.1 * _varies(signal)
    recognized = Recognized(signal, "")
    expected = motion.expected(role)
    gain = math.nan
    if expected is not None and _varies(signal):
        correlation, gain = motion.relation(motion.of(signal), expected)
        recognized = replace(recognized, correlation=correlation)
        signed = _with_sign_bit(motion, signal, expected, signals)
        if signed is not None and abs(signed[0].correlation) > abs(correlation) + 0.1:
            recognized, gain = signed
        agreement = abs(recognized.correlation)
        if agreement > ROLES.alike:
            points += 0.3 + agreement
        elif agreement < ROLES.unlike:
            points -= 0.7
    elif expected is not None:
        points -= 0.5
    if points < ROLES.enough:
        return None
    unit, factor, reason = _unit_and_factor(signal, concept.quantity, gain, role)
    reasons = [reason] if reason else []
    if abs(recognized.correlation) > ROLES.alike and gain < 0:
        factor = -factor
        reasons.append("reversed: positive to the right (or backwards) in the database")
    if not math.isfinite(recognized.correlation):
        reasons.append("by its name alone: the drive does not show whether it agrees with the others")
    elif abs(recognized.correlation) <= ROLES.alike:
        reasons.append(f"agrees weakly with the others (correlation {recognized.correlation:.2f}): look at it")
    return _Candidate(points, replace(recognized, unit=unit, factor=factor, reasons=tuple(reasons)))


def _with_sign_bit(
    motion: _Motion, signal: HeardSignal, expected: Array, signals: Sequence[HeardSignal]
) -> tuple[Recognized, float] | None:
    """A magnitude with the bit of its message that says its direction, and its gain; None if there is none."""
    if signal.low < 0:
        return None
    best: tuple[Recognized, float] | None = None
    for bit in signals:
        if bit.message != signal.message or bit.bits != 1 or not _varies(bit):
            continue
        recognized = Recognized(signal, "", sign=bit)
        correlation, gain = motion.relation(_signed(motion, recognized), expected)
        if best is None or abs(correlation) > abs(best[0].correlation):
            best = replace(recognized, correlation=correlation), gain
    if best is not None and best[1] < 0:  # then the bit says the opposite, and nothing need be reversed
        best = replace(best[0], negative=0, correlation=-best[0].correlation), -best[1]
    return best


def _unit_and_factor(signal: HeardSignal, quantity: str, gain: float, role: str) -> tuple[str, float, str]:
    """Unit of a signal, what turns its values into it, and why where it is not stated. `gain` is the expected value in
    SI units per unit of the signal."""
    stated = units.canonical(signal.unit) if signal.unit else None
    if stated is not None and units.quantity_of(stated) == quantity:
        off = abs(gain) / units.to_si(stated)
        loose = 2.0 if role == "steering_wheel" else 1.0  # ratio and wheelbase are not known
        if math.isfinite(off) and not 1 / (loose * ROLES.unit_factor) < off < loose * ROLES.unit_factor:
            return stated, 1.0, f"{off:.3g} times as large were expected from the others: look at the unit"
        return stated, 1.0, ""
    choices = _UNITS[quantity]
    if math.isfinite(gain) and gain != 0:
        unit = min(choices, key=lambda one: abs(math.log(units.to_si(one) / abs(gain))))
        off = abs(gain) / units.to_si(unit)
        if 1 / ROLES.unit_factor < off < ROLES.unit_factor:
            return unit, 1.0, f"no unit is stated; {unit} by what the other signals say"
        factor = float(f"{off:.2g}")
        return unit, factor, f"no unit is stated; the factor {factor:g} is about what the other signals say"
    largest = max(abs(signal.low), abs(signal.high))
    unit = choices[0] if largest * units.to_si(choices[0]) <= _LARGEST[quantity] else choices[-1]
    if largest <= 0.2 * _LARGEST[quantity] and quantity in ("angular velocity", "angle"):
        unit = choices[1]
    return unit, 1.0, f"no unit is stated; {unit} by its size (up to {largest:.4g})"
