"""How well an observer predicts where a car goes while its GNSS receiver is silent.

The receiver is taken away for some seconds, again and again. What the observer then says of the course is a prediction
of messages that it never hears: the gyro carries its heading on, and the model its side slip, so that the course at
the antenna goes wrong by what gyro, steering, latencies and tyres of the vehicle file are wrong by. No reference is
needed. Two vehicle files can be compared by the same silences, pair by pair (Diebold & Mariano 1995).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vsense_ros.errors import InputError
from vsense_ros.identification.progress import Progress, part
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.model.sensors import GnssVelocity, SensorBase
from vsense_ros.model.sensors.gnss import Receiver
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.runner.run import run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PredictionSettings:
    """How silences are made and judged: decisions of this project."""

    settled: float = 15.0  # [s] for which the observer hears everything first
    silence: float = 6.0  # [s] long enough for a bend, short enough for a gyro that is off by 0.1 °/s
    between: float = 6.0  # [s] in which it hears the receiver again
    slowest: float = 4.0  # [m/s] below which a course says little
    largest: float = 0.05  # [rad] beyond which an error counts no more: a car that stops has any course
    rate: float = 20.0  # [Hz] of the estimates
    fewest: int = 4  # silences, without which nothing is judged
    # [-] standard errors by which a file must predict worse to be refused: by chance 2 of 100 equally good ones do.
    worse: float = 2.0


PREDICTION = PredictionSettings()


@dataclass(frozen=True)
class Prediction:
    """Mean square error of the course in each silence, (k,) [rad²]; NaN where the car was slow or not followed."""

    squares: Array

    @property
    def error(self) -> float:
        """Root mean square error of the course over all silences [rad]."""
        return float(np.sqrt(np.nanmean(self.squares))) if np.isfinite(self.squares).any() else float("nan")


@dataclass(frozen=True)
class Comparison:
    """Two vehicle files by the same silences: errors [rad] before and after, and how many standard errors the mean
    square error is larger after."""

    before: float
    after: float
    silences: int
    increase: float

    @property
    def is_worse(self) -> bool:
        """True if the new file predicts worse than the old one by more than chance."""
        return self.silences >= PREDICTION.fewest and self.increase > PREDICTION.worse

    @property
    def sentence(self) -> str:
        """The comparison in words."""
        if self.silences < PREDICTION.fewest:
            return (
                f"Not judged by prediction: the drives have {self.silences} stretches of {PREDICTION.silence:g} s with "
                f"GNSS in which the car drives and the observer follows; expected {PREDICTION.fewest} or more."
            )
        return (
            f"In {self.silences} stretches of {PREDICTION.silence:g} s whose GNSS the observer did not hear, it "
            f"predicted the course to {np.degrees(self.before):.2f}° before and {np.degrees(self.after):.2f}° after."
        )

    def as_dict(self) -> dict[str, float | int]:
        """The comparison as JSON: errors in degrees."""
        return {
            "silences": self.silences,
            "before_deg": float(np.degrees(self.before)) if self.silences else 0.0,
            "after_deg": float(np.degrees(self.after)) if self.silences else 0.0,
        }


def predict(recordings: Sequence[Recording], vehicle: Vehicle, progress: Progress | None = None) -> Prediction:
    """Errors of the course in silences of the receiver, on recordings in a row.

    The course is compared at the antenna of the vehicle file, at the times of measurement by its latency. Where the
    observer does not start, it follows nothing. Raises `InputError` where the vehicle has no GNSS velocity.
    """
    antenna = next((sensor for sensor in vehicle.sensors.values() if isinstance(sensor, GnssVelocity)), None)
    if antenna is None:
        raise InputError(f"{vehicle.name}: a prediction is compared with a GNSS velocity, which the file does not have")
    heard = [recording for recording in recordings if antenna.topic in recording]
    parts = [_squares(recording, vehicle, antenna, part(progress, i, len(heard))) for i, recording in enumerate(heard)]
    return Prediction(np.concatenate(parts) if parts else np.zeros(0))


def compare(before: Prediction, after: Prediction) -> Comparison:
    """Compare two predictions of the same silences. Those that the file before could not follow do not count; where
    only the file after could not, it has the largest error."""
    followed = np.isfinite(before.squares)
    old = before.squares[followed]
    new = np.nan_to_num(after.squares[followed], nan=PREDICTION.largest**2)
    if not len(old):
        return Comparison(float("nan"), float("nan"), 0, 0.0)
    difference = new - old
    spread = float(np.std(difference, ddof=1) / np.sqrt(len(old))) if len(old) > 1 else float("inf")
    increase = float(np.mean(difference)) / spread if spread > 0 else 0.0
    return Comparison(float(np.sqrt(old.mean())), float(np.sqrt(new.mean())), len(old), increase)


def judged(
    recordings: Sequence[Recording], before: Vehicle, after: Vehicle, progress: Progress | None = None
) -> Comparison | None:
    """Compare two files of a car by predictions on recordings; None where none of these has a GNSS velocity."""
    antenna = next((sensor for sensor in before.sensors.values() if isinstance(sensor, GnssVelocity)), None)
    if antenna is None or not any(antenna.topic in recording for recording in recordings):
        return None
    predictions = (predict(recordings, vehicle, part(progress, i, 2)) for i, vehicle in enumerate((before, after)))
    return compare(*predictions)


def _squares(recording: Recording, vehicle: Vehicle, antenna: GnssVelocity, progress: Progress | None) -> Array:
    """Mean square errors (k,) of the course in the silences of a recording [rad²]."""
    gnss = recording[antenna.topic]
    period = PREDICTION.silence + PREDICTION.between
    first = recording.first_stamp + round(PREDICTION.settled * 1e9)
    count = max(int((int(gnss.stamp.max()) - first) * 1e-9 / period), 0)
    if not count:
        return np.zeros(0)
    silent = {sensor.topic for sensor in vehicle.sensors.values() if isinstance(sensor, Receiver)}
    channels = {
        topic: channel.select(_silence_of(channel, first, period) < 0) if topic in silent else channel
        for topic, channel in recording.channels.items()
    }
    try:
        heard = replace(recording, channels=channels)
        output = run(heard, vehicle, rate=PREDICTION.rate, progress=progress).output["vsense/odometry"]
    except InputError:
        return np.full(count, np.nan)
    number = _silence_of(gnss, first, period)
    east, north = gnss.columns["linear"][:, :2].T
    predicted = _velocity_at(output, antenna, gnss.stamp - round(antenna.latency * 1e9))
    error = np.angle((predicted[:, 0] + 1j * predicted[:, 1]) * (east - 1j * north))
    rows = (np.hypot(east, north) > PREDICTION.slowest) & np.isfinite(error)
    squares = np.full(count, np.nan)
    for k in range(count):
        inside = rows & (number == k)
        if inside.sum() > 0.5 * (number == k).sum():
            squares[k] = np.mean(np.minimum(error[inside] ** 2, PREDICTION.largest**2))
    return squares


def _silence_of(channel: Channel, first: int, period: float) -> NDArray[np.int64]:
    """The number of the silence in which each message is measured (n,), -1 for none."""
    since = (channel.stamp - first) * 1e-9
    number = np.floor(since / period).astype(np.int64)
    return np.where((since >= 0) & (since - number * period >= PREDICTION.between), number, -1)


def _velocity_at(odometry: Channel, sensor: SensorBase, stamp: NDArray[np.int64]) -> Array:
    """Velocity of an antenna over ground (n, 2) [m/s], east and north, at `stamp` (n,) [ns]; NaN outside."""
    arm = np.array([*sensor.mounting()[:2], 0.0])
    turning = np.nan_to_num(odometry.columns["angular"])
    velocity = np.nan_to_num(odometry.columns["linear"]) + np.cross(turning, arm)
    over_ground = Rotation.from_quat(odometry.columns["orientation"]).apply(velocity)
    columns = [np.interp(stamp, odometry.stamp, column, np.nan, np.nan) for column in over_ground[:, :2].T]
    return np.column_stack(columns)
