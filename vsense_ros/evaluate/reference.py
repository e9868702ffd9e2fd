"""The reference of a recording, moved from where its system sits to where the estimates are valid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.model.vehicle import Vehicle
from vsense_ros.recording import Recording

TOPIC = "reference/odometry"


def at_cog(recording: Recording, vehicle: Vehicle) -> Recording:
    """The same recording with `reference/odometry` moved to `cog`, by the mounting that the vehicle file states.

    A system at `position` whose forward axis is turned by `yaw` sees the velocity R(-yaw) (v + ω × position); rates
    that it did not measure (NaN) are taken to be zero for that.
    """
    mounting = vehicle.reference
    if TOPIC not in recording or (not any(mounting.position) and mounting.yaw == 0):
        return recording
    channel = recording[TOPIC]
    columns = dict(channel.columns)
    turn = Rotation.from_euler("z", mounting.yaw)
    arm = np.array(mounting.position)
    rates = turn.apply(np.nan_to_num(columns["angular"]))
    columns["linear"] = _turned(turn, columns["linear"]) - np.cross(rates, arm)
    columns["angular"] = _turned(turn, columns["angular"])
    attitude = Rotation.from_quat(columns["orientation"]) * turn.inv()
    columns["orientation"] = attitude.as_quat()
    columns["position"] = columns["position"] - attitude.apply(arm)
    channels = {**recording.channels, TOPIC: replace(channel, columns=columns)}
    return replace(recording, channels=channels)


def _turned(turn: Rotation, vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) turned about z; an absent z component stays absent and does not spread."""
    return np.column_stack([turn.apply(np.column_stack([vectors[:, :2], np.zeros(len(vectors))]))[:, :2], vectors[:, 2]])
