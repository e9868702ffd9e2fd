"""The innovations of an observer on a recording: what its sensors said beyond what it expected of them.

If the filter is right about itself, they are white noise of the covariance that it states (Mehra 1970), and the product
of their densities is the likelihood of the recording (Schweppe 1965).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Innovation
from vsense_ros.messages.recording import Recording
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.catalogue import FILTERS
from vsense_ros.observer.observer import Observer
from vsense_ros.observer.run import topics_in

Array = NDArray[np.float64]

MOST_OUTLIERS = 0.05  # of the messages of a sensor


@dataclass(frozen=True)
class Innovations:
    """Of one sensor on one recording, in order of measurement.

    `whitened` (n, m): each component, less what those before it in the same message tell, in units of its standard
    deviation, `deviation` (n, m) [units of the sensor]; both NaN where a component was absent. `used` (n,) is False
    where the gate refused the message.
    """

    whitened: Array
    deviation: Array
    used: NDArray[np.bool_]

    def log_density(self) -> Array:
        """Of each message given all before it, whether it was used or not, (n,)."""
        scale = np.nansum(np.log(self.deviation * np.sqrt(2 * np.pi)), axis=1)
        return -scale - 0.5 * np.nansum(self.whitened**2, axis=1)

    def credible(self) -> NDArray[np.bool_]:
        """Messages (n,) that are no outliers: what the gate let pass, and all if it refused more than `MOST_OUTLIERS`
        of them, since then it is the filter that is wrong."""
        return self.used | (np.mean(self.used) < 1 - MOST_OUTLIERS)


def innovations(recording: Recording, vehicle: Vehicle) -> dict[str, Innovations]:
    """Of each sensor with messages in a recording, by name.

    The filter is the errorEKF. Messages are taken in order of measurement, not of arrival, so that each innovation is
    given all that was measured before it. Raises `InputError` if the observer never starts.
    """
    seen: dict[str, list[tuple[bool, Array]]] = {}

    def keep(sensor: str, innovation: Innovation) -> None:
        if not innovation.nis < 0:
            whitened = innovation.whitened
            deviation = np.where(np.isnan(whitened), np.nan, innovation.factor.diagonal())
            seen.setdefault(sensor, []).append((innovation.accepted, np.stack([whitened, deviation])))

    observer = Observer(vehicle, recording.map_origin, FILTERS["error_ekf"].make, keep)
    topics = topics_in(recording, observer)
    for sample in _as_measured(recording, observer.sensors).samples(topics):
        observer.add(sample)
    if not observer.started:
        text = "; ".join(f"{d.name}: {d.message}" for d in observer.diagnostics())
        raise InputError(f"{recording.name or 'recording'}: the observer never started ({text})")
    found = {}
    for name in observer.sensors:
        if name in seen:
            whitened, deviation = np.array([innovation for _, innovation in seen[name]]).transpose(1, 0, 2)
            found[name] = Innovations(whitened, deviation, np.array([used for used, _ in seen[name]]))
    return found


def _as_measured(recording: Recording, sensors: dict[str, SensorBase]) -> Recording:
    """Every message arrives when it was measured."""
    latency = {sensor.topic: round(sensor.latency * 1e9) for sensor in sensors.values()}
    channels = {
        topic: replace(channel, received=channel.stamp - latency[topic]) if topic in latency else channel
        for topic, channel in recording.channels.items()
    }
    return replace(recording, channels=channels)
