"""The innovations of an observer on a recording: what its sensors said beyond what it expected of them.

If the filter is right about itself, they are white noise of the covariance that it states (Mehra 1970), and the product
of their densities is the likelihood of the recording (Schweppe 1965).
"""

from __future__ import annotations

from dataclasses import replace
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from vsense_ros.estimation.filter import Innovation
from vsense_ros.estimation.innovations import Innovations
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.runner.playing import play
from vsense_ros.runner.run import Collected, never_started, topics_in
from vsense_ros.runner.runner import Runner

Array = NDArray[np.float64]


def innovations(recording: Recording, vehicle: Vehicle, *, noise_as_stated: bool = False) -> dict[str, Innovations]:
    """Innovations of each sensor with messages in a recording, by name.

    The filter is the errorEKF. Messages are taken in order of measurement, not of arrival, so that each innovation is
    given all that was measured before it; what the observer goes back for and does again does not count again. With
    `noise_as_stated`, sensors are as noisy as the file or their messages state, even where their readings show more and
    the observer would believe these. Raises `InputError` if the observer never starts.
    """
    by_sensor, _ = _watched(recording, vehicle, None, noise_as_stated)
    return by_sensor


def innovations_and_output(
    recording: Recording, vehicle: Vehicle, rate: float = 100.0
) -> tuple[dict[str, Innovations], Recording]:
    """`innovations`, and what the same filter estimates, at `rate` [Hz] or less."""
    return _watched(recording, vehicle, int(0.999e9 / rate))


def _watched(
    recording: Recording, vehicle: Vehicle, interval: int | None, noise_as_stated: bool = False
) -> tuple[dict[str, Innovations], Recording]:
    """Innovations by sensor, and what is estimated once in each `interval` [ns]; without one, nothing of it."""
    seen: dict[str, list[tuple[int, bool, Array]]] = {}

    def keep(sensor: str, stamp: int, innovation: Innovation) -> None:
        if not innovation.nis < 0:
            whitened = innovation.whitened
            deviation = np.where(np.isnan(whitened), np.nan, innovation.factor.diagonal())
            seen.setdefault(sensor, []).append((stamp, innovation.accepted, np.stack([whitened, deviation])))

    runner = Runner(vehicle, recording.map_origin, FILTERS["error_ekf"].make, keep)
    if noise_as_stated:
        runner.intake.take_noise_as_stated()
    collected, last = Collected(runner.adapter), 0
    for _ in play(runner, _as_measured(recording, runner.sensors), topics_in(recording, runner.topics)):
        if interval is not None and runner.started and runner.stamp >= last + interval:
            last, newest = runner.stamp, runner.incomplete_snapshot()
            if runner.started:
                collected.add(newest)
    if not runner.started:
        raise never_started(recording, runner)
    by_sensor = {}
    for name in runner.sensors:
        if name in seen:
            in_order = sorted(seen[name], key=itemgetter(0))
            whitened, deviation = np.array([innovation for *_, innovation in in_order]).transpose(1, 0, 2)
            used, stamps = np.array([used for _, used, _ in in_order]), np.array([stamp for stamp, *_ in in_order])
            by_sensor[name] = Innovations(whitened, deviation, used, stamps)
    return by_sensor, collected.recording(recording) if collected.count else Recording({}, name=recording.name)


def _as_measured(recording: Recording, sensors: dict[str, SensorBase]) -> Recording:
    """Every message arrives when it was measured."""
    latency = {sensor.topic: round(sensor.latency * 1e9) for sensor in sensors.values()}
    channels = {
        topic: replace(channel, received=channel.stamp - latency[topic]) if topic in latency else channel
        for topic, channel in recording.channels.items()
    }
    return replace(recording, channels=channels)
