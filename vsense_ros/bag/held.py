"""Messages of a satellite receiver that repeat its latest values until new ones come: each measurement is kept once.

A driver that publishes a receiver's 10 Hz at 100 Hz would make a filter believe each of them ten times.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.held import first_of_each, period_of_updates
from vsense_ros.messages.recording import Channel, Recording

_FIX = "sensor_msgs/msg/NavSatFix"


def without_repeats(recording: Recording) -> Recording:
    """The recording with each measurement of a satellite receiver once; notes say where there were more."""
    notes: list[str] = []
    channels = {
        topic: _once(channel, notes) if channel.kind == _FIX or topic.startswith("gps/") else channel
        for topic, channel in recording.channels.items()
    }
    if not notes:
        return recording
    return replace(recording, channels=channels, notes=(*recording.notes, *notes))


def _moves(values: NDArray[np.float64]) -> bool:
    """True if (n, m) values are not all the same; absent ones do not count."""
    if not values.size or not values.strides[0]:  # of a field that a source lacks one row stands for all
        return False
    return bool(np.fmax.reduce(values, axis=None) > np.fmin.reduce(values, axis=None))


def _once(channel: Channel, notes: list[str]) -> Channel:
    moving = [v for v in channel.columns.values() if _moves(v)]
    if not moving:
        return channel
    values = np.column_stack(moving)
    every = period_of_updates(values)
    if every is None:
        return channel
    notes.append(f"{channel.topic}: each value stands in {every} messages; only the first of them is a measurement")
    return channel.select(np.flatnonzero(first_of_each(values, every)))
