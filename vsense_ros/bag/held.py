"""Messages of a satellite receiver that repeat its latest values until new ones come: each measurement is kept once.

A driver that publishes a receiver's 10 Hz at 100 Hz would make a filter believe each of them ten times.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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


def _once(channel: Channel, notes: list[str]) -> Channel:
    moving = [v for v in channel.columns.values() if v.shape[1] and np.isfinite(v).any() and np.nanstd(v) > 0]
    if not moving:
        return channel
    values = np.column_stack(moving)
    every = period_of_updates(values)
    if every is None:
        return channel
    notes.append(f"{channel.topic}: each value stands in {every} messages; only the first of them is a measurement")
    return channel.select(np.flatnonzero(first_of_each(values, every)))
