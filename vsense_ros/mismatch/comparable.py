"""What of recordings can be compared with a model: windows to fit to, windows to prove it on, without wrong signals.

A signal that contradicts the others is left out, with a remark that says why, and the rest is compared without it. So
one bad signal does not prevent an answer that the others can give.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vsense_ros.checks.aligned import INERTIAL_FIELDS
from vsense_ros.messages.recording import Recording
from vsense_ros.mismatch.beforehand import Beforehand, beforehand, with_sizes
from vsense_ros.mismatch.data_quality import Hindrance, hindrance
from vsense_ros.mismatch.spoilt import without_spoilt
from vsense_ros.mismatch.windows import Dataset
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle

MOST_LEFT_OUT = 8  # signals; where more are wrong, it is not one of them


class NotAssessableError(Exception):
    """Nothing can be said of the recordings; the message says why."""


@dataclass(frozen=True)
class Comparable:
    """Recordings without the signals that cannot be right: `fitted` windows of `recordings`, and `unseen` ones of
    `held_out`, with the `vehicle` that has the defects of its sensors which are `known` before any fit.
    `left_out` says which signals are missing and why; `refused` why nothing can be compared, empty where something can.
    """

    recordings: Sequence[Recording]
    held_out: Sequence[Recording]
    fitted: Dataset
    unseen: Dataset
    vehicle: Vehicle
    known: Sequence[Beforehand]
    left_out: tuple[str, ...] = ()
    refused: str = ""


def comparable(recordings: Sequence[Recording], held_out: Sequence[Recording], vehicle: Vehicle) -> Comparable:
    """What can be compared of `recordings` and of those that are `held_out`."""
    result = _compared(recordings, held_out, vehicle, _known(recordings, held_out, vehicle))
    while wrong := hindrance([*result.recordings, *result.held_out], result.fitted, result.unseen, result.vehicle):
        rest = _without(result, wrong, vehicle) if len(result.left_out) < MOST_LEFT_OUT else None
        if rest is None:
            return replace(result, refused="; ".join((*result.left_out, wrong.reason)))
        result = rest
    return result


def _known(recordings: Sequence[Recording], held_out: Sequence[Recording], vehicle: Vehicle) -> tuple[Beforehand, ...]:
    """Defects of sensors that show before any fit; the windows that show them are hundreds of megabytes after hours of
    driving, and are not kept."""
    fitted = without_spoilt(recordings, vehicle)
    return beforehand(fitted, without_spoilt(held_out, vehicle, fitted), vehicle)


def _compared(
    recordings: Sequence[Recording], held_out: Sequence[Recording], vehicle: Vehicle, known: Sequence[Beforehand]
) -> Comparable:
    """The windows of recordings of a vehicle with the defects of its sensors that are `known`."""
    car = with_sizes(vehicle, known)
    fitted = without_spoilt(recordings, car)
    return Comparable(recordings, held_out, fitted, without_spoilt(held_out, car, fitted), car, known)


def _without(compared: Comparable, wrong: Hindrance, vehicle: Vehicle) -> Comparable | None:
    """The rest without a signal that is wrong, or without the recording that differs from all others, with the defects
    that are known with it; None where it is nothing that can be missing."""
    if wrong.recording and not wrong.topic:
        others, unseen = (
            [one for one in every if one.name != wrong.recording] for every in (compared.recordings, compared.held_out)
        )
        same_car = _compared(others, unseen, vehicle, compared.known)
        return replace(same_car, left_out=(*compared.left_out, wrong.reason)) if same_car.fitted.windows else None
    sensor = next((sensor for sensor in vehicle.sensing().values() if sensor.topic == wrong.topic), None)
    if sensor is None:
        return None

    def rest_of(every: Iterable[Recording]) -> list[Recording]:
        return [
            without_components(one, sensor, wrong.components) if wrong.recording in ("", one.name) else one
            for one in every
        ]

    rest = _compared(rest_of(compared.recordings), rest_of(compared.held_out), vehicle, compared.known)
    if len(rest.fitted.by_recording()) < len(compared.fitted.by_recording()):
        return None
    return replace(rest, left_out=(*compared.left_out, wrong.reason))


def without_components(recording: Recording, sensor: SensorBase, components: Sequence[int]) -> Recording:
    """The recording without these components of a sensor, in the axes of the car; without its topic where they are all,
    or not components of an inertial sensor, which alone may lack some."""
    if (channel := recording.channels.get(sensor.topic)) is None:
        return recording
    columns = dict(channel.columns)
    inertial = all(field in columns for field in INERTIAL_FIELDS)
    if not components or not inertial or len(components) == len(sensor.components):
        return replace(recording, channels={k: c for k, c in recording.channels.items() if k != sensor.topic})
    for number, field in enumerate(INERTIAL_FIELDS):
        wrong = [component - 3 * number for component in components if component // 3 == number]
        if wrong:
            columns[field] = columns[field].copy()
            columns[field][:, _axes_of_sensor(sensor, wrong)] = np.nan
    return replace(recording, channels={**recording.channels, sensor.topic: replace(channel, columns=columns)})


def _axes_of_sensor(sensor: SensorBase, axes: Sequence[int]) -> list[int]:
    """The axes of a sensor that are nearest to these of the car."""
    units = {field: np.eye(3) for field in INERTIAL_FIELDS}
    turned = sensor.message_in_axes_of_car(units)
    if not turned:
        return list(axes)
    of_car = turned["angular_velocity"]  # row: axis of the sensor, in the axes of the car
    return [int(np.argmax(np.abs(of_car[:, axis]))) for axis in axes]
