"""Stretches of recordings that would spoil every figure: spins, frozen signals, sensors at the end of their range.

They are cut out and mentioned in the remarks, unless little would remain of a recording: then the fault is the whole
recording's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from vsense_ros.checks.aligned import means_around, runs_of_equal_values, stretches
from vsense_ros.checks.setting import JUDGEMENT, setting
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.windows import WINDOWS, Dataset, Readings, Spoilt, Window, build_dataset, within
from vsense_ros.model.sensors import MeasuredQuantity, Response, SensorBase, best_measuring
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SpoiltSettings:
    """By which stretches of a recording are spoilt."""

    kept: float = setting(0.5, "-", "of the driving of a recording that has to remain for cuts", JUDGEMENT)
    rounds: int = setting(3, "-", "of looking for what is spoilt, as what is cut out hides less", JUDGEMENT)
    listed: int = setting(4, "-", "stretches that a remark lists", JUDGEMENT)
    around: float = setting(0.5, "s", "that are cut out before and after a stretch", JUDGEMENT)
    spin: float = setting(13.0, "m/s²", "speed times yaw rate that no car on a road has", "grip of race tyres, 1.3")
    slide: float = setting(0.7, "rad", "by which side slip changes in `slide_time` only if the car spins", JUDGEMENT)
    slide_time: float = setting(3.0, "s", "in which side slip changes by `slide`", JUDGEMENT)
    coarse: int = setting(100, "-", "values of a signal; one with fewer may well keep its value", JUDGEMENT)
    frozen_rows: int = setting(10, "-", "samples for which a signal keeps its value, at least", JUDGEMENT)
    saturated: int = setting(8, "-", "times longer at the end of a range than at other values, in samples", JUDGEMENT)
    clipped: int = setting(3, "-", "times that a steering angle is so; it may be held at one end once", JUDGEMENT)
    still: float = setting(2.0, "s", "of the same input during which the car begins to move otherwise", JUDGEMENT)
    response: float = setting(0.5, "s", "in which a car follows what went before", JUDGEMENT)
    foresight: float = setting(0.3, "s", "by which means and clocks reach beyond an end", JUDGEMENT)
    other_shape: float = setting(0.5, "-", "of its largest amount by which the response changes", JUDGEMENT)
    moment: float = setting(0.2, "s", "of means beside which one wild sample is no motion", JUDGEMENT)


SETTINGS = SpoiltSettings()


def without_spoilt(recordings: Sequence[Recording], vehicle: Vehicle, seen: Dataset | None = None) -> Dataset:
    """The windows of recordings outside of stretches that would spoil every figure, with remarks that say which these
    are; all windows where little of a recording would remain, as then the fault is the whole recording's."""
    whole = kept = build_dataset(recordings, vehicle, seen)
    cut: list[Spoilt] = []
    for _ in range(SETTINGS.rounds):
        new = [stretch for windows in kept.by_recording() for stretch in spoilt_stretches(windows, kept.sensors)]
        if not new:
            break
        cut += new
        kept = build_dataset(recordings, vehicle, seen, cut)
    before, after = ({w[0].recording: _duration(w) for w in of.by_recording()} for of in (whole, kept))
    lost = {index for index, duration in before.items() if after.get(index, 0.0) < SETTINGS.kept * duration}
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
        when = ", ".join(f"{begin:.1f} to {end:.1f} s" for begin, end in spans[: SETTINGS.listed])
        more = f" and {len(spans) - SETTINGS.listed} more" if len(spans) > SETTINGS.listed else ""
        yield f"cut out: {reason} ({when}{more})"


def _duration(windows: Sequence[Window]) -> float:
    return sum(window.end - window.begin for window in windows)


def spoilt_stretches(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    """Stretches of one recording that would spoil every figure."""
    # What is cut out stays in the margins of the neighbours.
    windows = [replace(w, readings=within(w.readings, w.begin, w.end)) for w in windows]
    yield from _standing_still(windows, sensors)
    yield from _saturated(windows, sensors)
    yield from _clipped(windows, sensors)
    yield from _spinning(windows, sensors)


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
                coarse = 1 < len(np.unique(value)) < SETTINGS.coarse
                if length[long] >= SETTINGS.frozen_rows and duration >= sensor.longest(coarse=coarse):
                    begin = t[first[long]]
                    yield _stretch(
                        window, begin, begin + duration,
                        f"the {component.words} is frozen for {duration:.1f} s from {begin:.1f} s on in {window.name}",
                        name, (column,),
                    )  # fmt: skip
            if sensor.response is not None:
                yield from _input_still(window, readings, sensor.response, sensors)


def _input_still(
    window: Window, driven: Readings, expected: Response, sensors: Mapping[str, SensorBase]
) -> Iterator[Spoilt]:
    """A driver may well hold wheel and pedals still, but then the motion of the car does not change."""
    imu = readings_of(window, sensors, "rates and forces")
    present = np.isfinite(driven.value).all(axis=1)
    value, t = driven.value[present], driven.t[present]
    if imu is None or len(t) < 2 or np.isfinite(imu.value[:, expected.component]).sum() < 2:
        return
    response, at = _present(imu, expected.component)
    if expected.by_speed:
        speed = np.interp(at, window.speed.t, window.speed.value[:, 0])
        response = means_around(at, at, response * speed, SETTINGS.moment)
        shape = response / np.maximum(speed, 1.0) ** 2
    else:
        response = shape = means_around(at, at, response, SETTINGS.moment)
    for first, length in zip(*runs_of_equal_values(value), strict=True):
        begin, end = t[first], t[first + length - 1]
        # The car needs a while to follow what went before, and means and clocks reach beyond the end.
        inside = (at >= begin + SETTINGS.response) & (at <= end - SETTINGS.foresight)
        if end - begin < SETTINGS.still or not inside.any():
            continue
        if np.ptp(response[inside]) > expected.least and np.ptp(shape[inside]) > SETTINGS.other_shape * np.max(
            np.abs(shape)
        ):
            reason = f"{expected.words} frozen for {end - begin:.1f} s from {begin:.1f} s on in {window.name}"
            yield _stretch(window, begin, end, reason)


def _stretch(
    window: Window, begin: float, end: float, reason: str, sensor: str = "", components: tuple[int, ...] = ()
) -> Spoilt:
    """The stretch with some time around it."""
    return Spoilt(window.recording, begin - SETTINGS.around, end + SETTINGS.around, reason, sensor, components)


def _saturated(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    """Signals that stay at their largest or smallest value as at no other."""
    for name in sorted({name for window in windows for name in window.readings if sensors[name].saturates}):
        for column, component in enumerate(sensors[name].components):
            readings = [(w, w.readings[name].in_own_axes) for w in windows if name in w.readings]
            ends, runs, elsewhere = _held(readings, column)
            usual = float(np.percentile(elsewhere, 99)) if len(elsewhere) else 1.0
            for end in ends:
                reason = f"the {component.words} is at the end of its range, {end:.4g}, in {windows[0].name}"
                held = _held_at(runs, end, SETTINGS.saturated * usual, reason)
                yield from (replace(stretch, sensor=name, components=(column,)) for stretch in held)


_Run = tuple[Window, Array, Array, NDArray[np.int64], NDArray[np.int64]]  # values, times, first and length of each


def _held(readings: Sequence[tuple[Window, Readings]], column: int) -> tuple[tuple[float, ...], list[_Run], Array]:
    """The ends of the range of a component, for how long it has one value, and those lengths elsewhere than at its
    ends; no ends if it has too few values."""
    present = [(window, *_present(rows, column)) for window, rows in readings]
    runs = [(window, value, t, *runs_of_equal_values(value)) for window, value, t in present if len(value)]
    every = np.concatenate([value for _, value, *_ in runs]) if runs else np.zeros(0)
    ends = () if len(np.unique(every)) < SETTINGS.coarse else (float(every.max()), float(every.min()))
    elsewhere = [length[~np.isin(value[first], ends)] for _, value, _, first, length in runs]
    return ends, runs, np.concatenate(elsewhere) if runs else np.zeros(0)


def _held_at(runs: Sequence[_Run], end: float, least: float, reason: str) -> Iterator[Spoilt]:
    """Where a signal has one value for so many samples."""
    for window, value, t, first, length in runs:
        for begin, count in zip(first, length, strict=True):
            if value[begin] == end and count >= least:
                yield _stretch(window, float(t[begin]), float(t[begin + count - 1]), reason)


def _clipped(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    """A steering angle that stays again and again at the ends of its range, and nowhere else."""
    for name in sorted({name for w in windows for name in w.readings if "steering" in sensors[name].measures}):
        ends, runs, elsewhere = _held([(w, w.readings[name]) for w in windows if name in w.readings], 0)
        longest = int(elsewhere.max(initial=1))
        for end in ends:
            reason = f"the steering angle is at the end of its range, {end:.4g} rad, in {windows[0].name}"
            held = list(_held_at(runs, end, SETTINGS.saturated * longest, reason))
            if len(held) >= SETTINGS.clipped:
                yield from held


def _spinning(windows: Sequence[Window], sensors: Mapping[str, SensorBase]) -> Iterator[Spoilt]:
    for window in windows:
        imu = readings_of(window, sensors, "rates and forces")
        rate, t = (np.zeros(0), np.zeros(0)) if imu is None else _present(imu, 2)
        if len(t) < 2:
            continue
        speed = np.interp(t, window.speed.t, window.speed.value[:, 0])
        fast = np.abs(means_around(t, t, rate * speed, SETTINGS.moment)) > SETTINGS.spin
        reason = f"the car spins in {window.name}, or the unit of its yaw rate or speed is wrong"
        yield from (_stretch(window, *span, reason) for span in _spans(t, fast))
        velocity = readings_of(window, sensors, "course")
        if velocity is None:
            continue
        moving = np.isfinite(velocity.value).all(axis=1) & (np.hypot(*velocity.value[:, :2].T) > WINDOWS.slowest)
        if moving.sum() < 2:
            continue
        at, (east, north) = velocity.t[moving], velocity.value[moving, :2].T
        heading = cumulative_trapezoid(rate, t, initial=0)
        slip = np.unwrap(np.arctan2(north, east)) - np.interp(at, t, heading)
        earlier = np.interp(at - SETTINGS.slide_time, at, slip)
        known = (at <= t[-1]) & (np.maximum(at - SETTINGS.slide_time, at[0]) >= t[0])  # how the car has turned
        reason = f"the car spins or slides sideways in {window.name}: its course and its yaw rate part"
        for begin, end in _spans(at, (np.abs(slip - earlier) > SETTINGS.slide) & known):
            yield _stretch(window, begin - SETTINGS.slide_time, end, reason)


def _spans(t: Array, where: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Begin and end [s] of each stretch in which a mask is true."""
    return [(float(t[first]), float(t[end - 1])) for first, end in stretches(where)]


def readings_of(window: Window, sensors: Mapping[str, SensorBase], what: MeasuredQuantity) -> Readings | None:
    """The readings of a window by the sensor that measures something; None without one."""
    name = best_measuring(((name, sensors[name]) for name in window.readings), what)
    return None if name is None else window.readings[name]


def _present(readings: Readings, column: int) -> tuple[Array, Array]:
    """Values of a component and their times, without those that are absent."""
    value = readings.value[:, column]
    present = np.isfinite(value)
    return value[present], readings.t[present]
