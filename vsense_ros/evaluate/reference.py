"""Estimates, moved from `cog` to where the reference system of a recording sits.

A reference that sits elsewhere, or whose axes are turned, measures other velocities than those of `cog`. The comparison
is made at its place, so that what was measured stays as it was measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle

ODOMETRY = "vsense/odometry"
SIDE_SLIP = "vsense/sideslip"
REFERENCE, SMOOTHED = "reference", "smoothed"  # what topics of a reference begin with: measured, or computed offline


def at_reference(output: Recording, vehicle: Vehicle) -> Recording:
    """The estimates of `output` as the reference system would see them, by the mounting that the vehicle file states.

    A system at `position` whose forward axis is turned by `yaw` sees the velocity R(-yaw) (v + ω × position). Position,
    attitude, velocity, rates and side slip are moved; covariances are left, since the mounting is taken as known. What
    is absent (NaN) stays so, and counts as zero for the rest.
    """
    mounting = vehicle.reference
    if ODOMETRY not in output or (not any(mounting.position) and mounting.yaw == 0):
        return output
    odometry = output[ODOMETRY]
    columns = dict(odometry.columns)
    turn = Rotation.from_euler("z", mounting.yaw)
    arm = np.array(mounting.position)
    attitude = Rotation.from_quat(columns["orientation"])
    columns["position"] = columns["position"] + attitude.apply(arm)
    columns["orientation"] = (attitude * turn).as_quat()
    linear, angular = (np.nan_to_num(columns[name]) for name in ("linear", "angular"))
    moved = {"linear": turn.inv().apply(linear + np.cross(angular, arm)), "angular": turn.inv().apply(angular)}
    for name, value in moved.items():
        columns[name] = np.where(np.isnan(columns[name]), np.nan, value)
    channels = {**output.channels, ODOMETRY: replace(odometry, columns=columns)}
    slip = output.channels.get(SIDE_SLIP)  # not every filter estimates it
    if slip is not None and len(slip) and np.array_equal(slip.stamp, odometry.stamp):
        vector = slip.columns["vector"].copy()
        vector[:, 0] = np.arctan2(columns["linear"][:, 1], columns["linear"][:, 0])
        channels[SIDE_SLIP] = replace(slip, columns={"vector": vector})
    return replace(output, channels=channels)


def judged_by(recording: Recording, source: str) -> Recording:
    """A recording whose topics below `source`, as of the bag that `vsense smooth` writes, are its reference.

    Raises `InputError` if it has none.
    """
    if source == REFERENCE:
        return recording
    plain_names = {topic: topic.strip("/") for topic in recording.channels}
    chosen = {
        topic: f"{REFERENCE}{name[len(source) :]}"
        for topic, name in plain_names.items()
        if name.startswith(f"{source}/")
    }
    if not chosen:
        sources = sorted({name.partition("/")[0] for name in plain_names.values() if name.endswith("/odometry")})
        raise InputError(
            f"{recording.name or 'recording'}: no topic {source}/… to compare with; "
            f"there {'is' if len(sources) == 1 else 'are'} {', '.join(sources) or 'none'} with an odometry "
            f"(`vsense smooth` writes a bag with {SMOOTHED}/odometry)"
        )
    channels = {
        t: c for t, c in recording.channels.items() if t not in chosen and plain_names[t].partition("/")[0] != REFERENCE
    }
    channels |= {new: replace(recording.channels[old], topic=new) for old, new in chosen.items()}
    return replace(recording, channels=channels)


def as_smoothed(recording: Recording, output: Recording) -> Recording:
    """A recording with the motion of a run's `output` beside it, on topics below `smoothed`."""
    moved = {f"{SMOOTHED}{topic.removeprefix('vsense')}": c for topic, c in output.channels.items()}
    others = {t: c for t, c in recording.channels.items() if t.strip("/").partition("/")[0] != SMOOTHED}
    return replace(recording, channels=others | {topic: replace(c, topic=topic) for topic, c in moved.items()})


def mounting_in_words(vehicle: Vehicle) -> str:
    """Where the estimates are compared, or nothing where that is `cog`."""
    mounting = vehicle.reference
    if not any(mounting.position) and mounting.yaw == 0:
        return ""
    x, y, z = mounting.position
    angle = np.degrees(mounting.yaw)
    return f"Compared at the reference system: ({x:.2f}, {y:.2f}, {z:.2f}) m from cog, its axes turned by {angle:.2f}°."
