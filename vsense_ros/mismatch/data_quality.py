"""Why recordings, or signals in them, cannot be compared with a model, before anything is fitted to them.

A spin, a sensor that is frozen or at the end of its range, a wrong unit or another car spoil every figure that
follows, and some effect would still seem to explain them. What lasts for a while is cut out (`spoilt`). Where a signal
contradicts others throughout, the hindrance names it, so that the rest can be compared without it. What is wrong with a
whole recording prevents an answer; without that recording the user gets one about the others.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks import values
from vsense_ros.checks.aligned import means_around
from vsense_ros.checks.consistency import axes_in_plane, turning
from vsense_ros.checks.examination import OF_UNITS, run
from vsense_ros.checks.finding import Finding, Kind
from vsense_ros.checks.lags import LONG_LAGS, match
from vsense_ros.checks.mending import mends
from vsense_ros.checks.motion import GNSS
from vsense_ros.checks.roles import topics_of
from vsense_ros.checks.sentences import mend_in_words, sentence
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.checks.subject import Subject
from vsense_ros.identification.least_squares import DEFAULT, Fit, prior_weight, solve
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.ages import LAG_SEARCH
from vsense_ros.mismatch.candidates import BASE
from vsense_ros.mismatch.residuals import Residuals
from vsense_ros.mismatch.spoilt import readings_of, spoilt_stretches
from vsense_ros.mismatch.windows import Dataset, Readings, Window
from vsense_ros.model.sensors import MeasuredQuantity, SensorBase, best_measuring
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DataQualitySettings:
    """By which nothing can be said of recordings."""

    least: float = setting(10.0, "s", "of driving", JUDGEMENT)
    gentle: float = setting(0.15, "m/s²", "lateral and longitudinal, below which a drive shows nothing", JUDGEMENT)
    gripping: float = setting(4.0, "m/s²", "lateral, up to which the path follows the steering", JUDGEMENT)
    smooth: float = setting(0.5, "s", "of the means between which relations are judged", JUDGEMENT)
    radius_apart: float = setting(0.04, "-", "relative difference of rolling radii that two cars have", JUDGEMENT)
    strange: float = setting(2.0, "-", "standard deviations of residuals of recordings of several cars", JUDGEMENT)
    constant_apart: float = setting(
        1.7, "-", "scatter of a constant parameter over several cars, in its standard deviations", JUDGEMENT
    )
    antenna: float = setting(2.0, "m", "that an antenna may be beside the middle of a car", JUDGEMENT)
    antenna_share: float = setting(0.01, "-", "of the speed by which such an antenna may be faster", JUDGEMENT)
    tilt_apart: float = setting(1.5, "m/s²", "of gravity that a sensor which was moved has on another axis", JUDGEMENT)
    goes_along: float = setting(0.3, "-", "correlation of signals that follow from one another", JUDGEMENT)
    opposite: float = setting(-0.5, "-", "correlation of signals with opposite signs", JUDGEMENT)
    same_shape: float = setting(0.97, "-", "correlation of signals of which one has another unit", JUDGEMENT)


SETTINGS = DataQualitySettings()
# Which components of an inertial sensor a finding of the checks is about, by its signal.
COMPONENTS_OF: Mapping[str, tuple[int, ...]] = {
    "angular_velocity": (0, 1, 2),
    "angular_velocity.z": (2,),
    "linear_acceleration": (3, 4, 5),
    "linear_acceleration.x": (3,),
    "linear_acceleration.y": (4,),
}
CONSTANT = ("mass", "tyre radius")  # parameters that neither road nor driver changes


@dataclass(frozen=True)
class Hindrance:
    """A reason why recordings cannot be compared with a model.

    Where the reason is one signal, `topic` has it, and `components` are those of its sensor that are wrong, all of them
    where there are none; without it the rest may be compared. It is wrong in one `recording`, or in all of them where
    that is empty: a clock, a sign or a unit is the same in all, and only some show it.
    """

    reason: str
    topic: str = ""
    components: tuple[int, ...] = ()
    recording: str = ""


def hindrance(recordings: Sequence[Recording], fitted: Dataset, unseen: Dataset, vehicle: Vehicle) -> Hindrance | None:
    """The first reason why the recordings cannot be compared with a model; None where they can. `recordings` are all of
    them, `fitted` the windows to fit to, `unseen` those of the recordings that are held out."""
    return next(_hindrances(recordings, fitted, unseen, vehicle), None)


def _hindrances(
    recordings: Sequence[Recording], fitted: Dataset, unseen: Dataset, vehicle: Vehicle
) -> Iterator[Hindrance]:
    sensors = {**fitted.sensors, **unseen.sensors}
    yield from map(Hindrance, (*_given_twice(recordings), *_of_several_cars(recordings, sensors), *_twins(sensors)))
    drives = [*fitted.by_recording(), *unseen.by_recording()]
    for windows in drives:
        for stretch in spoilt_stretches(windows, sensors):
            topic = sensors[stretch.sensor].topic if stretch.sensor else ""
            yield Hindrance(stretch.reason, topic, stretch.components, windows[0].name)
    driven = {windows[0].name for windows in drives}
    yield from _units(recordings, sensors, float(np.mean(rolling_radii(vehicle))), driven)
    means = [(windows[0].name, Drive.of(windows, sensors, vehicle)) for windows in drives]
    yield from map(Hindrance, _too_little(fitted, [drive for _, drive in means[: len(fitted.by_recording())]]))
    for name, drive in means:
        yield from _unrelated(drive, name, sensors)
    yield from _unlike(means)


def faults_of(recording: Recording, vehicle: Vehicle) -> list[Finding]:
    """What would mend signs, axes and units of a recording that cannot be right, with sensors as the file has them."""
    sensors = vehicle.sensing()
    mounted = {s.topic for s in sensors.values() if recording_turned(recording, s)}
    topics = {s.topic for s in sensors.values() if _is_compared(s)} - mounted
    radius = float(np.mean(rolling_radii(vehicle)))
    findings = mends(_as_mounted(recording, sensors), topics_of(sensors.values()), radius)
    return [finding for finding in findings if finding.topic in topics]


def recording_turned(recording: Recording, sensor: SensorBase) -> bool:
    """True if the vehicle file says that a sensor of the recording is mounted in other axes than the car's."""
    channel = recording.channels.get(sensor.topic)
    return channel is not None and bool(sensor.message_in_axes_of_car(channel.columns))


def faults_in_words(recordings: Sequence[Recording], faults: Sequence[Sequence[Finding]]) -> list[str]:
    """By recording what would mend it."""
    return [
        f"what mends {recording.name}: {', '.join(map(mend_in_words, todo))}"
        for recording, todo in zip(recordings, faults, strict=True)
        if todo
    ]


def steps_in_words(recordings: Sequence[Recording], vehicle: Vehicle) -> list[str]:
    """By recording, which compared signals come in coarse steps or are sent more often than they are measured."""
    sensors = [sensor for sensor in vehicle.sensing().values() if _is_compared(sensor)]
    topics = {sensor.topic for sensor in sensors}
    return [
        f"{recording.name}, {finding.topic}: {sentence(finding)}"
        for recording in recordings
        for finding in run((values.quantised, values.held), Subject(recording, topics_of(sensors)))
        if finding.topic in topics
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
    if level > SETTINGS.strange and offsets.keys() >= set(CONSTANT):
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
        estimates = [change[at] for change in own]
        if np.std(estimates) > SETTINGS.constant_apart:
            low, high = int(np.argmin(estimates)), int(np.argmax(estimates))
            apart = 100 * (estimates[high] - estimates[low]) * base.free_parameters[at].deviation
            yield (
                f"the {name} of the car in {drives[high][0].name} is {apart:.0f} % more than in {drives[low][0].name}, "
                "and no parameters fit both; are they recordings of one car?"
            )


def _too_little(dataset: Dataset, drives: Sequence[Drive]) -> Iterator[str]:
    if not dataset.windows:
        yield "; ".join(dataset.remarks) or "there is no recording"
        return
    if dataset.driven < SETTINGS.least:
        yield f"only {dataset.driven:.1f} s of driving can be used, {SETTINGS.least:g} s are needed"
    lateral, longitudinal = (max(felt) for felt in zip(*(drive.strongest for drive in drives), strict=True))
    if lateral < SETTINGS.gentle and longitudinal < SETTINGS.gentle:
        yield (
            f"the car does nothing but go straight ahead at constant speed (at most {lateral:.2f} m/s² lateral and "
            f"{longitudinal:.2f} m/s² longitudinal)"
        )
    if not any("rates and forces" in dataset.sensors[name].measures for w in dataset.windows for name in w.readings):
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
    """Recordings with the measurements of another one, which would seem to prove what was found in the other."""
    names: dict[bytes, str] = {}
    for recording in recordings:
        content = recording.digest()
        if content in names:
            yield f"{names[content]} and {recording.name} hold the same measurements; leave one of them out"
        names[content] = recording.name


def _twins(sensors: Mapping[str, SensorBase]) -> Iterator[str]:
    for kind in sorted({sensor.kind for sensor in sensors.values() if _is_compared(sensor)}):
        names = [name for name, sensor in sensors.items() if sensor.kind == kind]
        if len(names) > 1:
            yield (
                f"the vehicle file has {len(names)} sensors of the kind {kind} with measurements "
                f"({', '.join(names)}), of which one can be compared; leave the others out of the file"
            )


def _units(
    recordings: Sequence[Recording], sensors: Mapping[str, SensorBase], radius: float, driven: Collection[str]
) -> Iterator[Hindrance]:
    """Units, signs and axes that cannot be right, as `vsense info` finds them, in what the model is compared with.
    Recordings that are not among the `driven` ones, of which something is compared, say nothing of the others."""
    for recording in recordings:
        subject = Subject(_as_mounted(recording, sensors), topics_of(sensors.values()), radius)
        signs = run((turning, axes_in_plane), subject)
        for finding in (*run(OF_UNITS, subject), *(one for one in signs if _is_sure(one))):
            if finding.topic in {sensor.topic for sensor in sensors.values() if _is_compared(sensor)}:
                reason = f"in {recording.name}, {finding.topic}: {sentence(finding)}"
                of_itself = recording.name if driven and recording.name not in driven else ""
                yield Hindrance(reason, finding.topic, COMPONENTS_OF.get(finding.signal, ()), of_itself)


def _is_sure(sign: Finding) -> bool:
    """True for a turning against that of GNSS, and for a single acceleration against how the car moves."""
    return sign.against == GNSS or (sign.kind is Kind.SIGN and sign.signal in COMPONENTS_OF)


def _as_mounted(recording: Recording, sensors: Mapping[str, SensorBase]) -> Recording:
    """The recording with inertial measurements in the axes of the car, where the vehicle file says that the sensor is
    turned away from them."""
    channels = dict(recording.channels)
    for sensor in sensors.values():
        if (channel := channels.get(sensor.topic)) is not None:
            turned = sensor.message_in_axes_of_car(channel.columns)
            channels[sensor.topic] = replace(channel, columns={**channel.columns, **turned})
    return replace(recording, channels=channels)


@dataclass(frozen=True)
class Drive:
    """Means over half a second of what physics relates, over all windows of a recording; NaN where not measured."""

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
    def of(cls, windows: Sequence[Window], sensors: Mapping[str, SensorBase], vehicle: Vehicle) -> Drive:
        chassis = vehicle.physics.chassis
        parts: dict[str, list[Array]] = {name: [] for name in cls.__dataclass_fields__ if name != "wheelbase"}
        for window in windows:
            t = np.arange(window.begin, window.end, SETTINGS.smooth / 2)
            imu, steering, torques = (
                readings_of(window, sensors, what) or Readings(np.zeros(0), np.zeros((0, 6)))
                for what in ("rates and forces", "steering", "torques")
            )
            speed = _mean(t, window.speed.t, window.speed.value[:, 0])
            parts["speed"].append(speed)
            parts["speed_rate"].append(np.gradient(speed, SETTINGS.smooth / 2))
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
        percentiles = []
        for acceleration in (self.turning, self.speed_rate):
            present = np.abs(acceleration[np.isfinite(acceleration)])
            percentiles.append(float(np.percentile(present, 95)) if len(present) else 0.0)
        return percentiles[0], percentiles[1]


def _unrelated(drive: Drive, name: str, sensors: Mapping[str, SensorBase]) -> Iterator[Hindrance]:
    """Signals that follow from one another by physics, and differ by more than any effect could make: a unit, a sign,
    an axis or a clock is wrong."""
    gentle = np.where(np.abs(drive.turning) < SETTINGS.gripping, 1.0, np.nan)
    bend = drive.wheelbase * drive.yaw_rate / drive.speed * gentle
    relations: tuple[tuple[str, MeasuredQuantity, tuple[int, ...], Array, str, Array, float, float, float], ...] = (
        ("lateral acceleration", "rates and forces", (4,), drive.lateral,
         "speed times yaw rate", drive.turning, 0.5, 0.5, 2.0),
        ("road-wheel angle", "steering", (), drive.steering,
         "wheelbase times yaw rate over speed", bend, 0.005, 0.3, 6.0),
        ("longitudinal acceleration", "rates and forces", (3,), drive.longitudinal,
         "change of the speed", drive.speed_rate, 0.5, 0.5, 2.0),
        ("wheel torque over radius and mass", "torques", (), drive.drive,
         "change of the speed", drive.speed_rate, 0.5, 0.3, 3.0),
    )  # fmt: skip
    for what, quantity, components, measured, other, expected, least, low, high in relations:
        if contradiction := _contradiction(measured, expected, least, (low, high)):
            sensor = best_measuring(sensors.items(), quantity)
            topic = "" if sensor is None else sensors[sensor].topic
            yield Hindrance(f"in {name} the {what} {contradiction.format(other=other)}", topic, components)


def _contradiction(measured: Array, expected: Array, least: float, sizes: tuple[float, float]) -> str:
    """What is wrong between a signal (n,) and what it follows from (n,), in words with a place for the `other`; empty
    where nothing is, or less than a standard deviation `least` is expected. `sizes` limit the ratio of the two."""
    both = np.isfinite(measured) & np.isfinite(expected)
    if both.sum() < SETTINGS.least / SETTINGS.smooth or np.std(expected[both]) < least:
        return ""
    size = float(np.std(measured[both]) / np.std(expected[both]))
    alike = float(np.corrcoef(measured[both], expected[both])[0, 1]) if size > 0 else 0.0
    if alike > SETTINGS.goes_along and sizes[0] < size < sizes[1]:
        return ""
    # The lag comes before sign and scale: what is a second late goes along with nothing.
    late = match(measured, expected, SETTINGS.smooth / 2, LONG_LAGS)
    if (
        late is not None
        and abs(late.lag) >= LAG_SEARCH.least_lag
        and late.clear > LAG_SEARCH.clearance
        and late.best > max(LAG_SEARCH.least_correlation, alike + LAG_SEARCH.correlation_gain)
    ):
        side = "behind" if late.lag > 0 else "ahead of"
        return f"lies {abs(late.lag):.1f} s {side} {{other}}; which of the clocks is wrong?"
    if alike < SETTINGS.opposite:
        return "has the sign opposite to {other}"
    if not sizes[0] < size < sizes[1]:
        # Another unit changes the size alone; a slow filter also the shape, of which a lag is a part.
        shape_kept = max(alike, late.best if late is not None else 0.0) > SETTINGS.same_shape
        doubt = "is its unit wrong" if shape_kept or size > 1 else "is it smoothed, or is its unit wrong"
        return f"is {size:.3g} times the {{other}}; {doubt}?"
    return "does not go along with {other}; is a clock or an axis wrong?"


def _unlike(drives: Sequence[tuple[str, Drive]]) -> Iterator[Hindrance]:
    """Recordings, by name, between which the car or its sensors have changed; the one that differs from all others,
    where these agree."""
    radii: list[tuple[float, str]] = []
    tilts: list[tuple[Array, str]] = []
    for name, drive in drives:
        steady = np.isfinite(drive.over_ground) & np.isfinite(drive.rolling) & (np.abs(drive.speed_rate) < 1.0)
        if steady.sum() >= SETTINGS.least / SETTINGS.smooth:
            radii += [(ratio, name) for ratio in _over_rolling(drive, steady)]
        felt = np.array([drive.longitudinal - drive.speed_rate, drive.lateral - drive.turning])
        present = np.isfinite(felt).all(axis=0)
        if present.sum() >= SETTINGS.least / SETTINGS.smooth:
            tilts.append((felt[:, present].mean(axis=1), name))
    if radii:
        (small, of_small), (large, of_large) = min(radii), max(radii)
        if large > (1 + SETTINGS.radius_apart) * small:
            odd = _odd_one(radii, lambda low, high: high <= (1 + SETTINGS.radius_apart) * low)
            yield Hindrance(
                f"the wheels of {of_large} are {100 * (large / small - 1):.0f} % larger than those of {of_small}; "
                + (f"is {odd} of another car than the others?" if odd else "are they recordings of one car?"),
                recording=odd,
            )
    for axis, what in enumerate(("longitudinal", "lateral")):
        at = [(float(tilt[axis]), name) for tilt, name in tilts]
        if at and max(at)[0] - min(at)[0] > SETTINGS.tilt_apart:
            odd = _odd_one(at, lambda low, high: high - low <= SETTINGS.tilt_apart)
            yield Hindrance(
                f"between {min(at)[1]} and {max(at)[1]} the {what} accelerometer has shifted by "
                f"{max(at)[0] - min(at)[0]:.1f} m/s²; is it one car, and does the sensor sit where it sat?"
                + (f" {odd} differs from the others" if odd else ""),
                recording=odd,
            )


def _odd_one(values: Sequence[tuple[float, str]], agree: Callable[[float, float], bool]) -> str:
    """The only recording, by name, without which the smallest and the largest value of the others `agree`; empty where
    there is none, or fewer than two others."""
    names = list(dict.fromkeys(name for _, name in values))
    odd = []
    for name in names:
        rest = [value for value, of in values if of != name]
        if len(names) > 2 and agree(min(rest), max(rest)):
            odd.append(name)
    return odd[0] if len(odd) == 1 else ""


def _over_rolling(drive: Drive, steady: NDArray[np.bool_]) -> list[float]:
    """Speed over ground over that of the wheels; none where bends to one side leave it open, as an antenna beside the
    middle of the car is faster or slower there."""
    ratio = drive.over_ground[steady] / drive.rolling[steady]
    bent = np.nan_to_num(drive.yaw_rate[steady] / drive.speed[steady])
    if SETTINGS.antenna * abs(float(np.mean(bent))) < SETTINGS.antenna_share:
        return [float(np.median(ratio))]
    if float(np.std(bent)) < abs(float(np.mean(bent))):
        return []
    return [float(np.polyfit(bent, ratio, 1)[1])]


def _speed(t: Array, window: Window, sensors: Mapping[str, SensorBase], what: MeasuredQuantity, radius: float) -> Array:
    """Means of the speed that a sensor measures in a window around the times `t` [s]; NaN where there is none."""
    name = best_measuring(((name, sensors[name]) for name in window.readings), what)
    if name is None:
        return np.full(len(t), np.nan)
    readings = window.readings[name]
    return _mean(t, readings.t, sensors[name].mean_speed(readings.value, radius))


def _mean(at: Array, t: Array, value: Array) -> Array:
    """Means over half a second around the times `at`; NaN where there is nothing."""
    return means_around(at, t, value, SETTINGS.smooth)


def _is_compared(sensor: SensorBase) -> bool:
    """True if a simulation needs the sensor, or is compared with it: then one of its kind is enough."""
    return bool(sensor.signals) or sensor.is_input
