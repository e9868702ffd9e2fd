"""Recordings of which nothing can be said, with the reason, before anything is fitted to them.

A spin, a sensor that is frozen or at the end of its range, a wrong unit or another car spoil every figure that follows,
and some effect would still seem to explain them. What lasts for a while is cut out and told. What is wrong with a whole
recording is enough for no answer; without it the user gets one about the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from vsense_ros.checks.aligned import means_around, runs_of_equal_values, stretches
from vsense_ros.checks.consistency import turning
from vsense_ros.checks.examination import OF_UNITS, run
from vsense_ros.checks.finding import Finding
from vsense_ros.checks.lags import LONG_LAGS, match
from vsense_ros.checks.mending import mends
from vsense_ros.checks.motion import GNSS
from vsense_ros.checks.roles import topics_of
from vsense_ros.checks.sentences import mend_in_words, sentence
from vsense_ros.checks.subject import Subject
from vsense_ros.identify.least_squares import DEFAULT, Fit, prior_weight, solve
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.ages import ALIKE, BETTER, CLEAR, LATE
from vsense_ros.mismatch.candidates import BASE
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.windows import SLOWEST, Dataset, Readings, Spoilt, Window, build_dataset
from vsense_ros.model.sensors import Response, SensorBase, Tells, telling
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]

LEAST = 10.0  # [s] of driving
KEPT = 0.5  # of the driving of a recording that has to be left for a stretch of it to be cut out
ROUNDS = 3  # of looking for what is spoilt, as what is cut out hides less
MANY = 4  # stretches that a remark lists
AROUND = 0.5  # [s] that are cut out before and after a stretch
GENTLE = 0.15  # [m/s²] lateral and longitudinal, below which nothing can be said
SPIN = 13.0  # [m/s²] speed times yaw rate that no car on a road has
SLIDE = 0.7  # [rad] by which nobody's side slip changes …
SLIDE_TIME = 3.0  # [s] … in so long, unless the car spins
COARSE = 100  # values that a signal takes; one with fewer may well keep its value
SATURATED = 8  # samples at the end of a range, and as many times longer than it stays at other values
CLIPPED = 3  # times that a steering angle does so, which may be held at one end once
INPUT_STILL = 2.0  # [s] of the same steering angle, or the same torques, during which the car begins to move otherwise
GRIPPING = 4.0  # [m/s²] of lateral acceleration up to which the path follows the steering
MOMENT = 0.2  # [s] of means beside which one wild sample is no motion
SMOOTH = 0.5  # [s] of the means between which relations are judged
RADIUS_APART = 0.04  # relative difference of rolling radii that two cars have
STRANGE = 2.0  # standard deviations left over, from which on the recordings may be of several cars
CONSTANT = ("mass", "tyre radius")  # what neither road nor driver changes …
CONSTANT_APART = 1.7  # … and its standard deviation over recordings of several cars, in deviations of the parameter
ANTENNA, BESIDE = 2.0, 0.01  # [m] of an antenna beside the middle of a car, and the share of the speed that it may add
TILT_APART = 1.5  # [m/s²] of gravity that a sensor feels on another axis when it sits otherwise


def hindrance(recordings: Sequence[Recording], fitted: Dataset, unseen: Dataset, vehicle: Vehicle) -> str:
    """Why nothing can be said of the recordings; empty where something can. `recordings` are all of them, `fitted` the
    windows to fit to, `unseen` those of the recordings that are held out."""
    return next(_hindrances(recordings, fitted, unseen, vehicle), "")


def _hindrances(recordings: Sequence[Recording], fitted: Dataset, unseen: Dataset, vehicle: Vehicle) -> Iterator[str]:
    sensors = {**fitted.sensors, **unseen.sensors}
    yield from _given_twice(recordings)
    yield from _of_several_cars(recordings, sensors)
    yield from _twins(sensors)
    drives = [*fitted.by_recording(), *unseen.by_recording()]
    for windows in drives:
        yield from (stretch.reason for stretch in _spoilt(windows, sensors))
    yield from _units(recordings, sensors, float(np.mean(rolling_radii(vehicle))))
    means = [(windows[0].name, _Drive.of(windows, sensors, vehicle)) for windows in drives]
    yield from _too_little(fitted, [drive for _, drive in means[: len(fitted.by_recording())]])
    for name, drive in means:
        yield from _unrelated(drive, name)
    yield from _unlike(means)


def without_spoilt(recordings: Sequence[Recording], vehicle: Vehicle, seen: Dataset | None = None) -> Dataset:
    """The windows of recordings outside of stretches that would spoil every figure, with remarks that say which these
    are; all windows where little would be left of a recording, as then the fault is the whole recording's."""
    whole = kept = build_dataset(recordings, vehicle, seen)
    cut: list[Spoilt] = []
    for _ in range(ROUNDS):
        new = [stretch for windows in kept.by_recording() for stretch in _spoilt(windows, kept.sensors)]
        if not new:
            break
        cut += new
        kept = build_dataset(recordings, vehicle, seen, cut)
    before, after = ({w[0].recording: _duration(w) for w in of.by_recording()} for of in (whole, kept))
    lost = {index for index, duration in before.items() if after.get(index, 0.0) < KEPT * duration}
    if lost:
        cut = [stretch for stretch in cut if stretch.recording not in lost]
        kept = build_dataset(recordings, vehicle, seen, cut) if cut else whole
    return replace(kept, remarks=(*kept.remarks, *_cut_in_words(cut)))


def _cut_in_words(cut: Sequence[Spoilt]) -> Iterator[str]:
    by_reason: dict[str, list[Spoilt]] = {}
    for stretch in cut:
        by_reason.setdefault(stretch.reason, []).append(stretch)
    for reason, cuts in by_reason.items():
        spans: list[tuple[float, float]] = []
        for one in sorted(cuts, key=lambda one: one.begin):
            if spans and one.begin <= spans[-1][1]:
                spans[-1] = spans[-1][0], max(spans[-1][1], one.end)
            else:
                spans.append((one.begin, one.end))
        when = ", ".join(f"{begin:.1f} to {end:.1f} s" for begin, end in spans[:MANY])
        more = f" and {len(spans) - MANY} more" if len(spans) > MANY else ""
        yield f"cut out: {reason} ({when}{more})"


def _duration(windows: Sequence[Window]) -> float:
    return sum(window.end - window.begin for window in windows)


def _spoilt(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    """Stretches of one recording that would spoil every figure."""
    windows = [_without_margins(window) for window in windows]
    yield from _standing_still(windows, sensors)
    yield from _saturated(windows, sensors)
    yield from _clipped(windows, sensors)
    yield from _spinning(windows, sensors)


def _without_margins(window: Window) -> Window:
    """The window with what was measured inside of it alone: what is cut out stays in the margins of its neighbours."""
    inside = {
        name: found.rows((found.t >= window.begin) & (found.t <= window.end)) for name, found in window.readings.items()
    }
    return replace(window, readings={name: found for name, found in inside.items() if len(found.t) >= 2})


def faults_of(recording: Recording, vehicle: Vehicle) -> list[Finding]:
    """What would mend signs, axes and units of a recording that cannot be right, with sensors as the file has them."""
    sensors = vehicle.sensing()
    mounted = {s.topic for s in sensors.values() if recording_turned(recording, s)}
    topics = {s.topic for s in sensors.values() if s.is_compared} - mounted
    radius = float(np.mean(rolling_radii(vehicle)))
    found = mends(_as_mounted(recording, sensors), topics_of(sensors.values()), radius)
    return [finding for finding in found if finding.topic in topics]


def recording_turned(recording: Recording, sensor: SensorBase) -> bool:
    """Whether the vehicle file says that a sensor of the recording is mounted in other axes than the car's."""
    channel = recording.channels.get(sensor.topic)
    return channel is not None and bool(sensor.message_in_axes_of_car(channel.columns))


def faults_in_words(recordings: Sequence[Recording], faults: Sequence[Sequence[Finding]]) -> list[str]:
    """By recording what would mend it."""
    return [
        f"what mends {recording.name}: {', '.join(map(mend_in_words, todo))}"
        for recording, todo in zip(recordings, faults, strict=True)
        if todo
    ]


def misfit(base: Fit, residuals: Residuals) -> str:
    """Why a fit of the base parameters cannot be built on; empty where it can."""
    return next(_misfits(base, residuals), "")


def _misfits(base: Fit, residuals: Residuals) -> Iterator[str]:
    level = residuals.level(base.residuals)
    if level > 1 and not base.converged:
        yield f"the base parameters do not settle: after {DEFAULT.iterations} steps the fit is still changing"
    offsets = dict(zip((parameter.name for parameter in base.free_parameters), base.offsets, strict=True))
    outside = [k for k in BASE if k.name in offsets and not k.low < offsets[k.name] < k.high]
    # One stiffness may stand in for the physics that is missing.
    if len(outside) > 1 or any(parameter.name in CONSTANT for parameter in outside):
        names = "; ".join(f"no {k.name} between {k.low:+g} and {k.high:+g} ({k.unit})" for k in outside)
        yield f"{names} of the vehicle file's fits; is it the file of this car?"
    if level > STRANGE and offsets.keys() >= set(CONSTANT):
        yield from _of_several_fits(base, residuals)


def _of_several_fits(base: Fit, residuals: Residuals) -> Iterator[str]:
    """Recordings that each fit best with another mass or another tyre radius, to first order."""
    drives = residuals.predictor.dataset.by_recording()
    own = []
    for rows in residuals.predictor.dataset.places_by_recording():
        left, slopes = [base.residuals[i] for i in rows], [base.slopes[i] for i in rows]
        own.append(base.scaled_offsets + solve(slopes, left, base.scaled_offsets, prior_weight(left)))
    for name in CONSTANT:
        at = [parameter.name for parameter in base.free_parameters].index(name)
        found = [change[at] for change in own]
        if np.std(found) > CONSTANT_APART:
            low, high = int(np.argmin(found)), int(np.argmax(found))
            apart = 100 * (found[high] - found[low]) * base.free_parameters[at].deviation
            yield (
                f"the {name} of the car in {drives[high][0].name} is {apart:.0f} % more than in {drives[low][0].name}, "
                "and no parameters fit both; are they recordings of one car?"
            )


def _too_little(dataset: Dataset, drives: Sequence[_Drive]) -> Iterator[str]:
    if not dataset.windows:
        yield "; ".join(dataset.remarks) or "there is no recording"
        return
    if dataset.driven < LEAST:
        yield f"only {dataset.driven:.1f} s of driving can be used, {LEAST:g} s are needed"
    lateral, longitudinal = (max(found) for found in zip(*(drive.strongest for drive in drives), strict=True))
    if lateral < GENTLE and longitudinal < GENTLE:
        yield (
            f"the car does nothing but go straight ahead at constant speed (at most {lateral:.2f} m/s² lateral and "
            f"{longitudinal:.2f} m/s² longitudinal)"
        )
    if not any("rates and forces" in dataset.sensors[name].tells for w in dataset.windows for name in w.readings):
        yield "; ".join(
            ["there are no inertial measurements, with which a simulation could be compared", *dataset.remarks]
        )


def _of_several_cars(recordings: Sequence[Recording], sensors: Mapping[str, SensorBase]) -> Iterator[str]:
    """What recordings say of their car and its sensors must agree."""
    said: dict[str, str] = {}
    for recording in recordings:
        stated = {"vehicle": recording.metadata.get("vehicle", "")}
        for sensor in sensors.values():
            if sensor.topic in recording:
                stated[f"frame of {sensor.topic}"] = recording[sensor.topic].frame_id
        for what, value in stated.items():
            if value and said.setdefault(what, value) != value:
                yield (
                    f"the recordings are of different cars: the {what} is {said[what]!r} in one and {value!r} in "
                    f"{recording.name}; explain each car by itself"
                )


def _given_twice(recordings: Sequence[Recording]) -> Iterator[str]:
    """The same measurements in two recordings: one would seem to prove what was found in the other."""
    names: dict[bytes, str] = {}
    for recording in recordings:
        content = recording.digest()
        if content in names:
            yield f"{names[content]} and {recording.name} hold the same measurements; leave one of them out"
        names[content] = recording.name


def _twins(sensors: Mapping[str, SensorBase]) -> Iterator[str]:
    for kind in sorted({sensor.kind for sensor in sensors.values() if sensor.is_compared}):
        names = [name for name, sensor in sensors.items() if sensor.kind == kind]
        if len(names) > 1:
            yield (
                f"the vehicle file has {len(names)} sensors of the kind {kind} with measurements "
                f"({', '.join(names)}), of which one can be compared; leave the others out of the file"
            )


def _units(recordings: Sequence[Recording], sensors: Mapping[str, SensorBase], radius: float) -> Iterator[str]:
    """Units, signs and axes that cannot be right, as `vsense info` finds them, in what the model is compared with."""
    for recording in recordings:
        subject = Subject(_as_mounted(recording, sensors), topics_of(sensors.values()), radius)
        found = [*run(OF_UNITS, subject), *(one for one in run((turning,), subject) if one.against == GNSS)]
        for finding in found:
            if finding.topic in {sensor.topic for sensor in sensors.values() if sensor.is_compared}:
                yield f"in {recording.name}, {finding.topic}: {sentence(finding)}"


def _as_mounted(recording: Recording, sensors: Mapping[str, SensorBase]) -> Recording:
    """The recording with inertial measurements in the axes of the car, where the vehicle file says that the sensor is
    turned away from them."""
    channels = dict(recording.channels)
    for sensor in sensors.values():
        if (channel := channels.get(sensor.topic)) is not None:
            turned = sensor.message_in_axes_of_car(channel.columns)
            channels[sensor.topic] = replace(channel, columns={**channel.columns, **turned})
    return replace(recording, channels=channels)


def _standing_still(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    """Signals that do not change although the car moves."""
    for window in windows:
        for name, readings in window.readings.items():
            sensor = sensors[name]
            for column, component in enumerate(sensor.components):
                value, t = _present(readings.in_own_axes, column)
                if len(value) < 2:
                    continue
                first, length = runs_of_equal_values(value)
                last = first + length - 1
                long = int(np.argmax(t[last] - t[first]))
                duration = float(t[last[long]] - t[first[long]])
                coarse = 1 < len(np.unique(value)) < COARSE
                if length[long] >= 10 and duration >= sensor.longest(coarse=coarse):
                    begin = t[first[long]]
                    yield _stretch(
                        window, begin, begin + duration,
                        f"the {component.words} is frozen for {duration:.1f} s from {begin:.1f} s on in {window.name}",
                    )  # fmt: skip
            if sensor.response is not None:
                yield from _input_still(window, readings, sensor.response, sensors)


def _input_still(
    window: Window, driven: Readings, expected: Response, sensors: Mapping[str, SensorBase]
) -> Iterator[Spoilt]:
    """A driver may well hold wheel and pedals still, but then the motion of the car does not change."""
    imu = _telling(window, sensors, "rates and forces")
    present = np.isfinite(driven.value).all(axis=1)
    value, t = driven.value[present], driven.t[present]
    if imu is None or len(t) < 2 or np.isfinite(imu.value[:, expected.component]).sum() < 2:
        return
    response, at = _present(imu, expected.component)
    if expected.by_speed:
        speed = np.interp(at, window.speed.t, window.speed.value[:, 0])
        response = means_around(at, at, response * speed, MOMENT)
        shape = response / np.maximum(speed, 1.0) ** 2
    else:
        response = shape = means_around(at, at, response, MOMENT)
    for first, length in zip(*runs_of_equal_values(value), strict=True):
        begin, end = t[first], t[first + length - 1]
        # The car needs a while to follow what went before, and means and clocks reach beyond the end.
        inside = (at >= begin + 0.5) & (at <= end - 0.3)
        if end - begin < INPUT_STILL or not inside.any():
            continue
        if np.ptp(response[inside]) > expected.least and np.ptp(shape[inside]) > 0.5 * np.max(np.abs(shape)):
            reason = f"{expected.words} frozen for {end - begin:.1f} s from {begin:.1f} s on in {window.name}"
            yield _stretch(window, begin, end, reason)


def _stretch(window: Window, begin: float, end: float, reason: str) -> Spoilt:
    return Spoilt(window.recording, begin - AROUND, end + AROUND, reason)


def _saturated(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    """Signals that stay at their largest or smallest value as at no other."""
    for name in sorted({name for window in windows for name in window.readings if sensors[name].saturates}):
        for column, component in enumerate(sensors[name].components):
            parts = [(w, *_present(w.readings[name].in_own_axes, column)) for w in windows if name in w.readings]
            parts = [part for part in parts if len(part[1])]
            if not parts or len(np.unique(np.concatenate([value for _, value, _ in parts]))) < COARSE:
                continue
            ends = max(value.max() for _, value, _ in parts), min(value.min() for _, value, _ in parts)
            runs = [(window, value, t, *runs_of_equal_values(value)) for window, value, t in parts]
            elsewhere = np.concatenate([length[~np.isin(value[first], ends)] for _, value, _, first, length in runs])
            usual = float(np.percentile(elsewhere, 99)) if len(elsewhere) else 1.0
            for end in ends:
                reason = f"the {component.words} is at the end of its range, {end:.4g}, in {windows[0].name}"
                yield from _held_at(runs, end, SATURATED * usual, reason)


_Run = tuple[Window, Array, Array, NDArray[np.int64], NDArray[np.int64]]  # values, times, first and length of each


def _held_at(runs: Sequence[_Run], end: float, least: float, reason: str) -> Iterator[Spoilt]:
    """Where a signal has one value for so many samples."""
    for window, value, t, first, length in runs:
        for begin, count in zip(first, length, strict=True):
            if value[begin] == end and count >= least:
                yield _stretch(window, float(t[begin]), float(t[begin + count - 1]), reason)


def _clipped(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    """A steering angle that stays again and again at the ends of its range, and nowhere else."""
    for name in sorted({name for w in windows for name in w.readings if "steering" in sensors[name].tells}):
        parts = [(w, *_present(w.readings[name], 0)) for w in windows if name in w.readings]
        parts = [part for part in parts if len(part[1])]
        if not parts or len(np.unique(np.concatenate([value for _, value, _ in parts]))) < COARSE:
            continue
        ends = max(value.max() for _, value, _ in parts), min(value.min() for _, value, _ in parts)
        runs = [(window, value, t, *runs_of_equal_values(value)) for window, value, t in parts]
        elsewhere = np.concatenate([length[~np.isin(value[first], ends)] for _, value, _, first, length in runs])
        longest = int(elsewhere.max(initial=1))
        for end in ends:
            reason = f"the steering angle is at the end of its range, {end:.4g} rad, in {windows[0].name}"
            held = list(_held_at(runs, end, SATURATED * longest, reason))
            if len(held) >= CLIPPED:
                yield from held


def _spinning(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    for window in windows:
        imu = _telling(window, sensors, "rates and forces")
        rate, t = (np.zeros(0), np.zeros(0)) if imu is None else _present(imu, 2)
        if len(t) < 2:
            continue
        speed = np.interp(t, window.speed.t, window.speed.value[:, 0])
        fast = np.abs(means_around(t, t, rate * speed, MOMENT)) > SPIN
        reason = f"the car spins in {window.name}, or the unit of its yaw rate or speed is wrong"
        yield from (_stretch(window, *span, reason) for span in _spans(t, fast))
        velocity = _telling(window, sensors, "course")
        if velocity is None:
            continue
        moving = np.isfinite(velocity.value).all(axis=1) & (np.hypot(*velocity.value[:, :2].T) > SLOWEST)
        if moving.sum() < 2:
            continue
        at, (east, north) = velocity.t[moving], velocity.value[moving, :2].T
        heading = cumulative_trapezoid(rate, t, initial=0)
        slip = np.unwrap(np.arctan2(north, east)) - np.interp(at, t, heading)
        earlier = np.interp(at - SLIDE_TIME, at, slip)
        known = (at <= t[-1]) & (np.maximum(at - SLIDE_TIME, at[0]) >= t[0])  # how the car has turned
        reason = f"the car spins or slides sideways in {window.name}: its course and its yaw rate part"
        for begin, end in _spans(at, (np.abs(slip - earlier) > SLIDE) & known):
            yield _stretch(window, begin - SLIDE_TIME, end, reason)


def _spans(t: Array, where: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Begin and end [s] of each stretch in which a mask is true."""
    return [(float(t[first]), float(t[end - 1])) for first, end in stretches(where)]


@dataclass(frozen=True)
class _Drive:
    """Means over `SMOOTH` seconds of what physics relates, over all windows of a recording; NaN where not measured."""

    speed: Array  # [m/s]
    speed_rate: Array  # [m/s²]
    rolling: Array  # [m/s], by the wheels
    over_ground: Array  # [m/s], by GNSS
    steering: Array  # [rad], of the road wheels
    yaw_rate: Array  # [rad/s]
    longitudinal: Array  # [m/s²], specific force in the axes of the car
    lateral: Array  # [m/s²]
    drive: Array  # [m/s²], wheel torques over radius and mass
    wheelbase: float  # [m]

    @classmethod
    def of(cls, windows: Sequence[Window], sensors: Mapping[str, SensorBase], vehicle: Vehicle) -> _Drive:
        chassis = vehicle.physics.chassis
        parts: dict[str, list[Array]] = {name: [] for name in cls.__dataclass_fields__ if name != "wheelbase"}
        for window in windows:
            t = np.arange(window.begin, window.end, SMOOTH / 2)
            imu, steering, torques = (
                _telling(window, sensors, what) or Readings(np.zeros(0), np.zeros((0, 6)))
                for what in ("rates and forces", "steering", "torques")
            )
            speed = _mean(t, window.speed.t, window.speed.value[:, 0])
            parts["speed"].append(speed)
            parts["speed_rate"].append(np.gradient(speed, SMOOTH / 2))
            for name, column in (("yaw_rate", 2), ("longitudinal", 3), ("lateral", 4)):
                parts[name].append(_mean(t, imu.t, imu.value[:, column]))
            parts["steering"].append(_mean(t, steering.t, steering.value[:, 0]))
            radius = float(np.mean(rolling_radii(vehicle)))
            parts["rolling"].append(_speed(t, window, sensors, "rolling speed", radius))
            parts["over_ground"].append(_speed(t, window, sensors, "ground speed", radius))
            push = torques.value.sum(axis=1) / (radius * chassis.mass)
            parts["drive"].append(_mean(t, torques.t, push))
        joined = {name: np.concatenate(arrays) for name, arrays in parts.items()}
        return cls(**joined, wheelbase=chassis.cog_to_front_axle + chassis.cog_to_rear_axle)

    @property
    def turning(self) -> Array:
        """Lateral acceleration that goes with speed and yaw rate [m/s²]."""
        return self.speed * self.yaw_rate

    @property
    def strongest(self) -> tuple[float, float]:
        """Lateral and longitudinal acceleration that are exceeded in a twentieth of the time [m/s²]."""
        found = []
        for acceleration in (self.turning, self.speed_rate):
            present = np.abs(acceleration[np.isfinite(acceleration)])
            found.append(float(np.percentile(present, 95)) if len(present) else 0.0)
        return found[0], found[1]


def _unrelated(drive: _Drive, name: str) -> Iterator[str]:
    """Signals that follow from one another by physics, and differ by more than any effect could make: a unit, a sign,
    an axis or a clock is wrong."""
    gentle = np.where(np.abs(drive.turning) < GRIPPING, 1.0, np.nan)
    bend = drive.wheelbase * drive.yaw_rate / drive.speed * gentle
    for what, found, other, expected, least, low, high in (
        ("lateral acceleration", drive.lateral, "speed times yaw rate", drive.turning, 0.5, 0.5, 2.0),
        ("road-wheel angle", drive.steering, "wheelbase times yaw rate over speed", bend, 0.005, 0.3, 6.0),
        ("longitudinal acceleration", drive.longitudinal, "change of the speed", drive.speed_rate, 0.5, 0.5, 2.0),
        ("wheel torque over radius and mass", drive.drive, "change of the speed", drive.speed_rate, 0.5, 0.3, 3.0),
    ):
        both = np.isfinite(found) & np.isfinite(expected)
        if both.sum() < LEAST / SMOOTH or np.std(expected[both]) < least:
            continue
        size = float(np.std(found[both]) / np.std(expected[both]))
        alike = float(np.corrcoef(found[both], expected[both])[0, 1]) if size > 0 else 0.0
        if alike > 0.3 and low < size < high:
            continue
        # The lag comes before sign and scale: what is a second late goes along with nothing.
        late = match(found, expected, SMOOTH / 2, LONG_LAGS)
        if late is not None and abs(late.lag) >= LATE and late.clear > CLEAR and late.best > max(ALIKE, alike + BETTER):
            side = "behind" if late.lag > 0 else "ahead of"
            yield f"in {name} the {what} lies {abs(late.lag):.1f} s {side} {other}; which of the clocks is wrong?"
        elif alike < -0.5:
            yield f"in {name} the {what} has the sign opposite to {other}"
        elif not low < size < high:
            yield f"in {name} the {what} is {size:.3g} times the {other}; is its unit wrong?"
        else:
            yield f"in {name} the {what} does not go along with {other}; is a clock or an axis wrong?"


def _unlike(drives: Sequence[tuple[str, _Drive]]) -> Iterator[str]:
    """Recordings, by name, between which the car or its sensors have changed."""
    radii: list[tuple[float, str]] = []
    tilts: list[tuple[Array, str]] = []
    for name, drive in drives:
        steady = np.isfinite(drive.over_ground) & np.isfinite(drive.rolling) & (np.abs(drive.speed_rate) < 1.0)
        if steady.sum() >= LEAST / SMOOTH:
            radii += [(ratio, name) for ratio in _over_rolling(drive, steady)]
        felt = np.array([drive.longitudinal - drive.speed_rate, drive.lateral - drive.turning])
        present = np.isfinite(felt).all(axis=0)
        if present.sum() >= LEAST / SMOOTH:
            tilts.append((felt[:, present].mean(axis=1), name))
    if radii:
        (small, of_small), (large, of_large) = min(radii), max(radii)
        if large > (1 + RADIUS_APART) * small:
            yield (
                f"the wheels of {of_large} are {100 * (large / small - 1):.0f} % larger than those of {of_small}; "
                "are they recordings of one car?"
            )
    for axis, what in enumerate(("longitudinal", "lateral")):
        at = [(float(tilt[axis]), name) for tilt, name in tilts]
        if at and max(at)[0] - min(at)[0] > TILT_APART:
            yield (
                f"between {min(at)[1]} and {max(at)[1]} the {what} accelerometer has shifted by "
                f"{max(at)[0] - min(at)[0]:.1f} m/s²; is it one car, and does the sensor sit where it sat?"
            )


def _over_rolling(drive: _Drive, steady: NDArray[np.bool_]) -> list[float]:
    """Speed over ground over that of the wheels; none where bends to one side leave it open, as an antenna beside the
    middle of the car is faster or slower there."""
    ratio = drive.over_ground[steady] / drive.rolling[steady]
    bent = np.nan_to_num(drive.yaw_rate[steady] / drive.speed[steady])
    if ANTENNA * abs(float(np.mean(bent))) < BESIDE:
        return [float(np.median(ratio))]
    if float(np.std(bent)) < abs(float(np.mean(bent))):
        return []
    return [float(np.polyfit(bent, ratio, 1)[1])]


def _telling(window: Window, sensors: Mapping[str, SensorBase], what: Tells) -> Readings | None:
    """What the sensor that tells something gave in a window."""
    name = telling(((name, sensors[name]) for name in window.readings), what)
    return None if name is None else window.readings[name]


def _speed(t: Array, window: Window, sensors: Mapping[str, SensorBase], what: Tells, radius: float) -> Array:
    """Means of the speed that a sensor tells in a window around the times `t` [s]; NaN where there is none."""
    name = telling(((name, sensors[name]) for name in window.readings), what)
    if name is None:
        return np.full(len(t), np.nan)
    found = window.readings[name]
    return _mean(t, found.t, sensors[name].mean_speed(found.value, radius))


def _present(readings: Readings, column: int) -> tuple[Array, Array]:
    """Values of a component and their times, without those that are absent."""
    value = readings.value[:, column]
    present = np.isfinite(value)
    return value[present], readings.t[present]


def _mean(at: Array, t: Array, value: Array) -> Array:
    """Means over `SMOOTH` seconds around the times `at`; NaN where there is nothing."""
    return means_around(at, t, value, SMOOTH)
